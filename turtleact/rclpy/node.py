"""Nodes, which open everything that a program has on the graph."""

from __future__ import annotations

import weakref
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from functools import partial
from typing import TYPE_CHECKING

from turtleact.node.learning import offer_descriptions
from turtleact.rclpy.clock import Clock, ROSClock, TimeSource
from turtleact.rclpy.context import get_default_context
from turtleact.rclpy.event_handler import (
    EventCallbacks,
    PublisherEventCallbacks,
    SubscriptionEventCallbacks,
)
from turtleact.rclpy.exceptions import InvalidHandle, NotInitializedException
from turtleact.rclpy.executors import Executor
from turtleact.rclpy.graph import NodeGraph
from turtleact.rclpy.impl.arguments import arguments_of
from turtleact.rclpy.impl.connection import Sender
from turtleact.rclpy.impl.entity import (
    Block,
    CallbackGroup,
    EndSpec,
    GuardCondition,
    Handle,
    MutuallyExclusiveCallbackGroup,
    ReentrantCallbackGroup,
    Waitable,
    wait_until,
)
from turtleact.rclpy.impl.node_parameters import NodeParameters, ParameterService
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.logging import (
    LoggingService,
    RcutilsLogger,
    Rosout,
    get_logger,
    logger_named,
)
from turtleact.rclpy.messages import (
    check_is_valid_msg_type,
    check_is_valid_srv_type,
    decode,
    interface_class,
    type_name_of,
)
from turtleact.rclpy.names import (
    expand_topic_name,
    validate_full_topic_name,
    validate_namespace,
    validate_node_name,
    validate_topic_name,
)
from turtleact.rclpy.parameter import Parameter
from turtleact.rclpy.qos import (
    QoSProfile,
    profile_of,
    qos_profile_parameter_events,
    qos_profile_rosout_default,
    qos_profile_services_default,
)
from turtleact.rclpy.services import Client, Service
from turtleact.rclpy.time import S_TO_NS
from turtleact.rclpy.timer import Rate, Timer
from turtleact.rclpy.topics import (
    Publisher,
    QoSOverridingOptions,
    Subscription,
    declare_qos_parameters,
)
from turtleact.transports.base import Endpoint, EndpointKind, Source

if TYPE_CHECKING:
    from turtleact.rclpy.context import Context

__all__ = [
    "HIDDEN_NODE_PREFIX",
    "START_TYPE_DESCRIPTION_SERVICE_PARAM",
    "Node",
    "wait_for_message",
]

HIDDEN_NODE_PREFIX = "_"
START_TYPE_DESCRIPTION_SERVICE_PARAM = "start_type_description_service"
PARAMETER_EVENTS = "/parameter_events"
ORDER = (Waitable, Timer, Subscription, GuardCondition, Client, Service)
"""The kinds of entities, in the order in which executors serve them."""


