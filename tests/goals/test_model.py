"""Servers and clients at random, in virtual time, compared step by step with a plain model.

A `Plan` says who serves what and what happens when. The `Model` plays it first, by the contract
alone: it is a small simulator, where bodies, clients and requests are generators that say what they
wait for. Then `World` plays it with turtleact, and must show the same after each step.

No two things fall together by chance: each wait has a fraction of a second of its own (`span`). A
plan in which they still do is thrown away, as its end is left open.

``MODEL_EXAMPLES`` says how many plans are played on each loop.
"""

from __future__ import annotations

import heapq
import itertools
import math
import os
from collections import defaultdict, deque
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Generator, Iterator
from contextlib import aclosing, asynccontextmanager
from functools import partial
from random import Random
from typing import Any, Literal, NamedTuple, TypeAlias, TypeVar

import anyio
import anyio.abc
import hypothesis
import pytest
from hypothesis import strategies as st

import turtleact
from turtleact import CancelResponse, GoalResponse
from turtleact.errors import (
    Abort,
    Cancel,
    GoalAborted,
    GoalCanceled,
    GoalRejected,
    PauseRefused,
    ServerUnavailable,
    TurtleactError,
    UnknownGoal,
)
from turtleact.goals.observers import GoalObserver
from turtleact.goals.policies import Slot
from turtleact.goals.server import LocalActionServer
from turtleact.goals.state import TRANSITIONS, Goal, GoalStatus
from turtleact.tasks import wait_until_idle
from turtleact.testing import virtual_backend
from turtleact.transports import MemoryTransport

from ..conftest import INSTALLED
from ..lab import Count, HandClock, Running, feedback, local_server, other_tasks, result, take_turns

T = TypeVar("T")

EXAMPLES = int(os.environ.get("MODEL_EXAMPLES", "60"))
GRACE, CANCEL_TIMEOUT = 5.0, 6.0
"""What `action_server` and `action_client` have unless the user says (s)."""
LONG = 60.0
"""Longer than all that a plan leaves behind (s)."""

# --- plans ----------------------------------------------------------------------------------

Verdict = Literal["result", "nothing", "abort", "abort with a result", "error", "out", "canceled"]
How = Literal["await", "enter", "leave", "detach"]


class Recovery(NamedTuple):
    """What a body does when it is canceled."""

    speaks: bool
    seconds: float
    verdict: Verdict


class Sleep(NamedTuple):
    seconds: float


class Say(NamedTuple):
    messages: int


class Partial(NamedTuple):
    """Sets the partial result."""


class Nest(NamedTuple):
    """Sends a goal, after a while."""

    server: int
    script: Script
    how: How
    seconds: float
    timeout: float


class Script(NamedTuple):
    """What a body does; the number is that of its goal."""

    number: int
    steps: tuple[Sleep | Say | Partial | Nest, ...]
    verdict: Verdict
    recovery: Recovery
    is_unwelcome: bool


class ServerPlan(NamedTuple):
    rules: tuple[tuple[str, Any], ...]
    shares: bool
    asked_for_goals: Literal["never", "at once", "later"]
    asked_for_cancels: Literal["never", "at once", "later"]
    keep: float | None
    on_client_lost: Literal["keep", "cancel"]
    is_generator: bool


class Send(NamedTuple):
    server: int
    client: int
    script: Script
    how: How
    goal_id: int
    is_canceled_at_once: bool


class CancelGoal(NamedTuple):
    target: int
    by: Literal["id", "stamp", "both", "all", "unknown id"]


class Leave(NamedTuple):
    """Cancels the task of a client."""

    target: int


class Attach(NamedTuple):
    target: int


class CloseClient(NamedTuple):
    server: int
    client: int


class CloseServer(NamedTuple):
    server: int


class Pause(NamedTuple):
    """Pauses a goal; it is chosen among those that send no others."""

    target: int
    timeout: float


class Resume(NamedTuple):
    target: int


Operation: TypeAlias = (
    Send | CancelGoal | Leave | Attach | CloseClient | CloseServer | Pause | Resume
)


class Plan(NamedTuple):
    servers: tuple[ServerPlan, ...]
    is_watched: bool
    operations: tuple[tuple[float, Operation], ...]
    last: float


def span(seconds: float, *key: object) -> float:
    """Some seconds and a fraction that no other key has; no sum of them equals another."""
    return seconds + Random(repr(key)).random() / 10


def goal_id_of(number: int) -> bytes | None:
    return bytes([number]) * 16 if number else None


SHARED_RULES = st.sampled_from(
    [
        (("policy", "reject"),),
        (("policy", "queue"),),
        (("policy", "queue"), ("queue_limit", 1)),
        (("policy", "preempt"),),
        (("max_active", 1),),
        (("max_active", 2), ("queue_limit", 2)),
    ]
)
SECONDS = st.sampled_from([0.0, 0.5, 2.0, 4.0])
RECOVERIES = st.builds(
    Recovery,
    st.booleans(),
    st.sampled_from([0.0, 0.0, 0.5, 1.0]),
    st.sampled_from(["out", "out", "result", "canceled", "abort", "error"]),
)
STUBBORN = Recovery(False, 20.0, "out")


@st.composite
def scripts(draw, numbers: Iterator[int], servers: int, depth: int = 2) -> Script:
    number = next(numbers)
    kinds: list[st.SearchStrategy[Any]] = [
        st.builds(Sleep, SECONDS),
        st.builds(Sleep, SECONDS),
        st.builds(Say, st.integers(1, 3)),
        st.just(Partial()),
    ]
    if depth:
        nests = st.builds(
            Nest,
            st.integers(0, servers - 1),
            scripts(numbers, servers, depth - 1),
            st.sampled_from(["await", "enter", "leave", "detach"]),
            SECONDS,
            st.sampled_from([math.inf, math.inf, 0.3, 1.0]),
        )
        kinds += [nests] * 3
    steps = draw(st.lists(st.sampled_from(kinds).flatmap(lambda kind: kind), max_size=5))
    is_leaf = not any(isinstance(step, Nest) for step in steps)
    return Script(
        number,
        tuple(steps),
        draw(st.sampled_from(["result", "result", "nothing", "abort", "abort with a result"])),
        draw(RECOVERIES | st.just(STUBBORN) if is_leaf and depth == 2 else RECOVERIES),
        draw(st.integers(0, 9)) == 9,
    )


