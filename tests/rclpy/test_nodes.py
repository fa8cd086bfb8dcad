"""What a node sees of the graph, its log, its qualities of service, and smaller parts of rclpy."""

from __future__ import annotations

import os
from logging import LogRecord
from pathlib import Path
from typing import Any

import pytest

from turtleact.rclpy import action, logging
from turtleact.rclpy import toplevel as rclpy
from turtleact.rclpy.clock import ROSClock
from turtleact.rclpy.exceptions import (
    InvalidServiceNameException,
    InvalidTopicNameException,
)
from turtleact.rclpy.executors import SingleThreadedExecutor
from turtleact.rclpy.logging import Console, LoggingSeverity
from turtleact.rclpy.messages import (
    check_is_valid_action_type,
    check_is_valid_msg_type,
    check_is_valid_srv_type,
    deserialize_message,
    interface_class,
    serialize_message,
)
from turtleact.rclpy.node import wait_for_message
from turtleact.rclpy.parameter import Parameter
from turtleact.rclpy.qos import (
    DurabilityPolicy,
    LivelinessPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
)
from turtleact.rclpy.time import Duration, Infinite, Time
from turtleact.rclpy.topics import InvalidQosOverridesError, QoSOverridingOptions
from turtleact.rclpy.toplevel import rclpy_implementation

String = interface_class("std_msgs/msg/String")
AddTwoInts = interface_class("example_interfaces/srv/AddTwoInts")
Fibonacci = interface_class("example_interfaces/action/Fibonacci")
Log = interface_class("rcl_interfaces/msg/Log")


@pytest.fixture(autouse=True)
def _levels():
    yield
    logging.clear_config()


# --- the graph ----------------------------------------------------------------------------------


def test_a_node_sees_nodes_topics_and_services(context, node):
    rclpy.create_node("arm", context=context, namespace="/hall")
    node.create_publisher(String, "chatter", 10)
    node.create_subscription(String, "chatter", print, 10)
    node.create_service(AddTwoInts, "add", print)
    node.create_client(AddTwoInts, "add")
    assert sorted(node.get_node_names_and_namespaces()) == [("arm", "/hall"), ("lab", "/")]
    assert sorted(node.get_node_names()) == ["arm", "lab"]
    assert "/hall/arm" in node.get_fully_qualified_node_names()
    assert ("lab", "/", "/") in node.get_node_names_and_namespaces_with_enclaves()
    assert ("/chatter", ["std_msgs/msg/String"]) in node.get_topic_names_and_types()
    assert ("/add", ["example_interfaces/srv/AddTwoInts"]) in node.get_service_names_and_types()
    for method, name in (
        ("get_publisher_names_and_types_by_node", "/chatter"),
        ("get_subscriber_names_and_types_by_node", "/chatter"),
        ("get_service_names_and_types_by_node", "/add"),
        ("get_client_names_and_types_by_node", "/add"),
    ):
        assert name in dict(getattr(node, method)("lab", "/"))
        with pytest.raises(rclpy_implementation.NodeNameNonExistentError):
            getattr(node, method)("nobody", "/")
    counted = [node.count_publishers("chatter"), node.count_subscribers("/chatter")]
    assert [*counted, node.count_services("add"), node.count_clients("add")] == [1, 1, 1, 1]
    for method in ("count_publishers", "count_services", "get_publishers_info_by_topic"):
        with pytest.raises(ValueError, match="is invalid"):
            getattr(node, method)("42")


def test_endpoints_are_shown_with_their_quality(node):
    qos = QoSProfile(
        depth=3,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
        reliability=ReliabilityPolicy.BEST_EFFORT,
        deadline=Duration(seconds=1),
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC,
    )
    node.create_publisher(String, "map", qos)
    node.create_subscription(String, "map", print, 10)
    (publisher,) = node.get_publishers_info_by_topic("map")
    (subscription,) = node.get_subscriptions_info_by_topic("/map", no_mangle=True)
    assert (publisher.node_name, publisher.node_namespace) == ("lab", "/")
    assert publisher.qos_profile.deadline == Duration(seconds=1)
    assert subscription.endpoint_type.name == "SUBSCRIPTION"
    assert publisher.qos_profile.depth == 3
    assert publisher.qos_profile.reliability is ReliabilityPolicy.BEST_EFFORT
    assert publisher.qos_profile.durability is DurabilityPolicy.TRANSIENT_LOCAL
    assert publisher.qos_profile.liveliness is LivelinessPolicy.MANUAL_BY_TOPIC
    assert publisher.qos_profile.lifespan == Infinite
    assert publisher.endpoint_type.name == "PUBLISHER"


