"""``interface``: what there is, as ``ros2 interface`` prints it."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import pytest

import turtleact.actions  # noqa: F401  # for the interfaces that they declare
from turtleact.interfaces.finders import Finders
from turtleact.interfaces.types import REGISTRY

from ..registry import isolated_registry

GOLDEN = json.loads(Path(__file__).with_name("golden").joinpath("verbs.json").read_text())
SHOWN = [case for case in GOLDEN if " interface show " in case["command"]]


@pytest.fixture(autouse=True)
def own_registry(monkeypatch):
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    with isolated_registry():
        REGISTRY.look_in(Finders())
        yield


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Puts an interface file into a ROS workspace that is sourced."""

    def put(type_name, text, *, is_sourced=True):
        package, kind, name = type_name.split("/")
        share = tmp_path / "share" if is_sourced else tmp_path
        path = share / package / kind / f"{name}.{kind}"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        if is_sourced:
            monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path}")
        return tmp_path

    return put


def arguments_of(case):
    return shlex.split(case["command"])[1:]


# --- as recorded ----------------------------------------------------------------------------


@pytest.mark.parametrize("case", SHOWN, ids=lambda case: case["case"])
def test_a_definition_is_shown_as_ros2_shows_it(turtleact, install, case):
    lines = [line for line in case["stdout"].splitlines() if not line.startswith("\t")]
    install(arguments_of(case)[-1], "\n".join(lines) + "\n")
    ran = turtleact(*arguments_of(case))
    assert (ran.status, ran.out) == (case["exit"], case["stdout"])


def test_a_prototype_is_printed_as_ros2_prints_it(turtleact):
    [case] = [case for case in GOLDEN if case["case"] == "interface_proto"]
    assert turtleact(*arguments_of(case)).out == case["stdout"]


def test_all_that_ros2_lists_is_listed_in_its_order(turtleact):
    [case] = [case for case in GOLDEN if case["case"] == "interface_list_a"]
    recorded = case["stdout"].splitlines()
    listed = turtleact(*arguments_of(case)).out.splitlines()
    assert [line for line in listed if line in recorded] == recorded


# --- list, package, packages ----------------------------------------------------------------


def test_everything_is_listed_by_its_kind(turtleact):
    lines = turtleact("interface", "list").out.splitlines()
    assert [line for line in lines if line[0] != " "] == ["Messages:", "Services:", "Actions:"]
    assert "    turtleact_interfaces/action/GoTo" in lines[lines.index("Actions:") :]


def test_an_unknown_package_is_an_error_that_names_the_nearest(turtleact):
    ran = turtleact("interface", "package", "turtlesin")
    assert (ran.status, ran.out) == (1, "")
    assert ran.err == "turtleact: unknown package 'turtlesin', did you mean 'turtlesim'?\n"


# --- show -----------------------------------------------------------------------------------


@pytest.fixture
def paint(install):
    """A service with comments, whose message has some too."""
    install("turtlesim/msg/Color", "# Red, green, blue.\nuint8 r # red\nuint8 g\nuint8 b\n")
    install("paint_interfaces/srv/Paint", WITH_COMMENTS.format(nested=""))
    return "paint_interfaces/srv/Paint"


WITH_COMMENTS = """# What is asked for.

turtlesim/Color[] colors  # as many as you like
{nested}uint8 MOST=3  # a constant
---
"""


@pytest.mark.parametrize(
    ("options", "shown"),
    [
        ([], WITH_COMMENTS.format(nested="\tuint8 r\n\tuint8 g\n\tuint8 b\n")),
        (
            ["--all-comments"],
            WITH_COMMENTS.format(
                nested="\t# Red, green, blue.\n\tuint8 r # red\n\tuint8 g\n\tuint8 b\n"
            ),
        ),
        (
            ["--no-comments"],
            "turtlesim/Color[] colors\n\tuint8 r\n\tuint8 g\n\tuint8 b\nuint8 MOST=3\n---\n",
        ),
    ],
)
def test_comments_are_shown_as_asked_for(turtleact, paint, options, shown):
    assert turtleact("interface", "show", paint, *options).out == shown


@pytest.mark.parametrize("name", ["/fibonacci", "fibonacci"])
def test_an_action_of_the_graph_is_shown_with_a_goal_to_copy(on_graph, graphs, name):
    ran = on_graph(graphs.fibonacci, "interface", "show", name)
    fields, goal = ran.out.split("\n\n")
    assert "counted from 0.\nint32 order\n---\n# The Fibonacci numbers" in fields
    assert goal == f"To send it:  turtleact send-goal {name} '{{order: 0}}'\n"


