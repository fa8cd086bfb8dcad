"""The world: against the real turtlesim's poses, and its own promises."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact.errors import SimError
from turtleact.sim.kinematics import DT, HALF_TURN, SIDE, Hit, wrap
from turtleact.sim.world import World

GOLDEN = Path(__file__).parent / "golden"
POSES = {
    name: tuple(pose) for name, pose in json.loads((GOLDEN / "poses.json").read_text()).items()
}
PROBED_FROM = (5.544445, 5.544445, 0.0)

FEW, MANY = 3, 40
PI = 3.14159265  # as turtle.hpp defines it


class RealTurtles:
    """``Turtle::update`` of turtle.cpp, for the turtles of a new world, without pens."""

    def __init__(self, world: World) -> None:
        places = world.places()
        self.x, self.y = places.real.copy(), places.imag.copy()
        self.orient = np.array([world.heading(name) for name in world.names])
        self.speeds = np.zeros((3, len(places)))
        self.commanded = -math.inf

    def update(self, now: float) -> None:
        if now - self.commanded > 1.0:
            self.speeds = np.zeros_like(self.speeds)
        vx, vy, omega = self.speeds
        angle = self.orient + omega * DT
        angle -= 2.0 * PI * np.floor((angle + PI) / (2.0 * PI))
        self.orient = np.where((angle >= -PI) & (angle < PI), angle, -PI)
        cos, sin = np.cos(self.orient), np.sin(self.orient)
        self.x = np.clip(self.x + (cos * vx - sin * vy) * DT, 0.0, SIDE)
        self.y = np.clip(self.y - (sin * vx + cos * vy) * DT, 0.0, SIDE)

    def poses(self) -> np.ndarray:
        return np.array([self.x, SIDE - self.y, self.orient]).astype(np.float32)


def table(name: str) -> list[list[str]]:
    """The rows of a recorded table: the time, and five numbers as printed."""
    return [line.split() for line in (GOLDEN / name).read_text().splitlines()[1:]]


def printed(world: World) -> list[str]:
    x, y, theta, linear, angular = world.pose("turtle1")
    return [f"{x:.6f}", f"{y:.6f}", f"{theta:.6f}", f"{linear:.3f}", f"{angular:.3f}"]


def run(world: World, ticks: int) -> World:
    for _ in range(ticks):
        world.step()
    return world


def world_at(x: float, y: float, theta: float) -> World:
    world = World()
    world.teleport_absolute("turtle1", x, y, theta)
    return run(world, 1)


# --- against the real turtlesim -------------------------------------------------------------


def test_turtle1_starts_where_the_real_one_does():
    assert World().pose("turtle1") == POSES["start"]


def test_one_command_gives_the_real_poses_tick_by_tick():
    world = World()
    world.set_velocity("turtle1", 2.0, 0.0, 1.8)
    for _, *row in table("cmd_vel.txt"):
        world.step()
        assert printed(world) == row


def test_three_commands_half_a_second_apart_end_at_the_real_pose():
    world, moving = world_at(*PROBED_FROM), 0
    for tick in range(160):
        if tick in (0, 31, 63):
            world.set_velocity("turtle1", 2.0, 0.0, 1.8)
        world.step()
        moving += world.pose("turtle1").linear_velocity > 0.0
    assert (moving, world.pose("turtle1")) == (126, POSES["three_cmd_vel_end"])


def test_linear_y_is_ignored():
    world = world_at(*PROBED_FROM)
    world.set_velocity("turtle1", 0.0, 1.0, 0.0)
    assert run(world, 10).pose("turtle1") == POSES["linear_y_end"]


def test_the_wall_stops_a_turtle_where_it_stops_the_real_one():
    world = world_at(10.0, 5.0, 0.0)
    world.set_velocity("turtle1", 2.0)
    recorded = table("wall.txt")
    for number, (_, *row) in enumerate(recorded):
        run(world, 1 if number == 0 else 8)
        assert printed(world) == row
    assert world.pose("turtle1") == POSES["wall_end"]


def test_a_relative_teleport_ends_at_the_real_pose():
    world = world_at(*PROBED_FROM)
    world.teleport_relative("turtle1", 1.0, 1.57)
    assert run(world, 1).pose("turtle1") == POSES["teleport_relative_1.0_1.57"]


def test_an_absolute_teleport_is_clamped_and_wrapped_as_the_real_one():
    assert world_at(-5.0, 50.0, 10.0).pose("turtle1") == POSES["teleport_absolute_-5_50_10"]


# --- figures computed from turtlesim's formulas ---------------------------------------------


@pytest.mark.parametrize("count", [1, 1000])
def test_20000_ticks_of_random_driving_round_to_turtlesims_float32(count):
    rng, ours = np.random.default_rng(2), World(count, holonomic=True)
    real = RealTurtles(ours)
    for tick in range(20_000):
        if tick % 70 == 0:  # after 63 ticks, a command ends
            speeds = rng.uniform(-2.0, 2.0, (3, count)) * rng.integers(0, 2, (3, count))
            ours.set_velocities(*speeds)
            real.speeds, real.commanded = speeds, tick * DT
        ours.step()
        real.update(tick * DT)
        assert (real.poses() == ours.poses()[:, :3].T).all()


def test_half_a_turn_wraps_to_its_negative():
    assert wrap(HALF_TURN) == -HALF_TURN == -PI


@given(st.floats(-1e300, 1e300))
def test_a_wrapped_angle_is_in_the_half_open_range(theta):
    assert -PI <= wrap(theta) < PI


@given(st.tuples(*[st.floats(-1e307, 1e307)] * 3))
def test_no_speed_leads_out_of_the_walls(command):
    world = World(holonomic=True)
    world.set_velocity("turtle1", *command)
    x, y, theta, *_ = run(world, 5).pose("turtle1")
    assert 0.0 <= x <= SIDE
    assert 0.0 <= y <= SIDE
    assert -3.1415928 <= theta <= 3.1415928


def test_commands_end_one_by_one():
    world, moving = World(2), []
    for tick in range(100):
        if tick in (0, 10):
            world.set_velocity(tick // 10, 0.1)
        moving.append(run(world, 1).poses()[:, 3] > 0.0)
    assert np.sum(moving, axis=0).tolist() == [63, 63]


# --- walls ----------------------------------------------------------------------------------


def test_hits_come_in_the_order_of_the_indices_and_once_for_a_corner():
    world = World(4)
    world.teleport_absolute("turtle4", 20.0, -1.0, 0.0)
    world.teleport_absolute("turtle2", -2.0, 3.0, 0.0)
    assert world.step() == [Hit(1, -2.0, SIDE - 3.0), Hit(3, 20.0, SIDE + 1.0)]
    assert world.step() == []  # they only touch the walls now


# --- time and commands ----------------------------------------------------------------------


def test_linear_velocity_is_never_negative():
    world = World()
    world.set_velocity("turtle1", -2.0)
    assert run(world, 1).pose("turtle1").linear_velocity == 2.0


def test_a_holonomic_turtle_moves_sideways():
    world = World(FEW, holonomic=True)
    world.set_velocities(0.0, 1.0)
    world.step()
    x, y, *_ = world.pose("turtle1")
    assert (x, y) == pytest.approx((SIDE / 2, SIDE / 2 + DT))


# --- teleports ------------------------------------------------------------------------------


def test_teleports_are_made_in_order():
    world = World()
    world.teleport_absolute("turtle1", 3.0, 4.0, 0.0)
    world.teleport_relative("turtle1", 1.0, 0.0)
    assert run(world, 1).pose("turtle1")[:3] == (4.0, 4.0, 0.0)


# --- many turtles ---------------------------------------------------------------------------


# --- mistakes -------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_speed_that_is_not_finite_is_refused_by_name(value):
    with pytest.raises(SimError, match=f"^turtle1: omega is {value}: give a finite number$"):
        World().set_velocity("turtle1", 1.0, 0.0, value)


def test_among_speeds_for_all_the_one_that_is_not_finite_is_named():
    world = World(FEW)
    omega = np.zeros(FEW)
    omega[world.index("turtle3")] = math.inf
    with pytest.raises(SimError, match=r"^turtle3: omega is inf"):
        world.set_velocities(1.0, 0.0, omega)


@pytest.mark.parametrize(
    ("numbers", "what"), [((math.nan, 0.0, 0.0), "x is nan"), ((0.0, 0.0, 1e39), "theta is inf")]
)
def test_a_teleport_to_no_place_is_refused(numbers, what):
    with pytest.raises(SimError, match=f"^turtle1: {what}: give a finite number$"):
        World().teleport_absolute("turtle1", *numbers)


@pytest.mark.parametrize("turtle", ["turtle4", "", -1, 3])
def test_an_unknown_turtle_is_refused_with_those_there_are(turtle):
    with pytest.raises(
        SimError, match=r"give a name \(turtle1, turtle2, turtle3\) or an index to 2$"
    ):
        World(FEW).set_velocity(turtle, 1.0)


@pytest.mark.parametrize("turtles", [0, -1])
def test_a_world_without_turtles_is_refused(turtles):
    with pytest.raises(SimError, match=f"^a world of {turtles} turtles: give 1 or more$"):
        World(turtles)


# --- turtles that come and go ---------------------------------------------------------------


def test_a_new_turtle_is_in_name_order():
    world = World(2)
    world.spawn(1.0, 1.0, 0.0, "bob")
    world.spawn(1.0, 1.0, 0.0, "turtle11")
    assert world.names == ("bob", "turtle1", "turtle11", "turtle2")


def test_names_are_counted_up_past_those_in_use():
    world = World()
    world.spawn(1.0, 1.0, 0.0, "turtle3")
    names = [world.spawn(1.0, 1.0, 0.0) for _ in range(3)]
    assert names == ["turtle2", "turtle4", "turtle5"]


def test_a_name_that_was_given_once_is_not_made_up_again():
    world = World()
    world.kill(world.spawn(1.0, 1.0, 0.0))
    assert world.spawn(1.0, 1.0, 0.0) == "turtle3"


def test_a_turtle_spawned_outside_is_brought_back_by_the_walls():
    world = World()
    world.spawn(20.0, -3.0, 0.0, "far")
    assert list(world.step()) == [Hit(0, 20.0, SIDE + 3.0)]
    assert world.pose("far")[:2] == (SIDE, 0.0)


@pytest.mark.parametrize(("name", "who"), [("", "a new turtle"), ("bob", "bob")])
def test_a_spawn_at_no_place_is_refused(name, who):
    with pytest.raises(SimError, match=f"^{who}: theta is nan: give a finite number$"):
        World().spawn(1.0, 1.0, math.nan, name)


def test_what_was_asked_before_a_spawn_is_not_lost():
    world = World(2)
    world.set_velocity("turtle1", 1.0)
    world.teleport_absolute("turtle2", 3.0, 4.0, 0.0)
    world.spawn(1.0, 1.0, 0.0, "a")
    run(world, 1)
    assert world.pose("turtle1").linear_velocity == 1.0
    assert world.pose("turtle2")[:2] == (3.0, 4.0)


def test_the_last_turtle_may_be_killed():
    world = World()
    world.kill("turtle1")
    assert not world.step()
    assert world.poses().shape == (0, 5)
    with pytest.raises(
        SimError, match=r"^there is no turtle 'turtle1', because the world is empty: spawn one$"
    ):
        world.pose("turtle1")
