"""Time as a service: a world is paused, stepped, resumed and begun anew as other simulators are.

The services ``~/get_simulator_features``, ``~/get_simulation_state``, ``~/set_simulation_state``,
``~/step_simulation`` and ``~/reset_simulation``, and the action ``~/simulate_steps``.

Source: simulation_interfaces 2.1.0; for the names Gazebo, which serves them below its node's, too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import anyio

from turtleact.errors import Abort, SimError
from turtleact.interfaces.standard.simulation import (
    GetSimulationState,
    GetSimulatorFeatures,
    ResetSimulation,
    SetSimulationState,
    SimulateSteps,
    SimulationResult,
    SimulationState,
    SimulatorFeatures,
    StepSimulation,
)

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from turtleact.node import Node
    from turtleact.server import ServerGoalHandle
    from turtleact.sim.ticking import Ticking

    Handle = ServerGoalHandle[SimulateSteps.Goal, SimulateSteps.Result, SimulateSteps.Feedback]

__all__ = ["FEATURES", "Simulation"]

FEATURES: Final = (
    SimulatorFeatures.SIMULATION_RESET,
    SimulatorFeatures.SIMULATION_STATE_GETTING,
    SimulatorFeatures.SIMULATION_STATE_SETTING,
    SimulatorFeatures.SIMULATION_STATE_PAUSE,
    SimulatorFeatures.STEP_SIMULATION_SINGLE,
    SimulatorFeatures.STEP_SIMULATION_MULTIPLE,
    SimulatorFeatures.STEP_SIMULATION_ACTION,
)
"""What the world can do of what simulators can do."""

_OK: Final = SimulationResult(SimulationResult.RESULT_OK)
_STATES: Final = {
    SimulationState.STATE_STOPPED: "stopped",
    SimulationState.STATE_PLAYING: "playing",
    SimulationState.STATE_PAUSED: "paused",
}
_SCOPES: Final = (ResetSimulation.Request.SCOPE_DEFAULT, ResetSimulation.Request.SCOPE_ALL)


class Simulation:
    """The services of a world's time; open as long as the node.

    Args:
        node: Where they are opened.
        ticking: The world's ticks.
        restart: Puts the world back to its start.
    """

    def __init__(
        self, node: Node, ticking: Ticking, restart: Callable[[], Awaitable[None]]
    ) -> None:
        self._ticking = ticking
        self._restart = restart
        self._is_stopped = False
        self._turns = anyio.Lock()  # one change of the state after the other
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
            problem = f"canceled after {made} of {goal.steps} steps"
            failed = SimulationResult(SimulationResult.RESULT_OPERATION_FAILED, problem)
            handle.set_partial_result(SimulateSteps.Result(failed))
            raise
        return SimulateSteps.Result(_OK)

    async def _pass(self, steps: int, on_tick: Callable[[], None] | None = None) -> None:
        if self._state == SimulationState.STATE_STOPPED:
            raise SimError("the simulation is stopped: pause it first")
        await self._ticking.step(steps, on_tick)


def _failure(error: SimError) -> SimulationResult:
    return SimulationResult(SimulationResult.RESULT_OPERATION_FAILED, str(error))
