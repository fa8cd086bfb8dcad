"""Types that are learned from the nodes that use them, and what lying nodes get."""

from __future__ import annotations

import json
from contextlib import asynccontextmanager
from typing import Any

import anyio
import msgspec
import pytest

from turtleact import (
    NotLearned,
    TurtleactError,
    UnknownInterface,
    get_interface,
    learn_interface,
    open_node,
    open_zenoh,
)
from turtleact.interfaces import type_hash
from turtleact.interfaces.loading import authored_text, comments
from turtleact.interfaces.standard import Fibonacci, Point
from turtleact.interfaces.type_hash import structure_hash
from turtleact.interfaces.types import REGISTRY
from turtleact.transports import MemoryTransport

from ..lab import free_endpoint, running
from ..registry import isolated_registry
from ..robots import FILES, Robot, write_package

DIG = "robot_msgs/action/Dig"
PARTS = ("_SendGoal", "_GetResult", "_FeedbackMessage")
BATTERY = "robot_msgs/msg/Battery"


@pytest.fixture(autouse=True)
def empty_cache(tmp_path, monkeypatch):
    """A cache of this test alone, and a registry that forgets what the test learns."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with isolated_registry():
        yield tmp_path / "cache" / "turtleact" / "types"


@pytest.fixture
def package(tmp_path):
    return write_package(tmp_path)


@asynccontextmanager
async def robot_and_node(package):
    transport = MemoryTransport()
    robot = Robot(transport, package)
    async with open_node("here", transport=transport) as node:
        node.learner.note = robot.notes.append
        yield robot, node


async def test_an_action_is_learned_by_its_name_alone_with_text_comments_and_constants(package):
    async with robot_and_node(package) as (robot, node):
        robot.serve_action("/dig", DIG)
        dig: Any = await learn_interface(node, "dig")
        assert (dig.type_name, type_hash(dig)) == (DIG, robot.hash_of(DIG))
        assert authored_text(dig) == FILES["action/Dig.action"]
        assert comments(dig.Goal)["depth"] == "How deep to dig (m)"
        assert comments(dig.Feedback)["so_far"] == "how much was dug"
        assert dig.Goal.FAST == 2
        assert dig.Goal(where=Point(x=1.0)).where.x == 1.0
        with pytest.raises(TypeError, match="did you mean 'depth'"):
            dig.Goal(deph=1.0)
        assert not robot.notes


async def test_an_action_is_learned_once_all_endpoints_of_its_server_are_known(package):
    async with robot_and_node(package) as (robot, node):
        robot.open("service", "/dig/_action/send_goal", f"{DIG}_SendGoal")
        async with running(lambda: learn_interface(node, "dig")) as learned:
            await anyio.wait_all_tasks_blocked()
            robot.open("service", "/dig/_action/get_result", f"{DIG}_GetResult")
            await anyio.wait_all_tasks_blocked()
            robot.open("publisher", "/dig/_action/feedback", f"{DIG}_FeedbackMessage")
            await learned.done.wait()
            assert learned.value.type_name == DIG


async def test_the_hashes_of_two_types_under_one_name_are_not_mixed(package):
    async with robot_and_node(package) as (robot, node):
        robot.serve_action("/dig", DIG)
        other = f"RIHS01_{'0' * 64}"
        robot.open("service", "/dig/_action/send_goal", "lab_msgs/action/Dig_SendGoal", other)
        robot.open("service", "/dig/_action/get_result", "lab_msgs/action/Dig_GetResult", other)
        robot.open(
            "publisher", "/dig/_action/feedback", "lab_msgs/action/Dig_FeedbackMessage", other
        )
        parts = [robot.hash_of(f"{DIG}{part}") for part in PARTS]
        found = {use.type_name: use.hashes for use in node.learner.uses("/dig")}
        assert found == {DIG: tuple(parts), "lab_msgs/action/Dig": (other,) * 3}


async def test_a_learned_class_is_not_registered(package):
    async with robot_and_node(package) as (robot, node):
        robot.serve_action("/dig", DIG)
        dig = await learn_interface(node, "dig")
        assert await learn_interface(node, "dig") is dig
        with pytest.raises(UnknownInterface):
            get_interface(DIG)


@pytest.mark.parametrize(
    ("kind", "name", "type_name"),
    [("publisher", "/battery", BATTERY), ("service", "/grip", "robot_msgs/srv/Grip")],
)
async def test_topics_and_services_are_learned(package, kind, name, type_name):
    async with robot_and_node(package) as (robot, node):
        robot.open(kind, name, type_name)
        found = await learn_interface(node, name)
        assert (found.type_name, type_hash(found)) == (type_name, robot.hash_of(type_name))
        assert (
            authored_text(found)
            == FILES[f"{type_name.removeprefix('robot_msgs/')}.{type_name.split('/')[1]}"]
        )


async def test_a_type_that_is_known_here_under_the_hash_is_not_asked_for(package):
    async with robot_and_node(package) as (robot, node):
        robot.open("publisher", "/at", Point.type_name, type_hash(Point))
        assert await learn_interface(node, "at") is Point
        assert not robot.asked


async def test_what_was_learned_is_not_asked_for_again_in_another_process(package):
    async with robot_and_node(package) as (robot, node):
        robot.serve_action("/dig", DIG)
        first = await learn_interface(node, "dig")
        REGISTRY.learned.clear()
        robot.asked.clear()
        second: Any = await learn_interface(node, "dig")
        assert second is not first
        assert type_hash(second) == type_hash(first)
        assert authored_text(second) == FILES["action/Dig.action"]
        assert not robot.asked


async def test_defaults_come_from_the_node_that_is_asked_now_and_never_from_the_cache(tmp_path):
    seven = write_package(tmp_path / "a", {"msg/Mode.msg": "uint8 A=9\nuint8 mode 7\n"})
    one = write_package(tmp_path / "b", {"msg/Mode.msg": "uint8 A=1\nuint8 mode 1\n"})
    transport = MemoryTransport()
    robots = [Robot(transport, seven, "/seven"), Robot(transport, one, "/one")]
    async with open_node("here", transport=transport) as node:
        notes: list[str] = []
        node.learner.note = notes.append
        for robot in robots:
            robot.open("publisher", f"{robot.node}/mode", "robot_msgs/msg/Mode")
        learned: list[Any] = [await learn_interface(node, f"{each.node}/mode") for each in robots]
        assert [each().mode for each in learned] == [7, 1]
        assert [each.A for each in learned] == [9, 1]
        assert type_hash(learned[0]) == type_hash(learned[1])
        REGISTRY.learned.clear()
        robots[0].answer = lambda request, truth: type(truth)(failure_reason="not now")
        silent: Any = await learn_interface(node, "/seven/mode")
        assert silent().mode == 0
        assert notes == [
            "the fields of robot_msgs/msg/Mode start with zeros: node /seven does not describe it: "
            "'not now'"
        ]


async def test_another_definition_under_a_known_name_is_learned_with_one_note(tmp_path):
    changed = tmp_path / Fibonacci.type_name.partition("/")[0]
    (changed / "action").mkdir(parents=True)
    text = "int32 order\nstring why\n---\nint32[] sequence\n---\nint32[] partial_sequence\n"
    (changed / "action" / "Fibonacci.action").write_text(text)
    async with robot_and_node(changed) as (robot, node):
        robot.serve_action("/fibonacci", Fibonacci.type_name)
        learned: Any = await learn_interface(node, "fibonacci")
        assert learned.Goal(why="so").why == "so"
        assert get_interface(Fibonacci.type_name) is Fibonacci
        await learn_interface(node, "fibonacci")
        assert robot.notes == [
            f"node /robot defines {Fibonacci.type_name} differently; its definition is used"
        ]


async def test_several_kinds_or_hashes_under_one_name_are_listed(package):
    async with robot_and_node(package) as (robot, node):
        robot.open("publisher", "/x", BATTERY)
        robot.open("service", "/x", "robot_msgs/srv/Grip")
        with pytest.raises(
            TurtleactError, match=r"'/x' has several types: service of .*; topic of"
        ):
            await learn_interface(node, "x")
        assert (await learn_interface(node, "x", "topic")).type_name == BATTERY


async def test_a_name_is_awaited_until_the_timeout(package):
    async with robot_and_node(package) as (robot, node):
        with pytest.raises(TurtleactError, match="the graph has no topic '/battery'"):
            await learn_interface(node, "battery", "topic", timeout=0)
        async with anyio.create_task_group() as group:
            group.start_soon(learn_interface, node, "battery")
            await anyio.lowlevel.checkpoint()
            robot.open("publisher", "/battery", BATTERY)


# --- lies -----------------------------------------------------------------------------------


def renamed(truth, name):
    fields = truth.type_description.type_description.fields
    fields[0] = msgspec.structs.replace(fields[0], name=name)
    return truth


def nested(truth, name):
    whole = truth.type_description.type_description
    kind = type(whole.fields[0].type)(1, 0, 0, name)
    whole.fields[0] = msgspec.structs.replace(whole.fields[0], type=kind)
    return truth


def of_type(truth, number, capacity=0):
    whole = truth.type_description.type_description
    kind = type(whole.fields[0].type)(number, capacity)
    whole.fields[0] = msgspec.structs.replace(whole.fields[0], type=kind)
    return truth


def repeated(truth, count):
    whole = truth.type_description.type_description
    whole.fields = [msgspec.structs.replace(whole.fields[0], name=f"f{n}") for n in range(count)]
    return truth


LIES = {
    "another type": (lambda truth: renamed(truth, "other"), "describes a type of another hash"),
    "a failure": (
        lambda truth: type(truth)(failure_reason="no\x1b[2J" * 100),
        r"does not describe it: 'no\\x1b",
    ),
}

TRUE_HASH_LIES = {
    "a path": (lambda truth: renamed(truth, "../../etc"), "'../../etc' is not a valid field name"),
    "a path of a type": (lambda truth: nested(truth, "../msg/X"), "it is used, but not described"),
    "a circle": (lambda truth: nested(truth, BATTERY), "a message contains itself"),
    "a million fields": (lambda truth: repeated(truth, 10_001), "more than 10,000 fields"),
    "a huge array": (lambda truth: of_type(truth, 50, 2**62), "more than 1,000,000 values"),
    "wchar": (lambda truth: of_type(truth, 14), "its type is wchar, which turtleact cannot encode"),
    "long double": (lambda truth: of_type(truth, 12), "its type is long double"),
    "a fixed string": (lambda truth: of_type(truth, 19, 8), "its type is a string of fixed length"),
    "no type": (lambda truth: of_type(truth, 47), "its type 47 is not a type of ROS 2"),
}


@pytest.mark.parametrize("lie", LIES)
async def test_a_lie_is_one_clear_line_and_is_not_kept(package, empty_cache, lie):
    said, problem = LIES[lie]
    async with robot_and_node(package) as (robot, node):
        robot.open("publisher", "/battery", BATTERY)
        robot.answer = lambda request, truth: said(truth)
        with pytest.raises(NotLearned, match=problem) as caught:
            await learn_interface(node, "battery")
        assert "\n" not in str(caught.value)
        assert not empty_cache.exists()


@pytest.mark.parametrize("lie", TRUE_HASH_LIES)
async def test_a_description_of_the_right_hash_may_still_not_be_a_type(package, empty_cache, lie):
    said, problem = TRUE_HASH_LIES[lie]
    async with robot_and_node(package) as (robot, node):
        lied = said(robot.truth_about(BATTERY))
        wanted = structure_hash(lied.type_description)
        robot.open("publisher", "/battery", BATTERY, wanted)
        robot.answer = lambda request, truth: lied
        with pytest.raises(NotLearned, match=problem) as caught:
            await learn_interface(node, "battery")
        assert "\n" not in str(caught.value)
        assert not empty_cache.exists()


async def test_a_text_that_is_too_long_or_does_not_fit_is_not_used(package):
    async with robot_and_node(package) as (robot, node):
        robot.open("publisher", "/battery", BATTERY)

        def lie(request, truth):
            for each in truth.type_sources:
                each.raw_file_contents = "#" * 1_000_001
            return truth

        robot.answer = lie
        battery: Any = await learn_interface(node, "battery")
        assert authored_text(battery) == ""
        assert robot.notes == [
            f"the constants, comments and defaults of {BATTERY} are missing: "
            "its description has more than 1,000,000 characters of text"
        ]


@pytest.mark.loops("asyncio")
async def test_an_answer_that_is_too_large_is_refused(package, monkeypatch):
    monkeypatch.setattr("turtleact.node.learning.LARGEST", 4_000)
    at = free_endpoint()
    async with (
        open_zenoh([], listen=[at], mode="router", config={}) as there,
        open_zenoh([at], mode="client", config={}) as here,
        open_node("here", transport=here) as node,
    ):
        robot = Robot(there, package)
        robot.open("publisher", "/battery", BATTERY)
        robot.answer = lambda request, truth: type(truth)(failure_reason="x" * 4_000)
        with pytest.raises(
            NotLearned, match=r"node /robot: .*the answer has 4,0\d\d bytes, over 4"
        ):
            await learn_interface(node, "battery", timeout=20)


async def test_a_node_without_a_hash_is_named(package):
    async with robot_and_node(package) as (robot, node):
        robot.open("publisher", "/battery", BATTERY, "TypeHashNotSupported")
        with pytest.raises(NotLearned, match="node /robot sends no type hash, as in ROS 2 Humble"):
            await learn_interface(node, "battery")


async def test_a_node_that_does_not_answer_is_asked_again_until_the_timeout(package, monkeypatch):
    monkeypatch.setattr("turtleact.node.learning.QUESTION", 0.01)
    async with robot_and_node(package) as (robot, node):
        robot.open("publisher", "/battery", BATTERY)
        robot.answer = lambda request, truth: truth if len(robot.asked) > 3 else None
        with pytest.raises(NotLearned, match="a node whose only thread runs a goal cannot"):
            await learn_interface(node, "battery")
        battery: Any = await learn_interface(node, "battery", timeout=20)
        assert battery(charge=1.0)
        assert [each for each in robot.notes if each.endswith("; asking again")] == robot.notes


async def test_a_node_that_offers_no_descriptions_is_named(package, monkeypatch):
    monkeypatch.setattr("turtleact.node.learning.QUESTION", 0.01)
    async with robot_and_node(package) as (robot, node):
        robot.open("publisher", "/battery", BATTERY)
        robot.service.close()
        with pytest.raises(NotLearned, match="node /robot offers no get_type_description"):
            await learn_interface(node, "battery")


async def test_no_node_is_asked_while_learning_is_off(package):
    async with robot_and_node(package) as (robot, node):
        robot.serve_action("/dig", DIG)
        node.learner.is_on = False
        await node.learner.learn_all(lambda kind, name: True)
        assert not robot.asked


async def test_a_cache_file_that_was_changed_is_not_used(package, empty_cache):
    async with robot_and_node(package) as (robot, node):
        robot.open("publisher", "/battery", BATTERY)
        await learn_interface(node, "battery")
        [path] = empty_cache.rglob("*.json")
        assert path.relative_to(empty_cache).parts[:-1] == tuple(BATTERY.split("/"))
        changed = json.loads(path.read_text())
        changed["types"][0]["fields"][0]["name"] = "other"
        path.write_text(json.dumps(changed))
        REGISTRY.learned.clear()
        robot.asked.clear()
        battery: Any = await learn_interface(node, "battery")
        assert battery(charge=1.0)
        assert robot.asked
