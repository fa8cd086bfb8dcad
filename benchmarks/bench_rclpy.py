"""How fast is turtleact's rclpy, beside the genuine one?

Both run the same program, `benchmarks.rclpy_program`, in turns. turtleact's rclpy joins a router,
as a program would on a real graph. The genuine rclpy uses the installed middleware. Without a
genuine rclpy, only turtleact's figures are printed, with the limits that they should keep.

``TURTLEACT_ROS=/path/to/python python -m benchmarks.bench_rclpy``; the variable names the Python
that can import the genuine rclpy.
"""

from __future__ import annotations

import asyncio
import json
import os
import platform
import socket
import statistics
import subprocess
import sys
from pathlib import Path

from turtleact.transports import open_zenoh

ROUNDS = 3
PATIENCE = 120.0
PROGRAM = Path(__file__).with_name("rclpy_program.py")

BARS = {
    "import, init and node (s)": "at most 0.4",
    "pings a second": "at least 3,000",
    "service calls a second": "at least 1,500",
    "goals a second": "at least 500",
    "idle spin_once(0) (us)": "at most 50",
    "log line (us)": "at most 100",
    "idle spin (% of a core)": "at most 1",
}

Figures = dict[str, float]


def installed() -> dict[str, str]:
    """The environment of a program that runs as pip installs it, with its bytecode.

    Compiling turtleact takes three times as long as importing it. Here the first round compiles,
    and the median of the rounds leaves that one out.
    """
    return {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}


def measure(*command: str) -> Figures:
    """Run the program once. The program measures its own log, so nobody reads the output."""
    ran = subprocess.run(
        [*command, str(PROGRAM)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        timeout=PATIENCE,
        env=installed(),
        check=True,
    )
    figures: Figures = json.loads(ran.stdout.splitlines()[-1])
    return figures


async def main() -> None:
    """Let both run in turns, and print the medians."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    ours = (sys.executable, "-m", "turtleact.rclpy", "--face=turtleact", f"--connect={address}")
    commands: dict[str, tuple[str, ...]] = {"turtleact": ours}
    genuine = os.environ.get("TURTLEACT_ROS")
    if genuine:
        commands["genuine"] = (genuine,)
    rounds: dict[str, list[Figures]] = {name: [] for name in commands}
    async with open_zenoh([], listen=[address], mode="router", config={}):
        for _ in range(ROUNDS):
            for name, command in commands.items():
                rounds[name].append(await asyncio.to_thread(measure, *command))
    print(machine())
    print(f"{'':28}" + "".join(f"{name:>12}" for name in commands) + "  bar")
    for what, bar in BARS.items():
        medians = (statistics.median(each[what] for each in rounds[name]) for name in commands)
        print(f"{what:28}" + "".join(f"{value:12,.2f}" for value in medians) + f"  {bar}")


def machine() -> str:
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    return f"Python {platform.python_version()}, {os.cpu_count()} cores, load {load}"


if __name__ == "__main__":
    asyncio.run(main())
