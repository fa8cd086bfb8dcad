"""Learns types from the nodes that use them, so that this machine needs none of their files.

A node of ROS 2 describes its types on the service ``NODE/get_type_description``, by their hash
alone. The endpoints on the graph have the hashes of topics and services. An action has none there,
so learning takes two steps: first the types of its three endpoints, which hold the goal, the result
and the feedback; then, by the hash of the action itself, its text.

Whatever a node says is checked: the class made from a description must have the hash that was asked
for. Learned classes stand in ``REGISTRY.learned`` by name and hash, and in the user's cache.

`offer_descriptions` serves the same service. A node opens it only when another process looks for
it. Until then, it costs nothing.

Source: ``type_description_interfaces/srv/GetTypeDescription``; rcl ``node_type_cache.c`` and
``type_description_service``; REP 2016.
"""

from __future__ import annotations

import logging
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any, Final, NamedTuple, cast

import anyio

from turtleact.errors import InvalidInterface, InvalidMessage, NotLearned, TurtleactError
from turtleact.interfaces import Action, Message, WireFormat, implied, type_hash
from turtleact.interfaces.learned import Known, LearnedTypes, cached, describe, keep, remember
from turtleact.interfaces.loading import installed_class, known_classes
from turtleact.interfaces.standard.type_description_interfaces.srv import GetTypeDescription
from turtleact.interfaces.type_hash import first_difference, structure_hash
from turtleact.interfaces.types import REGISTRY
from turtleact.names import DESCRIBE
from turtleact.transports.base import (
    Closeable,
    Endpoint,
    EndpointKind,
    Reply,
    ServiceHandler,
    Target,
    Transport,
)
from turtleact.transports.graph import ENDPOINTS, SEND_GOAL, Kind, types_by_name

if TYPE_CHECKING:
    from turtleact.interfaces.types import Interface

__all__ = ["Learner", "Use", "offer_descriptions", "uses_of"]

logger = logging.getLogger("turtleact.learning")

QUESTION: Final = 2.0
"""How long one question to a node may take (s, event loop time)."""

LARGEST: Final = 4_000_000
"""The most bytes of an answer. A larger one is refused before it is decoded."""

HASH: Final = re.compile("RIHS01_[0-9a-f]{64}")

LONGEST_REASON: Final = 200
"""The most characters of a node's own words that an error shows."""

NO_ANSWER: Final = "does not answer; a node whose only thread runs a goal cannot"

PARTS: Final = ("_SendGoal", "_GetResult", "_FeedbackMessage")
"""The suffixes of the types of an action's endpoints."""


class Use(NamedTuple):
    """A type that is used under a name on the graph.

    Attributes:
        kind: What the name belongs to: an action, a service or a topic.
        type_name: The name of the type.
        hashes: The hash of the type. For an action, the hashes of the services ``send_goal`` and
            ``get_result`` and of the topic ``feedback``.
    """

    kind: Kind
    type_name: str
    hashes: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.kind} of {self.type_name} ({', '.join(self.hashes)})"

    def is_of(self, found: Interface) -> bool:
        """Whether a class has these hashes. A hash that the graph does not know fits any class."""
        parts: list[Any] = [found]
        if self.kind == "action":
            if not issubclass(found, Action):
                return False
            types = implied(found)
            parts = [types.send_goal, types.get_result, types.feedback_message]
        return all(
            not HASH.fullmatch(wanted) or type_hash(part) == wanted
            for part, wanted in zip(parts, self.hashes, strict=True)
        )


def uses_of(transport: Transport, name: str, kind: Kind | None = None) -> dict[Use, list[str]]:
    """Return the types that a name has on the graph, each with the nodes that use it.

    Args:
        transport: The transport to the graph.
        name: The full name of an action, a service or a topic.
        kind: Which of the three; None for any.
    """
    found = defaultdict[Use, list[str]](list)
    for each in (kind,) if kind else ENDPOINTS:
        for use, node in _uses(transport, name, each):
            if node not in found[use]:
                found[use].append(node)
    # An endpoint of this process has no hash on the graph.
    hashed = {(use.kind, use.type_name) for use in found if any(use.hashes)}
    return {
        use: nodes
        for use, nodes in found.items()
        if any(use.hashes) or (use.kind, use.type_name) not in hashed
    }


