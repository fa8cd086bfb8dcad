"""Managed nodes: a state machine that other nodes and the program itself can drive.

A managed node is unconfigured, inactive, active or finalized. A transition between these states
first enters a state such as "configuring", in which a callback of the node runs. The callback's
return value decides which state follows. If a callback raises an exception, it has returned ERROR.
After an ERROR, `on_error` decides between "unconfigured" and "finalized".

Source: the ROS 2 design article "Managed nodes"; rcl_lifecycle ``default_state_machine.c``.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from enum import IntEnum
from typing import Final, NamedTuple

from turtleact.rclpy.exceptions import RCLError
from turtleact.rclpy.impl.entity import CallbackGroup
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.messages import interface_class
from turtleact.rclpy.node import Node as PlainNode
from turtleact.rclpy.qos import QoSProfile
from turtleact.rclpy.topics import Publisher as PlainPublisher

__all__ = [
    "LifecycleNode",
    "LifecycleNodeMixin",
    "LifecyclePublisher",
    "LifecycleState",
    "ManagedEntity",
    "Node",
    "NodeMixin",
    "Publisher",
    "SimpleManagedEntity",
    "State",
    "TransitionCallbackReturn",
]

STATES: Final = {
    "unknown": 0,
    "unconfigured": 1,
    "inactive": 2,
    "active": 3,
    "finalized": 4,
    "configuring": 10,
    "cleaningup": 11,
    "shuttingdown": 12,
    "activating": 13,
    "deactivating": 14,
    "errorprocessing": 15,
}
"""The states of a managed node, with the numbers of ``lifecycle_msgs.msg.State``."""

CALLBACKS: Final = {
    "configuring": "on_configure",
    "cleaningup": "on_cleanup",
    "shuttingdown": "on_shutdown",
    "activating": "on_activate",
    "deactivating": "on_deactivate",
    "errorprocessing": "on_error",
}
"""The name of the callback that runs in each state between two others."""


class Transition(NamedTuple):
    """A transition, with the number that ``lifecycle_msgs.msg.Transition`` gives it."""

    number: int
    label: str
    start: str
    goal: str


TRANSITIONS: Final = (
    Transition(1, "configure", "unconfigured", "configuring"),
    Transition(10, "transition_success", "configuring", "inactive"),
    Transition(11, "transition_failure", "configuring", "unconfigured"),
    Transition(12, "transition_error", "configuring", "errorprocessing"),
    Transition(2, "cleanup", "inactive", "cleaningup"),
    Transition(20, "transition_success", "cleaningup", "unconfigured"),
    Transition(21, "transition_failure", "cleaningup", "inactive"),
    Transition(22, "transition_error", "cleaningup", "errorprocessing"),
    Transition(3, "activate", "inactive", "activating"),
    Transition(30, "transition_success", "activating", "active"),
    Transition(31, "transition_failure", "activating", "inactive"),
    Transition(32, "transition_error", "activating", "errorprocessing"),
    Transition(4, "deactivate", "active", "deactivating"),
    Transition(40, "transition_success", "deactivating", "inactive"),
    Transition(41, "transition_failure", "deactivating", "active"),
    Transition(42, "transition_error", "deactivating", "errorprocessing"),
    Transition(5, "shutdown", "unconfigured", "shuttingdown"),
    Transition(6, "shutdown", "inactive", "shuttingdown"),
    Transition(7, "shutdown", "active", "shuttingdown"),
    Transition(50, "transition_success", "shuttingdown", "finalized"),
    Transition(51, "transition_failure", "shuttingdown", "finalized"),
    Transition(52, "transition_error", "shuttingdown", "errorprocessing"),
    Transition(60, "transition_success", "errorprocessing", "unconfigured"),
    Transition(61, "transition_failure", "errorprocessing", "finalized"),
    Transition(62, "transition_error", "errorprocessing", "finalized"),
)


class TransitionCallbackReturn(IntEnum):
    """What the callback of a transition returns."""

    SUCCESS = 97
    FAILURE = 98
    ERROR = 99

    def to_label(self) -> str:
        """Return the label of the transition that follows."""
        return f"transition_{self.name.lower()}"


class LifecycleState(NamedTuple):
    """A state of a managed node."""

    label: str
    state_id: int


class ManagedEntity:
    """A part of a managed node that takes part in the node's transitions."""

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:  # noqa: ARG002
        """Handle the transition from unconfigured to inactive. ``state`` is the former state."""
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:  # noqa: ARG002
        """Handle the transition from inactive to unconfigured."""
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:  # noqa: ARG002
        """Handle the transition to finalized."""
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:  # noqa: ARG002
        """Handle the transition from inactive to active."""
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:  # noqa: ARG002
        """Handle the transition from active to inactive."""
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:  # noqa: ARG002
        """Handle an error of another callback. SUCCESS means that the node can go on."""
        return TransitionCallbackReturn.SUCCESS


