"""Signals: the first asks the command to end, the second ends the process."""

from __future__ import annotations

import subprocess
import sys

import pytest

BEGIN = """
import asyncio, os, signal, sys, time
from turtleact.commands.interrupts import Interrupts
interrupts = Interrupts()
def come(name='SIGINT'):
    os.kill(os.getpid(), getattr(signal, name))
"""


def ran(code):
    """A program that runs a coroutine ``main``."""
    end = "\nstatus = interrupts.run(main())\nprint('left', status)\nsys.exit(status)"
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", BEGIN + code + end],
        capture_output=True,
        text=True,
        check=False,
        timeout=30,
    )


@pytest.mark.parametrize(("name", "status"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129)])
def test_the_first_signal_cancels_the_command(name, status):
    it = ran(f"""
async def main():
    come({name!r})
    try:
        await asyncio.sleep(60)
    finally:
        await asyncio.sleep(0)  # cleaning up goes on
        print('cleaned')
""")
    assert (it.returncode, it.stdout, it.stderr) == (status, f"cleaned\nleft {status}\n", "")


def test_a_command_may_wait_for_the_first_signal_instead():
    it = ran("""
async def main():
    interrupts.cancels = False
    come()
    await interrupts.wait()
    return 7
""")
    assert it.returncode == 7


@pytest.mark.parametrize(("name", "status"), [("SIGINT", 130), ("SIGTERM", 143)])
def test_a_second_signal_ends_the_process_while_code_blocks_the_loop(name, status):
    it = ran(f"""
interrupts.restore = lambda: os.write(1, b'restored ')
interrupts.last_words = lambda: 'the goal goes on'
async def main():
    come()
    come({name!r})
    while True:
        pass
""")
    assert (it.returncode, it.stdout, it.stderr) == (status, "restored ", "the goal goes on")


def test_a_terminal_that_closes_sends_one_signal_twice():
    it = ran("""
async def main():
    come('SIGHUP')
    come('SIGHUP')
    await asyncio.sleep(60)
""")
    assert (it.returncode, it.stdout) == (129, "left 129\n")