def _uses(transport: Transport, name: str, kind: Kind) -> Iterator[tuple[Use, str]]:
    if kind != "action":
        for end in transport.endpoints(name):
            if end.kind in ENDPOINTS[kind]:
                yield Use(kind, end.type_name, (end.type_hash,)), end.node
        return

    def hashes(part: str, type_name: str, node: str) -> list[str]:
        ends = transport.endpoints(f"{name}/_action/{part}")
        fitting = (each for each in ends if (each.type_name, each.node) == (type_name, node))
        return sorted({each.type_hash for each in fitting if each.kind in ("service", "publisher")})

    # The endpoints of a server become known one by one: until the last, the type is not known.
    # A node may serve one name with several types.
    for end in transport.endpoints(f"{name}{SEND_GOAL}"):
        if end.kind == "service":
            action = end.type_name.removesuffix(PARTS[0])
            results = hashes("get_result", action + PARTS[1], end.node)
            feedbacks = hashes("feedback", action + PARTS[2], end.node)
            for each in product([end.type_hash], results, feedbacks):
                yield Use(kind, action, each), end.node


def deadline_of(timeout: float | None) -> float | None:
    """Return the event loop time at which a timeout ends."""
    return None if timeout is None else anyio.current_time() + timeout


def _only(name: str, uses: dict[Use, list[str]]) -> tuple[Use, list[str]]:
    """Return the only type of a name, with its nodes."""
    if len(uses) > 1:
        listed = "; ".join(sorted(f"{use}, used by {ends[0]}" for use, ends in uses.items()))
        raise TurtleactError(f"'{name}' has several types: {listed}")
    return next(iter(uses.items()))


def _is_name_of(given: str, type_name: str) -> bool:
    """Whether a user who typed this name means this type: the middle part may be left out."""
    package, _, name = type_name.split("/") if type_name.count("/") == 2 else ("", "", type_name)
    return given in (type_name, f"{package}/{name}")