def test_actions_are_shown_as_one_name(node):
    action.ActionServer(node, Fibonacci, "fibonacci", print)
    action.ActionClient(node, Fibonacci, "fibonacci")
    shown = [("/fibonacci", ["example_interfaces/action/Fibonacci"])]
    assert action.get_action_names_and_types(node) == shown
    assert action.get_action_server_names_and_types_by_node(node, "lab", "/") == shown
    assert action.get_action_client_names_and_types_by_node(node, "lab", "/") == shown
    with pytest.raises(RuntimeError, match="unknown node"):
        action.get_action_server_names_and_types_by_node(node, "nobody", "/")


def test_a_node_may_wait_for_another(node):
    assert node.wait_for_node("lab", 0)
    assert not node.wait_for_node("nobody", 0)


def test_a_node_is_a_context_manager_and_closes_what_it_has(context):
    with rclpy.create_node("hall", context=context) as node:
        publisher = node.create_publisher(String, "chatter", 10)
        subscription = node.create_subscription(String, "chatter", print, 10)
        service = node.create_service(AddTwoInts, "add", print)
        client = node.create_client(AddTwoInts, "add")
        guard = node.create_guard_condition(print)
        assert publisher.get_subscription_count() == subscription.get_publisher_count() == 1
        assert publisher.wait_for_all_acked()
        assert (publisher.topic_name, subscription.topic_name) == ("/chatter", "/chatter")
        assert (service.service_name, client.service_name) == ("/add", "/add")
        assert (publisher.logger_name, client.logger_name) == ("chatter", "add")
        publisher.assert_liveliness()
        for kind, thing in (
            ("subscription", subscription),
            ("service", service),
            ("client", client),
            ("guard_condition", guard),
        ):
            assert getattr(node, f"destroy_{kind}")(thing)
            assert not getattr(node, f"destroy_{kind}")(thing)
    node.destroy_node()
    assert list(node.publishers) == []
    assert context.ok()


def test_a_subscription_may_get_bytes_or_more_about_a_message(node, executor):
    raws: list[bytes] = []
    infos: list[Any] = []
    node.create_subscription(String, "chatter", raws.append, 10, raw=True)
    node.create_subscription(String, "chatter", lambda _, info: infos.append(info), 10)
    message = String(data="hi")
    node.create_publisher(String, "chatter", 10).publish(serialize_message(message))
    for _ in range(2):
        executor.spin_once(timeout_sec=1)
    assert deserialize_message(raws[0], String) == message
    assert infos[0]["received_timestamp"] > 0
    with pytest.raises(RuntimeError, match="one argument"):
        node.create_subscription(String, "chatter", lambda: None, 10)


def test_one_message_can_be_waited_for(node):
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_publisher(String, "map", latched).publish(String(data="lab"))
    assert wait_for_message(String, node, "map", qos_profile=latched, time_to_wait=1) == (
        True,
        String(data="lab"),
    )
    assert wait_for_message(String, node, "nothing", time_to_wait=0) == (False, None)


@pytest.mark.parametrize(
    ("check", "interface"),
    [
        (check_is_valid_msg_type, AddTwoInts),
        (check_is_valid_srv_type, String),
        (check_is_valid_action_type, AddTwoInts),
    ],
)
def test_an_interface_of_another_kind_is_refused(check, interface):
    with pytest.raises(RuntimeError, match="not valid"):
        check(interface)


# --- the log ------------------------------------------------------------------------------------


def test_a_log_line_has_severity_time_and_name(node, capsys):
    assert node.get_logger().get_child("arm").warning("hot")
    assert not node.get_logger().debug("unheard")
    node.get_logger().error("late")
    node.get_logger().fatal("lost")
    node.get_logger().warn("low")
    node.get_logger().info("done")
    first, *others = capsys.readouterr().err.splitlines()
    assert first.startswith("[WARN] [")
    assert first.endswith("] [lab.arm]: hot")
    assert [line[: line.index("]")] for line in others] == ["[ERROR", "[FATAL", "[WARN", "[INFO"]


def test_a_line_is_published_too(node, executor):
    heard: list[Any] = []
    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_subscription(Log, "/rosout", heard.append, latched)
    node.get_logger().info("hello")
    executor.spin_once(timeout_sec=1)
    assert (heard[0].msg, heard[0].name, heard[0].level) == ("hello", "lab", 20)
    assert heard[0].function == "test_a_line_is_published_too"


