"""Tools for testing actions: virtual time, a call that runs a goal, and an unreliable transport.

This package uses nodes, clocks and transports, but no simulated world and no particular action.
``turtleact.testing.plugin`` is the pytest plug-in, and the only module that imports pytest.
"""

from turtleact.tasks import wait_until_idle
from turtleact.testing.faults import Faults, FaultyTransport
from turtleact.testing.goals import GoalRun, run_goal
from turtleact.testing.time import run, virtual_backend

__all__ = [
    "Faults",
    "FaultyTransport",
    "GoalRun",
    "run",
    "run_goal",
    "virtual_backend",
    "wait_until_idle",
]