class Learner:
    """Learns types for one node; see `Node.learner`.

    Args:
        transport: The transport to the graph.
        node: The full name of the node.

    Attributes:
        is_on: Whether nodes are asked. If not, only the types that are known here are used.
        note: Called with each line that the user should read, once.
    """

    def __init__(self, transport: Transport, node: str) -> None:
        self.transport = transport
        self.is_on = True
        self.note: Callable[[str], object] = logger.warning
        self._node = node
        self._noted: set[str] = set()
        self._seen: set[tuple[str, str]] = set()
        self._locks = defaultdict[str, anyio.Lock](anyio.Lock)

    def uses(self, name: str, kind: Kind | None = None) -> dict[Use, list[str]]:
        """Return the types that a name has on the graph, with the nodes that use them."""
        return uses_of(self.transport, name, kind)

    async def wait_for(
        self, name: str, kind: Kind | None = None, timeout: float | None = None
    ) -> Interface:
        """Return the class of a name; see `turtleact.learn_interface`."""
        deadline = deadline_of(timeout)
        with anyio.move_on_after(timeout):
            while not self.uses(name, kind):
                await self.transport.wait_for_change()
        uses = self.uses(name, kind)
        if not uses:
            raise TurtleactError(f"the graph has no {kind or 'action, service or topic'} '{name}'")
        return await self.learn(*_only(name, uses), deadline)

    def known(self, name: str, kind: Kind, type_name: str = "") -> Interface | None:
        """Return the class of a name if its type is known or was learned; otherwise None.

        If the name has several types, ``type_name`` selects one.
        """
        found = (
            known_class(use, nodes)
            for use, nodes in self.uses(name, kind).items()
            if type_name in ("", use.type_name)
        )
        return next((each for each in found if each is not None), None)

    async def learn_type(self, type_name: str) -> Interface:
        """Return the class of a type that some name on the graph has.

        Raises:
            NotLearned: if no node uses the type, or none describes it.
            TurtleactError: if the graph has several definitions of the type. The error lists them.
        """
        endpoints = self.transport.endpoints()
        found: dict[Use, list[str]] = {}
        for kind in ENDPOINTS:
            for name, types in types_by_name(endpoints, kind, hidden=True).items():
                if type_name in types:
                    found |= self.uses(name, kind)
        fitting = {use: nodes for use, nodes in found.items() if use.type_name == type_name}
        if not fitting:
            raise NotLearned(type_name, "no node on the graph uses it")
        return await self.learn(*_only(type_name, fitting))

    async def learn_used(
        self, name: str, kind: Kind, type_name: str, timeout: float | None = None
    ) -> Interface | None:
        """Return the class of a type that a name has on the graph; None if it has no such type.

        None also means that the type has several definitions there, and one here.

        Args:
            name: The full name of an action, a service or a topic.
            kind: Which of the three.
            type_name: The type: its full name, or ``package/Name``.
            timeout: How long to ask again nodes that do not answer (s, event loop time); None to
                ask each node once.

        Raises:
            NotLearned: if no node describes the type, or a description cannot be used.
            TurtleactError: if the type has several definitions, all unknown here.
        """
        found = self.uses(name, kind).items()
        fitting = {use: nodes for use, nodes in found if _is_name_of(type_name, use.type_name)}
        known = [known_class(use, nodes) for use, nodes in fitting.items()]
        for each in known:
            if each is not None:
                return each
        if not fitting or (len(fitting) > 1 and _is_known(type_name)):
            return None
        return await self.learn(*_only(name, fitting), deadline_of(timeout))

    async def learn(self, use: Use, nodes: list[str], deadline: float | None = None) -> Interface:
        """Return the class of a type: from this process, from the cache, or from a node.

        Args:
            use: The type.
            nodes: The nodes that use it.
            deadline: Until when to ask again nodes that do not answer (event loop time); None to
                ask each node once.

        Raises:
            NotLearned: if no node describes the type, or a description cannot be used.
        """
        found = known_class(use, nodes)
        if found is not None:
            return found
        if not all(map(HASH.fullmatch, filter(None, use.hashes))) or not use.hashes[0]:
            problem = f"node {nodes[0]} sends no type hash, as in ROS 2 Humble"
            raise NotLearned(use.type_name, problem)
        self._note_difference(use, nodes[0])
        held = next((each for each in cached(use.type_name) if use.is_of(each.interface)), None)
        if held is not None and not held.has_own_defaults:
            return remember(held)
        try:
            known = await self._ask_all(use, nodes, deadline)
        except NotLearned as error:
            if held is None:
                raise
            # The hash does not cover defaults, so those of another day or node may be wrong.
            self._tell(f"the fields of {use.type_name} start with zeros: {error.problem}")
            return held.interface
        keep(known)
        return remember(known)

    async def difference(self, name: str, kind: Kind, ours: Interface) -> str:
        """Name the first field that nodes which use a name define differently from a class.

        The result is empty if no node defines the type differently, or none describes it in time.
        """
        with anyio.move_on_after(QUESTION), suppress(NotLearned):
            for use, nodes in self.uses(name, kind).items() if self.is_on else ():
                if use.type_name == ours.type_name and not use.is_of(ours):
                    return first_difference(ours, await self.described(use, nodes))
        return ""

    async def described(self, use: Use, nodes: list[str]) -> Interface:
        """Return the class of a type as nodes describe it, without using it from now on.

        Raises:
            NotLearned: if none of the nodes describes it.
        """
        known = known_class(use, nodes)
        return known or (await self._ask_all(use, nodes, None)).interface

    async def learn_all(self, wants: Callable[[Kind, str], bool]) -> None:
        """Learn the unknown types of all names on the graph that are wanted.

        Each type is looked at once. If it cannot be learned, the user is told why.
        """
        if not self.is_on:
            return
        endpoints = self.transport.endpoints()
        fresh = [each for each in endpoints if (each.type_name, each.type_hash) not in self._seen]
        names = [
            (kind, name)
            for kind in ENDPOINTS
            for name in types_by_name(fresh, kind)
            if wants(kind, name)
        ]
        self._seen |= {(each.type_name, each.type_hash) for each in fresh}
        for kind, name in names:
            for use, nodes in self.uses(name, kind).items():
                try:
                    await self.learn(use, nodes)
                except TurtleactError as error:
                    self._tell(str(error))

    async def keep_learning(self, wants: Callable[[Kind, str], bool]) -> None:
        """Learn the unknown types of wanted names as they appear, until cancelled."""
        seen = -1
        while True:
            if self.transport.changes == seen:
                await self.transport.wait_for_change()
            seen = self.transport.changes
            await self.learn_all(wants)

    async def _ask_all(self, use: Use, nodes: list[str], deadline: float | None) -> Known:
        """Ask one node after another, and those that do not answer again until the deadline."""
        while True:
            problems = []
            for holder in nodes:
                try:
                    async with self._locks[holder]:
                        return await self._ask_for(use, holder)
                except NotLearned as error:
                    problems.append(error)
            silent = next((each for each in problems if NO_ANSWER in each.problem), None)
            if silent is None or deadline is None or anyio.current_time() >= deadline:
                raise problems[0]
            self._tell(f"{silent.problem}; asking again")

    async def _ask_for(self, use: Use, holder: str) -> Known:
        """Ask one node for a type, then for the texts of the type."""
        described: dict[str, Any] = {}
        suffixes = PARTS if use.kind == "action" else ("",)
        for suffix, wanted in zip(suffixes, use.hashes, strict=True):
            answer = await self._ask(holder, f"{use.type_name}{suffix}", wanted)
            whole = answer.type_description
            types = (whole.type_description, *whole.referenced_type_descriptions)
            described |= {each.type_name: each for each in types}
        types = tuple(described.values())
        try:
            made = LearnedTypes(types).interface(use.type_name)
            if not use.is_of(made):
                raise NotLearned(use.type_name, f"the description of node {holder} does not match")
        except (InvalidInterface, RecursionError) as error:
            problem = f"node {holder} describes it wrongly: {error}"
            raise NotLearned(use.type_name, problem) from None
        found = type_hash(made)
        sources, learned = await self._with_texts(use.type_name, found, holder, types)
        made = learned.interface(use.type_name)
        return Known(made, found, holder, types, sources, learned.has_own_defaults)

    async def _with_texts(
        self, type_name: str, wanted: str, holder: str, types: tuple[Any, ...]
    ) -> tuple[tuple[Any, ...], LearnedTypes]:
        """Ask for the texts of a type. Without them, its constants and comments are missing."""
        try:
            answer = await self._ask(holder, type_name, wanted, with_texts=True)
            sources = tuple(answer.type_sources)
            return sources, LearnedTypes(types, sources)
        except (NotLearned, InvalidInterface) as error:
            missing = "constants, comments and defaults"
            self._tell(f"the {missing} of {type_name} are missing: {error.problem}")
            return (), LearnedTypes(types)

    async def _ask(
        self, holder: str, type_name: str, wanted: str, *, with_texts: bool = False
    ) -> GetTypeDescription.Response:
        """Ask one question, and return the answer.

        Raises:
            NotLearned: if there is no answer that describes a type of the wanted hash.
        """
        end = _endpoint("client", holder, self._node)
        format = _Answers(GetTypeDescription, asks=True)
        caller = self.transport.join(end, format, Target(counts=partial(_matches, format, wanted)))
        request = GetTypeDescription.Request(type_name, wanted, include_type_sources=with_texts)
        answer: GetTypeDescription.Response | None = None
        is_offered = False
        try:
            with anyio.move_on_after(QUESTION):
                while not caller.is_served:
                    await self.transport.wait_for_change()
                is_offered = True
                answer = cast("GetTypeDescription.Response", (await caller.call(request)).message)
        except TurtleactError as error:
            raise NotLearned(type_name, f"node {holder}: {error}") from None
        finally:
            caller.close()
        if not is_offered:
            raise NotLearned(type_name, f"node {holder} offers no {DESCRIBE}")
        if answer is None:
            raise NotLearned(type_name, f"node {holder} {NO_ANSWER}")
        if not answer.successful:
            reason = answer.failure_reason[:LONGEST_REASON]
            raise NotLearned(type_name, f"node {holder} does not describe it: {reason!r}")
        if structure_hash(answer.type_description) != wanted:
            problem = f"node {holder} describes a type of another hash"
            raise NotLearned(type_name, problem)
        return answer

    def _note_difference(self, use: Use, holder: str) -> None:
        """Tell the user that the definition that is known here is not used."""
        if _is_known(use.type_name):
            self._tell(f"node {holder} defines {use.type_name} differently; its definition is used")

    def _tell(self, line: str) -> None:
        if line not in self._noted:
            self._noted.add(line)
            self.note(line)


