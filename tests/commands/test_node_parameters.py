"""``param``: what a node's parameters are, and what they shall be."""

from __future__ import annotations

import json
import shlex
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path

import anyio
import pytest

from turtleact import open_node
from turtleact.commands.node_parameters import parameter_value
from turtleact.interfaces.standard.rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ListParametersResult,
    ParameterDescriptor,
    ParameterValue,
    SetParametersResult,
)
from turtleact.interfaces.standard.rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParameters,
)

GOLDEN = {
    case["case"]: case
    for case in json.loads(Path(__file__).with_name("golden").joinpath("verbs.json").read_text())
}
EVENTS = "qos_overrides./parameter_events.publisher."
OF_TURTLESIM = {
    "background_b": "255",
    "background_g": "86",
    "background_r": "69",
    "holonomic": "false",
    f"{EVENTS}depth": "1000",
    f"{EVENTS}durability": "volatile",
    f"{EVENTS}history": "keep_last",
    f"{EVENTS}reliability": "reliable",
    "start_type_description_service": "true",
    "use_sim_time": "false",
}
ALL_KINDS = {
    "yes": "true",
    "whole": "7",
    "part": "0.5",
    "text": "a: b",
    "bools": "[true, false]",
    "wholes": "[1, 2]",
    "parts": "[0.5, .inf]",
    "texts": "[a, 'on']",
}


def values_of(texts):
    return {name: parameter_value(text) for name, text in texts.items()}


def answering(name, answers):
    """A node whose services of parameters give these answers, each a message or a function."""

    @asynccontextmanager
    async def nodes(transport):
        async with open_node(name, transport=transport) as node:
            for service, answer in answers.items():
                words = service.type_name.rpartition("/")[2].removesuffix("Parameters").lower()
                reply = answer if callable(answer) else partial(saying, answer)
                node.service(service, f"~/{words}_parameters", reply)
            yield

    return nodes


def saying(answer, _request):
    return answer


def having(values, name="turtlesim"):
    """A node that has these parameters, all read-only."""
    described = {
        each: ParameterDescriptor(each, value.type, read_only=True)
        for each, value in values.items()
    }
    if "part" in described:
        described["part"].floating_point_range = [FloatingPointRange(0.0, 2.0)]
        described["part"].additional_constraints = "no thirds"

    def found(known, names):
        return [known[each] for each in names] if known.keys() >= set(names) else []

    def listed(asked):
        groups = tuple(f"{each}." for each in asked.prefixes)
        names = [each for each in values if not groups or each.startswith(groups)]
        return ListParameters.Response(ListParametersResult(names))

    return answering(
        name,
        {
            ListParameters: listed,
            GetParameters: lambda asked: GetParameters.Response(found(values, asked.names)),
            DescribeParameters: lambda asked: DescribeParameters.Response(
                found(described, asked.names)
            ),
            SetParameters: lambda asked: SetParameters.Response(
                [SetParametersResult(True, "noted") for _ in asked.parameters]
            ),
        },
    )


async def think(_):
    await anyio.sleep_forever()


def test_a_node_that_does_not_answer_hides_no_other(on_graph, graphs):
    stuck = answering("camera", {ListParameters: think, GetParameters: think})
    nodes = graphs.in_turn(stuck, having({"yes": parameter_value("true")}))
    assert on_graph(nodes, "param", "list") == (
        1,
        "/turtlesim:\n  yes\n",
        "turtleact: service '/camera/list_parameters': no response within 5 s\n",
    )


@pytest.fixture
def on_turtlesim(on_graph, graphs):
    """Runs ``param`` on the graph of turtlesim's parameters."""
    return lambda *arguments: on_graph(graphs.parameters, "param", *arguments)


# --- as recorded ----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["param_list", "param_dump"])
def test_it_prints_what_ros2_prints(on_graph, name):
    case = GOLDEN[name]
    ran = on_graph(having(values_of(OF_TURTLESIM)), *shlex.split(case["command"])[1:])
    assert (ran.status, ran.out, ran.err) == (case["exit"], case["stdout"], "")


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("yes", "Boolean value is: True"),
        ("whole", "Integer value is: 7"),
        ("text", "String value is: a: b"),
        ("parts", "Double values are: [0.5, inf]"),
        ("texts", "String values are: ['a', 'on']"),
        ("bytes", "Byte values are: [1, 2]"),
        ("nothing", "Parameter not set."),
    ],
)
def test_a_value_is_printed_with_its_kind_as_by_ros2(on_graph, name, expected):
    values = values_of(ALL_KINDS) | {
        "bytes": ParameterValue(5, byte_array_value=[1, 2]),
        "nothing": ParameterValue(),
    }
    assert on_graph(having(values), "param", "get", "/turtlesim", name).out == f"{expected}\n"


