"""Quality of service: policies, profiles, preset profiles, and a check of their compatibility.

turtleact's transports apply only depth, reliability and durability. All other policies are shown to
other nodes, but have no effect on messages. The transports connect endpoints even if the profiles
of the endpoints are incompatible. `turtleact.rclpy.event_handler` checks deadlines and liveliness.
"""

from __future__ import annotations

import warnings
from enum import Enum, IntEnum
from typing import TypeVar

from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.time import Duration
from turtleact.transports import QoS
from turtleact.transports.base import TimePolicies

__all__ = [
    "DurabilityPolicy",
    "HistoryPolicy",
    "InvalidQoSProfileException",
    "LivelinessPolicy",
    "QoSCompatibility",
    "QoSDurabilityPolicy",
    "QoSHistoryPolicy",
    "QoSLivelinessPolicy",
    "QoSPolicyEnum",
    "QoSPolicyKind",
    "QoSPresetProfiles",
    "QoSProfile",
    "QoSReliabilityPolicy",
    "ReliabilityPolicy",
    "profile_of",
    "qos_check_compatible",
    "qos_policy_name_from_kind",
    "qos_profile_action_status_default",
    "qos_profile_best_available",
    "qos_profile_default",
    "qos_profile_parameter_events",
    "qos_profile_parameters",
    "qos_profile_rosout_default",
    "qos_profile_sensor_data",
    "qos_profile_services_default",
    "qos_profile_system_default",
    "qos_profile_unknown",
]

P = TypeVar("P", bound="QoSPolicyEnum")

UNSPECIFIED = Duration()
"""The duration of a policy that is not set."""


class InvalidQoSProfileException(Exception):
    """A profile lacks a required setting."""

    def __init__(self, *args: object) -> None:
        super().__init__("Invalid QoSProfile", *args)


class QoSPolicyKind(IntEnum):
    """The numbers that identify the policies."""

    INVALID = 1 << 0
    DURABILITY = 1 << 1
    DEADLINE = 1 << 2
    LIVELINESS = 1 << 3
    RELIABILITY = 1 << 4
    HISTORY = 1 << 5
    LIFESPAN = 1 << 6
    DEPTH = 1 << 7
    LIVELINESS_LEASE_DURATION = 1 << 8
    AVOID_ROS_NAMESPACE_CONVENTIONS = 1 << 9


def qos_policy_name_from_kind(policy_kind: QoSPolicyKind | int) -> str:
    """Return the name of a policy by its number."""
    return QoSPolicyKind(policy_kind).name


class QoSPolicyEnum(IntEnum):
    """The base class of the policies that have a few possible values."""

    @classmethod
    def short_keys(cls) -> list[str]:
        """Return the short names of the values, in lower case."""
        return [name.lower() for name in cls.__members__ if not name.startswith("RMW")]

    @classmethod
    def get_from_short_key(cls: type[P], name: str) -> int:
        """Return the value with this short name, as an integer."""
        return cls[name.upper()].value

    @property
    def short_key(self) -> str:
        """The short name of the value."""
        return self.name.lower()


class HistoryPolicy(QoSPolicyEnum):
    """Whether all messages are kept, or only the latest ``depth`` messages."""

    SYSTEM_DEFAULT = 0
    KEEP_LAST = 1
    KEEP_ALL = 2
    UNKNOWN = 3


class ReliabilityPolicy(QoSPolicyEnum):
    """Whether messages may be lost."""

    SYSTEM_DEFAULT = 0
    RELIABLE = 1
    BEST_EFFORT = 2
    UNKNOWN = 3
    BEST_AVAILABLE = 4


class DurabilityPolicy(QoSPolicyEnum):
    """Whether a new subscription gets messages that were published before it existed."""

    SYSTEM_DEFAULT = 0
    TRANSIENT_LOCAL = 1
    VOLATILE = 2
    UNKNOWN = 3
    BEST_AVAILABLE = 4


class LivelinessPolicy(QoSPolicyEnum):
    """How a publisher shows that it is alive."""

    SYSTEM_DEFAULT = 0
    AUTOMATIC = 1
    MANUAL_BY_TOPIC = 3
    UNKNOWN = 4
    BEST_AVAILABLE = 5


QoSHistoryPolicy = HistoryPolicy
QoSReliabilityPolicy = ReliabilityPolicy
QoSDurabilityPolicy = DurabilityPolicy
QoSLivelinessPolicy = LivelinessPolicy


DEFAULTS: dict[str, Anything] = {
    "history": HistoryPolicy.KEEP_LAST,
    "depth": 0,
    "reliability": ReliabilityPolicy.RELIABLE,
    "durability": DurabilityPolicy.VOLATILE,
    "lifespan": UNSPECIFIED,
    "deadline": UNSPECIFIED,
    "liveliness": LivelinessPolicy.SYSTEM_DEFAULT,
    "liveliness_lease_duration": UNSPECIFIED,
    "avoid_ros_namespace_conventions": False,
}
"""The policies of a profile that are not given; their types are those of all values."""