@st.composite
def plans(draw) -> Plan:
    shared = draw(SHARED_RULES)
    servers = tuple(draw(st.lists(server_plans(shared), min_size=1, max_size=3)))
    numbers = itertools.count(1)
    at = st.integers(0, len(servers) - 1)
    sends = st.builds(
        Send,
        at,
        st.integers(0, 1),
        scripts(numbers, len(servers)),
        st.sampled_from(["await", "enter", "leave", "detach"]),
        st.sampled_from([0, 0, 1, 2]),
        st.booleans(),
    )
    target = st.integers(0, 9)
    by = st.sampled_from(["id", "stamp", "both", "all", "unknown id"])
    cancels = st.builds(CancelGoal, target, by)
    leaves = st.builds(Leave, target)
    others = [st.builds(Attach, target), st.builds(CloseClient, at, st.integers(0, 1))]
    pauses = st.builds(Pause, target, st.sampled_from([1.0, 5.0])), st.builds(Resume, target)
    weighted = [*[sends] * 6, *[cancels] * 4, leaves, leaves, *others, st.builds(CloseServer, at)]
    weighted += [*pauses] * 3
    mixed = st.sampled_from(weighted).flatmap(lambda kind: kind)
    after = st.sampled_from([0.0, 0.0, 0.0, 0.5, 2.0])
    first = draw(st.lists(st.tuples(after, sends), min_size=1, max_size=3))
    operations = first + draw(st.lists(st.tuples(after, mixed), max_size=9))
    return Plan(servers, draw(st.booleans()), tuple(operations), draw(after))


def server_plans(shared: tuple[tuple[str, Any], ...]) -> st.SearchStrategy[ServerPlan]:
    options: list[st.SearchStrategy[Any]] = [
        st.sampled_from(["never", "never", "at once", "later"]),
        st.sampled_from(["never", "never", "at once", "later"]),
        st.sampled_from([10.0, 0.0, 3.0, None]),
        st.sampled_from(["keep", "cancel"]),
        st.booleans(),
    ]
    alone = SHARED_RULES | st.just(())
    return st.builds(ServerPlan, alone, st.just(False), *options) | st.builds(
        ServerPlan, st.just(shared), st.just(True), *options
    )


# --- the model ------------------------------------------------------------------------------


class Limits(NamedTuple):
    """How long is waited for what has been canceled.

    Attributes:
        grace: How long a closing server waits for its bodies (s).
        cancel_timeout: How long a client waits for the end of a goal that it has canceled (s).
    """

    grace: float
    cancel_timeout: float


class StopError(Exception):
    """A cancellation arrives."""


class OpenError(Exception):
    """What happens now is left open: by the order of two things, or as it is not settled yet."""


class RefusedError(Exception):
    """A goal is not taken."""


class Moment:
    """Something that comes once."""

    def __init__(self) -> None:
        self.has_come = False
        self.watchers: list[Callable[[], object]] = []


class Wait(NamedTuple):
    """What a process waits for; one that is shielded is not canceled meanwhile, but after it."""

    until: float = math.inf
    moment: Moment | None = None
    is_shielded: bool = False


Steps: TypeAlias = Generator[Wait, None, T]


class Process:
    """Something that goes on in time, and can be canceled once."""

    def __init__(self, model: Model, steps: Steps[object]) -> None:
        self._model = model
        self._steps = steps
        self._wait: Wait | None = None
        self.has_begun = False
        self.is_canceled = False
        self.is_cancel_due = False

    def begin(self) -> None:
        self.has_begun = True
        self._go(partial(next, self._steps))

    def wake(self, wait: Wait) -> None:
        if self._wait is wait:
            self._go(partial(self._steps.send, None))

    @property
    def is_about_to_stop(self) -> bool:
        return self.is_cancel_due and self._wait is not None and not self._wait.is_shielded

    def is_waiting(self, wait: Wait) -> bool:
        return self._wait is wait

    def cancel(self) -> None:
        if not self.is_canceled:
            self.is_canceled = self.is_cancel_due = True
            self._model.soon(self._stop)

    def _stop(self) -> None:
        if self.is_cancel_due and self._wait is not None and not self._wait.is_shielded:
            self.is_cancel_due = False
            self._go(partial(self._steps.throw, StopError()))

    def _go(self, resume: Callable[[], Wait]) -> None:
        self._wait = None
        try:
            wait = resume()
            while self.is_cancel_due and not wait.is_shielded:
                self.is_cancel_due = False
                wait = self._steps.throw(StopError())
        except (StopIteration, StopError):
            return
        self._wait = wait
        self._model.schedule(self, wait)


class ModelHold:
    """A request that a body stands still."""

    def __init__(self) -> None:
        self.stands = Moment()
        self.is_over = Moment()
        self.is_standing = False


class ModelGoal:
    def __init__(self, script: Script, server: ModelServer, parent: ModelGoal | None) -> None:
        self.script = script
        self.number = script.number
        self.server = server
        self.parent = parent
        self.goal_id = 0
        self.sender: object = None
        self.accepted = 0.0
        self.ended = math.inf
        self.status = "ACCEPTED"
        self.history: list[str] = []
        self.reason = ""
        self.result: tuple[int, ...] = ()
        self.feedback = 0
        self.kept_from = 0
        self.asked = 0
        self.is_paused = False
        self.hold: ModelHold | None = None
        self.process: Process | None = None
        self.end = Moment()

    @property
    def is_active(self) -> bool:
        return self.ended == math.inf

    @property
    def is_canceled(self) -> bool:
        return self.process is not None and self.process.is_canceled

    @property
    def is_about_to_stop(self) -> bool:
        return self.process is not None and self.process.is_about_to_stop

    @property
    def label(self) -> str:
        goal_id = goal_id_of(self.goal_id)
        return f"goal {goal_id.hex() if goal_id else self.number} of {self.server.name}"

    @property
    def outcome(self) -> tuple[object, ...]:
        return (self.status, self.result, self.reason)

    def enter(self, status: str) -> None:
        self.status = status
        self.history.append(status)


class ModelServer:
    def __init__(self, number: int, plan: ServerPlan, slot: ModelSlot) -> None:
        self.name = f"/s{number}"
        self.plan = plan
        self.slot = slot
        self.is_open = True
        self.closing = Moment()
        self.goals: list[ModelGoal] = []
        self.lost: set[int] = set()


