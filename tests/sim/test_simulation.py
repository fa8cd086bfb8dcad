"""The services by which a world's time is ruled."""

from __future__ import annotations

import math

import pytest

from turtleact.goals.state import GoalStatus
from turtleact.interfaces.standard import RotateAbsolute
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
from turtleact.tasks import wait_until_idle

from .stage import TICK, stage

OK = SimulationResult.RESULT_OK
FAILED = SimulationResult.RESULT_OPERATION_FAILED
UNSUPPORTED = SimulationResult.RESULT_FEATURE_UNSUPPORTED
STOPPED = SimulationState.STATE_STOPPED
PLAYING = SimulationState.STATE_PLAYING
PAUSED = SimulationState.STATE_PAUSED


async def set_state(here, state):
    request = SimulationState(state)
    return (await here.call(SetSimulationState, "world/set_simulation_state", request)).result


async def state_of(here):
    answer = await here.call(GetSimulationState, "world/get_simulation_state")
    assert answer.result.result == OK
    return answer.state.state


async def step(here, steps=1):
    return (await here.call(StepSimulation, "world/step_simulation", steps)).result


async def reset(here, scope=0):
    return (await here.call(ResetSimulation, "world/reset_simulation", scope)).result


def simulate(here, steps):
    client = here.node.action_client(SimulateSteps, "world/simulate_steps")
    return client.send_goal(SimulateSteps.Goal(steps))


async def test_it_says_what_it_can_do():
    async with stage() as here:
        answer = await here.call(GetSimulatorFeatures, "world/get_simulator_features")
    known = {value: name for name, value in vars(SimulatorFeatures).items() if name.isupper()}
    assert [known[feature] for feature in answer.features.features] == [
        "SIMULATION_RESET",
        "SIMULATION_STATE_GETTING",
        "SIMULATION_STATE_SETTING",
        "SIMULATION_STATE_PAUSE",
        "STEP_SIMULATION_SINGLE",
        "STEP_SIMULATION_MULTIPLE",
        "STEP_SIMULATION_ACTION",
    ]


# States


@pytest.mark.parametrize("first", [STOPPED, PLAYING, PAUSED])
@pytest.mark.parametrize("then", [STOPPED, PLAYING, PAUSED])
async def test_every_state_leads_to_every_other(first, then):
    async with stage() as here:
        await set_state(here, first)
        result = await set_state(here, then)
        already = SetSimulationState.Response.ALREADY_IN_TARGET_STATE
        assert result.result == (already if first == then else OK)
        assert await state_of(here) == then


@pytest.mark.parametrize("state", [3, 4, 5, 77])
async def test_a_state_that_cannot_be_set_is_refused(state):
    async with stage() as here:
        result = await set_state(here, state)
        assert result.result == UNSUPPORTED
        assert result.error_message == (
            f"state {state} cannot be set: give one of 0 (stopped), 1 (playing), 2 (paused)"
        )
        assert await state_of(here) == PLAYING


async def test_commands_of_a_pause_are_taken_up_by_the_next_tick():
    async with stage() as here:
        await set_state(here, PAUSED)
        here.command(x=1.0)
        here.command(x=2.0)
        await here.teleport(1.0, 1.0, 0.0)
        assert here.world.pose("turtle1").x > 5.0
        await step(here)
        assert here.world.pose("turtle1").x == pytest.approx(1.0 + 2.0 * TICK)


async def test_a_goal_gets_no_further_in_a_pause_than_it_had_come():
    async with stage() as here, here.rotations().send_goal(RotateAbsolute.Goal(1.57)) as handle:
        await here.pass_ticks(10)
        await set_state(here, PAUSED)
        theta = here.world.heading("turtle1")
        await wait_until_idle()
        assert here.world.heading("turtle1") == theta
        await step(here)
        assert here.world.heading("turtle1") == pytest.approx(theta + TICK)
        await set_state(here, PLAYING)
        assert (await handle.outcome()).result.delta == pytest.approx(-1.552, abs=1e-3)


