"""What all tests share: the event loops that an async test runs on, its watchdog, Hypothesis.

An async test runs on asyncio, uvloop and trio, for cancellation, tasks and wake-ups differ between
them. uvloop runs the tasks of asyncio, so of a test with many cases it runs the first and the last.
What is built on top of tasks, nodes and transports does not meet these differences: the tests in
the folders of `ONE_LOOP` run on asyncio. A test, or through ``pytestmark`` a module, that wants
other loops, or all its cases on uvloop, names its loops: ``@pytest.mark.loops("asyncio", "trio")``.
"""

from __future__ import annotations

import faulthandler
import functools
import gc
import inspect
import os
import signal
import threading
import time
from collections import Counter
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import anyio
import anyio.from_thread
import anyio.lowlevel
import hypothesis
import pytest

from turtleact.interfaces.types import REGISTRY, definition

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Generator

LOOPS = {
    "asyncio": ("asyncio", {"use_uvloop": False}),
    "uvloop": ("asyncio", {"use_uvloop": True}),
    "trio": ("trio", {}),
}
INSTALLED = [name for name in LOOPS if find_spec(name)]
ONE_LOOP = {
    "actions",
    "commands",
    "fuzz",
    "interfaces",
    "interop",
    "mcp",
    "recording",
    "sim",
    "telemetry",
    "web",
}
"""The folders whose async tests run on asyncio only, if no mark says otherwise."""
TESTS = Path(__file__).parent
SECONDS = 30.0
FROZEN = 90.0

os.environ["ROS_DOMAIN_ID"] = "231"  # no test is to see what else runs on this machine
# The programs that tests start compile turtleact once, not each of them again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

if os.name != "posix":  # these use pseudo-terminals, alarm clocks, bash and processes of POSIX
    collect_ignore = [
        *("commands", "test_docs.py", "test_house.py", "test_release.py"),
        *("transports/test_joining.py", "web/test_page.py"),
    ]

# A shell without job control has what it starts in the background ignore these. The programs that
# tests interrupt would inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGQUIT") and signal.getsignal(signal.SIGQUIT) is signal.SIG_IGN:
    signal.signal(signal.SIGQUIT, signal.SIG_DFL)


def pytest_configure(config: pytest.Config) -> None:
    """Declare the mark, and watch the tests of this process."""
    config.addinivalue_line("markers", "loops(*names): the event loops that a test runs on")
    WATCHDOG.stderr = os.dup(2)
    WATCHDOG.start()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int | None:
    """One worker more than there are cores, because tests wait for a quarter of their time.

    They wait for programs that they start, for the network, and for loops to become idle.
    """
    if "PYTEST_XDIST_AUTO_NUM_WORKERS" in os.environ:
        return None
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return (cores or 1) + 1


@pytest.fixture
def anyio_backend() -> object:
    """The loop of an async test: `pytest_generate_tests` gives each test its own."""
    return LOOPS["asyncio"]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run an async test on its event loops, unless it or its module parametrizes them itself."""
    if "anyio_backend" not in metafunc.fixturenames or hasattr(metafunc.module, "anyio_backend"):
        return
    marks = metafunc.definition.iter_markers("parametrize")
    if any("anyio_backend" in mark.args[0] for mark in marks):
        return
    loops = loops_of(metafunc.definition)
    installed = [pytest.param(LOOPS[name], id=name) for name in INSTALLED if name in loops]
    metafunc.parametrize("anyio_backend", installed)


def loops_of(test: pytest.Item) -> tuple[str, ...]:
    """The names of the event loops that a test should run on."""
    if mark := test.get_closest_marker("loops"):
        return mark.args
    folder = test.path.relative_to(TESTS).parts[0]
    return ("asyncio",) if folder in ONE_LOOP else tuple(LOOPS)


@pytest.hookimpl(wrapper=True)
def pytest_pycollect_makeitem() -> Generator[None, object, object]:
    """Leaves only the first and the last case of a test to uvloop, unless it names its loops."""
    made = yield
    if isinstance(made, list):
        on_uvloop = [each for each in made if is_on_uvloop_by_default(each)]
        dropped = set(on_uvloop[1:-1])
        made = [each for each in made if each not in dropped]
    return made


def is_on_uvloop_by_default(item: object) -> bool:
    if not isinstance(item, pytest.Function) or not hasattr(item, "callspec"):
        return False
    on_uvloop = item.callspec.params.get("anyio_backend") == LOOPS["uvloop"]
    return on_uvloop and item.get_closest_marker("loops") is None


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Says why tests were skipped, once for each reason; pytest alone would show an ``s``."""
    reasons = Counter(report.longrepr[2] for report in terminalreporter.stats.get("skipped", ()))
    for reason, number in reasons.most_common():
        terminalreporter.write_line(f"{number} skipped: {reason.removeprefix('Skipped: ')}")