def test_a_description_has_the_lines_of_ros2(on_graph):
    ran = on_graph(having(values_of(ALL_KINDS)), "param", "describe", "turtlesim", "part", "yes")
    assert ran.out == (
        "Parameter name: part\n  Type: double\n  Constraints:\n    Read only: true\n"
        "    Min value: 0.0\n    Max value: 2.0\n    Additional constraints: no thirds\n"
        "Parameter name: yes\n  Type: boolean\n  Constraints:\n    Read only: true\n"
    )


# --- list -----------------------------------------------------------------------------------


def test_the_parameters_of_one_node_stand_alone(on_turtlesim):
    assert on_turtlesim("list", "turtlesim").out == (
        "  background_b\n  background_g\n  background_r\n  holonomic\n"
    )


def test_kinds_are_listed_and_names_filtered(on_turtlesim):
    ran = on_turtlesim("list", "--param-type", "--filter", "h|.*_b")
    assert ran.out == ("/turtlesim:\n  background_b (type: integer)\n  holonomic (type: boolean)\n")


def test_a_group_is_listed_alone(on_graph):
    ran = on_graph(
        having(values_of(OF_TURTLESIM)), "param", "list", "--param-prefixes", "qos_overrides"
    )
    assert ran.out.splitlines()[1:] == [f"  {each}" for each in OF_TURTLESIM if EVENTS in each]


@pytest.mark.parametrize(
    ("option", "out"), [((), ""), (("--include-hidden-nodes",), "/_x:\n  a\n")]
)
def test_hidden_nodes_are_listed_if_asked_for(on_graph, option, out):
    assert on_graph(having(values_of({"a": "1"}), "_x"), "param", "list", *option).out == out


# --- set, delete, dump, load ----------------------------------------------------------------


def test_a_value_that_is_taken_is_told_as_by_ros2_and_there(on_graph, graphs):
    values = []

    @asynccontextmanager
    async def nodes(transport):
        async with graphs.parameters(transport) as declared:
            yield
            values.append(declared["background_r"].value)

    ran = on_graph(nodes, "param", "set", "/turtlesim", "background_r", "150")
    assert (ran, values) == ((0, "Set parameter successful\n", ""), [150])


@asynccontextmanager
async def numbers(transport):
    async with open_node("lab", transport=transport) as node:
        speed = node.parameter("speed", 1.0, range=(0, 2))
        gains = node.parameter("gains", [1.0])
        data = node.parameter("data", b"on")
        label = node.parameter("label", "a")
        yield speed, gains, data, label


CURT = answering(
    "lab",  # it refuses without the range, as nodes of ROS 2 do
    {
        GetParameters: GetParameters.Response(),
        ListParameters: ListParameters.Response(ListParametersResult(["whole"])),
        DescribeParameters: DescribeParameters.Response(
            [ParameterDescriptor("whole", 2, integer_range=[IntegerRange(0, 9)])]
        ),
        SetParameters: SetParameters.Response([SetParametersResult(False, "No.")]),
    },
)


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("speed", "2", 2.0),
        ("gains", "[1, 2]", [1.0, 2.0]),
        ("data", "[1, 255]", b"\x01\xff"),
        ("label", "'5'", "5"),
    ],
)
def test_a_value_is_taken_as_the_type_of_its_parameter(on_graph, name, text, value):
    values: dict[str, object] = {}

    @asynccontextmanager
    async def nodes(transport):
        async with numbers(transport) as parameters:
            yield
            values.update((each.name, each.value) for each in parameters)

    ran = on_graph(nodes, "param", "set", "/lab", name, text)
    assert (ran.status, ran.out, values[name]) == (0, "Set parameter successful\n", value)


def test_the_range_is_named_if_the_node_does_not_name_it(on_graph):
    ran = on_graph(CURT, "param", "set", "/lab", "whole", "300")
    assert ran.err == "turtleact: Setting parameter failed: No: it takes 0 to 9, not 300\n"


def test_what_a_node_says_to_a_value_it_takes_is_printed(on_graph):
    ran = on_graph(having({}), "param", "set", "/turtlesim", "x", "-1")
    assert ran.out == "Set parameter successful: noted\n"


