# In a checkout: pip install . py-trees
"""A behaviour tree whose ticks never wait: a leaf starts a goal, checks on it, and lets it go.

The turtle patrols until its battery is low. Then the tree switches to another branch, which cancels
the patrol. The turtle goes home as soon as the patrol has released it, because they share a lock.

Prints:

    patrol: to be sent
    patrol: 16.2 m to go
    go home: to be sent
    go home: 6.6 m to go
    go home: 4.6 m to go
    go home: 2.6 m to go
    go home: SUCCEEDED
    [o] turtle [o]
        [-] at last [o]
            --> low battery [o] -- 12 %
            --> go home [o] -- SUCCEEDED
        --> patrol [-] -- to be canceled
"""

import asyncio
from functools import partial
from typing import Any

import anyio
from anyio.abc import TaskGroup
from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Selector, Sequence
from py_trees.display import ascii_tree

from turtleact import ActionClient, ClientGoalHandle, GoalRejected, GoalStatus, Message, open_world
from turtleact.actions.go_to import GoTo
from turtleact.actions.patrol import Patrol
from turtleact.interfaces.standard import Point
from turtleact.tasks.clock import Clock

TARGETS = [Point(x=9.0, y=7.0), Point(x=5.0, y=1.0), Point(x=1.0, y=7.0)]


class GoalLeaf(Behaviour):
    """A leaf that is RUNNING while its goal runs. Only ``send`` waits."""

    def __init__(
        self,
        client: ActionClient[Any, Any, Any],
        goal: Message,
        *,
        name: str,
        group: TaskGroup,
        turtle: anyio.Lock,
    ) -> None:
        super().__init__(name)
        self.client = client
        self.goal = goal
        self.group = group
        self.turtle = turtle

    def initialise(self) -> None:
        """Start again. The first tick, and the first tick after an end, call this."""
        self.handle: ClientGoalHandle[Any, Any] | None = None
        self.rejection = ""
        self.scope = anyio.CancelScope()
        self.group.start_soon(self.send, self.scope)

    async def send(self, scope: anyio.CancelScope) -> None:
        """Wait for the turtle, for the server to accept, and for the end."""
        try:
            with scope:
                async with self.turtle, self.client.send_goal(self.goal) as self.handle:
                    await self.handle.outcome()
        except GoalRejected as error:
            self.rejection = str(error)

    def update(self) -> Status:
        """Return the status. Every tick calls this."""
        if self.handle is None:
            self.feedback_message = self.rejection or "to be sent"
            return Status.FAILURE if self.rejection else Status.RUNNING
        if self.handle.done:
            self.feedback_message = self.handle.status.name
            succeeded = self.handle.status is GoalStatus.SUCCEEDED
            return Status.SUCCESS if succeeded else Status.FAILURE
        if feedback := self.handle.last_feedback:
            self.feedback_message = f"{feedback.distance_remaining:.1f} m to go"
        return Status.RUNNING

    def terminate(self, new_status: Status) -> None:  # noqa: ARG002  # py_trees passes it
        """Cancel the goal, sent or not. A goal that has ended is left alone."""
        if self.handle is None:
            self.scope.cancel()
        elif not self.handle.done:
            self.handle.cancel_nowait()
            self.feedback_message = "to be canceled"


class LowBattery(Behaviour):
    def __init__(self, clock: Clock) -> None:
        super().__init__("low battery")
        self.clock = clock

    def update(self) -> Status:
        """Check the battery, which loses 10 % per second."""
        level = 100 - 10 * self.clock.time()
        self.feedback_message = f"{level:.0f} %"
        return Status.SUCCESS if level < 66 else Status.FAILURE


async def main() -> None:
    async with open_world(speed="max") as node, anyio.create_task_group() as group:
        leaf = partial(GoalLeaf, group=group, turtle=anyio.Lock())
        way, home = Patrol.Goal(targets=TARGETS), GoTo.Goal(x=2.0, y=2.0)
        patrol = leaf(node.action_client(Patrol, "patrol"), way, name="patrol")
        go_home = leaf(node.action_client(GoTo, "go_to"), home, name="go home")
        at_last = Sequence("at last", memory=False, children=[LowBattery(node.clock), go_home])
        tree = Selector("turtle", memory=False, children=[at_last, patrol])
        while tree.status is not Status.SUCCESS:
            await node.clock.sleep(1.25)
            tree.tick_once()
            tip = tree.tip() or tree
            print(f"{tip.name}: {tip.feedback_message}")
        print(ascii_tree(tree, show_status=True), end="")


if __name__ == "__main__":
    asyncio.run(main())
