"""Events of publishers and subscriptions."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from turtleact.rclpy import event_handler
from turtleact.rclpy.event_handler import (
    IncompatibleTypeInfo,
    PublisherEventCallbacks,
    QoSLivelinessChangedInfo,
    QoSLivelinessLostInfo,
    QoSOfferedDeadlineMissedInfo,
    QoSPublisherMatchedInfo,
    QoSRequestedDeadlineMissedInfo,
    QoSRequestedIncompatibleQoSInfo,
    SubscriptionEventCallbacks,
)
from turtleact.rclpy.messages import interface_class
from turtleact.rclpy.qos import (
    DurabilityPolicy,
    LivelinessPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
)
from turtleact.rclpy.time import Duration

String = interface_class("std_msgs/msg/String")
Bool = interface_class("std_msgs/msg/Bool")

SECOND = 1_000_000_000


class Clock:
    """Stands for the module ``time``."""

    def __init__(self):
        self.now = 0

    def monotonic_ns(self):
        return self.now


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(event_handler, "time", clock)
    return clock


def spin(executor):
    """Run everything that is ready, once what was closed has left the graph."""
    executor.context.connection.loop.call(lambda: None)
    for _ in range(5):
        executor.spin_once(0)


def test_a_publisher_is_told_who_comes_and_goes(node, executor):
    told: list[Any] = []
    callbacks = PublisherEventCallbacks(matched=told.append)
    node.create_publisher(String, "chatter", 10, event_callbacks=callbacks)
    first = node.create_subscription(String, "chatter", print, 10)
    spin(executor)
    node.create_subscription(String, "chatter", print, 10)
    node.create_subscription(String, "gossip", print, 10)
    spin(executor)
    node.destroy_subscription(first)
    spin(executor)

    facts = [(each.total_count, each.current_count, each.current_count_change) for each in told]
    assert facts == [(1, 1, 1), (2, 2, 1), (2, 1, -1)]
    assert isinstance(told[0], QoSPublisherMatchedInfo)


def test_an_executor_that_sleeps_wakes_up_for_a_match(node, executor):
    told: list[Any] = []
    callbacks = SubscriptionEventCallbacks(matched=told.append)
    node.create_subscription(String, "chatter", print, 10, event_callbacks=callbacks)
    spin(executor)
    coming = threading.Thread(target=node.create_publisher, args=(String, "chatter", 10))
    coming.start()
    while not told:
        executor.spin_once(5)
    coming.join()

    assert [each.current_count for each in told] == [1]


def test_a_subscription_is_told_of_publishers_that_are_alive(node, executor):
    told: list[Any] = []
    callbacks = SubscriptionEventCallbacks(liveliness=told.append)
    node.create_subscription(String, "chatter", print, 10, event_callbacks=callbacks)
    publisher = node.create_publisher(String, "chatter", 10)
    spin(executor)
    node.destroy_publisher(publisher)
    spin(executor)

    assert told == [
        QoSLivelinessChangedInfo(alive_count=1, alive_count_change=1),
        QoSLivelinessChangedInfo(alive_count=0, alive_count_change=-1),
    ]


def test_a_publisher_of_another_type_is_no_match_but_told(node, executor):
    told: list[Any] = []
    callbacks = SubscriptionEventCallbacks(incompatible_type=told.append, matched=told.append)
    node.create_subscription(String, "chatter", print, 10, event_callbacks=callbacks)
    publisher = node.create_publisher(Bool, "chatter", 10)
    spin(executor)
    node.destroy_publisher(publisher)
    spin(executor)

    assert told == [IncompatibleTypeInfo(total_count=1, total_count_change=1)]


SHORT, LONG = Duration(seconds=1), Duration(seconds=2)
MANUAL = LivelinessPolicy.MANUAL_BY_TOPIC


@pytest.mark.parametrize(
    ("offered", "requested", "kind"),
    [
        ({}, {"durability": DurabilityPolicy.TRANSIENT_LOCAL}, QoSPolicyKind.DURABILITY),
        ({}, {"deadline": SHORT}, QoSPolicyKind.DEADLINE),
        ({"deadline": LONG}, {"deadline": SHORT}, QoSPolicyKind.DEADLINE),
        ({}, {"liveliness": MANUAL}, QoSPolicyKind.LIVELINESS),
        ({}, {"liveliness_lease_duration": SHORT}, QoSPolicyKind.LIVELINESS),
        ({"reliability": ReliabilityPolicy.BEST_EFFORT}, {}, QoSPolicyKind.RELIABILITY),
    ],
)
def test_a_mismatch_of_quality_is_told_on_both_sides(node, executor, offered, requested, kind):
    told: list[Any] = []
    heard: list[Any] = []
    node.create_subscription(
        String,
        "chatter",
        heard.append,
        QoSProfile(depth=10, **requested),
        event_callbacks=SubscriptionEventCallbacks(incompatible_qos=told.append),
    )
    publisher = node.create_publisher(
        String,
        "chatter",
        QoSProfile(depth=10, **offered),
        event_callbacks=PublisherEventCallbacks(incompatible_qos=told.append),
    )
    publisher.publish(String(data="all the same"))
    spin(executor)

    info = QoSRequestedIncompatibleQoSInfo(
        total_count=1, total_count_change=1, last_policy_kind=kind
    )
    assert told == [info, info]
    assert [each.data for each in heard] == ["all the same"]


def test_qualities_that_fit_are_no_event(node, executor):
    told: list[Any] = []
    callbacks = SubscriptionEventCallbacks(incompatible_qos=told.append)
    wanted = QoSProfile(depth=1, deadline=LONG, reliability=ReliabilityPolicy.BEST_EFFORT)
    node.create_subscription(String, "chatter", print, wanted, event_callbacks=callbacks)
    node.create_publisher(String, "chatter", QoSProfile(depth=10, deadline=SHORT))
    spin(executor)

    assert told == []


def test_missed_deadlines_are_counted_from_the_first_message_on(node, executor, clock):
    told: list[Any] = []
    missed: list[Any] = []
    qos = QoSProfile(depth=10, deadline=SHORT)
    node.create_subscription(
        String,
        "chatter",
        lambda message: None,
        qos,
        event_callbacks=SubscriptionEventCallbacks(deadline=told.append),
    )
    callbacks = PublisherEventCallbacks(deadline=missed.append)
    publisher = node.create_publisher(String, "chatter", qos, event_callbacks=callbacks)
    clock.now += 5 * SECOND
    spin(executor)
    assert missed == []

    publisher.publish(String())
    spin(executor)
    publisher.assert_liveliness()  # is no message
    clock.now += 2 * SECOND
    spin(executor)
    clock.now += SECOND // 2
    spin(executor)

    assert missed == [QoSOfferedDeadlineMissedInfo(total_count=2, total_count_change=2)]
    assert told == [QoSRequestedDeadlineMissedInfo(total_count=2, total_count_change=2)]


def test_a_publisher_that_does_not_assert_its_liveliness_loses_it_once(node, executor, clock):
    told: list[Any] = []
    qos = QoSProfile(depth=10, liveliness=MANUAL, liveliness_lease_duration=SHORT)
    callbacks = PublisherEventCallbacks(liveliness=told.append)
    publisher = node.create_publisher(String, "chatter", qos, event_callbacks=callbacks)
    publisher.publish(String())
    clock.now += SECOND // 2
    publisher.assert_liveliness()
    clock.now += SECOND // 2
    spin(executor)
    assert told == []

    clock.now += 3 * SECOND
    spin(executor)
    assert told == [QoSLivelinessLostInfo(total_count=1, total_count_change=1)]


def test_an_executor_sleeps_no_longer_than_until_a_deadline(node, executor):
    told: list[Any] = []
    qos = QoSProfile(depth=10, deadline=Duration(nanoseconds=1_000_000))
    callbacks = PublisherEventCallbacks(deadline=told.append)
    publisher = node.create_publisher(String, "chatter", qos, event_callbacks=callbacks)
    publisher.publish(String())
    executor.spin_once(5)

    assert len(told) == 1


def test_a_coroutine_is_awaited_and_a_destroyed_publisher_has_no_events(node, executor):
    told: list[Any] = []

    async def tell(info):
        told.append(info)

    callbacks = PublisherEventCallbacks(matched=tell, liveliness=tell)
    publisher = node.create_publisher(String, "chatter", 10, event_callbacks=callbacks)
    node.create_subscription(String, "chatter", print, 10)
    spin(executor)
    assert len(told) == 1

    node.destroy_publisher(publisher)
    node.create_subscription(String, "chatter", print, 10)
    spin(executor)
    assert len(told) == 1
    assert list(node.waitables) == []


def test_an_unknown_event_is_refused():
    with pytest.raises(TypeError, match="unexpected keyword arguments: mached, message_lost"):
        PublisherEventCallbacks(mached=print, message_lost=print)