class SimpleManagedEntity(ManagedEntity):
    """A managed entity that only remembers whether the node is active."""

    def __init__(self) -> None:
        self._enabled = False

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:  # noqa: ARG002
        """Enable the entity."""
        self._enabled = True
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:  # noqa: ARG002
        """Disable the entity."""
        self._enabled = False
        return TransitionCallbackReturn.SUCCESS

    @property
    def is_activated(self) -> bool:
        """Whether the entity is enabled."""
        return self._enabled

    @staticmethod
    def when_enabled(
        wrapped: Callable[..., None] | None = None,
        *,
        when_not_enabled: Callable[..., None] | None = None,
    ) -> Anything:
        """Decorate a method, so that it does nothing while the entity is disabled.

        Args:
            wrapped: The method.
            when_not_enabled: Called instead of the method while the entity is disabled.
        """
        if wrapped is None:
            return functools.partial(
                SimpleManagedEntity.when_enabled, when_not_enabled=when_not_enabled
            )

        @functools.wraps(wrapped)
        def call(self: SimpleManagedEntity, *args: Anything, **kwargs: Anything) -> None:
            if self._enabled:
                wrapped(self, *args, **kwargs)
            elif when_not_enabled is not None:
                when_not_enabled()

        return call


class LifecyclePublisher(SimpleManagedEntity, PlainPublisher):
    """A publisher that drops messages while its node is not active."""

    def __init__(self, *args: Anything, **kwargs: Anything) -> None:
        SimpleManagedEntity.__init__(self)
        PlainPublisher.__init__(self, *args, **kwargs)

    @SimpleManagedEntity.when_enabled
    def publish(self, msg: Anything) -> None:
        """Send a message if the node is active; see `turtleact.rclpy.topics.Publisher`."""
        PlainPublisher.publish(self, msg)


class StateMachine:
    """The state of a managed node.

    Args:
        moved: Called after each transition.
    """

    def __init__(self, moved: Callable[[Transition], object]) -> None:
        self.state = "unconfigured"
        self._moved = moved
        for name in SERVICES:
            setattr(self, f"service_{name}", None)

    @property
    def current_state(self) -> tuple[int, str]:
        """The number and label of the state."""
        return STATES[self.state], self.state

    @property
    def available_transitions(self) -> list[Transition]:
        """The transitions that start in the current state."""
        return [each for each in TRANSITIONS if each.start == self.state]

    def trigger(self, wanted: int | str) -> bool:
        """Make a transition, given by its number or label. Return False if it is unavailable."""
        for each in self.available_transitions:
            if wanted in (each.number, each.label):
                self.state = each.goal
                self._moved(each)
                return True
        return False


SERVICES: Final = {
    "change_state": "ChangeState",
    "get_state": "GetState",
    "get_available_states": "GetAvailableStates",
    "get_available_transitions": "GetAvailableTransitions",
    "get_transition_graph": "GetAvailableTransitions",
}
"""The services of a managed node, each with its type in ``lifecycle_msgs.srv``."""


