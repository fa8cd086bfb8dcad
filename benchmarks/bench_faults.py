"""What happens to goals when the network between two hosts is slow, loses packets, or is cut?

Each host is a network namespace, and this process is the cable: it forwards packets, late or not at
all, so both ends use the TCP of a real machine. ``turtleact serve`` runs on one host and
``send-goal`` on the other. The goal publishes ten feedback messages a second. Faults begin in the
third second. Slow and lossy connections last to the end. Cuts last 5 or 60 s, by losing all packets
or by taking the interface down. When the connection works again, ``goals`` checks whether the goal
exists, ``watch`` attaches to it if its sender has given up, and ``cancel`` cancels it or another.

Needs Linux, root and ``ip``. Takes five minutes, most of them waiting.
Run it as ``sudo .venv/bin/python -m benchmarks.bench_faults``.
"""

from __future__ import annotations

import fcntl
import heapq
import json
import os
import platform
import random
import select
import shutil
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from turtleact.commands.output import note

HOSTS = ("turtleact-near", "turtleact-far")
AT = "tcp/10.213.7.1:7447"
DEVICE = "turtle{}"
TUNSETIFF, IFF_TUN, IFF_NO_PI = 0x400454CA, 0x0001, 0x1000

PERIOD = 0.1
BEFORE, AFTER = 3.0, 4.0
"""A goal runs for this long before a fault and after it (s)."""

TARGET = f"""
import asyncio
import turtleact
from turtleact.interfaces.standard import ExampleFibonacci

@turtleact.action(ExampleFibonacci, "count")
async def count(goal):
    for number in range(goal.order):
        await asyncio.sleep({PERIOD})
        yield ExampleFibonacci.Feedback(sequence=[number])
    yield ExampleFibonacci.Result(sequence=[goal.order])
"""
FIBONACCI = "example_interfaces/action/Fibonacci"


class Fault(NamedTuple):
    """A fault of the network, and how long it lasts; 0 means to the end."""

    name: str
    delay: float = 0.0
    loss: float = 0.0
    seconds: float = 0.0
    is_down: bool = False


FAULTS = [
    Fault("none"),
    Fault("200 ms each way", delay=0.2),
    Fault("10 % of packets lost", loss=0.1),
    Fault("both", delay=0.2, loss=0.1),
    Fault("all lost for 5 s", loss=1.0, seconds=5),
    Fault("link down for 5 s", is_down=True, seconds=5),
    Fault("all lost for 60 s", loss=1.0, seconds=60),
    Fault("link down for 60 s", is_down=True, seconds=60),
]


# --- two hosts ------------------------------------------------------------------------------


def ip(*arguments: str) -> None:
    subprocess.run([shutil.which("ip") or "ip", *arguments], check=True)


class Cable:
    """Two hosts, and the network between them."""

    def __init__(self) -> None:
        self.delay = self.loss = 0.0
        self._chance = random.Random(0)
        self._ends = [self._plug(number, host) for number, host in enumerate(HOSTS, 1)]
        self._stop, self._stopper = os.pipe()
        self._thread = threading.Thread(target=self._carry)
        self._thread.start()

    def _plug(self, number: int, host: str) -> int:
        device = DEVICE.format(number)
        ip("netns", "add", host)
        end = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
        fcntl.ioctl(end, TUNSETIFF, struct.pack("16sH22x", device.encode(), IFF_TUN | IFF_NO_PI))
        ip("link", "set", device, "netns", host)
        ip("-n", host, "link", "set", "lo", "up")
        near, far = f"10.213.7.{number}", f"10.213.7.{3 - number}"
        ip("-n", host, "addr", "add", near, "peer", far, "dev", device)
        ip("-n", host, "link", "set", device, "up")
        return end

    def take(self, fault: Fault) -> None:
        """Apply a fault."""
        self.delay, self.loss = fault.delay, fault.loss
        state = "down" if fault.is_down else "up"
        ip("-n", HOSTS[0], "link", "set", DEVICE.format(1), state)

    def close(self) -> None:
        os.write(self._stopper, b"!")
        self._thread.join()
        for each in (*self._ends, self._stop, self._stopper):
            os.close(each)

    def _carry(self) -> None:
        late: list[tuple[float, int, int, bytes]] = []
        count = 0
        while True:
            wait = max(0.0, late[0][0] - time.monotonic()) if late else None
            ready, _, _ = select.select([*self._ends, self._stop], [], [], wait)
            if self._stop in ready:
                return
            for end in ready:
                with suppress(OSError):  # no more of them, or the interface is down
                    while packet := os.read(end, 1 << 16):
                        if self._chance.random() >= self.loss:
                            count += 1
                            other = self._ends[end == self._ends[0]]
                            at = time.monotonic() + self.delay
                            heapq.heappush(late, (at, count, other, packet))
            while late and late[0][0] <= time.monotonic():
                _, _, end, packet = heapq.heappop(late)
                with suppress(OSError):
                    os.write(end, packet)