async def test_a_goal_can_be_canceled_in_a_pause():
    async with stage() as here, here.rotations().send_goal(RotateAbsolute.Goal(1.57)) as handle:
        await set_state(here, PAUSED)
        await handle.cancel()
        assert (await handle.outcome()).status is GoalStatus.CANCELED


# Steps


async def test_a_step_is_one_tick_unless_more_are_asked_for():
    async with stage() as here:
        await set_state(here, PAUSED)
        before = here.world.tick
        assert (await here.call(StepSimulation, "world/step_simulation")).result.result == OK
        assert here.world.tick == before + 1
        assert (await step(here, 41)).result == OK
        assert here.world.tick == before + 42
        assert await state_of(here) == PAUSED


@pytest.mark.parametrize(
    ("state", "problem"),
    [
        (PLAYING, "the world is not paused: pause it first"),
        (STOPPED, "the simulation is stopped: pause it first"),
    ],
)
async def test_only_a_pause_can_be_stepped(state, problem):
    async with stage() as here:
        await set_state(here, state)
        result = await step(here)
        assert (result.result, result.error_message) == (FAILED, problem)
        async with simulate(here, 3) as handle:
            outcome = await handle.outcome()
        assert (outcome.status, outcome.reason) == (GoalStatus.ABORTED, problem)
        assert outcome.result.result == result


async def test_steps_as_an_action_tell_of_each():
    async with stage() as here:
        await set_state(here, PAUSED)
        before = here.world.tick
        async with simulate(here, 4) as handle:
            told = [(each.completed_steps, each.remaining_steps) async for each in handle]
            outcome = await handle.outcome()
        assert told == [(1, 3), (2, 2), (3, 1), (4, 0)]
        assert (outcome.status, outcome.result.result.result) == (GoalStatus.SUCCEEDED, OK)
        assert here.world.tick == before + 4


async def test_steps_as_an_action_can_be_canceled():
    async with stage() as here:
        await set_state(here, PAUSED)
        async with simulate(here, 10**6) as handle:
            made = 0
            async for each in handle:
                made = each.completed_steps
                if made == 5:
                    await handle.cancel()
            outcome = await handle.outcome()
        after = here.world.tick
        await wait_until_idle()
        assert here.world.tick == after
        assert outcome.status is GoalStatus.CANCELED
        assert outcome.result.result.error_message == f"canceled after {made} of 1000000 steps"
        assert await state_of(here) == PAUSED


# Back to the start


@pytest.mark.parametrize("scope", [0, 255])
async def test_a_reset_brings_back_the_turtles_of_the_beginning(scope):
    async with stage(turtles=3) as here:
        start = here.world.poses().tolist()
        await here.kill("turtle2")
        assert await here.spawn(1.0, 1.0, 0.0) == "turtle4"
        here.command(x=2.0)
        await here.pass_ticks(20)
        assert (await reset(here, scope)).result == OK
        assert here.world.names == ("turtle1", "turtle2", "turtle3")
        assert here.world.poses().tolist() == start
        assert here.sim.snapshot().polylines == []
        assert await state_of(here) == PLAYING
        await here.pass_ticks(1)
        poses = here.poses("turtle2")
        await here.pass_ticks(1)
        assert len(poses.drain()) == 1
        assert await here.spawn(1.0, 1.0, 0.0) == "turtle4"


@pytest.mark.parametrize("scope", [1, 2, 4, 6])
async def test_a_part_of_the_world_cannot_be_reset_alone(scope):
    async with stage() as here:
        result = await reset(here, scope)
    problem = f"scope {scope} cannot be reset alone: give 0 or 255, for everything"
    assert (result.result, result.error_message) == (UNSUPPORTED, problem)


async def test_a_stop_is_a_pause_at_the_start():
    async with stage() as here:
        start = here.world.poses().tolist()
        here.command(x=2.0, turn=math.pi)
        await here.pass_ticks(20)
        await set_state(here, STOPPED)
        tick = here.world.tick
        await wait_until_idle()
        assert (here.world.poses().tolist(), here.world.tick) == (start, tick)
