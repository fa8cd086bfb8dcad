"""Does every goal end exactly once if its server is killed again and again?

``turtleact serve --journal`` is killed with SIGKILL at random moments, also while it starts, and is
started again at once. Meanwhile three clients send patrols of 20 targets and reattach. Run it as
``python -m benchmarks.bench_chaos [KILLS] [SEED]``. The kills come in rounds of 100, each with a
new journal and the next seed, so a run can be stopped and continued. It ends with 1 and names the
round's seed if

- a goal ends in any other way than SUCCEEDED with all 20 targets, or its end changes afterwards,
- a client sees feedback out of order, or a target reached twice,
- the journal lacks a goal that a client was told is accepted.

A process that has imported everything forks each server, because importing takes most of a start.
"""

from __future__ import annotations

import multiprocessing
import os
import platform
import random
import signal
import socket
import sqlite3
import statistics
import sys
import tempfile
import time
from contextlib import suppress
from importlib.metadata import version
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple

import anyio
import anyio.to_thread

import turtleact
from turtleact.actions.patrol import Patrol
from turtleact.goals.state import GoalStatus
from turtleact.interfaces.standard import Point
from turtleact.journal import read_goals

KILLS = 1_000
ROUND = 100
SEED = 1
CLIENTS = 3
TARGETS = 20
SPEED = 20
REATTACH = 60.0
"""How long a client waits for a silent server (s)."""

PATIENCE = 60.0
"""How long the first server may take to start, and the last goals to end (s)."""

LONGEST = 2.4
"""A server lives at most this long (s), counted from its fork."""


class Sent(NamedTuple):
    """A client's facts about a goal that has ended.

    Attributes:
        goal_id: Its id.
        seen: How many feedback messages came.
    """

    goal_id: bytes
    seen: int


class Broken(Exception):
    """An invariant does not hold."""


class Round(NamedTuple):
    """The outcome of 100 kills.

    Attributes:
        ended: How many goals were accepted, all of which have ended as they should.
        seen: How many feedback messages the clients have seen of each goal.
        crashes: The most crashes without feedback of any goal.
    """

    ended: int
    seen: list[int]
    crashes: int


# --- the server -----------------------------------------------------------------------------------


def free_address() -> str:
    """Return an address that nobody listens on, outside the range that systems give to clients."""
    while True:
        with socket.socket() as probe, suppress(OSError):
            port = random.randrange(20_000, 30_000)
            probe.bind(("127.0.0.1", port))
            return f"tcp/127.0.0.1:{port}"


def fork_servers(orders: Connection, path: str, address: str) -> None:
    """Start and kill servers. Each order says how long the next server lives (s); 0 ends this."""
    from turtleact import cli, journal  # imported here and not in each server
    from turtleact.commands import serve, serving

    _ = journal, serve, serving
    os.setsid()  # so that the servers can be ended together with this process
    command = f"serve --plain --listen {address} --turtles {CLIENTS} --speed {SPEED}"
    keeping = ["--journal", path, "--on-restart", "resume", "--max-starts", "0"]
    while True:
        lifetime = orders.recv()
        child = os.fork()
        if not child:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, 1)
            sys.argv[1:] = [*command.split(), *keeping]
            os._exit(cli.main())
        if not lifetime:
            orders.recv()
            os.kill(child, signal.SIGTERM)
            orders.send(os.waitpid(child, 0)[1])
            return
        time.sleep(lifetime)
        os.kill(child, signal.SIGKILL)
        status = os.waitpid(child, 0)[1]
        orders.send(None if os.WIFSIGNALED(status) else os.waitstatus_to_exitcode(status))


# --- the clients ----------------------------------------------------------------------------------


async def patrol_on(
    turtle: str, address: str, seed: int, sent: list[Sent], is_over: anyio.Event
) -> None:
    """Send one patrol after the other until the round is over. The last patrol still ends."""
    chance = random.Random(f"{seed} {turtle}")
    retry = {"period_init_ms": 20, "period_max_ms": 20}
    quick = {"connect/retry": retry, "connect/timeout_ms": -1}
    async with (
        turtleact.open_zenoh([address], listen=[], config=quick) as transport,
        turtleact.open_node(f"{turtle}_client", transport=transport) as node,
    ):
        client = node.action_client(Patrol, "/patrol")
        await client.wait_for_server(PATIENCE)
        while not is_over.is_set():
            goal_id = chance.randbytes(16)
            spots = [(chance.uniform(4, 7), chance.uniform(4, 7)) for _ in range(TARGETS)]
            goal = Patrol.Goal(targets=[Point(x, y) for x, y in spots], turtle=turtle)
            seen = list[Patrol.Feedback]()
            sending = client.send_goal(goal, goal_id=goal_id, reattach=REATTACH)
            async with sending as handle:
                async for feedback in handle:
                    seen.append(feedback)
                outcome = await handle.outcome()
            check_end(goal_id, outcome, seen)
            sent.append(Sent(goal_id, len(seen)))