class QoSProfile:
    """The quality of service of an endpoint.

    Args:
        **kwargs: The attributes below. ``depth`` or ``history`` is required.

    Raises:
        InvalidQoSProfileException: if neither ``depth`` nor ``history`` is given, or KEEP_LAST is
            given without ``depth``.

    Attributes:
        history: KEEP_LAST or KEEP_ALL.
        depth: How many messages are kept with KEEP_LAST.
        reliability: RELIABLE or BEST_EFFORT.
        durability: VOLATILE or TRANSIENT_LOCAL.
        lifespan: How long a message is valid.
        deadline: The longest allowed time between two messages.
        liveliness: AUTOMATIC or MANUAL_BY_TOPIC.
        liveliness_lease_duration: The longest allowed time until a publisher shows again that it is
            alive.
        avoid_ros_namespace_conventions: Ignored.
    """

    __slots__ = tuple(DEFAULTS)

    history: HistoryPolicy
    depth: int
    reliability: ReliabilityPolicy
    durability: DurabilityPolicy
    lifespan: Duration
    deadline: Duration
    liveliness: LivelinessPolicy
    liveliness_lease_duration: Duration
    avoid_ros_namespace_conventions: bool

    def __init__(self, **kwargs: Anything) -> None:
        if unknown := kwargs.keys() - set(self.__slots__):
            raise AssertionError(f"Invalid arguments passed to constructor: {sorted(unknown)}")
        if "history" not in kwargs and "depth" not in kwargs:
            raise InvalidQoSProfileException("History and/or depth settings are required.")
        if kwargs.get("history") == HistoryPolicy.KEEP_LAST and "depth" not in kwargs:
            raise InvalidQoSProfileException("History set to KEEP_LAST without a depth setting.")
        # The history comes first, because the depth is checked against it.
        for name, value in (DEFAULTS | kwargs).items():
            setattr(self, name, value)

    def __setattr__(self, name: str, value: Anything) -> None:
        """Set a policy. A number is converted to the policy's type, and other types are refused."""
        kind: Anything = type(DEFAULTS.get(name, value))
        if issubclass(kind, IntEnum) and isinstance(value, int):
            value = kind(value)
        if not isinstance(value, kind):
            raise AssertionError(f"the {name} must be of type {kind.__name__}, not {value!r}")
        if name == "depth":
            self._check_depth(value)
        super().__setattr__(name, value)

    def _check_depth(self, depth: int) -> None:
        if depth < 0:
            raise ValueError("depth must be greater than or equal to zero")
        if not depth and self.history == HistoryPolicy.KEEP_LAST:
            warnings.warn(
                "A zero depth with KEEP_LAST doesn't make sense; no data could be stored. "
                "This will be interpreted as SYSTEM_DEFAULT",
                stacklevel=2,
            )

    def __eq__(self, other: object) -> bool:
        return isinstance(other, QoSProfile) and self.to_dict() == other.to_dict()

    __hash__ = None  # type: ignore[assignment]  # profiles are mutable

    def __repr__(self) -> str:
        values = (f"{name}={value}" for name, value in self.to_dict().items())
        return f"{type(self).__name__}({', '.join(values)})"

    def get_c_qos_profile(self) -> QoSProfile:
        """Return the profile itself, because turtleact has no profiles in C."""
        return self

    def to_dict(self) -> dict[str, Anything]:
        """Return the policies by name."""
        return {name: getattr(self, name) for name in self.__slots__}

    def for_transport(self) -> QoS:
        """Return the policies that turtleact's transports apply."""
        is_latched = self.durability == DurabilityPolicy.TRANSIENT_LOCAL
        is_lossy = self.reliability == ReliabilityPolicy.BEST_EFFORT
        return QoS(
            depth=self.kept or KEEP_ALL,
            durability="transient_local" if is_latched else "volatile",
            reliability="best_effort" if is_lossy else "reliable",
        )

    def times(self) -> TimePolicies:
        """Return the deadline, lifespan and liveliness policies, as other nodes see them."""
        manual = self.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC
        return TimePolicies(
            deadline=_limit(self.deadline),
            lifespan=_limit(self.lifespan),
            liveliness="manual_by_topic" if manual else "automatic",
            lease=_limit(self.liveliness_lease_duration),
        )

    @classmethod
    def from_transport(cls, qos: QoS, times: TimePolicies) -> QoSProfile:
        """Return the profile of an endpoint on the graph."""
        return cls(
            depth=qos.depth,
            reliability=ReliabilityPolicy[qos.reliability.upper()],
            durability=DurabilityPolicy[qos.durability.upper()],
            lifespan=_duration(times.lifespan),
            deadline=_duration(times.deadline),
            liveliness=LivelinessPolicy[times.liveliness.upper()],
            liveliness_lease_duration=_duration(times.lease),
        )

    @property
    def kept(self) -> int | None:
        """How many unread messages are kept; None if all are kept."""
        if self.history == HistoryPolicy.KEEP_ALL:
            return None
        return self.depth or SYSTEM_DEPTH