class ModelSlot:
    """Places, each with a goal and its children, and those that wait."""

    def __init__(self, rules: dict[str, Any]) -> None:
        self.policy = rules.get("policy", "parallel")
        self.limit = rules.get("queue_limit", math.inf)
        self.size = rules.get("max_active", math.inf if self.policy == "parallel" else 1)
        self.has_queue = self.policy == "queue" or "max_active" in rules
        self.places: list[list[ModelGoal]] = []
        self.waiting: list[ModelGoal] = []

    def kin(self, goal: ModelGoal) -> list[ModelGoal]:
        """The parents that run here, the nearest first."""
        kin, parent = [], goal.parent
        while parent is not None and parent.is_active:
            if any(parent in place for place in self.places):
                kin.append(parent)
            parent = parent.parent
        return kin

    def place_of(self, goal: ModelGoal) -> list[ModelGoal]:
        return next(place for place in self.places if goal in place)

    def is_deadlock(self, goal: ModelGoal) -> bool:
        held_up = [self.place_of(kin) for each in (*self.waiting, goal) for kin in self.kin(each)]
        return all(any(place is each for each in held_up) for place in self.places)

    def heads(self) -> list[ModelGoal]:
        return [goal for place in self.places for goal in place if not self.kin(goal)]


class Model:
    """What the contract says will happen."""

    def __init__(self, plan: Plan, limits: Limits) -> None:
        self.limits = limits
        self.now = 0.0
        self.log: list[tuple[float, str, int]] = []
        self.outcomes: dict[int, tuple[object, ...]] = {}
        self.answers: dict[int, tuple[object, ...]] = {}
        self.goals: dict[int, ModelGoal] = {}
        self.clients: dict[int, Process] = {}
        self.servers: list[ModelServer] = []
        self._shared: ModelSlot | None = None
        for number, each in enumerate(plan.servers):
            slot = ModelSlot(dict(each.rules))
            if each.shares:
                slot = self._shared = self._shared or slot
            self.servers.append(ModelServer(number, each, slot))
        self._timers: list[tuple[float, int, Process, Wait]] = []
        self._order = itertools.count()
        self._ready: deque[Callable[[], object]] = deque()

    # time

    def soon(self, call: Callable[[], object]) -> None:
        self._ready.append(call)

    def start(self, steps: Steps[object]) -> Process:
        process = Process(self, steps)
        process.begin()
        return process

    def schedule(self, process: Process, wait: Wait) -> None:
        if wait.moment is not None:
            wait.moment.watchers.append(partial(process.wake, wait))
            if wait.moment.has_come:
                self.come(wait.moment)
        if wait.until < math.inf:
            heapq.heappush(self._timers, (wait.until, next(self._order), process, wait))

    def come(self, moment: Moment) -> None:
        moment.has_come = True
        for wake in moment.watchers:
            self.soon(wake)
        moment.watchers.clear()

    def settle(self) -> None:
        while self._ready:
            self._ready.popleft()()

    def pass_time(self, seconds: float) -> None:
        until, last = self.now + seconds, -1.0
        while self._timers and self._timers[0][0] <= until + 1e-6:
            moment, _, process, wait = heapq.heappop(self._timers)
            if not process.is_waiting(wait):
                continue
            if moment - last < 1e-6 or until - moment < 1e-6:
                raise OpenError
            self.now = last = moment
            process.wake(wait)
            self.settle()
        self.now = until

    def turn(self) -> Steps[None]:
        """Let all that are ready take a step."""
        turn = Moment()
        self.soon(partial(self.come, turn))
        yield Wait(moment=turn)

    # goals

    def take(self, goal: ModelGoal, goal_id: int, sender: object) -> ModelGoal:
        server = goal.server
        if not server.is_open:
            raise RefusedError(f"the server of '{server.name}' is shutting down")
        if goal_id and self.find(server, goal_id) is not None:
            held = bytes([goal_id]) * 16
            raise RefusedError(f"the server still holds a goal with the id {held.hex()}")
        goal.goal_id, goal.sender, goal.accepted = goal_id, sender, self.now
        is_started = self.place(goal)
        server.goals.append(goal)
        self.goals[goal.number] = goal
        if is_started:
            self.execute(goal)
        else:
            self.make_room(server.slot, f"preempted by {goal.label}")
        return goal

    def place(self, goal: ModelGoal) -> bool:
        """Whether a goal may start; else it waits."""
        slot = goal.server.slot
        kin = slot.kin(goal)
        rival = next((each for each in kin if each.server is goal.server), None)
        if kin and rival is None:
            slot.place_of(kin[0]).append(goal)
            return True
        if len(slot.places) < slot.size:
            slot.places.append([goal])
            return True
        if rival is not None and slot.is_deadlock(goal):
            raise RefusedError(
                f"a deadlock: it would wait for its own parent, {rival.label}",
            )
        if slot.policy == "preempt":
            displaced, slot.waiting = slot.waiting, [goal]
            for each in displaced:
                self.evict(each, f"preempted by {goal.label}")
            return False
        if not slot.has_queue:
            raise RefusedError(f"busy with {slot.places[0][0].label}")
        if len(slot.waiting) >= slot.limit:
            raise RefusedError(f"the queue is full ({len(slot.waiting)} waiting)")
        slot.waiting.append(goal)
        return False

    def make_room(self, slot: ModelSlot, reason: str) -> None:
        if slot.policy == "preempt":
            for each in slot.heads():
                self.evict(each, reason)

    def execute(self, goal: ModelGoal) -> None:
        """Start a body."""
        goal.enter("EXECUTING")
        goal.process = Process(self, self.body(goal))
        self.soon(goal.process.begin)

    def execute_next(self, goal: ModelGoal) -> None:
        if goal.is_active:
            self.execute(goal)

    def evict(self, goal: ModelGoal, reason: str) -> None:
        if goal.is_active and not goal.reason and goal.status != "CANCELING":
            relatives = self.relatives(goal)
            if any(each.is_about_to_stop or each.ended == self.now for each in relatives):
                raise OpenError  # which of the two will have been first?
            self.unpause(goal)
            goal.reason = reason
            self.stop(goal)

    def relatives(self, goal: ModelGoal) -> list[ModelGoal]:
        """The goal that has sent this one, and those that this one has sent."""
        everybody = self.goals.values()
        return [each for each in everybody if each.parent is goal or each is goal.parent]

    def cancel(self, goal: ModelGoal) -> bool:
        if not goal.is_active:
            return False
        if goal.status != "CANCELING":
            goal.enter("CANCELING")
            self.unpause(goal)
            self.stop(goal)
        return True

    def unpause(self, goal: ModelGoal) -> None:
        """Withdraw the request that a body stands still. If it stands, a cancel is to follow."""
        hold, goal.hold, goal.is_paused = goal.hold, None, False
        if hold is not None:
            self.come(hold.stands)

    def stop(self, goal: ModelGoal) -> None:
        """Cancel a body; one that has not begun never begins."""
        if goal.process is not None and goal.process.has_begun:
            goal.process.cancel()
            return
        if goal.status == "ACCEPTED":
            goal.enter("EXECUTING")
        self.finish(goal, "out")

    def end(
        self, goal: ModelGoal, status: str, result: tuple[int, ...] | None, reason: str = ""
    ) -> None:
        if not goal.is_active:
            return
        self.unpause(goal)
        goal.ended = self.now
        goal.enter(status)
        goal.result = goal.result if result is None else result
        goal.reason = reason
        self.come(goal.end)
        slot = goal.server.slot
        slot.waiting = [each for each in slot.waiting if each is not goal]
        slot.places = [[each for each in place if each is not goal] for place in slot.places]
        if [] in slot.places:
            slot.places.remove([])
            if slot.waiting:
                following = slot.waiting.pop(0)
                if following.parent is not None and following.parent.is_about_to_stop:
                    raise OpenError  # does it start before its parent cancels it?
                slot.places.append([following])
                self.soon(partial(self.execute_next, following))
        if slot.waiting:
            self.make_room(slot, f"preempted by {slot.waiting[0].label}")

    def find(self, server: ModelServer, goal_id: int) -> ModelGoal | None:
        return next((g for g in server.goals if g.goal_id == goal_id and self.is_held(g)), None)

    def namesake(self, goal: ModelGoal) -> ModelGoal | None:
        """The goal that has this one's id now."""
        if goal.goal_id:
            return self.find(goal.server, goal.goal_id)
        return goal if self.is_held(goal) else None

    def is_held(self, goal: ModelGoal) -> bool:
        keep = goal.server.plan.keep
        return goal.is_active or keep is None or self.now < goal.ended + keep

    # bodies

    def body(self, goal: ModelGoal) -> Steps[None]:
        script = goal.script
        verdict: Verdict
        if not goal.is_active:
            return
        try:
            yield from self.stand(goal)
        except StopError:
            self.finish(goal, "out")
            return
        self.log.append((self.now, "begun", goal.number))
        try:
            for index, step in enumerate(script.steps):
                if isinstance(step, Sleep):
                    yield Wait(self.now + span(step.seconds, goal.number, index))
                elif isinstance(step, Say):
                    for _ in range(step.messages):
                        goal.feedback += 1
                        yield from self.stand(goal)
                elif isinstance(step, Partial):
                    goal.result = (-1, goal.number)
                else:
                    yield Wait(self.now + span(step.seconds, goal.number, index))
                    timeout = span(step.timeout, "timeout", goal.number, index)
                    yield from self.sender(
                        step.script, self.servers[step.server], step.how, goal, self.now + timeout
                    )
                    yield Wait(self.now + span(0.0, "after", goal.number, index))
            verdict = script.verdict
        except StopError:
            try:
                verdict = yield from self.recover(goal)
            except StopError:
                verdict = "out"
        self.log.append((self.now, "over", goal.number))
        self.finish(goal, verdict)

    def stand(self, goal: ModelGoal) -> Steps[None]:
        """A body stands still here while its goal is paused."""
        hold = goal.hold
        if hold is not None:
            hold.is_standing = True
            self.come(hold.stands)
            yield Wait(moment=hold.is_over)

    def recover(self, goal: ModelGoal) -> Steps[Verdict]:
        recovery = goal.script.recovery
        if recovery.speaks:
            if not goal.is_active:
                return "error"
            goal.feedback += 1
        if recovery.seconds:
            seconds = span(recovery.seconds, "recovery", goal.number)
            yield Wait(self.now + seconds, is_shielded=True)
        return recovery.verdict

    def finish(self, goal: ModelGoal, verdict: Verdict) -> None:
        if not goal.is_active:
            return
        if verdict == "result":
            self.end(goal, "SUCCEEDED", (goal.number,))
            return
        if verdict == "nothing":
            yields = goal.server.plan.is_generator
            way = "the last value yielded must be" if yields else "the body must return"
            self.end(goal, "ABORTED", None, f"no result: {way} a Result")
            return
        is_canceling = goal.status == "CANCELING"
        if verdict == "abort":
            self.end(goal, "ABORTED", None, "given up")
        elif verdict == "abort with a result":
            self.end(goal, "ABORTED", (-2, goal.number), "given up")
        elif verdict == "error":
            self.end(goal, "ABORTED", None, "ValueError: broken")
        else:
            reached = (-3, goal.number) if verdict == "canceled" else None
            status, reason = ("CANCELED", "") if is_canceling else ("ABORTED", goal.reason)
            self.end(goal, status, reached, reason)

    # clients

    def sender(
        self,
        script: Script,
        server: ModelServer,
        how: How,
        parent: ModelGoal | None = None,
        deadline: float = math.inf,
        send: Send | None = None,
    ) -> Steps[None]:
        """Send a goal and note what comes of it."""
        try:
            outcome = yield from self.sending(script, server, how, parent, deadline, send)
        except RefusedError as refused:
            outcome = ("rejected", str(refused))
        except StopError:
            self.outcomes[script.number] = ("canceled",)
            raise
        self.outcomes[script.number] = outcome

    def sending(
        self,
        script: Script,
        server: ModelServer,
        how: How,
        parent: ModelGoal | None,
        deadline: float,
        send: Send | None,
    ) -> Steps[tuple[object, ...]]:
        if send is not None and send.client in server.lost:
            return ("closed",)
        if not server.is_open:
            return ("unavailable",)
        if server.plan.asked_for_goals != "never":
            if server.plan.asked_for_goals == "later":
                answered = self.now + span(0.5, "goal", script.number)
                yield Wait(min(deadline, answered), server.closing)
                if server.closing.has_come:
                    if parent is not None and parent.is_canceled:
                        raise OpenError  # which of the two will have been first?
                    raise RefusedError(f"the server of '{server.name}' is shutting down")
                if deadline < answered:
                    return ("canceled",)
            if script.is_unwelcome:
                raise RefusedError("the goal_callback rejected it")
            is_lost = send is not None and send.client in server.lost
            if is_lost and server.plan.on_client_lost == "cancel":
                raise RefusedError("its client has gone")
        goal = ModelGoal(script, server, parent)
        goal_id, client = (send.goal_id, send.client) if send is not None else (0, None)
        self.take(goal, goal_id, client)
        is_canceled = how == "enter" and send is not None and send.is_canceled_at_once
        if is_canceled and self.is_about_to_start(goal):
            raise OpenError  # does it start before it is canceled?
        says = any(isinstance(step, Say) for step in script.steps)
        if is_canceled and says and not server.plan.is_generator:
            raise OpenError  # at which of its checkpoints does that reach it?
        try:
            if how == "await":
                goal.kept_from = -1
            else:
                yield from self.turn()
            if how == "detach":
                return ("detached",)
            if is_canceled and server.plan.asked_for_cancels == "never":
                self.cancel(goal)
            leaves = self.now + span(0.5, "leave", script.number) if how == "leave" else math.inf
            if how == "leave" or goal.is_active:
                yield Wait(min(deadline, leaves), None if how == "leave" else goal.end)
        except StopError:
            yield from self.give_up(goal)
            raise
        if goal.is_active:
            yield from self.give_up(goal)
        elif how != "leave":
            return goal.outcome
        if self.now >= deadline:
            return ("canceled",)
        if parent is not None and parent.process is not None and parent.process.is_cancel_due:
            raise OpenError  # does it hear of that as it leaves, or at its next wait?
        yield from self.turn()
        return ("left",)

    def give_up(self, goal: ModelGoal) -> Steps[None]:
        """Cancel a goal and wait for its end."""
        if goal.is_active:
            if self.is_about_to_start(goal):
                raise OpenError  # likewise
            until = self.now + self.limits.cancel_timeout
            yield from self.let_go(goal)
            if goal.is_active:
                yield Wait(until, goal.end, is_shielded=True)

    def is_about_to_start(self, goal: ModelGoal) -> bool:
        """Whether a goal waits for one whose body is being canceled."""
        slot = goal.server.slot
        holders = [each for place in slot.places for each in place]
        return goal in slot.waiting and any(each.is_about_to_stop for each in holders)

    def let_go(self, goal: ModelGoal) -> Steps[bool]:
        """Ask the server's user, and cancel the goal."""
        server = goal.server
        how = server.plan.asked_for_cancels
        if not goal.is_active:
            return False
        if how != "never" and goal.status != "CANCELING":
            goal.asked += 1
            if how == "later" and not server.is_open:
                return False
            if how == "later":
                closing = server.closing
                seconds = span(0.5, "cancel", goal.number, goal.asked)
                yield Wait(self.now + seconds, closing, is_shielded=True)
                if closing.has_come:
                    return False
            if goal.number % 3 == 0:
                return False
        return self.cancel(goal)

    # operations

    def request(self, step: int, goal: ModelGoal, by: str) -> Steps[None]:
        """A request to cancel."""
        server = goal.server
        named = self.namesake(goal) if by in ("id", "both") else None
        before = goal.accepted if by in ("stamp", "both") else -1.0
        everything = by == "all"
        let_go: list[ModelGoal] = []
        kept: list[ModelGoal] = []
        for each in [each for each in server.goals if each.is_active]:
            if everything or each is named or each.accepted <= before:
                was_open = server.is_open
                (let_go if (yield from self.let_go(each)) else kept).append(each)
                if was_open and not server.is_open:
                    raise OpenError  # do those that are not let go end before the answer?
        code = 0
        if let_go or any(each.is_active for each in kept):
            code = 0 if let_go else 1
        elif by in ("id", "unknown id"):
            code = 2 if named is None else 3
        self.answers[step] = (code, [each.number for each in let_go])

    def observe(self, step: int, goal: ModelGoal) -> Steps[None]:
        """Somebody who attaches himself to a goal."""
        if not goal.server.is_open:
            self.answers[step] = ("unavailable",)
            return
        named = self.namesake(goal)
        if named is None:
            self.answers[step] = ("unknown",)
            return
        if named.kept_from < 0:
            named.kept_from = named.feedback
        if named.is_active:
            yield Wait(moment=named.end)
        seen = list(range(named.kept_from, named.feedback))
        self.answers[step] = (list(named.history), seen, named.outcome)

    def pause(self, step: int, goal: ModelGoal, timeout: float) -> Steps[None]:
        """Somebody pauses a goal."""
        if goal.hold is not None and not goal.is_paused:
            raise OpenError  # somebody else is about to pause it
        if not goal.is_paused:
            if not goal.is_active or goal.status == "CANCELING" or goal.reason:
                self.answers[step] = ("refused",)
                return
            hold = goal.hold = ModelHold()
            if goal.status == "EXECUTING":
                yield Wait(self.now + timeout, hold.stands)
                if goal.hold is not hold or not hold.is_standing:
                    if goal.hold is hold:
                        self.unpause(goal)
                    self.answers[step] = ("refused",)
                    return
            goal.is_paused = True
        self.answers[step] = ("paused",)

    def resume(self, step: int, goal: ModelGoal) -> None:
        """Somebody resumes a goal."""
        if goal.hold is not None and not goal.is_paused:
            raise OpenError  # likewise
        if goal.is_paused and goal.hold is not None:
            self.come(goal.hold.is_over)
            self.unpause(goal)
        self.answers[step] = ("resumed",)

    def lose(self, server: ModelServer, client: int) -> None:
        """A client is closed."""
        if server.is_open and client not in server.lost:
            server.lost.add(client)
            if server.plan.on_client_lost == "cancel":
                for goal in [goal for goal in server.goals if goal.sender == client]:
                    self.cancel(goal)

    def close(self, *servers: ModelServer) -> Steps[None]:
        """Servers are closed together: one grace is enough for all their bodies."""
        closing = [each for each in servers if each.is_open]
        for server in closing:
            server.is_open = False
            self.come(server.closing)
        goals = [goal for server in closing for goal in server.goals]
        for goal in goals:
            self.evict(goal, "shutdown")
        if any(goal.is_active for goal in goals):
            yield Wait(self.now + self.limits.grace)
        for goal in goals:
            self.end(goal, "ABORTED", None, goal.reason or "shutdown")


