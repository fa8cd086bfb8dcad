"""Services that turtlesim lacks: pause and step time, read all poses at once, take pictures.

- `Ticking` makes a tick every 16 ms, on a fixed schedule. While the world is paused, the clock
  stands still. Code that waits on the clock therefore misses no tick, and the schedule continues
  after the pause.
- `Simulation` opens the services by which other simulators control time:
  ``~/get_simulator_features``, ``~/get_simulation_state``, ``~/set_simulation_state``,
  ``~/step_simulation`` and ``~/reset_simulation``. It also opens the action ``~/simulate_steps``.
- `Poses` is one message with the poses of all turtles, in arrays. One message per turtle would be
  too slow, because sending the messages of one tick would take longer than a tick.
  ``geometry_msgs/msg/PoseArray`` has no field for names.
- `Pictures` opens the service ``~/snapshot``. The module `pictures` makes the picture, in a thread.

Source: simulation_interfaces 2.1.0; Gazebo, for service names that begin with the node's
name.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import anyio
import anyio.to_thread
from msgspec import field

from turtleact.errors import Abort, SimError
from turtleact.interfaces import Message, Service, float32, string
from turtleact.interfaces.standard import Time
from turtleact.interfaces.standard.simulation_interfaces.action import SimulateSteps
from turtleact.interfaces.standard.simulation_interfaces.msg import Result as SimulationResult
from turtleact.interfaces.standard.simulation_interfaces.msg import (
    SimulationState,
    SimulatorFeatures,
)
from turtleact.interfaces.standard.simulation_interfaces.srv import (
    GetSimulationState,
    GetSimulatorFeatures,
    ResetSimulation,
    SetSimulationState,
    StepSimulation,
)
from turtleact.sim.kinematics import DT
from turtleact.sim.pictures import Snapshot, to_png, to_svg
from turtleact.tasks import Background, current_tasks

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from turtleact.node import Node, ServerGoalHandle
    from turtleact.sim.world import World
    from turtleact.tasks.clock import Clock

    Handle = ServerGoalHandle[SimulateSteps.Goal, SimulateSteps.Result, SimulateSteps.Feedback]

__all__ = [
    "FEATURES",
    "FORMATS",
    "MOST_BEHIND",
    "Pictures",
    "Poses",
    "Simulation",
    "TakeSnapshot",
    "Ticking",
    "poses_of",
]

MOST_BEHIND: Final = 1.0
"""If a tick is late by more than this (s of the clock), the missed ticks are skipped."""

FEATURES: Final = (
    SimulatorFeatures.SIMULATION_RESET,
    SimulatorFeatures.SIMULATION_STATE_GETTING,
    SimulatorFeatures.SIMULATION_STATE_SETTING,
    SimulatorFeatures.SIMULATION_STATE_PAUSE,
    SimulatorFeatures.STEP_SIMULATION_SINGLE,
    SimulatorFeatures.STEP_SIMULATION_MULTIPLE,
    SimulatorFeatures.STEP_SIMULATION_ACTION,
)
"""The features of simulation_interfaces that the world has."""

_OK: Final = SimulationResult(SimulationResult.RESULT_OK)
_STATES: Final = {
    SimulationState.STATE_STOPPED: "stopped",
    SimulationState.STATE_PLAYING: "playing",
    SimulationState.STATE_PAUSED: "paused",
}
_SCOPES: Final = (ResetSimulation.Request.SCOPE_DEFAULT, ResetSimulation.Request.SCOPE_ALL)

FORMATS: Final[dict[str, Callable[[Snapshot], bytes]]] = {
    "png": to_png,
    "svg": lambda snapshot: to_svg(snapshot).encode(),
}
"""The formats of a picture."""


class Ticking:
    """Calls ``tick`` every 16 ms of the clock, until this object is closed.

    The owner makes the first tick itself, before it creates this object.

    Args:
        clock: The clock to follow. `Ticking` stops this clock during a pause.
        tick: The function that makes a tick.
        is_paused: Whether to start with a pause.

    Attributes:
        is_paused: Whether the ticks are paused. During a pause, only `step` makes ticks.
    """

    def __init__(self, clock: Clock, tick: Callable[[], None], *, is_paused: bool = False) -> None:
        self.is_paused = is_paused
        self._clock = clock
        self._tick = tick
        self._start = clock.time()
        self._count = 1
        self._step: _Step | None = None
        self._changed = current_tasks().signal()
        if is_paused:
            clock.stop_at(self._start)
        self._running = Background(self._run(), "turtlesim")

    @property
    def is_stepping(self) -> bool:
        """Whether a `step` is under way."""
        return self._step is not None

    def pause(self) -> None:
        """Stop the ticks and the clock until `resume`. This ends a `step` that is under way."""
        now = self._clock.time()
        self._clock.stop_at(now)
        # A tick that is late now would come at once after the pause, as if time had passed during
        # it. The schedule is therefore moved, so that the next tick is due now and not earlier.
        self._start = max(self._start, now - self._count * DT)
        self._end_step("paused")
        self.is_paused = True

    def resume(self) -> None:
        """Let the ticks and the clock continue. This ends a `step` that is under way."""
        self._end_step("resumed")
        self.is_paused = False
        self._clock.stop_at(math.inf)
        self._changed.fire()

    async def step(self, ticks: int = 1, on_tick: Callable[[], None] | None = None) -> None:
        """Advance the paused world by ``ticks`` ticks, at the pace of the clock.

        Returns after the last tick.

        Cancelling: the remaining ticks are skipped.

        Args:
            ticks: How many ticks to make, 0 or more.
            on_tick: Called after each tick.

        Raises:
            SimError: if there is no pause, if another `step` is under way, if ``ticks`` is
                negative, or if somebody pauses, resumes or closes this object before the last tick.
        """
        if ticks < 0:
            raise SimError(f"{ticks} steps: give 0 or more")
        if not self.is_paused:
            raise SimError("the world is not paused: pause it first")
        if self._step is not None:
            raise SimError(
                "the world is being stepped already: wait for the last step, or pause to end it"
            )
        if not ticks:
            return
        step = self._step = _Step(ticks, on_tick)
        # The clock runs exactly until the last of these ticks. Tasks that wait for a later moment
        # keep waiting, so a program that steps the world misses none of its own deadlines.
        self._clock.stop_at(self._due(ticks - 1))
        self._changed.fire()
        try:
            await step.ended.wait()
        except BaseException:
            # Cancelled: stop here, or the ticks that are left would be made for nobody. If another
            # caller has paused or resumed the world meanwhile, this step is over already.
            if self._step is step:
                self.pause()
            raise
        if step.left:
            made = f"{ticks - step.left} of {ticks} steps"
            raise SimError(f"the world was {step.how} after {made}: pause it, then step again")

    async def aclose(self) -> None:
        """Stop making ticks. If the clock is stopped by a pause, let the clock continue."""
        await self._running.aclose()
        self._end_step("closed")
        self._clock.stop_at(math.inf)

    def _due(self, later: int = 0) -> float:
        """Return the time at which the next tick is due (s of the clock).

        If ``later`` is 1, return the time of the tick after the next tick, and so on.
        """
        return self._start + (self._count + later) * DT

    async def _run(self) -> None:
        clock = self._clock
        # Until here nothing held the clock up, and it may have run ahead while a program started.
        # The first ticks would then be late, and come at once.
        self._start = max(self._start, clock.time() - self._count * DT)
        while True:
            # A machine that is a little late catches up tick by tick, so the schedule does not
            # drift. If it was suspended, or is too slow for the requested speed, catching up would
            # take forever. The schedule then starts anew from now, and a step ends later by as
            # much.
            if clock.time() - self._due() > MOST_BEHIND:
                self._start = clock.time() - self._count * DT
                if self._step is not None:
                    clock.stop_at(self._due(self._step.left - 1))
            await clock.sleep_until(self._due())
            # In a pause the clock stands, and a tick that was late is due all the same.
            if self.is_paused and self._step is None:
                await self._changed.wait()
                continue
            self._count += 1
            self._tick()
            step = self._step
            if step is not None:
                step.note()
                if not step.left:
                    self._end_step("stepped")

    def _end_step(self, how: str) -> None:
        if self._step is not None:
            self._step.how = how
            self._step.ended.set()
            self._step = None


class Simulation:
    """The services and the action that control a world's time. The node closes them when it closes.

    Args:
        node: The node on which the services and the action are opened.
        ticking: Makes the world's ticks.
        restart: A function that puts the world back to its start.
    """

    def __init__(
        self, node: Node, ticking: Ticking, restart: Callable[[], Awaitable[None]]
    ) -> None:
        self._ticking = ticking
        self._restart = restart
        self._is_stopped = False
        self._turns = anyio.Lock()  # handle one change of the state at a time
        node.service(GetSimulatorFeatures, "~/get_simulator_features", self._get_features)
        node.service(GetSimulationState, "~/get_simulation_state", self._get_state)
        node.service(SetSimulationState, "~/set_simulation_state", self._set_state)
        node.service(StepSimulation, "~/step_simulation", self._step)
        node.service(ResetSimulation, "~/reset_simulation", self._reset)
        node.action_server(SimulateSteps, "~/simulate_steps", self._simulate, policy="reject")

    @property
    def _state(self) -> int:
        if not self._ticking.is_paused:
            return SimulationState.STATE_PLAYING
        stopped, paused = SimulationState.STATE_STOPPED, SimulationState.STATE_PAUSED
        return stopped if self._is_stopped else paused

    def _get_features(
        self, _request: GetSimulatorFeatures.Request
    ) -> GetSimulatorFeatures.Response:
        return GetSimulatorFeatures.Response(SimulatorFeatures(list(FEATURES)))

    def _get_state(self, _request: GetSimulationState.Request) -> GetSimulationState.Response:
        return GetSimulationState.Response(SimulationState(self._state), _OK)

    async def _set_state(self, request: SetSimulationState.Request) -> SetSimulationState.Response:
        async with self._turns:
            return SetSimulationState.Response(await self._change(request.state.state))

    async def _change(self, wanted: int) -> SimulationResult:
        if wanted not in _STATES:
            known = ", ".join(f"{number} ({name})" for number, name in _STATES.items())
            return SimulationResult(
                SimulationResult.RESULT_FEATURE_UNSUPPORTED,
                f"state {wanted} cannot be set: give one of {known}",
            )
        # A pause that is asked for during a step ends the step, so it is not "paused already".
        if wanted == self._state and not self._ticking.is_stepping:
            return SimulationResult(
                SetSimulationState.Response.ALREADY_IN_TARGET_STATE,
                f"the simulation is {_STATES[wanted]} already",
            )
        if wanted == SimulationState.STATE_PLAYING:
            self._ticking.resume()
        else:
            self._ticking.pause()
        self._is_stopped = wanted == SimulationState.STATE_STOPPED
        if self._is_stopped:
            await self._restart()
        return _OK

    async def _step(self, request: StepSimulation.Request) -> StepSimulation.Response:
        try:
            await self._pass(request.steps)
        except SimError as error:
            return StepSimulation.Response(_failure(error))
        return StepSimulation.Response(_OK)

    async def _reset(self, request: ResetSimulation.Request) -> ResetSimulation.Response:
        if request.scope not in _SCOPES:
            problem = f"scope {request.scope} cannot be reset alone: give 0 or 255, for everything"
            unsupported = SimulationResult.RESULT_FEATURE_UNSUPPORTED
            return ResetSimulation.Response(SimulationResult(unsupported, problem))
        async with self._turns:
            await self._restart()
        return ResetSimulation.Response(_OK)

    async def _simulate(self, goal: SimulateSteps.Goal, handle: Handle) -> SimulateSteps.Result:
        made = 0

        def tell() -> None:
            nonlocal made
            made += 1
            handle.publish_feedback(SimulateSteps.Feedback(made, goal.steps - made))

        try:
            await self._pass(goal.steps, tell)
        except SimError as error:
            raise Abort(str(error), SimulateSteps.Result(_failure(error))) from None
        except anyio.get_cancelled_exc_class():
            # The ticks that were made stay made: the world cannot go back.
            problem = f"canceled after {made} of {goal.steps} steps"
            failed = SimulationResult(SimulationResult.RESULT_OPERATION_FAILED, problem)
            handle.set_partial_result(SimulateSteps.Result(failed))
            raise
        return SimulateSteps.Result(_OK)

    async def _pass(self, steps: int, on_tick: Callable[[], None] | None = None) -> None:
        if self._state == SimulationState.STATE_STOPPED:
            raise SimError("the simulation is stopped: pause it first")
        await self._ticking.step(steps, on_tick)


class Poses(Message, type_name="turtleact_interfaces/msg/Poses"):
    """The poses of all turtles of a world after a tick, with numbers as in ``turtlesim/msg/Pose``.

    Attributes:
        stamp: ROS time of the tick.
        names: The names of the turtles. The other lists have the same order.
        x: Distances from the left edge (m).
        y: Distances from the lower edge (m).
        theta: Headings (rad).
        linear_velocity: Speeds (m/s), never negative.
        angular_velocity: Turn rates to the left (rad/s).
    """

    stamp: Time = field(default_factory=Time)
    names: list[string] = field(default_factory=list)
    x: list[float32] = field(default_factory=list)
    y: list[float32] = field(default_factory=list)
    theta: list[float32] = field(default_factory=list)
    linear_velocity: list[float32] = field(default_factory=list)
    angular_velocity: list[float32] = field(default_factory=list)


def poses_of(world: World, stamp: Time) -> Poses:
    """Return the poses of a world's turtles as one message."""
    names = list(world.names)
    return Poses(stamp, names, *world.poses().T.tolist())