@contextmanager
def cabled() -> Iterator[Cable]:
    """Give a block two hosts, and remove them after it."""
    try:
        cable = Cable()
        try:
            yield cable
        finally:
            cable.close()
    finally:
        for host in HOSTS:
            subprocess.run(["ip", "netns", "del", host], check=False, capture_output=True)  # noqa: S607


def start(host: str, folder: Path, *arguments: str) -> subprocess.Popen[str]:
    """Start the command line on a host."""
    command = ["ip", "netns", "exec", host, sys.executable, "-m", "turtleact", *arguments]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, cwd=folder, text=True, stdout=pipe, stderr=pipe)


def run(folder: Path, *arguments: str) -> tuple[int, str]:
    process = start(HOSTS[1], folder, *arguments, "--connect", AT)
    out, _ = process.communicate()
    return process.returncode, out


# --- one goal -------------------------------------------------------------------------------


class Sender:
    """A ``send-goal`` that is under way, and its events with the times of their arrival."""

    def __init__(self, folder: Path, order: int) -> None:
        self.events: list[tuple[float, dict[str, object]]] = []
        self.accepted = threading.Event()
        arguments = ["send-goal", "/count", FIBONACCI, f"order: {order}", "--json"]
        self.process = start(HOSTS[1], folder, *arguments, "--connect", AT)
        self._thread = threading.Thread(target=self._read)
        self._thread.start()

    @property
    def goal_id(self) -> str:
        return str(self.events[0][1]["goal_id"])

    @property
    def numbers(self) -> list[int]:
        """The number of each feedback message that arrived."""
        told = [each["feedback"] for _, each in self.events if each["event"] == "feedback"]
        return [each["sequence"][0] for each in told]  # type: ignore[index]  # JSON of a Fibonacci

    def wait(self) -> int:
        self._thread.join()
        return self.process.wait()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.events.append((time.monotonic(), json.loads(line)))
            self.accepted.set()
        self.ended = time.monotonic()
        self.accepted.set()


def row(fault: Fault, cable: Cable, folder: Path) -> str:
    order = int((BEFORE + fault.seconds + AFTER) / PERIOD)
    sender = Sender(folder, order)
    assert sender.accepted.wait(30)
    time.sleep(BEFORE)
    struck = time.monotonic()
    cable.take(fault)
    if fault.seconds:
        time.sleep(fault.seconds)
        cable.take(FAULTS[0])
    mended = time.monotonic()
    while sender.goal_id not in (run(folder, "goals"))[1]:
        assert time.monotonic() - mended < 60, "the goal is not found"
    found = time.monotonic() - mended
    status = sender.wait()
    told = sender.ended - struck
    numbers = sender.numbers
    missing = order - len(numbers)
    assert numbers == sorted(set(numbers)), "feedback came twice or out of order"
    back = ""
    if status == 1:
        watched, _ = run(folder, "watch", sender.goal_id[:8])
        back = f"status {watched}"
    other = Sender(folder, 10_000)
    assert other.accepted.wait(30)
    began = time.monotonic()
    run(folder, "cancel", other.goal_id)
    assert other.wait() == 5
    canceled = other.ended - began
    cable.take(FAULTS[0])
    return (
        f"{fault.name:22} {status:>6} {told:>8.1f} s {len(numbers):>6} of {order:<4}"
        f" {missing if status == 0 else '-':>8} {found:>8.1f} s {back:>9} {canceled:>8.1f} s"
    )


def main() -> None:
    if os.geteuid() != 0 or shutil.which("ip") is None:
        note("this needs root, and the program 'ip' of iproute2")
        sys.exit(1)
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    print(f"{os.cpu_count()} cores, {platform.machine()}, load {load}")
    print(f"Python {platform.python_version()}, eclipse-zenoh {version('eclipse-zenoh')}\n")
    print(
        f"{'fault':22} {'status':>6} {'after':>10} {'feedback':>14} {'missing':>8}"
        f" {'goals':>10} {'watch':>9} {'cancel':>10}"
    )
    with tempfile.TemporaryDirectory() as name, cabled() as cable:
        folder = Path(name)
        (folder / "lab.py").write_text(TARGET)
        listen = ["--listen", AT.replace("10.213.7.1", "0.0.0.0"), "--insecure"]  # noqa: S104  # the cable's other end alone
        server = start(HOSTS[0], folder, "serve", "lab", "--no-sim", *listen)
        try:
            assert server.stdout is not None
            assert "ready" in server.stdout.readline()
            threading.Thread(target=server.stdout.read, daemon=True).start()
            for fault in FAULTS:
                print(row(fault, cable, folder), flush=True)
        finally:
            server.terminate()
            server.wait()


if __name__ == "__main__":
    main()