class Picture(NamedTuple):
    """What can be seen at one moment."""

    statuses: dict[int, str]
    paused: set[int]
    outcomes: dict[int, tuple[object, ...]]
    answers: dict[int, tuple[object, ...]]
    log: list[tuple[float, str, int]]


class Act(NamedTuple):
    """An operation with its goal, and what is to be seen before and after."""

    seconds: float
    operation: Operation | None
    goal: int
    before: Picture
    after: Picture


def is_alone(goal: ModelGoal) -> bool:
    """Whether a goal sends no others."""
    return not any(isinstance(step, Nest) for step in goal.script.steps)


class Play:
    """The model plays a plan."""

    def __init__(self, plan: Plan, limits: Limits) -> None:
        self.model = Model(plan, limits)
        self.acts = [
            self._act(step, span(seconds, "operation", step), operation)
            for step, (seconds, operation) in enumerate(plan.operations)
        ]
        end = len(plan.operations)
        self.acts.append(self._act(end, span(plan.last, "operation", end), None))
        self.model.pass_time(LONG)

    def _act(self, step: int, seconds: float, operation: Operation | None) -> Act:
        model = self.model
        model.pass_time(seconds)
        before = self._picture()
        number = self._goal(operation)
        self._do(step, operation, number)
        model.settle()
        return Act(seconds, operation, number, before, self._picture())

    def _goal(self, operation: Operation | None) -> int:
        """The number of the goal that an operation is about; 0 if it is about none."""
        model = self.model
        match operation:
            case Leave(target):
                numbers = list(model.clients)
            case CancelGoal(target) | Attach(target):
                begun = [number for _, what, number in model.log if what == "begun"]
                active = [goal.number for goal in model.goals.values() if goal.is_active]
                numbers = active if active and target < 8 else [*begun, *active]
            case Pause():
                numbers = [n for n, goal in model.goals.items() if is_alone(goal)]
            case Resume():
                alone = [n for n, goal in model.goals.items() if is_alone(goal)]
                numbers = [n for n in alone if model.goals[n].is_paused] or alone
            case _:
                return 0
        target = operation.target
        return numbers[target % len(numbers)] if numbers else 0

    def _do(self, step: int, operation: Operation | None, number: int) -> None:
        model = self.model
        goal = model.goals.get(number)
        match operation:
            case Send(server, _, script, how):
                steps = model.sender(script, model.servers[server], how, send=operation)
                model.clients[script.number] = model.start(steps)
            case CancelGoal(_, by) if goal is not None:
                model.start(model.request(step, goal, by))
            case Attach() if goal is not None:
                model.start(model.observe(step, goal))
            case Pause(_, timeout) if goal is not None:
                model.start(model.pause(step, goal, self._span(timeout, step)))
            case Resume() if goal is not None:
                model.resume(step, goal)
            case Leave() if number:
                model.clients[number].cancel()
            case CloseClient(at, client):
                model.lose(model.servers[at], client)
            case CloseServer(at):
                model.start(model.close(model.servers[at]))
            case None:
                model.start(model.close(*model.servers))

    def _span(self, timeout: float, step: int) -> float:
        """The timeout of a pause; it does not pass where the loop's own time stands still."""
        return math.inf if self.model.limits.grace == math.inf else span(timeout, "pause", step)

    def _picture(self) -> Picture:
        model = self.model
        return Picture(
            {goal.number: goal.status for goal in model.goals.values()},
            {goal.number for goal in model.goals.values() if goal.is_paused},
            dict(model.outcomes),
            dict(model.answers),
            list(model.log),
        )