class Node(NodeParameters, NodeGraph, Block):
    """A participant of the graph, with topics, services, timers and parameters.

    Args:
        node_name: The name of the node.
        context: The context; None means the default context.
        cli_args: Arguments as on a command line, for this node only.
        namespace: The namespace of the node. It is put before relative names.
        use_global_arguments: Whether the program's arguments apply to this node.
        enable_rosout: Whether the node's log is published on ``/rosout``.
        rosout_qos_profile: The quality of service of ``/rosout``.
        start_parameter_services: Whether other nodes may read and set the node's parameters.
        parameter_overrides: Initial values of parameters, in place of the declared ones.
        allow_undeclared_parameters: Whether a parameter may be used without a declaration.
        automatically_declare_parameters_from_overrides: Whether to declare every parameter that has
            an override.
        enable_logger_service: Whether other nodes may read and set the log levels of this process.

    Attributes:
        connection: The connection to the graph.

    Raises:
        NotInitializedException: if the context is not initialised, or was shut down.
        InvalidNodeNameException: if the name of the node is invalid.
        InvalidNamespaceException: if the namespace is invalid.
    """

    def __init__(
        self,
        node_name: str,
        *,
        context: Context | None = None,
        cli_args: list[str] | None = None,
        namespace: str | None = None,
        use_global_arguments: bool = True,
        enable_rosout: bool = True,
        rosout_qos_profile: QoSProfile | int = qos_profile_rosout_default,
        start_parameter_services: bool = True,
        parameter_overrides: list[Parameter] | None = None,
        allow_undeclared_parameters: bool = False,
        automatically_declare_parameters_from_overrides: bool = False,
        enable_logger_service: bool = False,
    ) -> None:
        self.context = get_default_context() if context is None else context
        if not self.context.ok():
            raise NotInitializedException("cannot create node")
        arguments = arguments_of(cli_args, self.context.arguments, use_shared=use_global_arguments)
        self._name = arguments.node_name(node_name)
        validate_node_name(self._name)
        self._namespace = f"/{arguments.namespace(namespace or '', node_name).removeprefix('/')}"
        validate_namespace(self._namespace)
        self._arguments = arguments
        self._executor_ref: weakref.ReferenceType[Executor] | None = None
        self._hold([])
        self.default_callback_group: CallbackGroup = MutuallyExclusiveCallbackGroup()
        self._rate_group = ReentrantCallbackGroup()
        self._clock = ROSClock()
        self.connection = self.context.connection
        self._closing = ExitStack()
        own = self.get_fully_qualified_name()
        self._closing.callback(self.connection.open(lambda graph: graph.enter(own)))
        self._handle = Handle(self._closing.close)
        self._logger = get_logger(self.get_fully_qualified_name()[1:].replace("/", "."))
        if enable_rosout and "--disable-rosout-logs" not in arguments.flags:
            self._start_rosout(profile_of(rosout_qos_profile))
        self._start_parameters(
            parameter_overrides or [],
            allow_undeclared=allow_undeclared_parameters,
            declares_all=automatically_declare_parameters_from_overrides,
        )
        self._time_source = TimeSource(node=self)
        self._time_source.attach_clock(self._clock)
        if start_parameter_services:
            ParameterService(self)
        if self._describes_types():
            offer = partial(offer_descriptions, node=self.get_fully_qualified_name())
            self._closing.callback(self.connection.open(offer))
        if enable_logger_service:
            LoggingService(self)
        self.context.nodes.add(self)

    def _start_rosout(self, qos: QoSProfile) -> None:
        """Publish the node's log on ``/rosout``."""
        sender = self.advertise("/rosout", "rcl_interfaces/msg/Log", qos)
        handler, logger = Rosout(sender), logger_named(self._logger.name)
        logger.addHandler(handler)
        self._closing.callback(sender.close)
        self._closing.callback(logger.removeHandler, handler)

    def _start_parameters(
        self, given: list[Parameter], *, allow_undeclared: bool, declares_all: bool
    ) -> None:
        """Prepare the parameters, with overrides from the command line and the program."""
        found = self._arguments.parameters_for(self.get_fully_qualified_name())
        overrides = {name: Parameter(name, value=value) for name, value in found.items()}
        overrides |= {each.name: each for each in given}
        self._parameter_event_publisher = self.create_publisher(
            interface_class("rcl_interfaces/msg/ParameterEvent"),
            PARAMETER_EVENTS,
            qos_profile_parameter_events,
        )
        self._init_parameters(overrides, allow_undeclared=allow_undeclared)
        if declares_all:
            dynamic = interface_class("rcl_interfaces/msg/ParameterDescriptor")
            declared = [(name, each.value, dynamic()) for name, each in overrides.items()]
            self.declare_parameters("", declared, ignore_override=True)

    def _describes_types(self) -> bool:
        """Declare the parameter that switches ``~/get_type_description`` on, and return it."""
        name = START_TYPE_DESCRIPTION_SERVICE_PARAM
        if not self.has_parameter(name):
            descriptor = interface_class("rcl_interfaces/msg/ParameterDescriptor")(
                description="Whether to offer get_type_description.", read_only=True
            )
            self.declare_parameter(name, True, descriptor)
        return self.get_parameter(name).value is True

    def _publish_event(self, **changes: list[Anything]) -> None:
        event = interface_class("rcl_interfaces/msg/ParameterEvent")(
            stamp=self._clock.now().to_msg(), node=self.get_fully_qualified_name(), **changes
        )

        def publish() -> None:
            with suppress(InvalidHandle):  # the node may have been destroyed meanwhile
                self._parameter_event_publisher.publish(event)

        self.connection.once_explored(publish)

    # what it has

    @property
    def publishers(self) -> Iterator[Publisher]:
        """The publishers of the node."""
        return self._of_kind(Publisher)

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """The subscriptions of the node."""
        return self._of_kind(Subscription)

    @property
    def clients(self) -> Iterator[Client]:
        """The node's clients of services."""
        return self._of_kind(Client)

    @property
    def services(self) -> Iterator[Service]:
        """The services that the node offers."""
        return self._of_kind(Service)

    @property
    def timers(self) -> Iterator[Timer]:
        """The timers of the node."""
        return self._of_kind(Timer)

    @property
    def guards(self) -> Iterator[GuardCondition]:
        """The guard conditions of the node."""
        return self._of_kind(GuardCondition)

    @property
    def waitables(self) -> Iterator[Waitable]:
        """The waitables of the node."""
        return self._of_kind(Waitable)

    @property
    def executor(self) -> Executor | None:
        """The executor that runs the node's callbacks; None if the node has no executor."""
        return None if self._executor_ref is None else self._executor_ref()

    @executor.setter
    def executor(self, new_executor: Executor | None) -> None:
        current = self.executor
        if current is new_executor:
            return
        if current is not None:
            current.remove_node(self)
        if new_executor is None:
            self._executor_ref = None
        else:
            self._executor_ref = weakref.ref(new_executor)
            new_executor.add_node(self)

    def wake_executor(self) -> None:
        """Make the node's executor, if it has one, check which callbacks are ready."""
        executor = self.executor
        if executor is not None:
            executor.wake()

    def _of_kind(self, kind: type) -> Iterator[Anything]:
        return (each for each in self._held if isinstance(each, kind))

    def _add(self, *entities: Anything) -> None:
        """Serve entities from now on."""
        self._hold([*self._held, *entities])

    def _hold(self, entities: list[Anything]) -> None:
        # The lists never change, so any thread may iterate over them.
        self._held = entities
        self.held_entities = [list(self._of_kind(kind)) for kind in ORDER]
        self.wake_executor()

    @property
    def handle(self) -> Handle:
        """The node's handle, which shows whether the node has been destroyed."""
        return self._handle

    def get_name(self) -> str:
        """Return the node's name."""
        with self._handle:
            return self._name

    def get_namespace(self) -> str:
        """Return the node's namespace."""
        with self._handle:
            return self._namespace

    def get_fully_qualified_name(self) -> str:
        """Return the full name of the node: the namespace and the name."""
        return f"{self._namespace.rstrip('/')}/{self._name}"

    def get_clock(self) -> Clock:
        """Return the node's clock, which follows ROS time."""
        return self._clock

    def get_logger(self) -> RcutilsLogger:
        """Return the node's logger."""
        return self._logger

    # names

    def resolve_topic_name(self, topic: str, *, only_expand: bool = False) -> str:
        """Return the full name of a topic, remapped unless ``only_expand`` is true."""
        return self._resolve(topic, is_service=False, only_expand=only_expand)

    def resolve_service_name(self, service: str, *, only_expand: bool = False) -> str:
        """Return the full name of a service, remapped unless ``only_expand`` is true."""
        return self._resolve(service, is_service=True, only_expand=only_expand)

    def _resolve(self, name: str, *, is_service: bool, only_expand: bool = False) -> str:
        with self._handle:
            validate_topic_name(name, is_service=is_service)
            full = expand_topic_name(name, self._name, self._namespace)
            validate_full_topic_name(full, is_service=is_service)
            if only_expand:
                return full
            remapped = self._arguments.remap(full, self._name, self._namespace)
            validate_full_topic_name(remapped, is_service=is_service)
            return remapped

    def endpoint(
        self, kind: EndpointKind, name: str, type_name: str, qos: QoSProfile | None = None
    ) -> Endpoint:
        """Return the description of an endpoint of this node."""
        own = self.get_fully_qualified_name()
        if qos is None:
            return Endpoint(kind, name, type_name, own)
        return Endpoint(kind, name, type_name, own, qos.for_transport(), times=qos.times())

    def advertise(
        self, name: str, type_name: str, qos: QoSProfile, source: Source | None = None
    ) -> Sender:
        """Open a publisher of encoded messages, which `publishers` does not list."""
        end = self.endpoint("publisher", name, type_name, qos)
        return self.connection.advertise(end, source)

    # opening

    def create_publisher(
        self,
        msg_type: Anything,
        topic: str,
        qos_profile: QoSProfile | int,
        *,
        callback_group: CallbackGroup | None = None,
        event_callbacks: PublisherEventCallbacks | None = None,
        qos_overriding_options: QoSOverridingOptions | None = None,
        publisher_class: Callable[..., Publisher] = Publisher,
    ) -> Publisher:
        """Create a publisher.

        Args:
            msg_type: The class of the messages.
            topic: The name of the topic.
            qos_profile: The quality of service. A number sets the depth; the other policies have
                their defaults.
            callback_group: Decides when the event callbacks may run.
            event_callbacks: Functions to call on events of the publisher.
            qos_overriding_options: Which policies may be overridden by parameters.
            publisher_class: The class of the publisher.

        Raises:
            InvalidTopicNameException: if the name of the topic is invalid.
        """
        end, qos = self.topic_end("publisher", msg_type, topic, qos_profile, qos_overriding_options)
        if topic != PARAMETER_EVENTS:  # so that even the first message reaches every subscription
            self.connection.wait_until_explored()
        group = callback_group or self.default_callback_group
        events: EventCallbacks = event_callbacks or PublisherEventCallbacks()
        publisher = publisher_class(EndSpec(self, end, msg_type, topic, qos, group, events))
        self._add(publisher, *publisher.event_handlers)
        return publisher

    def topic_end(
        self,
        kind: EndpointKind,
        msg_type: Anything,
        topic: str,
        qos_profile: QoSProfile | int,
        options: QoSOverridingOptions | None = None,
    ) -> tuple[Endpoint, QoSProfile]:
        """Return the description of a publisher or subscription, and its quality of service."""
        qos = profile_of(qos_profile)
        check_is_valid_msg_type(msg_type)
        full = self._resolve(topic, is_service=False)
        if options is not None:
            entity = Publisher if kind == "publisher" else Subscription
            qos = declare_qos_parameters(entity, self, full, qos, options)
        return self.endpoint(kind, full, type_name_of(msg_type), qos), qos

    def create_subscription(
        self,
        msg_type: Anything,
        topic: str,
        callback: Anything,
        qos_profile: QoSProfile | int,
        *,
        callback_group: CallbackGroup | None = None,
        event_callbacks: SubscriptionEventCallbacks | None = None,
        qos_overriding_options: QoSOverridingOptions | None = None,
        raw: bool = False,
        content_filter_options: object = None,  # noqa: ARG002  # no middleware of ours filters
    ) -> Subscription:
        """Create a subscription.

        Args:
            msg_type: The class of the messages.
            topic: The name of the topic.
            callback: Called with each message, and with a `MessageInfo` if it takes two arguments.
            qos_profile: The quality of service, or a number; see `create_publisher`.
            callback_group: Decides when the callback may run.
            event_callbacks: Functions to call on events of the subscription.
            qos_overriding_options: Which policies may be overridden by parameters.
            raw: Whether the callback gets encoded messages (bytes).
            content_filter_options: Ignored.

        Raises:
            InvalidTopicNameException: if the name of the topic is invalid.
        """
        end, qos = self.topic_end(
            "subscription", msg_type, topic, qos_profile, qos_overriding_options
        )
        group = callback_group or self.default_callback_group
        events: EventCallbacks = event_callbacks or SubscriptionEventCallbacks()
        spec = EndSpec(self, end, msg_type, topic, qos, group, events)
        subscription = Subscription(spec, callback, raw=raw)
        self._add(subscription, *subscription.event_handlers)
        return subscription

    def create_client(
        self,
        srv_type: Anything,
        srv_name: str,
        *,
        qos_profile: QoSProfile = qos_profile_services_default,
        callback_group: CallbackGroup | None = None,
    ) -> Client:
        """Create a client of a service.

        Args:
            srv_type: The class of the service.
            srv_name: The name of the service.
            qos_profile: Ignored.
            callback_group: Decides when a response may be handled.

        Raises:
            InvalidServiceNameException: if the name of the service is invalid.
        """
        check_is_valid_srv_type(srv_type)
        full = self._resolve(srv_name, is_service=True)
        group = callback_group or self.default_callback_group
        end = self.endpoint("client", full, type_name_of(srv_type))
        client = Client(EndSpec(self, end, srv_type, srv_name, qos_profile, group))
        self._add(client)
        return client

    def create_service(
        self,
        srv_type: Anything,
        srv_name: str,
        callback: Anything,
        *,
        qos_profile: QoSProfile = qos_profile_services_default,
        callback_group: CallbackGroup | None = None,
    ) -> Service:
        """Offer a service.

        Args:
            srv_type: The class of the service.
            srv_name: The name of the service.
            callback: Takes a request and an empty response, and returns a response.
            qos_profile: Ignored.
            callback_group: Decides when the callback may run.

        Raises:
            InvalidServiceNameException: if the name of the service is invalid.
        """
        check_is_valid_srv_type(srv_type)
        full = self._resolve(srv_name, is_service=True)
        end = self.endpoint("service", full, type_name_of(srv_type))
        group = callback_group or self.default_callback_group
        spec = EndSpec(self, end, srv_type, srv_name, qos_profile, group)
        service = Service(spec, callback)
        self._add(service)
        return service

    def create_timer(
        self,
        timer_period_sec: float,
        callback: Anything,
        callback_group: CallbackGroup | None = None,
        clock: Clock | None = None,
        autostart: bool = True,  # rclpy's signature
    ) -> Timer:
        """Create a timer, which calls a function periodically.

        Args:
            timer_period_sec: The time between two calls (s).
            callback: The function to call; see `Timer`.
            callback_group: Decides when the callback may run.
            clock: The clock to follow. None means the node's clock.
            autostart: Whether the timer starts at once.

        Raises:
            RCLError: if the period is negative.
        """
        self._handle.check()
        timer = Timer(
            callback,
            callback_group or self.default_callback_group,
            int(float(timer_period_sec) * S_TO_NS),
            clock or self._clock,
            autostart=autostart,
            wake=self.wake_executor,
        )
        self._add(timer)
        return timer

    def create_guard_condition(
        self, callback: Anything, callback_group: CallbackGroup | None = None
    ) -> GuardCondition:
        """Create a guard condition. Its `trigger` makes the executor call ``callback``."""
        self._handle.check()
        group = callback_group or self.default_callback_group
        guard = GuardCondition(callback, group, self.wake_executor)
        self._add(guard)
        return guard

    def create_rate(self, frequency: float, clock: Clock | None = None) -> Rate:
        """Create a rate, with which a thread can run a loop at a fixed frequency.

        Args:
            frequency: The frequency of the loop (Hz).
            clock: The clock to follow. None means the node's clock.

        Raises:
            ValueError: if the frequency is not above zero.
        """
        if frequency <= 0:
            raise ValueError("frequency must be > 0")
        timer = self.create_timer(1.0 / frequency, None, self._rate_group, clock)
        return Rate(timer, context=self.context)

    def add_waitable(self, waitable: Waitable) -> None:
        """Add a waitable to the node, so that the node's executor runs it."""
        self._add(waitable)

    def remove_waitable(self, waitable: Waitable) -> None:
        """Remove a waitable from the node, so that the node's executor no longer runs it."""
        self._hold([each for each in self._held if each is not waitable])

    # closing

    def destroy_publisher(self, entity: Anything) -> bool:
        """Destroy an entity and its event handlers. Return False if the node does not have it."""
        if entity not in self._held:
            return False
        gone = (entity, *getattr(entity, "event_handlers", ()))
        self._hold([each for each in self._held if each not in gone])
        entity.destroy()
        return True

    destroy_subscription = destroy_client = destroy_service = destroy_publisher
    destroy_timer = destroy_guard_condition = destroy_publisher

    def destroy_rate(self, rate: Rate) -> bool:
        """Destroy a rate. Return False if the node does not have the rate's timer."""
        rate.destroy()
        return self.destroy_timer(rate.timer)

    def destroy_node(self) -> None:
        """Destroy the node and all its entities. A second call does nothing."""
        if self._handle.is_destroyed:
            return
        self.context.nodes.discard(self)
        for entity in (*self.waitables, *self._held):
            entity.destroy()
        self._hold([])
        executor = self.executor
        if executor is not None:
            executor.remove_node(self)
        self._handle.destroy_when_not_in_use()

    def _leave(self) -> None:
        self.destroy_node()


def wait_for_message(
    msg_type: Anything,
    node: Node,
    topic: str,
    *,
    qos_profile: QoSProfile | int = 1,
    time_to_wait: float = -1,
) -> tuple[bool, Anything]:
    """Wait for the next message of a topic, without running other callbacks of the node.

    Args:
        msg_type: The class of the message.
        node: The node.
        topic: The name of the topic.
        qos_profile: The quality of service, or a number; see `Node.create_publisher`.
        time_to_wait: How long to wait (s); -1 means for ever.

    Returns:
        A pair: whether a message has arrived, and the message, or None if no message has arrived.
    """
    received: deque[bytes] = deque(maxlen=1)
    end, _ = node.topic_end("subscription", msg_type, topic, qos_profile)
    close = node.connection.subscribe(end, received.append)
    timeout = None if time_to_wait < 0 else time_to_wait
    try:
        has_arrived = wait_until(lambda: bool(received), timeout, node.context.ok)
    finally:
        close()
    return has_arrived, decode(received[0], msg_type) if has_arrived else None