KEEP_ALL = 1000
"""How many messages of a latched topic are kept for late subscriptions with KEEP_ALL."""

SYSTEM_DEPTH = 10
"""The depth that is used if a profile leaves the depth to the system."""


def _limit(duration: Duration) -> int | None:
    """Return a duration in nanoseconds; None if there is no limit."""
    return None if duration in (UNSPECIFIED, Duration.Infinite) else duration.nanoseconds


def _duration(limit: int | None) -> Duration:
    return Duration.Infinite if limit is None else Duration(nanoseconds=limit)


def profile_of(given: QoSProfile | int) -> QoSProfile:
    """Return ``given`` if it is a profile. If it is a number, return a profile with this depth.

    Raises:
        TypeError: if ``given`` is neither a profile nor a number.
        ValueError: if the number is negative.
    """
    if isinstance(given, QoSProfile):
        return given
    if isinstance(given, int) and not isinstance(given, bool):
        if given < 0:
            raise ValueError("history depth must be greater than or equal to zero")
        return QoSProfile(depth=given)
    raise TypeError(f"Expected QoSProfile or int, but received {type(given)}")


_UNKNOWN = {
    "reliability": ReliabilityPolicy.UNKNOWN,
    "durability": DurabilityPolicy.UNKNOWN,
    "liveliness": LivelinessPolicy.UNKNOWN,
}
_SYSTEM = {
    "reliability": ReliabilityPolicy.SYSTEM_DEFAULT,
    "durability": DurabilityPolicy.SYSTEM_DEFAULT,
}
_BEST_AVAILABLE = {
    "reliability": ReliabilityPolicy.BEST_AVAILABLE,
    "durability": DurabilityPolicy.BEST_AVAILABLE,
    "deadline": Duration(nanoseconds=2**63 - 2),
    "liveliness": LivelinessPolicy.BEST_AVAILABLE,
    "liveliness_lease_duration": Duration(nanoseconds=2**63 - 2),
}
_LATCHED = DurabilityPolicy.TRANSIENT_LOCAL

qos_profile_unknown = QoSProfile(history=HistoryPolicy.UNKNOWN, **_UNKNOWN)
qos_profile_default = QoSProfile(depth=10)
qos_profile_system_default = QoSProfile(history=HistoryPolicy.SYSTEM_DEFAULT, **_SYSTEM)
qos_profile_sensor_data = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
qos_profile_services_default = QoSProfile(depth=10)
qos_profile_parameters = QoSProfile(depth=1000)
qos_profile_parameter_events = QoSProfile(depth=1000)
qos_profile_action_status_default = QoSProfile(depth=1, durability=_LATCHED)
qos_profile_best_available = QoSProfile(depth=10, **_BEST_AVAILABLE)
qos_profile_rosout_default = QoSProfile(
    depth=1000, durability=_LATCHED, lifespan=Duration(seconds=10)
)


class QoSPresetProfiles(Enum):
    """The predefined profiles."""

    UNKNOWN = qos_profile_unknown
    DEFAULT = qos_profile_default
    SYSTEM_DEFAULT = qos_profile_system_default
    SENSOR_DATA = qos_profile_sensor_data
    SERVICES_DEFAULT = qos_profile_services_default
    PARAMETERS = qos_profile_parameters
    PARAMETER_EVENTS = qos_profile_parameter_events
    ACTION_STATUS_DEFAULT = qos_profile_action_status_default
    BEST_AVAILABLE = qos_profile_best_available
    ROSOUT_DEFAULT = qos_profile_rosout_default

    @classmethod
    def short_keys(cls) -> list[str]:
        """Return the names of the profiles, in lower case."""
        return [name.lower() for name in cls.__members__]

    @classmethod
    def get_from_short_key(cls, name: str) -> Anything:
        """Return the profile with this name."""
        return cls[name.upper()].value


class QoSCompatibility(IntEnum):
    """Whether the profiles of a publisher and a subscription are compatible."""

    OK = 0
    WARNING = 1
    ERROR = 2


def qos_check_compatible(
    publisher_qos: QoSProfile, subscription_qos: QoSProfile
) -> tuple[QoSCompatibility, str]:
    """Return whether two profiles are compatible, and the reason if they are not.

    turtleact and rmw_zenoh connect endpoints with any profiles, so the result is always OK.
    """
    del publisher_qos, subscription_qos
    return QoSCompatibility.OK, ""