# --- turtleact ------------------------------------------------------------------------------


class World:
    """Turtleact plays a plan, and is compared with the model."""

    def __init__(self, plan: Plan, play: Play, clock: Hand | None) -> None:
        self._plan = plan
        self._play = play
        self._hand = clock
        self._settle = take_turns if clock is not None else wait_until_idle
        self._log: list[tuple[float, str, int]] = []
        self._outcomes: dict[int, tuple[object, ...]] = {}
        self._answers: dict[int, tuple[object, ...]] = {}
        self._goals: dict[int, Goal] = {}
        self._slots: list[Slot[Any] | None] = []
        self._locals: dict[turtleact.ActionServer[Any, Any, Any], LocalActionServer] = {}
        self._scripts: dict[int, Script] = {}
        self._clients: dict[int, Running[None]] = {}
        self._received: dict[int, list[int]] = defaultdict(list)
        self._asked: dict[int, int] = defaultdict(int)
        self._changes: dict[int, list[str]] = defaultdict(list)

    async def run(self) -> None:
        transport = MemoryTransport(self._hand) if self._hand is not None else None
        before = tasks_of_the_loop()
        async with (
            anyio.create_task_group() as rest,  # time passes in it once something is wrong
            turtleact.open_node("world", transport=transport) as node,
            anyio.create_task_group() as self._group,
        ):
            self._node = node
            self._start = node.clock.time()
            if self._plan.is_watched:
                node.on_transition(self._watch)
            self._servers = [self._serve(i, each) for i, each in enumerate(self._plan.servers)]
            self._senders = [
                [node.action_client(Count, f"s{i}") for _ in range(3)]
                for i, _ in enumerate(self._plan.servers)
            ]
            try:
                for step, act in enumerate(self._play.acts):
                    await self._pass_time(act.seconds)
                    self._compare(act.before)
                    self._do(step, act)
                    await self._settle()
                    self._compare(act.after)
                await self._pass_time(LONG)
                self._compare_the_end()
            except AssertionError:
                if self._hand is not None:
                    rest.start_soon(self._hand.run)
                raise
            rest.cancel_scope.cancel()
        await self._settle()
        assert tasks_of_the_loop() <= before

    def _serve(self, number: int, plan: ServerPlan) -> turtleact.ActionServer[Any, Any, Any]:
        options = {"pausable": True, **dict(plan.rules)}
        if plan.shares:
            options["slot"] = "shared"
        if plan.asked_for_goals != "never":
            options["goal_callback"] = self._goal_callback(plan)
        if plan.asked_for_cancels != "never":
            options["cancel_callback"] = self._cancel_callback(plan)
        server = self._node.action_server(
            Count,
            f"s{number}",
            self._stream if plan.is_generator else self._body,
            result_timeout=plan.keep,
            on_client_lost=plan.on_client_lost,
            **options,
        )
        self._locals[server] = local = local_server(server)
        local.observers.add(_Noted(self._goals))
        self._slots.append(local.slot)
        return server

    def _goal_callback(self, plan: ServerPlan) -> Callable[..., object]:
        def answer(goal: Count.Goal) -> GoalResponse:
            is_unwelcome = self._scripts[goal.upto].is_unwelcome
            return GoalResponse.REJECT if is_unwelcome else GoalResponse.ACCEPT

        async def answer_later(goal: Count.Goal) -> GoalResponse:
            await self._sleep(span(0.5, "goal", goal.upto))
            return answer(goal)

        return answer if plan.asked_for_goals == "at once" else answer_later

    def _cancel_callback(self, plan: ServerPlan) -> Callable[..., object]:
        def answer(handle: Handle) -> CancelResponse:
            self._asked[handle.request.upto] += 1
            return CancelResponse.ACCEPT if handle.request.upto % 3 else CancelResponse.REJECT

        async def answer_later(handle: Handle) -> CancelResponse:
            verdict, number = answer(handle), handle.request.upto
            await self._sleep(span(0.5, "cancel", number, self._asked[number]))
            return verdict

        return answer if plan.asked_for_cancels == "at once" else answer_later

    def _watch(self, handle: Handle, _: GoalStatus, new: GoalStatus) -> None:
        self._changes[handle.request.upto].append(new.name)

    # time

    async def _sleep(self, seconds: float) -> None:
        await self._node.clock.sleep(seconds)

    async def _pass_time(self, seconds: float) -> None:
        if self._hand is None:
            await self._sleep(seconds)
        else:
            await self._hand.pass_time(seconds)
        await self._settle()

    @asynccontextmanager
    async def _limit(self, seconds: float) -> AsyncIterator[None]:
        """What ``anyio.move_on_after`` does, by the clock of the node."""
        if seconds == math.inf:
            yield
        elif self._hand is None:
            with anyio.move_on_after(seconds):
                yield
        else:
            async with anyio.create_task_group() as group:

                async def expire() -> None:
                    await self._sleep(seconds)
                    group.cancel_scope.cancel()

                group.start_soon(expire)
                yield
                group.cancel_scope.cancel()

    # bodies

    async def _body(self, goal: Count.Goal, handle: Handle) -> Any:
        async with aclosing(self._stream(goal, handle)) as words:
            async for word in words:
                if isinstance(word, Count.Result):
                    return word
                handle.publish_feedback(word)
        return None

    async def _stream(self, goal: Count.Goal, handle: Handle) -> AsyncGenerator[Any, None]:
        number, script = goal.upto, self._scripts[goal.upto]
        self._note("begun", number)
        count = itertools.count()
        try:
            for index, step in enumerate(script.steps):
                if isinstance(step, Say):
                    for _ in range(step.messages):
                        yield feedback(next(count))
                        if not self._yields(number):
                            await handle.checkpoint()
                elif isinstance(step, Partial):
                    handle.set_partial_result(result(-1, number))
                elif isinstance(step, Sleep):
                    await self._sleep(span(step.seconds, number, index))
                else:
                    await self._sleep(span(step.seconds, number, index))
                    await self._nest(step, span(step.timeout, "timeout", number, index))
                    await self._sleep(span(0.0, "after", number, index))
            verdict = script.verdict
        except anyio.get_cancelled_exc_class():
            recovery = script.recovery
            if recovery.speaks:
                yield feedback(next(count))
            if recovery.seconds:
                with anyio.CancelScope(shield=True):
                    await self._sleep(span(recovery.seconds, "recovery", number))
            verdict = recovery.verdict
            if verdict == "out":
                raise
        finally:
            self._note("over", number)
        if verdict == "result":
            yield result(number)
        elif verdict == "canceled":
            raise Cancel(result(-3, number))
        elif verdict in ("abort", "abort with a result"):
            raise Abort("given up", result(-2, number) if "with" in verdict else None)
        elif verdict == "error":
            raise ValueError("broken")

    def _yields(self, number: int) -> bool:
        return self._plan.servers[self._server_number(number)].is_generator

    def _note(self, what: str, number: int) -> None:
        self._log.append((self._node.clock.time() - self._start, what, number))

    async def _nest(self, step: Nest, timeout: float) -> None:
        async with self._limit(timeout):
            await self._send(Send(step.server, 2, step.script, step.how, 0, False))

    # clients

    async def _send(self, send: Send) -> None:
        number = send.script.number
        self._scripts[number] = send.script
        outcome: tuple[object, ...]
        try:
            outcome = await self._outcome(send, number)
        except GoalRejected as error:
            outcome = ("rejected", error.reason)
        except GoalAborted as error:
            outcome = ("ABORTED", error.result, error.reason)
        except GoalCanceled as error:
            outcome = ("CANCELED", error.result, error.reason)
        except ServerUnavailable:
            outcome = ("unavailable",)
        except TurtleactError:
            outcome = ("closed",)
        except anyio.get_cancelled_exc_class():
            self._outcomes[number] = ("canceled",)
            raise
        self._outcomes[number] = outcome

    async def _outcome(self, send: Send, number: int) -> tuple[object, ...]:
        client, received = self._senders[send.server][send.client], self._received[number]
        sending = client.send_goal(
            Count.Goal(upto=number),
            goal_id=goal_id_of(send.goal_id),
            feedback_callback=lambda message: received.append(message.so_far[0]),
        )
        if send.how == "await":
            return ("SUCCEEDED", await sending, "")
        async with sending as handle:
            if send.how == "detach":
                handle.detach()
                return ("detached",)
            if send.how == "leave":
                await self._sleep(span(0.5, "leave", number))
                return ("left",)
            if send.is_canceled_at_once and self._asks_nobody(send.server):
                handle.cancel_nowait()
            read = [message.so_far[0] async for message in handle]
            outcome = await handle.outcome()
            assert read == received
            return (outcome.status.name, outcome.result, outcome.reason)

    def _asks_nobody(self, server: int) -> bool:
        return self._plan.servers[server].asked_for_cancels == "never"

    # operations

    def _do(self, step: int, act: Act) -> None:
        goal = self._goals.get(act.goal)
        server = None if goal is None else self._server_of(act.goal)
        start = self._group.start_soon
        match act.operation:
            case Send(script=script) as send:
                sending: Running[None] = Running(partial(self._send, send))
                self._clients[script.number] = sending
                start(sending.run)
            case Leave() if act.goal:
                self._clients[act.goal].scope.cancel()
            case Pause(_, timeout) if server is not None and goal is not None:
                limit = math.inf if self._hand is not None else span(timeout, "pause", step)
                start(self._pause, step, server, goal, limit)
            case Resume() if server is not None and goal is not None:
                start(self._resume, step, server, goal)
            case CancelGoal(_, by) if server is not None and goal is not None:
                start(self._cancel, step, server, goal, by)
            case Attach() if server is not None and goal is not None:
                start(
                    self._observe,
                    step,
                    self._server_number(act.goal),
                    goal.id,
                )
            case CloseClient(at, client):
                if self._servers[at].is_open:
                    start(self._senders[at][client].aclose)
            case CloseServer(at):
                start(self._servers[at].aclose)
            case None:
                start(self._node.aclose)

    def _server_number(self, number: int) -> int:
        return self._play.model.servers.index(self._play.model.goals[number].server)

    def _server_of(self, number: int) -> turtleact.ActionServer[Any, Any, Any]:
        return self._servers[self._server_number(number)]

    async def _cancel(
        self, step: int, server: turtleact.ActionServer[Any, Any, Any], goal: Goal, by: str
    ) -> None:
        local = self._locals[server]
        goal_id = goal.id if by in ("id", "both") else None
        if by == "unknown id":
            goal_id = b"unknown".ljust(16)
        response = await local.cancel(goal_id, goal.stamp if by in ("stamp", "both") else 0)
        canceling = [
            self._number_of(bytes(each.goal_id.uuid), server) for each in response.goals_canceling
        ]
        self._answers[step] = (response.return_code, canceling)

    async def _pause(
        self,
        step: int,
        server: turtleact.ActionServer[Any, Any, Any],
        goal: Goal,
        timeout: float,
    ) -> None:
        try:
            await self._locals[server].pauses.pause(goal, timeout)
        except PauseRefused:
            self._answers[step] = ("refused",)
        else:
            self._answers[step] = ("paused",)

    async def _resume(
        self, step: int, server: turtleact.ActionServer[Any, Any, Any], goal: Goal
    ) -> None:
        await self._locals[server].pauses.resume(goal)
        self._answers[step] = ("resumed",)

    async def _observe(self, step: int, at: int, goal_id: bytes) -> None:
        kinds, statuses, seen = [], [], []
        try:
            async with self._senders[at][2].attach(goal_id) as handle:
                async for event in handle.events():
                    kinds.append(event.kind)
                    if event.kind == "status":
                        statuses.append(event.status.name)
                    elif event.kind == "feedback":
                        seen.append(event.feedback.so_far[0])
                outcome = await handle.outcome()
        except UnknownGoal:
            self._answers[step] = ("unknown",)
        except ServerUnavailable:
            self._answers[step] = ("unavailable",)
        else:
            assert kinds[0] == "accepted"
            assert kinds[-2:] == ["status", "result"]
            end = (outcome.status.name, outcome.result, outcome.reason)
            self._answers[step] = (statuses, seen, end)

    # comparing

    def _compare(self, expected: Picture) -> None:
        plain = self._plain
        assert {n: goal.status.name for n, goal in self._goals.items()} == expected.statuses
        paused = {n for n, goal in self._goals.items() if self._is_paused(n, goal)}
        assert paused == expected.paused
        assert plain(self._outcomes) == expected.outcomes
        assert plain(self._answers) == expected.answers
        assert rounded(self._log) == rounded(expected.log)

    def _is_paused(self, number: int, goal: Goal) -> bool:
        return self._locals[self._server_of(number)].pauses.is_paused(goal)

    def _plain(self, value: Any) -> Any:
        """Results as tuples, and numbers of goals for the ids that nobody has chosen."""
        if isinstance(value, dict):
            return {key: self._plain(each) for key, each in value.items()}
        if isinstance(value, tuple):
            return tuple(self._plain(each) for each in value)
        if isinstance(value, Count.Result):
            return tuple(value.counted)
        if isinstance(value, str):
            for number, goal in self._goals.items():
                if goal.id is not None and len(set(goal.id)) > 1:
                    value = value.replace(goal.id.hex(), str(number))
        return value

    def _number_of(self, goal_id: bytes, server: turtleact.ActionServer[Any, Any, Any]) -> int:
        """The number of the newest goal of that id."""
        newest_first = reversed(self._goals.items())
        return next(
            number
            for number, goal in newest_first
            if goal.id == goal_id and self._server_of(number) is server
        )

    def _compare_the_end(self) -> None:
        model = self._play.model
        assert all(client.done.is_set() for client in self._clients.values())
        assert self._plain(self._outcomes) == model.outcomes
        assert self._plain(self._answers) == model.answers
        assert rounded(self._log) == rounded(model.log)
        for number, goal in self._goals.items():
            self._compare_goal(goal, model.goals[number])
        assert {n: n_asked for n, n_asked in self._asked.items() if n_asked} == {
            goal.number: goal.asked for goal in model.goals.values() if goal.asked
        }
        for server in self._servers:
            self._check_nothing_is_left(server)
        for slot in self._slots:
            assert slot is None or slot.is_empty

    def _compare_goal(self, goal: Goal, expected: ModelGoal) -> None:
        number = expected.number
        history = [*(status.name for status, _ in goal.log.history), goal.status.name]
        assert history == expected.history
        chain = itertools.pairwise(["ACCEPTED", *history])
        assert all(step in LEGAL for step in chain)
        if self._plan.is_watched:
            assert self._changes[number] == ["ACCEPTED", *history]
        assert (goal.status.name, *self._plain((goal.result, goal.reason))) == expected.outcome
        assert self._received[number] == list(range(expected.feedback))

    def _check_nothing_is_left(self, server: turtleact.ActionServer[Any, Any, Any]) -> None:
        assert server.is_idle