COLLECTED: dict[str, Any] = {}
"""The interfaces that the test modules define, by name."""


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collects no garbage while the tests are collected: next to nothing of it is garbage."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_finish() -> None:
    """Remembers the interfaces that are known once all test modules are imported."""
    COLLECTED.update((name, REGISTRY.get(name)) for name in REGISTRY.names())


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(
    item: pytest.Item, nextitem: pytest.Item | None
) -> Generator[None, object, object]:
    """Keeps garbage collections as quick in the last module as in the first."""
    done = yield
    if nextitem is None or nextitem.path != item.path:
        pass_over_what_is_there()
    return done


def pass_over_what_is_there() -> None:
    """Has later garbage collections pass over what is there now.

    Test modules, items and reports live until the end. With them, a full collection takes 0.2 s,
    and some tests make hundreds.
    """
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def names_mean_what_they_meant() -> None:
    """Undoes another test's definition of a name: which tests went before must not matter."""
    for name, interface in COLLECTED.items():
        if REGISTRY.get(name) is not interface:
            REGISTRY.forget(name)
            REGISTRY.add(interface, definition(interface))


class Watchdog(threading.Thread):
    """One thread that keeps real time, whatever clock a test has.

    It cancels an async test that runs for `SECONDS`. As long as it can run itself, it keeps winding
    up faulthandler, which otherwise ends the process after `FROZEN` seconds and shows every thread.
    """

    def __init__(self) -> None:
        super().__init__(name="watchdog", daemon=True)
        self.stderr = 2
        self.watched: tuple[float, Callable[[], object]] | None = None
        """When the running test is to be canceled, and how."""

    def run(self) -> None:
        wind_up = 0.0
        while True:
            now = time.monotonic()
            if now >= wind_up:
                faulthandler.dump_traceback_later(FROZEN, exit=True, file=self.stderr)
                wind_up = now + FROZEN / 9
            if (watched := self.watched) and now >= watched[0]:
                self.watched = None
                # A thread of its own, for the test may end right now, and its loop never answer.
                threading.Thread(target=watched[1], daemon=True).start()
            time.sleep(min(1.0, SECONDS))


WATCHDOG = Watchdog()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> Generator[None, object, object]:
    """Fails an async test that hangs, on every loop: uvloop and trio outlive pytest-timeout."""
    if inspect.iscoroutinefunction(pyfuncitem.obj):
        pyfuncitem.obj = watched(pyfuncitem.obj)
    return (yield)


def watched(test: Callable[..., Awaitable[None]]) -> Callable[..., Awaitable[None]]:
    """The same test, cancelled by the watchdog once it has run for `SECONDS`."""

    @functools.wraps(test)
    async def run(**fixtures: object) -> None:
        token = anyio.lowlevel.current_token()
        with anyio.CancelScope() as scope:

            def cancel() -> None:
                with suppress(RuntimeError):  # the loop is closed
                    anyio.from_thread.run_sync(scope.cancel, token=token)

            WATCHDOG.watched = time.monotonic() + SECONDS, cancel
            try:
                await test(**fixtures)
            except anyio.get_cancelled_exc_class():
                if scope.cancel_called:
                    pytest.fail(f"still waiting after {SECONDS:g} s; where, is shown above")
                raise
            finally:
                WATCHDOG.watched = None

    return run


# A slow machine is no failure, so there is no deadline. In CI each run draws the same examples.
hypothesis.settings.register_profile(
    "house",
    deadline=None,
    derandomize="CI" in os.environ,
    max_examples=50,
    suppress_health_check=[hypothesis.HealthCheck.too_slow],
)
# pytest --hypothesis-profile=thorough searches for longer.
hypothesis.settings.register_profile(
    "thorough", hypothesis.settings.get_profile("house"), derandomize=False, max_examples=1000
)
hypothesis.settings.load_profile("house")