def test_a_parameter_can_be_deleted_if_its_node_lets_us(on_graph):
    assert on_graph(having({}), "param", "delete", "/turtlesim", "x").out == (
        "Deleted parameter successfully: noted\n"
    )


def test_what_was_dumped_can_be_loaded(on_graph, tmp_path):
    values = values_of(ALL_KINDS | {"group.inner.x": "1", "group.y": "2", "yes.no": "3"})
    dumped = on_graph(having(values), "param", "dump", "/turtlesim").out
    file = tmp_path / "params.yaml"
    file.write_text(dumped)
    ran = on_graph(having(values), "param", "load", "/turtlesim", str(file))
    assert ran.out == "".join(
        f"Set parameter {name} successful: noted\n" for name in sorted(values)
    )


def test_loading_tells_what_was_not_taken(on_turtlesim, tmp_path):
    file = tmp_path / "params.yaml"
    file.write_text(
        "/**: {ros__parameters: {background_r: 1, background_g: 300}}\n"
        "/other: {ros__parameters: {background_b: 2}}\n"
        "turtlesim: {ros__parameters: {holonomic: true}}\n"
    )
    ran = on_turtlesim("load", "/turtlesim", str(file))
    assert (ran.status, ran.out) == (
        1,
        "Set parameter background_r successful\nSet parameter holonomic successful\n",
    )
    assert ran.err == (
        "turtleact: Set parameter background_g failed: "
        "Parameter {background_g} doesn't comply with integer range. "
        "It takes 0 to 255, not 300.\n"
    )
    assert on_turtlesim("load", "/turtlesim", str(file), "--no-use-wildcard").out == (
        "Set parameter holonomic successful\n"
    )


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("/other: {ros__parameters: {x: 1}}", "has no parameters for /turtlesim, but for /other"),
        ("", ": is empty: 'param dump' prints such a file\n"),
        ("hello", ": holds no nodes with their parameters: 'param dump' prints such a file\n"),
        ("/turtlesim: {x: 1}", "/turtlesim has no ros__parameters"),
        ("/turtlesim: {ros__parameters: {a: {b: null}}}", "a.b: a parameter is a bool, a number"),
        ("/turtlesim: {ros__parameters: {a: [1", "1:37: "),
        (None, "No such file or directory"),
    ],
)
def test_a_file_that_cannot_be_loaded_is_a_usage_error(on_turtlesim, tmp_path, text, problem):
    file = tmp_path / "params.yaml"
    if text is not None:
        file.write_bytes(text if isinstance(text, bytes) else f"{text}\n".encode())
    ran = on_turtlesim("load", "/turtlesim", str(file))
    assert ran.status == 2
    assert ran.err.startswith(f"turtleact: {file}")
    assert problem in ran.err


# --- values ---------------------------------------------------------------------------------


@pytest.mark.parametrize("text", ["null", "[1, a]", "[1, 0.5]", "[[1]]"])
def test_what_is_of_no_kind_is_refused(on_turtlesim, text):
    ran = on_turtlesim("set", "/turtlesim", "background_r", text)
    assert ran.status == 2
    assert "a bool, a number, text, or a list of values of one kind" in ran.err


# --- nodes that are not there ---------------------------------------------------------------


@pytest.mark.parametrize("line", ["list X", "set X a 1", "dump X"])
def test_an_unknown_node_is_told_with_the_nearest(on_turtlesim, line):
    ran = on_turtlesim(*line.replace("X", "/turtlesin").split())
    assert (ran.status, ran.err) == (
        1,
        "turtleact: there is no node '/turtlesin', did you mean '/turtlesim'?\n",
    )


def test_a_node_that_comes_late_is_waited_for(on_graph, graphs):
    nodes = graphs.later(0.9, graphs.parameters)
    assert on_graph(nodes, "param", "get", "/turtlesim", "background_r").status == 0


def test_a_node_without_parameters_is_told_so(on_graph, graphs):
    ran = on_graph(graphs.fibonacci, "param", "dump", "/fibonacci_action_server")
    assert ran.err == (
        "turtleact: node '/fibonacci_action_server' has no parameters: "
        "nobody serves /fibonacci_action_server/get_parameters\n"
    )


def test_an_unknown_parameter_is_told_with_the_nearest(on_turtlesim):
    ran = on_turtlesim("get", "/turtlesim", "holonomik", "--hide-type")
    assert (ran.status, ran.err) == (
        1,
        "turtleact: node '/turtlesim' has no parameter 'holonomik', did you mean 'holonomic'?\n",
    )