class TakeSnapshot(Service, type_name="turtleact_interfaces/srv/TakeSnapshot"):
    """Makes a picture of the world as it looks now."""

    class Request(Message):
        """Asks for a picture.

        Attributes:
            format: The format of the picture: ``png`` or ``svg``.
        """

        format: string = "png"

    class Response(Message):
        """The picture, or the reason why there is none.

        Attributes:
            data: The contents of the picture file; empty if there is no picture.
            problem: Why there is no picture; empty if there is a picture.
        """

        data: bytes = b""
        problem: string = ""


class Pictures:
    """The service that takes pictures. The node closes the service when the node itself closes.

    Args:
        node: The node on which the service is opened.
        look: A function that returns how the world looks now.
    """

    def __init__(self, node: Node, look: Callable[[], Snapshot]) -> None:
        self._look = look
        node.service(TakeSnapshot, "~/snapshot", self._take)

    async def _take(self, request: TakeSnapshot.Request) -> TakeSnapshot.Response:
        make = FORMATS.get(request.format)
        if make is None:
            problem = (
                f"there is no picture format '{request.format}': ask for {' or '.join(FORMATS)}"
            )
            return TakeSnapshot.Response(problem=problem)
        # The snapshot is taken here, between two ticks; only the picture is made in the thread.
        return TakeSnapshot.Response(await anyio.to_thread.run_sync(make, self._look()))


class _Step:
    """A call of `Ticking.step` that is under way.

    Attributes:
        left: How many ticks are still to be made.
        how: What ended the call: "stepped", "paused", "resumed" or "closed".
        ended: An event that is set when the call has ended.
    """

    def __init__(self, ticks: int, on_tick: Callable[[], None] | None) -> None:
        self.left = ticks
        self.how = ""
        self.ended = anyio.Event()
        self._on_tick = on_tick

    def note(self) -> None:
        """Count a tick that was made, and call ``on_tick``."""
        self.left -= 1
        if self._on_tick is not None:
            self._on_tick()


def _failure(error: SimError) -> SimulationResult:
    return SimulationResult(SimulationResult.RESULT_OPERATION_FAILED, str(error))
