"""Parameters of a node: declaring, reading, setting, descriptors, callbacks and services."""

from __future__ import annotations

from typing import Any

import pytest

from turtleact.rclpy import toplevel as rclpy
from turtleact.rclpy.exceptions import (
    InvalidParameterException,
    InvalidParameterTypeException,
    InvalidParameterValueException,
    ParameterAlreadyDeclaredException,
    ParameterImmutableException,
    ParameterNotDeclaredException,
    ParameterUninitializedException,
)
from turtleact.rclpy.messages import interface_class
from turtleact.rclpy.parameter import (
    AsyncParameterClient,
    Parameter,
    ParameterEventHandler,
)

Descriptor = interface_class("rcl_interfaces/msg/ParameterDescriptor")
IntegerRange = interface_class("rcl_interfaces/msg/IntegerRange")
FloatRange = interface_class("rcl_interfaces/msg/FloatingPointRange")
Result = interface_class("rcl_interfaces/msg/SetParametersResult")
Value = interface_class("rcl_interfaces/msg/ParameterValue")
Type = Parameter.Type
WRONG: Any = "int"


@pytest.fixture
def free(context):
    """A node whose parameters need no declaration."""
    return rclpy.create_node("free", context=context, allow_undeclared_parameters=True)


def names(node, prefixes=(), depth=0):
    found = node.list_parameters(list(prefixes), depth)
    return list(found.names), list(found.prefixes)


# --- a parameter by itself ----------------------------------------------------------------------


# --- declaring ----------------------------------------------------------------------------------


def test_a_declared_parameter_has_its_value_or_an_override(context):
    node = rclpy.create_node(
        "lab", context=context, parameter_overrides=[Parameter("speed", value=2.0)]
    )
    assert node.declare_parameter("speed", 1.0).value == 2.0
    assert node.declare_parameter("turns", 3).value == 3
    declared = node.declare_parameters("arm", [("length", 0.5), ("name", "left", Descriptor())])
    assert [each.name for each in declared] == ["arm.length", "arm.name"]
    assert node.get_parameter("arm.name").value == "left"


def test_overrides_are_declared_by_themselves_if_asked_for(context):
    node = rclpy.create_node(
        "lab",
        context=context,
        parameter_overrides=[Parameter("speed", value=2.0)],
        automatically_declare_parameters_from_overrides=True,
    )
    assert node.get_parameter("speed").value == 2.0


def test_a_parameter_may_be_declared_with_a_type_only(node):
    node.declare_parameter("speed", Type.DOUBLE)
    with pytest.raises(ParameterUninitializedException, match="not initialized"):
        node.get_parameter("speed")
    assert node.get_parameter_or("speed", Parameter("speed", value=9.0)).value == 9.0
    assert node.set_parameters([Parameter("speed", value=1.0)])[0].successful
    assert node.get_parameter("speed").value == 1.0


def test_a_declaration_without_a_type_is_warned_of(node):
    with pytest.warns(UserWarning, match="'speed' is declared without a type"):
        node.declare_parameter("speed")
    assert node.set_parameters([Parameter("speed", value="any")])[0].successful


def test_what_cannot_be_declared(context):
    node = rclpy.create_node(
        "lab", context=context, parameter_overrides=[Parameter("speed", value="fast")]
    )
    node.declare_parameter("turns", 3)
    with pytest.raises(TypeError, match="ParameterDescriptor"):
        node.declare_parameter("length", 3, WRONG)
    with pytest.raises(ParameterAlreadyDeclaredException, match="turns"):
        node.declare_parameter("turns", 3)
    with pytest.raises(InvalidParameterException, match="Invalid parameter name"):
        node.declare_parameter("", 3)
    with pytest.raises(InvalidParameterTypeException, match="expecting type 'DOUBLE'"):
        node.declare_parameter("speed", Type.DOUBLE)
    with pytest.raises(ValueError, match="can have no type"):
        node.declare_parameter("any", Type.DOUBLE, Descriptor(dynamic_typing=True))
    with pytest.raises(ValueError, match="PARAMETER_NOT_SET"):
        node.declare_parameter("empty", descriptor=Descriptor())


def test_a_declaration_may_hold_a_message(node):
    assert node.declare_parameter("turns", Value(type=2, integer_value=4)).value == 4