def known_class(use: Use, nodes: Iterable[str] = ()) -> Interface | None:
    """Return the class of a type if this process knows it; None if its hash is not known here.

    A learned class with defaults is used only for the node that sent them.
    """
    for (type_name, _), (learned, holder) in REGISTRY.learned.items():
        if type_name == use.type_name and use.is_of(learned) and holder in ("", *nodes):
            return learned
    found = installed_class(use.type_name)
    return found if found is not None and use.is_of(found) else None


def _is_known(type_name: str) -> bool:
    """Whether this process has a definition of a type, perhaps another one than the graph."""
    with suppress(InvalidInterface):
        return installed_class(type_name) is not None
    return True


class _Answers(WireFormat):
    """The wire format of the questions and answers, which refuses large answers."""

    def decode(self, data: bytes) -> Message:
        if len(data) > LARGEST:
            problem = f"the answer has {len(data):,} bytes, over {LARGEST:,}"
            raise InvalidMessage("response", problem)
        return super().decode(data)


def _matches(format: _Answers, wanted: str, data: bytes) -> bool:
    """Whether a reply describes the type that was asked for. Two nodes may have one name."""
    try:
        answer: Any = format.decode(data)
    except InvalidMessage:
        return False
    return answer.successful and structure_hash(answer.type_description) == wanted