class LifecycleNodeMixin(ManagedEntity):
    """Makes a subclass of `turtleact.rclpy.node.Node` a managed node.

    Args:
        enable_communication_interface: Whether other nodes can see and change the state.
        callback_group: Decides when the services may answer.
    """

    def __init__(
        self,
        *,
        enable_communication_interface: bool = True,
        callback_group: CallbackGroup | None = None,
    ) -> None:
        if not isinstance(enable_communication_interface, bool):
            raise TypeError("enable_communication_interface must be a bool")
        self._managed_entities: dict[ManagedEntity, None] = {}
        self._events: PlainPublisher | None = None
        self._state_machine = StateMachine(self._publish_transition)
        if enable_communication_interface:
            self._open_interface(callback_group)

    @property
    def _node(self) -> PlainNode:
        if not isinstance(self, PlainNode):
            raise RuntimeError("LifecycleNodeMixin needs Node in the inheritance tree")
        return self

    def _open_interface(self, group: CallbackGroup | None) -> None:
        event = interface_class("lifecycle_msgs/msg/TransitionEvent")
        self._events = self._node.create_publisher(event, "~/transition_event", 10)
        for name, kind in SERVICES.items():
            service = self._node.create_service(
                interface_class(f"lifecycle_msgs/srv/{kind}"),
                f"~/{name}",
                getattr(self, f"_answer_{name}"),
                callback_group=group,
            )
            setattr(self._state_machine, f"service_{name}", service)
            setattr(self, f"_service_{name}", service)

    # what belongs to the node

    def add_managed_entity(self, entity: ManagedEntity) -> None:
        """Let an entity take part in the node's transitions.

        Raises:
            TypeError: if it is no `ManagedEntity`.
        """
        if not isinstance(entity, ManagedEntity):
            raise TypeError("Expected a rclpy.lifecycle.ManagedEntity instance.")
        self._managed_entities[entity] = None

    def create_lifecycle_publisher(
        self, msg_type: Anything, topic: str, qos_profile: QoSProfile | int, **kwargs: Anything
    ) -> LifecyclePublisher:
        """Create a publisher that drops messages while the node is not active."""
        node = self._node
        publisher: Anything = node.create_publisher(
            msg_type, topic, qos_profile, publisher_class=LifecyclePublisher, **kwargs
        )
        self.add_managed_entity(publisher)
        return publisher  # type: ignore[no-any-return]  # of the class above

    def destroy_lifecycle_publisher(self, publisher: LifecyclePublisher) -> bool:
        """Destroy a publisher of the node. Return False if the node does not have it."""
        self._managed_entities.pop(publisher, None)
        return self._node.destroy_publisher(publisher)

    # transitions

    def trigger_configure(self) -> TransitionCallbackReturn:
        """Go from unconfigured to inactive."""
        return self._change_state("configure")

    def trigger_cleanup(self) -> TransitionCallbackReturn:
        """Go from inactive to unconfigured."""
        return self._change_state("cleanup")

    def trigger_activate(self) -> TransitionCallbackReturn:
        """Go from inactive to active."""
        return self._change_state("activate")

    def trigger_deactivate(self) -> TransitionCallbackReturn:
        """Go from active to inactive."""
        return self._change_state("deactivate")

    def trigger_shutdown(self) -> TransitionCallbackReturn:
        """Go to finalized.

        Raises:
            RCLError: if the node is finalized already.
        """
        if self._state_machine.state == "finalized":
            raise RCLError("Shutdown transition not possible")
        return self._change_state("shutdown")

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Call `on_configure` of the managed entities until one does not succeed."""
        return self._call_entities("on_configure", state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Call `on_cleanup` of the managed entities until one does not succeed."""
        return self._call_entities("on_cleanup", state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Call `on_shutdown` of the managed entities until one does not succeed."""
        return self._call_entities("on_shutdown", state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Call `on_activate` of the managed entities until one does not succeed."""
        return self._call_entities("on_activate", state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Call `on_deactivate` of the managed entities until one does not succeed."""
        return self._call_entities("on_deactivate", state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Call `on_error` of the managed entities until one does not succeed."""
        return self._call_entities("on_error", state)

    def _call_entities(self, name: str, state: LifecycleState) -> TransitionCallbackReturn:
        for entity in self._managed_entities:
            returned = self._checked(getattr(entity, name)(state), name)
            if returned is not TransitionCallbackReturn.SUCCESS:
                return returned
        return TransitionCallbackReturn.SUCCESS

    def _change_state(self, wanted: int | str) -> TransitionCallbackReturn:
        machine = self._state_machine
        number, label = machine.current_state
        former = LifecycleState(label, number)
        if not machine.trigger(wanted):
            self._node.get_logger().error(
                f"Unable to start transition {wanted} from current state {label}"
            )
            return TransitionCallbackReturn.ERROR
        returned = self._run_callback(former)
        if returned is TransitionCallbackReturn.ERROR:
            self._run_callback(former)  # on_error
        return returned

    def _run_callback(self, former: LifecycleState) -> TransitionCallbackReturn:
        """Run the callback of the current state, and make the transition that it decides on."""
        name = CALLBACKS[self._state_machine.state]
        try:
            returned = self._checked(getattr(self, name)(former), name)
        except Exception as error:  # a failure of the program's code, which on_error handles
            self._node.get_logger().error(f"Error raised in {name}: {error!r}")
            returned = TransitionCallbackReturn.ERROR
        self._state_machine.trigger(returned.to_label())
        return returned

    def _checked(self, returned: object, name: str) -> TransitionCallbackReturn:
        if not isinstance(returned, TransitionCallbackReturn):
            raise TypeError(f"{name}() must return a TransitionCallbackReturn, not {returned!r}")
        return returned

    # for other nodes

    def _publish_transition(self, made: Transition) -> None:
        if self._events is None:
            return
        said = _described(made)
        event = self._events.msg_type(
            self._node.get_clock().now().nanoseconds,
            said.transition,
            said.start_state,
            said.goal_state,
        )
        self._events.publish(event)

    def _answer_change_state(self, request: Anything, response: Anything) -> Anything:
        wanted = request.transition.label or request.transition.id
        response.success = self._change_state(wanted) is TransitionCallbackReturn.SUCCESS
        return response

    def _answer_get_state(self, _: Anything, response: Anything) -> Anything:
        response.current_state = _state(self._state_machine.state)
        return response

    def _answer_get_available_states(self, _: Anything, response: Anything) -> Anything:
        response.available_states = [_state(label) for label in STATES]
        return response

    def _answer_get_available_transitions(self, _: Anything, response: Anything) -> Anything:
        available = self._state_machine.available_transitions
        response.available_transitions = [_described(each) for each in available]
        return response

    def _answer_get_transition_graph(self, _: Anything, response: Anything) -> Anything:
        response.available_transitions = [_described(each) for each in TRANSITIONS]
        return response


class LifecycleNode(LifecycleNodeMixin, PlainNode):
    """A managed node.

    Args:
        node_name: The name of the node.
        enable_communication_interface: Whether other nodes can see and change the state.
        **kwargs: The other arguments of `turtleact.rclpy.node.Node`.
    """

    def __init__(
        self, node_name: str, *, enable_communication_interface: bool = True, **kwargs: Anything
    ) -> None:
        PlainNode.__init__(self, node_name, **kwargs)
        LifecycleNodeMixin.__init__(
            self, enable_communication_interface=enable_communication_interface
        )


def _state(label: str) -> Anything:
    return interface_class("lifecycle_msgs/msg/State")(STATES[label], label)


def _described(made: Transition) -> Anything:
    transition = interface_class("lifecycle_msgs/msg/Transition")(made.number, made.label)
    described = interface_class("lifecycle_msgs/msg/TransitionDescription")
    return described(transition, _state(made.start), _state(made.goal))


# rclpy offers these under shorter names, too.
Node = LifecycleNode
NodeMixin = LifecycleNodeMixin
State = LifecycleState
Publisher = LifecyclePublisher