def test_a_parameter_can_be_undeclared_unless_it_is_read_only(node):
    node.declare_parameter("speed", 1.0)
    node.declare_parameter("fixed", 1.0, Descriptor(read_only=True))
    node.undeclare_parameter("speed")
    assert not node.has_parameter("speed")
    with pytest.raises(ParameterNotDeclaredException):
        node.undeclare_parameter("speed")
    with pytest.raises(ParameterImmutableException):
        node.undeclare_parameter("fixed")


# --- reading ------------------------------------------------------------------------------------


def test_an_undeclared_parameter_is_not_there(node, free):
    with pytest.raises(ParameterNotDeclaredException, match="speed"):
        node.get_parameter("speed")
    with pytest.raises(ParameterNotDeclaredException):
        node.get_parameter_type("speed")
    with pytest.raises(ParameterNotDeclaredException):
        node.describe_parameter("speed")
    assert node.get_parameter_or("speed").value is None
    assert free.get_parameter("speed").type_ is Type.NOT_SET
    assert free.get_parameter_type("speed") is Type.NOT_SET
    assert free.describe_parameters(["speed"]) == [Descriptor()]


def test_parameters_are_found_by_names_and_prefixes(node):
    node.declare_parameters("", [("arm.left.length", 1), ("arm.right", 2), ("speed", 3)])
    assert [each.value for each in node.get_parameters(["speed", "arm.right"])] == [3, 2]
    assert node.get_parameter_types(["speed"]) == [Type.INTEGER]
    assert set(node.get_parameters_by_prefix("arm")) == {"left.length", "right"}
    assert names(node, ["arm"]) == (["arm.left.length", "arm.right"], ["arm.left", "arm"])
    assert names(node, ["arm"], 1) == (["arm.right"], ["arm"])
    assert "speed" in names(node, depth=1)[0]


# --- setting ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("descriptor", "value", "reason"),
    [
        (Descriptor(), 1.5, "Wrong parameter type, expected 'Type.INTEGER' got 'Type.DOUBLE'"),
        (Descriptor(), None, "Static parameter cannot be undeclared"),
        (Descriptor(read_only=True), 6, "read-only"),
        (Descriptor(integer_range=[IntegerRange(from_value=0, to_value=9)]), 10, "out of range"),
        (
            Descriptor(integer_range=[IntegerRange(from_value=0, to_value=9, step=5)]),
            6,
            "in steps of 5, not 6",
        ),
    ],
)
def test_a_value_that_its_descriptor_forbids_is_refused(node, descriptor, value, reason):
    node.declare_parameter("turns", 5, descriptor)
    (result,) = node.set_parameters([Parameter("turns", value=value)])
    assert not result.successful
    assert reason in result.reason
    assert node.get_parameter("turns").value == 5


@pytest.mark.parametrize(
    ("value", "fits"), [(0.0, True), (1.0, True), (0.5, True), (0.3, False), (1.5, False)]
)
def test_a_float_is_near_a_step_of_its_range(node, value, fits):
    bounds = FloatRange(from_value=0.0, to_value=1.0, step=0.25)
    node.declare_parameter("speed", 0.25, Descriptor(floating_point_range=[bounds]))
    assert node.set_parameters([Parameter("speed", value=value)])[0].successful is fits


def test_a_descriptor_is_replaced_if_it_allows_a_value(node, free):
    node.declare_parameter("turns", 3)
    small = Descriptor(type=2, integer_range=[IntegerRange(from_value=0, to_value=2, step=1)])
    with pytest.raises(InvalidParameterValueException, match="out of range"):
        node.set_descriptor("turns", small)
    small.read_only = True
    assert node.set_descriptor("turns", small, Value(type=2, integer_value=1)).integer_value == 1
    assert node.describe_parameter("turns").name == "turns"
    with pytest.raises(ParameterImmutableException):
        node.set_descriptor("turns", Descriptor())
    assert free.set_descriptor("turns", small).type == 0


def test_all_parameters_are_set_or_none(node):
    node.declare_parameters("", [("a", 1), ("b", 2)])
    result = node.set_parameters_atomically([Parameter("a", value=5), Parameter("b", value="x")])
    assert not result.successful
    assert node.get_parameter("a").value == 1
    with pytest.raises(ParameterNotDeclaredException):
        node.set_parameters_atomically([Parameter("a", value=5), Parameter("c", value=1)])


def test_an_undeclared_parameter_comes_and_goes_where_that_is_allowed(free):
    assert free.set_parameters([Parameter("speed", value=1.0)])[0].successful
    assert free.has_parameter("speed")
    assert free.set_parameters([Parameter("speed")])[0].successful
    assert not free.has_parameter("speed")