def offer_descriptions(transport: Transport, node: str) -> Closeable:
    """Offer ``get_type_description`` for the node with the fully qualified name ``node``."""
    endpoint = _endpoint("service", node, node, is_unlisted=True)
    return transport.serve(endpoint, WireFormat(GetTypeDescription), _Describer(transport, node))


def _endpoint(kind: EndpointKind, holder: str, own: str, *, is_unlisted: bool = False) -> Endpoint:
    name = f"{holder}/{DESCRIBE}"
    return Endpoint(kind, name, GetTypeDescription.type_name, own, is_unlisted=is_unlisted)


class _Describer(ServiceHandler):
    """Describes the types of the topics, services and actions of one node."""

    def __init__(self, transport: Transport, node: str) -> None:
        self._transport = transport
        self._node = node

    async def reply(self, request: Any, caller: bytes) -> Reply:  # noqa: ANN401, ARG002  # as below
        """Describe the type with the hash in the request."""
        response = GetTypeDescription.Response
        if not HASH.fullmatch(request.type_hash):
            return Reply(response(failure_reason="Failed to parse type hash"))
        for name in self._candidates(request.type_hash):
            for found in known_classes(name):  # none, if messages are passed on as bytes
                if type_hash(found) == request.type_hash:
                    return Reply(describe(found, has_sources=request.include_type_sources))
        return Reply(response(failure_reason="Type not currently in use by this node"))

    def _candidates(self, wanted: str) -> Iterator[str]:
        """Yield the names of types that may have this hash.

        An endpoint says the hash of its type. The hash of an action is the only one that no
        endpoint has.
        """
        for each in self._transport.local_endpoints():
            if each.node == self._node and each.type_hash in ("", wanted):
                yield each.type_name
            if each.node == self._node and each.type_name.endswith(PARTS[0]):
                yield each.type_name.removesuffix(PARTS[0])