def check_end(
    goal_id: bytes, outcome: turtleact.Outcome[Patrol.Result], seen: list[Patrol.Feedback]
) -> None:
    """Check the feedback and outcome that a client got for a goal.

    Raises:
        Broken: if the goal should have done something else.
    """
    who, result = f"goal {goal_id.hex()}", outcome.result
    if outcome.status is not GoalStatus.SUCCEEDED:
        raise Broken(f"{who} ended {outcome.status.name}: {outcome.reason}")
    if result.reached != TARGETS or result.missed:
        raise Broken(f"{who} reached {result.reached} targets and missed {result.missed}")
    reached = [feedback.index for feedback in seen if feedback.is_reached]
    if reached != sorted(set(reached)):
        raise Broken(f"{who} reached its targets in this order: {reached}")
    counts = [feedback.reached for feedback in seen]
    if counts != sorted(counts):
        raise Broken(f"feedback of {who} came out of order: {counts}")


# --- the run --------------------------------------------------------------------------------------


def check_journal(path: Path, sent: list[Sent], ends: dict[bytes, int]) -> None:
    """Check that the journal has the goals that were sent, and that no end has changed.

    Args:
        path: The journal.
        sent: The goals that have ended.
        ends: When each goal ended, as far as known before. This call updates it.

    Raises:
        Broken: if a goal is missing or an end has changed.
    """
    records = {record.id: record for record in read_goals(path)}
    for each in sent:
        record = records.get(each.goal_id)
        if record is None:
            raise Broken(f"the journal lacks goal {each.goal_id.hex()}")
        if record.status is not GoalStatus.SUCCEEDED:
            raise Broken(f"the journal says that goal {each.goal_id.hex()} is {record.status.name}")
    for record in records.values():
        if record.id in ends and record.ended != ends[record.id]:
            raise Broken(f"goal {record.id.hex()} ended twice")
        if record.ended:
            ends[record.id] = record.ended
    if len(set(records)) != len(records):
        raise Broken("the journal has an id twice")


async def run(kills: int, seed: int, path: Path) -> tuple[list[Sent], dict[bytes, int]]:
    """Kill servers while clients send goals. Return the goals and the times of their ends.

    Raises:
        Broken: if an invariant does not hold.
    """
    chance, sent, is_over = random.Random(seed), list[Sent](), anyio.Event()
    ends: dict[bytes, int] = {}
    address = free_address()
    mine, its = multiprocessing.Pipe()
    forking = multiprocessing.get_context("spawn").Process(
        target=fork_servers, args=(its, str(path), address)
    )
    forking.start()
    its.close()
    try:
        async with anyio.create_task_group() as clients:
            for number in range(1, CLIENTS + 1):
                turtle = f"turtle{number}"
                clients.start_soon(patrol_on, turtle, address, seed, sent, is_over)
            for count in range(kills):
                mine.send(chance.uniform(0.0, LONGEST))
                status = await anyio.to_thread.run_sync(mine.recv, abandon_on_cancel=True)
                if status is not None:
                    raise Broken(f"server {count} ended by itself with status {status}")
                if count % 20 == 19:
                    check_journal(path, list(sent), ends)
                    print(f"{count + 1} kills, {len(sent)} goals", end="\r", file=sys.stderr)
            mine.send(0)
            is_over.set()
            clients.cancel_scope.deadline = anyio.current_time() + PATIENCE
        if clients.cancel_scope.cancelled_caught:
            raise Broken(f"goals have not ended {PATIENCE:g} s after the last kill")
        mine.send(0)
        if await anyio.to_thread.run_sync(mine.recv):
            raise Broken("the last server did not end cleanly")
        check_journal(path, sent, ends)
        left = [record.id.hex() for record in read_goals(path) if not record.ended]
        if left:
            raise Broken(f"goals have not ended: {', '.join(left)}")
    finally:
        with suppress(ProcessLookupError):
            os.killpg(forking.pid or 0, signal.SIGKILL)
        forking.join()
    return sent, ends


def run_round(kills: int, seed: int) -> Round:
    """Run one round with a journal of its own.

    Raises:
        ExceptionGroup: with `Broken` if an invariant does not hold.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "goals.db")
        sent, ends = anyio.run(run, kills, seed, path)
        crashes = max(record.crashes for record in read_goals(path))
    return Round(len(ends), [each.seen for each in sent], crashes)


def main() -> int:
    kills = int(sys.argv[1]) if len(sys.argv) > 1 else KILLS
    first = int(sys.argv[2]) if len(sys.argv) > 2 else SEED
    print(
        f"Python {platform.python_version()}, SQLite {sqlite3.sqlite_version}, "
        f"zenoh {version('eclipse-zenoh')}, {os.cpu_count()} cores"
    )
    began = time.monotonic()
    rounds = list[Round]()
    for seed, done in enumerate(range(0, kills, ROUND), first):
        problems = list[str]()
        try:
            rounds.append(run_round(min(ROUND, kills - done), seed))
        except* (Broken, turtleact.TurtleactError) as broken:
            problems = [str(each) for each in broken.exceptions]
        if problems:
            print(f"BROKEN with seed {seed}: {problems}")
            return 1
        print(f"seed {seed}: {rounds[-1].ended} patrols", flush=True)
    minutes = (time.monotonic() - began) / 60
    seen = statistics.median(count for each in rounds for count in each.seen)
    print(
        f"{kills} kills in {minutes:.1f} min: {sum(each.ended for each in rounds)} patrols of "
        f"{TARGETS} targets were accepted, each ended SUCCEEDED once with all targets reached "
        f"once; the clients saw {seen:g} feedback messages of a patrol (median); most crashes "
        f"without feedback: {max(each.crashes for each in rounds)}"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