class _Noted(GoalObserver):
    """Notes all goals that are accepted, by their numbers."""

    def __init__(self, goals: dict[int, Goal]) -> None:
        self._goals = goals

    def goal_changed(self, goal: Goal, before: GoalStatus, after: GoalStatus) -> None:
        self._goals[number_of(goal)] = goal


Handle: TypeAlias = turtleact.ServerGoalHandle[Any, Any, Any]

LEGAL = {(old.name, new.name) for (old, _), new in TRANSITIONS.items()}


def number_of(goal: Goal) -> int:
    assert isinstance(goal.request, Count.Goal)
    return goal.request.upto


def rounded(log: list[tuple[float, str, int]]) -> list[tuple[float, str, int]]:
    """In the order of time; what falls together has no order between goals."""
    return sorted((round(when, 5), what, number) for when, what, number in log)


def tasks_of_the_loop() -> set[object]:
    """All tasks but the one that asks."""
    if anyio.get_cancelled_exc_class().__module__.startswith("trio"):
        import trio

        root = trio.lowlevel.current_root_task()
        assert root is not None
        return {task for nursery in root.child_nurseries for task in nursery.child_tasks}
    return set(other_tasks())


class Hand(HandClock):
    """A clock that passes through each moment at which somebody wakes up, for uvloop.

    uvloop does not tell when it is idle, so all others get some turns instead.
    """

    async def pass_time(self, seconds: float) -> None:
        until = self._time + seconds
        while self._sleepers and self._sleepers[0][0] <= until:
            self._time, _, sleeper = self._sleepers.pop(0)
            sleeper.fire()
            await take_turns()
        self._time = until


def play(plan: Plan, backend: str) -> None:
    """Let the model and turtleact play a plan, and compare."""
    if backend == "uvloop":  # the limits are by the loop's own time, which stands still here
        limits = Limits(math.inf, math.inf)
        name, options = "asyncio", {"use_uvloop": True}
    else:
        limits = Limits(GRACE, CANCEL_TIMEOUT)
        name, options = virtual_backend("trio" if backend == "trio" else "asyncio")
    try:
        expected = Play(plan, limits)
    except OpenError:
        hypothesis.reject()

    async def run() -> None:
        await World(plan, expected, Hand() if backend == "uvloop" else None).run()

    anyio.run(run, backend=name, backend_options=options)


@pytest.mark.parametrize("backend", INSTALLED)
@hypothesis.settings(max_examples=EXAMPLES)
@hypothesis.given(plan=plans())
def test_servers_and_clients_do_what_the_model_says(backend: str, plan: Plan):
    play(plan, backend)
