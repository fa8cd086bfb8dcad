"""Descriptions of the publishers and subscriptions on the graph."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum

import msgspec

from turtleact.rclpy.duration import Duration
from turtleact.rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSPresetProfiles,
    QoSProfile,
    ReliabilityPolicy,
)
from turtleact.transports.base import Endpoint

__all__ = ["TopicEndpointInfo", "TopicEndpointTypeEnum", "TypeHash", "info_of"]

SIZE = 32


class TypeHash(msgspec.Struct, frozen=True):
    """The hash of an interface type.

    Attributes:
        version: The version of the algorithm; -1 if there is no hash.
        value: The 32 bytes of the hash.
    """

    version: int = -1
    value: bytes = bytes(SIZE)

    @classmethod
    def from_text(cls, text: str) -> TypeHash:
        """Parse a hash such as ``RIHS01_…``. For any other text, return a hash with version -1."""
        version, _, digits = text.removeprefix("RIHS").partition("_")
        try:
            return cls(int(version), bytes.fromhex(digits))
        except ValueError:
            return cls()

    def __str__(self) -> str:
        if self.version <= 0 or len(self.value) != SIZE:
            return "INVALID"
        return f"RIHS{self.version:02}_{self.value.hex()}"


FOREVER = 2**63 - 1


class TopicEndpointTypeEnum(IntEnum):
    """The kinds of endpoints."""

    INVALID = 0
    PUBLISHER = 1
    SUBSCRIPTION = 2


class TopicEndpointInfo:
    """A description of an endpoint: a publisher or subscription.

    Attributes:
        node_name: The name of the endpoint's node.
        node_namespace: The namespace of the node.
        topic_type: The type of the messages.
        topic_type_hash: The hash of that type.
        endpoint_type: Whether the endpoint is a publisher or a subscription.
        endpoint_gid: The bytes that identify the endpoint.
        qos_profile: The quality of service of the endpoint.
    """

    def __init__(
        self,
        *,
        node_name: str = "",
        node_namespace: str = "",
        topic_type: str = "",
        topic_type_hash: TypeHash | None = None,
        endpoint_type: TopicEndpointTypeEnum | int = TopicEndpointTypeEnum.INVALID,
        endpoint_gid: Sequence[int] = (),
        qos_profile: QoSProfile = QoSPresetProfiles.UNKNOWN.value,
    ) -> None:
        self.node_name = node_name
        self.node_namespace = node_namespace
        self.topic_type = topic_type
        self.topic_type_hash = TypeHash() if topic_type_hash is None else topic_type_hash
        self.endpoint_type = TopicEndpointTypeEnum(endpoint_type)
        self.endpoint_gid = list(endpoint_gid)
        self.qos_profile = qos_profile

    def __eq__(self, other: object) -> bool:
        return isinstance(other, TopicEndpointInfo) and vars(self) == vars(other)

    __hash__ = None  # type: ignore[assignment]  # it is mutable

    def __str__(self) -> str:
        qos = self.qos_profile
        history = qos.history.name
        if qos.history is HistoryPolicy.KEEP_LAST:
            history = f"{history} ({qos.depth})"
        return "\n".join(
            (
                f"Node name: {self.node_name}",
                f"Node namespace: {self.node_namespace}",
                f"Topic type: {self.topic_type}",
                f"Topic type hash: {self.topic_type_hash}",
                f"Endpoint type: {self.endpoint_type.name}",
                f"GID: {'.'.join(format(byte, '02x') for byte in self.endpoint_gid)}",
                "QoS profile:",
                f"  Reliability: {qos.reliability.name}",
                f"  History (Depth): {history}",
                f"  Durability: {qos.durability.name}",
                f"  Lifespan: {qos.lifespan}",
                f"  Deadline: {qos.deadline}",
                f"  Liveliness: {qos.liveliness.name}",
                f"  Liveliness lease duration: {qos.liveliness_lease_duration}",
            )
        )


def info_of(endpoint: Endpoint) -> TopicEndpointInfo:
    """Return the `TopicEndpointInfo` of an endpoint of the graph."""
    namespace, _, name = endpoint.node.rpartition("/")
    is_publisher = endpoint.kind == "publisher"
    kind = TopicEndpointTypeEnum.PUBLISHER if is_publisher else TopicEndpointTypeEnum.SUBSCRIPTION
    return TopicEndpointInfo(
        node_name=name,
        node_namespace=namespace or "/",
        topic_type=endpoint.type_name,
        topic_type_hash=TypeHash.from_text(endpoint.type_hash),
        endpoint_type=kind,
        endpoint_gid=list(endpoint.gid),
        qos_profile=_profile(endpoint),
    )


def _profile(endpoint: Endpoint) -> QoSProfile:
    qos, times = endpoint.qos, endpoint.times
    is_latched = qos.durability == "transient_local"
    is_lossy = qos.reliability == "best_effort"
    manual = times.liveliness == "manual_by_topic"
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=qos.depth,
        reliability=ReliabilityPolicy.BEST_EFFORT if is_lossy else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if is_latched else DurabilityPolicy.VOLATILE,
        lifespan=_duration(times.lifespan),
        deadline=_duration(times.deadline),
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC if manual else LivelinessPolicy.AUTOMATIC,
        liveliness_lease_duration=_duration(times.lease),
    )


def _duration(nanoseconds: int | None) -> Duration:
    return Duration(nanoseconds=FOREVER if nanoseconds is None else nanoseconds)