def test_a_line_is_published_by_the_nearest_node_only(context, node, executor):
    heard: list[Any] = []
    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_subscription(Log, "/rosout", heard.append, latched)
    rclpy.create_node("arm", namespace="lab", context=context).get_logger().info("hello")
    node.get_logger().info("bye")
    for _ in range(3):
        executor.spin_once(timeout_sec=0.1)
    assert [(each.name, each.msg) for each in heard] == [("lab.arm", "hello"), ("lab", "bye")]


def test_levels_are_inherited():
    child = logging.get_logger("lab").get_child("arm")
    assert child.get_effective_level() is LoggingSeverity.INFO
    logging.set_logger_level("lab", LoggingSeverity.ERROR)
    assert not child.is_enabled_for(LoggingSeverity.WARN)
    child.set_level(LoggingSeverity.DEBUG)
    assert logging.get_logger_effective_level("lab.arm") is LoggingSeverity.DEBUG
    logging.apply_levels([("", 40)])
    assert logging.get_logger("hall").get_effective_level() is LoggingSeverity.ERROR
    assert logging.get_logging_severity_from_string("warn") is LoggingSeverity.WARN
    with pytest.raises(RuntimeError, match="does not exist"):
        logging.get_logging_severity_from_string("loud")
    with pytest.raises(ValueError, match="empty"):
        logging.get_logger("")
    with pytest.raises(ValueError, match="empty"):
        child.get_child("")


def test_a_place_in_the_code_may_log_seldom():
    logger, clock = logging.get_logger("lab"), ROSClock()
    clock.activate(is_told=True)
    once, later, seldom = [], [], []
    for second in range(5):
        clock.set_ros_time_override(Time(seconds=second))
        once.append(logger.info("x", once=True))
        later.append(logger.info("x", skip_first=True))
        seldom.append(logger.info("x", throttle_duration_sec=2, throttle_time_source_type=clock))
    assert once == [True, False, False, False, False]
    assert later == [False, True, True, True, True]
    assert seldom == [False, False, True, False, True]


def test_a_place_in_the_code_may_not_change_its_mind():
    logger = logging.get_logger("lab")

    def log(severity=20, name=None, **filters):
        return logger.log("x", severity, name, **filters)

    log(once=True)
    with pytest.raises(ValueError, match="severity"):
        log(30, once=True)
    with pytest.raises(ValueError, match="name"):
        log(name="other", once=True)
    with pytest.raises(ValueError, match="parameters"):
        log(skip_first=True)
    with pytest.raises(ValueError, match="parameters"):
        log(once=2)
    with pytest.raises(TypeError, match="recognized"):
        logger.info("x", nonsense=True)
    with pytest.raises(TypeError, match="required parameter"):
        logger.info("x", throttle_time_source_type=ROSClock())
    with pytest.raises(RuntimeError, match="severity"):
        logger.log("x", 17)


def test_the_folder_of_logs_follows_the_environment(monkeypatch):
    for name in ("ROS_LOG_DIR", "ROS_HOME"):
        monkeypatch.delenv(name, raising=False)
    assert logging.get_logging_directory() == Path(os.path.expanduser("~")) / ".ros" / "log"  # noqa: PTH111
    monkeypatch.setenv("ROS_HOME", "/ros")
    assert logging.get_logging_directory() == Path("/ros/log")
    monkeypatch.setenv("ROS_LOG_DIR", "/logs")
    assert logging.get_logging_directory() == Path("/logs")
    logging.shutdown()


def test_others_see_and_set_log_levels(context):
    node = rclpy.create_node("arm", context=context, enable_logger_service=True)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    levels = interface_class("rcl_interfaces/msg/LoggerLevel")
    results = []
    for kind, fields in (
        ("Set", {"levels": [levels(name="arm", level=40), levels(name="arm", level=17)]}),
        ("Get", {"names": ["arm"]}),
    ):
        service = interface_class(f"rcl_interfaces/srv/{kind}LoggerLevels")
        client = node.create_client(service, f"/arm/{kind.lower()}_logger_levels")
        future = client.call_async(service.Request(**fields))
        executor.spin_until_future_complete(future, timeout_sec=2)
        results.append(future.result())
    assert [each.successful for each in results[0].results] == [True, False]
    assert results[1].levels[0].level == 40


# --- quality of service -------------------------------------------------------------------------


