"""The doctor beside a program whose machine is at fault, and that hangs in the end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import anyio
import pytest

import turtleact
from turtleact.doctor.checks import find_faults
from turtleact.doctor.gathering import take_snapshot
from turtleact.transports import open_zenoh

PATIENT = Path(__file__).with_name("patient.py")
SOON = 3.0
"""How quickly the doctor names a fault (s)."""

pytestmark = [
    pytest.mark.loops("asyncio"),
    pytest.mark.skipif(os.name != "posix", reason="the program is stopped by a signal of POSIX"),
]


async def test_a_full_disk_a_wrong_clock_and_a_hung_process_are_named(tmp_path):
    address = f"unixsock-stream/{tmp_path}/router"
    journal = tmp_path / "goals.db"
    arguments = ["serve", "--plain", "--connect", address, "--journal", str(journal)]
    arguments += ["--domain", os.environ["ROS_DOMAIN_ID"]]
    async with open_zenoh([], mode="router", listen=[address]):
        with subprocess.Popen(
            [sys.executable, str(PATIENT), *arguments], stdout=subprocess.PIPE, text=True
        ) as program:
            try:
                assert program.stdout is not None
                ready = await anyio.to_thread.run_sync(program.stdout.readline)
                assert ready.startswith("ready")
                found = await diagnosis(address, "clock", "disk")
                assert found["disk"].startswith(f"the disk of the journal {journal} is nearly full")
                assert "is 5 s ahead of" in found["clock"]
                program.send_signal(signal.SIGSTOP)
                assert "/turtle_actions" in (await diagnosis(address, "silent-node"))["silent-node"]
            finally:
                program.kill()


async def diagnosis(address: str, *kinds: str) -> dict[str, str]:
    """The problems that the doctor names, by kind of fault, once these kinds are among them.

    A program may be ready before a thread of it has asked the disk.
    """
    async with (
        open_zenoh([address], mode="client", listen=[]) as transport,
        turtleact.open_node("_doctor", transport=transport) as node,
    ):
        await transport.explore()
        with anyio.fail_after(SOON):
            while True:
                faults = find_faults(await take_snapshot(node))
                found = {each.kind: each.problem for each in faults}
                if found.keys() >= {*kinds}:
                    return found
                with anyio.move_on_after(0.1):
                    await transport.wait_for_change()