def test_an_action_that_is_not_there_is_told_with_the_nearest(on_graph, graphs):
    ran = on_graph(graphs.fibonacci, "interface", "show", "fibonaci")
    assert ran.status == 1
    assert "action '/fibonaci' is not there, did you mean '/fibonacci'?" in ran.err


def test_control_characters_of_comments_do_not_reach_the_terminal(turtleact, install):
    install("paint_interfaces/msg/Pot", "# red\x1b[31m\x07\u3000\u200d\nuint8 r\t# a\tb\x00\n")
    out = turtleact("interface", "show", "paint_interfaces/msg/Pot").out
    assert out == "# red[31m\u3000\u200d\nuint8 r\t# a\tb\n"


def test_a_class_without_a_file_is_shown_with_the_comments_of_its_docstrings(turtleact):
    shown = turtleact("interface", "show", "turtleact_interfaces/GoTo").out
    assert shown.startswith("# Go to a place.\n\n# Where to go, which turtle goes, and how")
    assert "\n# The x coordinate of the place (m).\nfloat64 x\n" in shown


def test_the_type_may_come_from_a_pipe(turtleact, stdin_of):
    stdin_of(b"std_msgs/msg/String\nmore\n")
    assert turtleact("interface", "show", "-").out == "string data\n"


# --- what is known --------------------------------------------------------------------------


def test_interfaces_of_a_folder_are_known(turtleact, install):
    folder = install("paint_interfaces/msg/Hue", "float64 hue\n", is_sourced=False)
    ran = turtleact("interface", "show", "paint_interfaces/msg/Hue", "--interfaces", str(folder))
    assert (ran.status, ran.out) == (0, "float64 hue\n")


# --- near the working directory -------------------------------------------------------------


def test_an_interface_near_the_working_directory_is_found_with_a_note(
    turtleact, tmp_path, monkeypatch
):
    for name in ("Go", "Come"):
        put(tmp_path / "src" / "lab" / "action" / f"{name}.action", "int32 x\n---\n---\n")
    monkeypatch.chdir(tmp_path)
    ran = turtleact("interface", "proto", "lab/action/Go", "--no-quotes")
    assert ran == (0, "x: 0\n\n", f"turtleact: found lab/action/Go in {tmp_path}/src/lab\n")
    assert "lab/action/Come" in turtleact("interface", "package", "lab").out
    assert turtleact("interface", "show", "std_msgs/msg/Bool").err == ""


def test_the_option_comes_before_the_workspace_and_that_before_the_working_directory(
    turtleact, install, tmp_path, monkeypatch
):
    install("lab/msg/Here", "int32 installed")
    for folder, name in (("here", "Here"), ("here", "There"), ("option", "There")):
        put(tmp_path / folder / "lab" / "msg" / f"{name}.msg", f"int32 {folder}")
    monkeypatch.chdir(tmp_path / "here")
    shown = [
        turtleact("interface", "show", f"lab/msg/{name}", "--interfaces", f"{tmp_path}/option").out
        for name in ("Here", "There")
    ]
    assert shown == ["int32 installed\n", "int32 option\n"]


ADVICE = (
    "source the ROS workspace that has the interface, give --interfaces DIR, or change to the "
    "folder of"
)


@pytest.mark.parametrize(
    ("type_name", "problem"),
    [
        ("labs/action/Gone", f"unknown interface 'labs/action/Gone': {ADVICE} its package"),
        ("std_msgs/msg/Strin", f"did you mean 'std_msgs/msg/String'? If not, {ADVICE} its"),
        ("lab/msg/Out", "lab/msg/Out: x: unknown interface 'labs/msg/Gone'"),
        ("lab/msg/Out", f"\nto make it known, {ADVICE} its package\n"),
    ],
)
def test_an_unknown_interface_comes_with_what_to_do(
    turtleact, tmp_path, monkeypatch, type_name, problem
):
    put(tmp_path / "lab" / "msg" / "Out.msg", "labs/Gone x")
    monkeypatch.chdir(tmp_path)
    ran = turtleact("interface", "show", type_name)
    assert (ran.status, ran.out) == (1, "")
    assert problem in ran.err


def put(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
