"""Selects the topics, services and actions to record or play. All functions are pure.

A recorded service consists of one topic: its service events. A recorded action consists of these
topics:

- its feedback and its status
- the service events of its three services
- the reasons that turtleact's servers publish when a goal fails

Users select all these topics by the name of the action or service.

Source: rosbag2 ``record.py``, ``play.py`` and ``action_utils.cpp``.
"""

from __future__ import annotations

import re
from typing import Final, Literal, NamedTuple, TypeAlias

import msgspec

from turtleact.errors import InvalidOption
from turtleact.names import EVENT_SUFFIX

__all__ = ["REQUESTS", "Part", "Selection", "owner_of", "part_of"]

REQUESTS: Final = frozenset({0, 1})
"""The event types REQUEST_SENT and REQUEST_RECEIVED.

Events of these types contain a request. Events of other types contain a response.
"""

Owner: TypeAlias = Literal["topic", "service", "action"]

_ACTION = re.compile(
    rf"(?P<name>.+)/_action/(?P<part>feedback|status|reason|(send_goal|cancel_goal|get_result){EVENT_SUFFIX})"
)


class Part(NamedTuple):
    """The action or service that a topic belongs to; for other topics, the topic itself.

    Attributes:
        owner: ``"action"`` or ``"service"``; ``"topic"`` if the topic belongs to neither.
        name: The name of the action, service or topic.
        part: Which of the action's topics the topic is, such as ``"feedback"`` or ``"send_goal"``;
            empty if the topic does not belong to an action.
    """

    owner: Owner
    name: str
    part: str = ""


def part_of(topic: str) -> Part:
    """Return the action or service that a topic belongs to, and which of the action's topics it is.

    >>> part_of("/patrol/_action/feedback")
    Part(owner='action', name='/patrol', part='feedback')
    >>> part_of("/reset/_service_event")
    Part(owner='service', name='/reset', part='')
    """
    found = _ACTION.fullmatch(topic)
    if found is not None:
        return Part("action", found["name"], found["part"].removesuffix(EVENT_SUFFIX))
    if topic.endswith(EVENT_SUFFIX):
        return Part("service", topic.removesuffix(EVENT_SUFFIX))
    return Part("topic", topic)


def owner_of(topic: str, type_name: str) -> str:
    """Return the type of the action or service that a topic belongs to; empty if it is not known.

    >>> owner_of("/patrol/_action/feedback", "lab/action/Patrol_FeedbackMessage")
    'lab/action/Patrol'
    >>> owner_of("/patrol/_action/status", "action_msgs/msg/GoalStatusArray")
    ''
    """
    owner, _, part = part_of(topic)
    if owner == "service":
        return type_name.removesuffix("_Event")
    suffix = {
        "feedback": "_FeedbackMessage",
        "send_goal": "_SendGoal_Event",
        "get_result": "_GetResult_Event",
    }.get(part, "")
    is_known = owner == "action" and suffix and type_name.endswith(suffix)
    return type_name.removesuffix(suffix) if is_known else ""


class Selection(msgspec.Struct, frozen=True, kw_only=True):
    """Selects topics, services and actions to record or play.

    Attributes:
        topics: Names of topics to select.
        services: Names of services to select.
        actions: Names of actions to select.
        types: Types of topics to select.
        regex: A regular expression that selects topics, services and actions if it matches any part
            of their names.
        all_topics: Whether to select all topics; see ``hidden``.
        all_services: Whether to select all services.
        all_actions: Whether to select all actions.
        hidden: Whether ``all_topics`` includes hidden topics.
        exclude: Names of topics, services and actions to exclude.
        exclude_types: Types of topics to exclude.
        exclude_regex: A regular expression that excludes topics, services and actions if it matches
            any part of their names.

    Raises:
        InvalidOption: if ``regex`` or ``exclude_regex`` is not a valid regular expression.
    """

    topics: frozenset[str] = frozenset()
    services: frozenset[str] = frozenset()
    actions: frozenset[str] = frozenset()
    types: frozenset[str] = frozenset()
    regex: str = ""
    all_topics: bool = False
    all_services: bool = False
    all_actions: bool = False
    hidden: bool = False
    exclude: frozenset[str] = frozenset()
    exclude_types: frozenset[str] = frozenset()
    exclude_regex: str = ""

    def __post_init__(self) -> None:
        for name in ("regex", "exclude_regex"):
            try:
                re.compile(getattr(self, name))
            except re.error as error:
                raise InvalidOption(name, f"it is not a regular expression: {error}") from None

    def wants(self, topic: str, type_name: str) -> bool:
        """Whether a topic with this name and type is selected."""
        part = part_of(topic)
        if {topic, part.name} & self.exclude or type_name in self.exclude_types:
            return False
        if self.exclude_regex and re.search(self.exclude_regex, part.name):
            return False
        return topic in self.topics or self._has(part, type_name)

    def wants_owner(self, owner: Owner, name: str) -> bool:
        """Whether an action or a service with this name is selected."""
        if name in self.exclude:
            return False
        if self.exclude_regex and re.search(self.exclude_regex, name):
            return False
        return self._has(Part(owner, name), "")

    def _has(self, part: Part, type_name: str) -> bool:
        if self.regex and re.search(self.regex, part.name):
            return True
        if part.owner == "action":
            return self.all_actions or part.name in self.actions
        if part.owner == "service":
            return self.all_services or part.name in self.services
        is_listed = self.all_topics and (self.hidden or "/_" not in part.name)
        return is_listed or part.name in self.topics or type_name in self.types


EVERYTHING: Final = Selection(all_topics=True, all_services=True, all_actions=True)
"""The selection of everything that is not hidden."""
