"""How many steps per second does the world run, compared with naive numpy and ir-sim?

All run the same motion. Every turtle has its own speed and turning rate, which change every 50
steps. Each step turns, moves, stops at walls and forgets old commands. "Naive numpy" is what a
student would write: sines and cosines in each step, and a new array for each intermediate value.
ir-sim also handles shapes and goals, so it does more; its collision checks are switched off.

Rounds are interleaved. A ratio is the median of the rounds' ratios.
"""

from __future__ import annotations

import importlib.util
import os
import platform
import statistics
import tempfile
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import numpy as np
import numpy.typing as npt

from turtleact.sim.kinematics import DT, SIDE
from turtleact.sim.world import World

STEPS = 50
COUNTS = [1, 10, 100, 1_000, 10_000, 100_000, 1_000_000]
PEER_COUNTS = [1, 10, 100]
WORK = 1_000_000
"""About this many turtle-steps per round, but at least one command and at most 40."""

Floats = npt.NDArray[np.float64]
Contender = Callable[[], None]


class Naive:
    def __init__(self, vx: Floats, omega: Floats) -> None:
        count = len(vx)
        self.command = vx, omega
        poses = World(count).poses().astype(np.float64)
        self.x, self.y, self.theta = poses[:, 0], poses[:, 1], poses[:, 2]
        self.time = 0.0

    def drive(self) -> None:
        self.vx, self.omega = self.command
        self.commanded = np.full(len(self.vx), self.time)
        for _ in range(STEPS):
            self.step()

    def step(self) -> None:
        is_old = self.time - self.commanded > 1.0
        self.vx = np.where(is_old, 0.0, self.vx)
        self.omega = np.where(is_old, 0.0, self.omega)
        self.theta = self.theta + self.omega * DT
        self.theta = (self.theta + np.pi) % (2 * np.pi) - np.pi
        self.x = np.clip(self.x + self.vx * np.cos(self.theta) * DT, 0.0, SIDE)
        self.y = np.clip(self.y + self.vx * np.sin(self.theta) * DT, 0.0, SIDE)
        self.time += DT


class Ours:
    def __init__(self, vx: Floats, omega: Floats) -> None:
        self.command = vx, omega
        self.world = World(len(vx))

    def drive(self) -> None:
        world = self.world
        world.set_velocities(self.command[0], 0.0, self.command[1])
        for _ in range(STEPS):
            world.step()


class IrSim:
    def __init__(self, vx: Floats, omega: Floats) -> None:
        import irsim

        text = f"""
world: {{height: {SIDE}, width: {SIDE}, step_time: {DT}, collision_mode: unobstructed}}
robot:
  - number: {len(vx)}
    distribution: {{name: random, range_low: [1, 1, -3.1], range_high: [10, 10, 3.1]}}
    kinematics: {{name: diff}}
    shape: {{name: circle, radius: 0.1}}
    vel_max: [3, 3]
    vel_min: [-3, -3]
"""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "world.yaml")
            path.write_text(text)
            self.env = irsim.make(str(path), display=False, log_level="ERROR")
        self.actions = [np.array([[v], [w]]) for v, w in zip(vx, omega, strict=True)]
        self.ids = list(range(len(vx)))

    def drive(self) -> None:
        for _ in range(STEPS):
            self.env.step(self.actions, self.ids)


def in_the_open(count: int) -> tuple[Floats, Floats]:
    """Speeds for circles that stay inside: turtles start a metre or more from the walls."""
    rng = np.random.default_rng(0)
    omega = rng.uniform(0.5, 2.0, count) * rng.choice([-1.0, 1.0], count)
    return np.abs(omega) * rng.uniform(0.1, 0.49, count), omega


def into_the_walls(count: int) -> tuple[Floats, Floats]:
    """Any speeds, held for ever. In the end, many turtles are pressed against a wall."""
    rng = np.random.default_rng(0)
    return rng.uniform(-2.0, 2.0, count), rng.uniform(-2.0, 2.0, count)


def check_that_both_move_alike(commands: tuple[Floats, Floats]) -> None:
    naive, ours = Naive(*commands), Ours(*commands)
    naive.drive()
    ours.drive()
    poses = ours.world.poses()
    assert np.allclose(poses[:, 0], naive.x, atol=1e-5)
    assert np.allclose(poses[:, 1], naive.y, atol=1e-5)


def seconds_a_step(drive: Contender, repeats: int) -> float:
    start = time.perf_counter()
    for _ in range(repeats):
        drive()
    return (time.perf_counter() - start) / (repeats * STEPS)


def compare(
    ours: Contender, peer: Contender, *, rounds: int, repeats: int
) -> tuple[float, float, float]:
    """The median seconds per step of both, and the median of the rounds' ratios."""
    ours()
    peer()
    measured = [
        (seconds_a_step(ours, repeats), seconds_a_step(peer, repeats)) for _ in range(rounds)
    ]
    mine, theirs = (statistics.median(column) for column in zip(*measured, strict=True))
    return mine, theirs, statistics.median(b / a for a, b in measured)


def row(commands: tuple[Floats, Floats]) -> str:
    count = len(commands[0])
    repeats = min(40, max(1, WORK // (STEPS * count)))
    rounds = 15 if count <= 100_000 else 5
    ours, naive = Ours(*commands), Naive(*commands)
    mine, theirs, ratio = compare(ours.drive, naive.drive, rounds=rounds, repeats=repeats)
    cells = f"{count:>9,} {1 / mine:>12,.0f} {count / mine / 1e6:>10.1f} {1 / theirs:>10,.0f}"
    return f"{cells} {ratio:>7.1f}x {peer_cells(commands)}"


def peer_cells(commands: tuple[Floats, Floats]) -> str:
    if len(commands[0]) not in PEER_COUNTS or not importlib.util.find_spec("irsim"):
        return f"{'-':>8} {'-':>8}"
    ours, peer = Ours(*commands), IrSim(*commands)
    _, theirs, ratio = compare(ours.drive, peer.drive, rounds=5, repeats=1)
    return f"{1 / theirs:>8,.0f} {ratio:>7,.0f}x"


def machine() -> str:
    path = Path("/proc/cpuinfo")
    lines = path.read_text().splitlines() if path.exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    model = models[0] if models else platform.processor() or platform.machine()
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    return f"{os.cpu_count()} cores, {model}, load {load}"


def versions() -> str:
    peer = f"ir-sim {version('ir-sim')}" if importlib.util.find_spec("irsim") else ""
    return ", ".join(
        filter(None, [f"Python {platform.python_version()}", f"numpy {version('numpy')}", peer])
    )


def main() -> None:
    os.environ.setdefault("MPLBACKEND", "Agg")
    print(machine())
    print(versions())
    if not importlib.util.find_spec("irsim"):
        print("ir-sim is skipped: it is not installed (pip install ir-sim)")
    for title, commands in (("in the open", in_the_open), ("into the walls", into_the_walls)):
        check_that_both_move_alike(commands(100))
        print(f"\n{title}, steps a second:")
        print(
            f"{'turtles':>9} {'turtleact':>12} {'M turtles':>10} {'naive':>10} {'ratio':>8}"
            f" {'ir-sim':>8} {'ratio':>8}"
        )
        for count in COUNTS:
            print(row(commands(count)), flush=True)


if __name__ == "__main__":
    main()