def test_parameters_may_override_a_quality(context):
    node = rclpy.create_node(
        "lab",
        context=context,
        parameter_overrides=[
            Parameter("qos_overrides./chatter.publisher.depth", value=77),
            Parameter("qos_overrides./chatter.subscription_in.reliability", value="best_effort"),
            Parameter("qos_overrides./chatter.publisher.lifespan", value=5),
        ],
    )
    kinds = (QoSPolicyKind.DEPTH, QoSPolicyKind.LIFESPAN, QoSPolicyKind.RELIABILITY)
    options = QoSOverridingOptions(kinds)
    for _ in range(2):  # the second one finds the parameters declared
        publisher = node.create_publisher(String, "chatter", 1, qos_overriding_options=options)
        assert publisher.qos_profile.depth == 77
        assert publisher.qos_profile.lifespan == Duration(nanoseconds=5)
    named = QoSOverridingOptions(kinds, entity_id="in")
    heard = node.create_subscription(String, "chatter", print, 1, qos_overriding_options=named)
    assert heard.qos_profile.reliability is ReliabilityPolicy.BEST_EFFORT
    result = interface_class("rcl_interfaces/msg/SetParametersResult")
    strict = QoSOverridingOptions.with_default_policies(
        callback=lambda _: result(reason="too deep")
    )
    with pytest.raises(InvalidQosOverridesError, match="too deep"):
        node.create_publisher(String, "other", 1, qos_overriding_options=strict)


# --- what a node has ------------------------------------------------------------------------------


def test_a_node_lists_what_it_has(node, executor):
    publisher = node.create_publisher(String, "chatter", 10)
    subscription = node.create_subscription(String, "chatter", print, 10)
    client = node.create_client(AddTwoInts, "add")
    service = node.create_service(AddTwoInts, "add", print)
    timer = node.create_timer(1.0, print)
    guard = node.create_guard_condition(print)
    rate = node.create_rate(10)
    assert publisher in node.publishers
    assert subscription in node.subscriptions
    assert client in node.clients
    assert service in node.services
    assert list(node.timers) == [timer, rate.timer]
    assert list(node.guards) == [guard]
    assert [each.describe() for each in (subscription, client, service, timer, guard)] == [
        "the subscription of /chatter",
        "the client of /add",
        "the service of /add",
        "the timer of 1 s",
        "a guard condition",
    ]
    assert node.destroy_rate(rate)
    with node.handle:
        assert node.executor is executor


def test_a_remapping_to_a_name_that_breaks_the_rules_is_refused(context):
    node = rclpy.create_node(
        "arm", context=context, cli_args=["--ros-args", "-r", "chatter:=4ever", "-r", "add:=4ever"]
    )
    with pytest.raises(InvalidTopicNameException):
        node.create_publisher(String, "chatter", 10)
    with pytest.raises(InvalidServiceNameException):
        node.create_client(AddTwoInts, "add")


def test_a_subscription_may_have_a_coroutine_or_a_function_of_c_as_callback(node, executor):
    heard: list[Any] = []

    async def hear(message):
        heard.append(message.data)

    node.create_subscription(String, "chatter", hear, 10)
    seen = node.create_subscription(String, "chatter", dir, 10)
    assert seen.callback is not None
    node.create_publisher(String, "chatter", 10).publish(String(data="hi"))
    for _ in range(2):
        executor.spin_once(timeout_sec=1)
    assert heard == ["hi"]


def test_a_message_that_cannot_be_read_is_logged_and_dropped(node, executor, capsys):
    heard: list[Any] = []
    node.create_subscription(String, "chatter", heard.append, 10)
    publisher = node.create_publisher(String, "chatter", 10)
    publisher.publish(b"\0\1\0\0")
    publisher.publish(String(data="hi"))
    for _ in range(2):
        executor.spin_once(timeout_sec=0)
    assert [each.data for each in heard] == ["hi"]
    assert "a message of /chatter cannot be read" in capsys.readouterr().err


def test_a_log_line_may_have_another_format(monkeypatch, capsys):
    monkeypatch.setenv(
        "RCUTILS_CONSOLE_OUTPUT_FORMAT", "{severity} {name} {line_number} {message} {x}"
    )
    monkeypatch.setenv("RCUTILS_COLORIZED_OUTPUT", "1")
    record = LogRecord("arm", LoggingSeverity.WARN, "f.py", 7, "hot", (), None)
    record.levelname = "WARN"
    Console().handle(record)
    assert capsys.readouterr().err == "\033[33mWARN arm 7 hot {x}\033[0m\n"
