"""What tests of actions need: virtual time, a goal run to its end, a transport that loses things.

It stands beside `turtleact.app` and knows nodes, clocks and transports, no world and no action.
``turtleact.testing.plugin`` is the door to pytest, and the only module that imports it.
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