def test_callbacks_change_refuse_and_follow_a_change(node):
    followed: list[object] = []

    def double(parameters):
        return [Parameter(each.name, value=2 * each.value) for each in parameters]

    def refuse(parameters):
        return Result(successful=parameters[0].value < 10, reason="too fast")

    node.declare_parameter("speed", 1)
    node.add_pre_set_parameters_callback(double)
    node.add_on_set_parameters_callback(refuse)
    node.add_post_set_parameters_callback(followed.append)
    assert node.set_parameters([Parameter("speed", value=3)])[0].successful
    assert node.get_parameter("speed").value == 6
    assert node.set_parameters([Parameter("speed", value=6)])[0].reason == "too fast"
    assert len(followed) == 1
    node.remove_pre_set_parameters_callback(double)
    node.remove_on_set_parameters_callback(refuse)
    node.remove_post_set_parameters_callback(followed.append)
    assert node.set_parameters([Parameter("speed", value=99)])[0].successful
    node.add_pre_set_parameters_callback(lambda _: [])
    assert "cannot be empty" in node.set_parameters([Parameter("speed", value=1)])[0].reason


def test_a_callback_may_refuse_an_initial_value(node):
    node.add_on_set_parameters_callback(lambda _: Result(successful=False, reason="never"))
    with pytest.raises(InvalidParameterValueException, match="never"):
        node.declare_parameter("speed", 1.0)


# --- through services ---------------------------------------------------------------------------


@pytest.fixture
def ask(node, executor):
    """Calls a method of a parameter client of the node itself, and returns the response."""
    client = AsyncParameterClient(node, "lab")
    assert client.wait_for_services(1)

    def ask(method, *arguments):
        future = getattr(client, method)(*arguments)
        executor.spin_until_future_complete(future, timeout_sec=2)
        return future.result()

    return ask


def test_another_node_sees_and_sets_parameters(node, ask):
    node.declare_parameter("speed", 1.0)
    speed = Parameter("speed", value=2.0)
    assert "speed" in ask("list_parameters").result.names
    assert ask("list_parameters", ["speed"], 1).result.names == ["speed"]
    assert ask("get_parameters", ["speed"]).values[0].double_value == 1.0
    assert list(ask("get_parameters", ["nothing"]).values) == []
    assert list(ask("get_parameter_types", ["speed"]).types) == [3]
    assert list(ask("get_parameter_types", ["nothing"]).types) == []
    assert [each.name for each in ask("describe_parameters", ["speed", "x"]).descriptors] == [
        "speed",
        "x",
    ]
    assert ask("set_parameters", [speed]).results[0].successful
    assert not ask("set_parameters", [Parameter("x", value=1)]).results[0].successful
    assert ask("set_parameters_atomically", [speed.to_parameter_msg()]).result.successful
    assert not ask("set_parameters_atomically", [Parameter("x", value=1)]).result.successful
    assert "undeclared" in ask("delete_parameters", ["speed"]).results[0].reason


def test_another_node_loads_a_file(node, ask, tmp_path):
    node.declare_parameter("speed", 1.0)
    file = tmp_path / "lab.yaml"
    file.write_text("/lab: {ros__parameters: {speed: 3.0}}")
    assert ask("load_parameter_file", str(file)).results[0].successful
    assert ask("load_parameter_file_atomically", str(file)).result.successful
    assert node.get_parameter("speed").value == 3.0


def test_changes_are_published_and_handled(node, executor):
    handler = ParameterEventHandler(node)
    seen: list[str] = []
    events: list[Any] = []
    one = handler.add_parameter_callback("speed", "lab", lambda each: seen.append(each.name))
    every = handler.add_parameter_event_callback(events.append)
    node.declare_parameter("speed", 1.0)
    node.declare_parameter("turns", 1)
    for _ in range(2):
        executor.spin_once(timeout_sec=1)
    assert (seen, len(events)) == (["speed"], 2)
    handler.remove_parameter_callback(one)
    handler.remove_parameter_event_callback(every)
    with pytest.raises(RuntimeError, match="doesn't exist"):
        handler.remove_parameter_callback(one)
    with pytest.raises(RuntimeError, match="doesn't exist"):
        handler.remove_parameter_event_callback(every)
    assert handler.get_parameter_from_event(events[0], "speed", "/hall") is None
    handler.destroy()
