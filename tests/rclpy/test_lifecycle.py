"""Managed nodes: which transitions are possible, and what other nodes see of them."""

from __future__ import annotations

from typing import Any

import pytest

from turtleact.rclpy.exceptions import RCLError
from turtleact.rclpy.lifecycle import (
    LifecycleNode,
    LifecycleNodeMixin,
    SimpleManagedEntity,
    TransitionCallbackReturn,
)
from turtleact.rclpy.messages import interface_class

SUCCESS, FAILURE, ERROR = TransitionCallbackReturn
String: Any = interface_class("std_msgs/msg/String")
TransitionEvent: Any = interface_class("lifecycle_msgs/msg/TransitionEvent")


class Camera(LifecycleNode):
    """A managed node with callbacks that return or raise what the test says."""

    def __init__(self, context, **outcomes):
        super().__init__("camera", context=context)
        self.outcomes = outcomes
        self.formers: list[str] = []

    def on_configure(self, state):
        self.formers.append(state.label)
        outcome = self.outcomes.get("configure", SUCCESS)
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    def on_error(self, state):
        self.formers.append(state.label)
        return self.outcomes.get("error", SUCCESS)


@pytest.fixture
def ask(node, executor):

    def call(kind, name, **fields):
        service = interface_class(f"lifecycle_msgs/srv/{kind}")
        future = node.create_client(service, f"/camera/{name}").call_async(
            service.Request(**fields)
        )
        executor.spin_until_future_complete(future, timeout_sec=2)
        return future.result()

    return call


@pytest.mark.parametrize(
    ("outcomes", "returned", "state", "formers"),
    [
        ({}, SUCCESS, "inactive", 1),
        ({"configure": FAILURE}, FAILURE, "unconfigured", 1),
        ({"configure": ERROR}, ERROR, "unconfigured", 2),
        ({"configure": ERROR, "error": FAILURE}, ERROR, "finalized", 2),
        ({"configure": ValueError("dark")}, ERROR, "unconfigured", 2),
        ({"configure": None}, ERROR, "unconfigured", 2),
    ],
)
def test_a_callback_decides_the_next_state(
    context, ask, executor, outcomes, returned, state, formers
):
    node = Camera(context, **outcomes)
    executor.add_node(node)
    assert node.trigger_configure() is returned
    assert ask("GetState", "get_state").current_state.label == state
    assert node.formers == ["unconfigured"] * formers


def test_the_log_says_why_a_callback_failed(context, capsys):
    assert Camera(context, configure=ValueError("dark")).trigger_configure() is ERROR
    assert "Error raised in on_configure: ValueError('dark')" in capsys.readouterr().err


def test_an_impossible_transition_is_an_error(context, capsys):
    node = LifecycleNode("camera", context=context)
    assert node.trigger_activate() is ERROR
    assert "Unable to start transition activate from current state" in capsys.readouterr().err
    assert node.trigger_shutdown() is SUCCESS
    with pytest.raises(RCLError, match="not possible"):
        node.trigger_shutdown()


def test_a_publisher_is_silent_while_its_node_is_not_active(context, node, executor):
    heard: list[Any] = []
    node.create_subscription(String, "image", heard.append, 10)
    camera = LifecycleNode("camera", context=context)
    publisher = camera.create_lifecycle_publisher(String, "image", 10)
    for trigger in (camera.trigger_configure, camera.trigger_activate, camera.trigger_deactivate):
        assert trigger() is SUCCESS
        publisher.publish(String(data=trigger.__name__))
    assert camera.trigger_cleanup() is SUCCESS
    executor.spin_once(timeout_sec=1)
    executor.spin_once(timeout_sec=0)
    assert [each.data for each in heard] == ["trigger_activate"]
    assert camera.destroy_lifecycle_publisher(publisher)
    assert not camera.destroy_lifecycle_publisher(publisher)


def test_a_managed_entity_may_refuse(context):
    class Lens(SimpleManagedEntity):
        @SimpleManagedEntity.when_enabled(when_not_enabled=lambda: told.append("closed"))
        def look(self):
            told.append("seen")

        def on_deactivate(self, state):
            super().on_deactivate(state)
            return FAILURE

    told: list[str] = []
    node, lens = LifecycleNode("camera", context=context), Lens()
    node.add_managed_entity(lens)
    lens.look()
    node.trigger_configure()
    node.trigger_activate()
    lens.look()
    assert (told, lens.is_activated) == (["closed", "seen"], True)
    assert node.trigger_deactivate() is FAILURE
    with pytest.raises(TypeError, match="ManagedEntity"):
        node.add_managed_entity("lens")  # type: ignore[arg-type]


def test_other_nodes_drive_a_managed_node(context, node, executor, ask):
    executor.add_node(LifecycleNode("camera", context=context))
    events: list[Any] = []
    node.create_subscription(TransitionEvent, "/camera/transition_event", events.append, 10)
    transition: Any = interface_class("lifecycle_msgs/msg/Transition")
    configure, nonsense = transition(id=1), transition(label="nonsense")
    assert ask("ChangeState", "change_state", transition=configure).success
    assert not ask("ChangeState", "change_state", transition=nonsense).success
    assert [(each.start_state.label, each.goal_state.label) for each in events] == [
        ("unconfigured", "configuring"),
        ("configuring", "inactive"),
    ]
    available = ask("GetAvailableTransitions", "get_available_transitions").available_transitions
    assert {each.transition.id: each.transition.label for each in available} == {
        2: "cleanup",
        3: "activate",
        6: "shutdown",
    }
    graph = ask("GetAvailableTransitions", "get_transition_graph").available_transitions
    assert len(graph) == 25
    states = ask("GetAvailableStates", "get_available_states").available_states
    assert {each.id for each in states} == {0, 1, 2, 3, 4, *range(10, 16)}


def test_the_mixin_needs_a_node_and_a_bool():
    with pytest.raises(RuntimeError, match="needs Node"):
        LifecycleNodeMixin()
    with pytest.raises(TypeError, match="bool"):
        LifecycleNodeMixin(enable_communication_interface="yes")  # type: ignore[arg-type]
