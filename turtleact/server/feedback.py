"""The feedback of a server's goals for who listens to its topic.

Feedback that nobody in this process looks at is written as the body gives it: what it holds is
checked on the way, and the bytes are the copy that is kept.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

from turtleact.goal import Goal
from turtleact.interfaces import Action, FeedbackFormat, implied
from turtleact.interfaces.standard import UUID
from turtleact.transports.base import Publication, Source

if TYPE_CHECKING:
    from turtleact.server.action_server import ActionServer

__all__ = ["FeedbackSource"]


class FeedbackSource(Source):
    """The source of the feedback topic, which is for those who are there.

    Args:
        server: The server.

    Attributes:
        publication: The topic's sending end, to be set once that is open.
        format: How its messages are written.
    """

    publication: Publication

    def __init__(self, server: ActionServer[Any, Any, Any]) -> None:
        self._server = server
        self._action = cast("type[Action]", server.action_type)
        self.format = FeedbackFormat(self._action)

    def readers_changed(self, *, has_readers: bool) -> None:
        """Publish while somebody reads."""
        execution = self._server.execution
        if has_readers:
            execution.also_feedback, execution.emit = self._publish, self._emit
        else:
            execution.also_feedback = execution.emit = None

    def read_last(self, goal: Goal) -> None:
        """Make a message of a goal's newest feedback, if it was kept as it was sent."""
        if isinstance(goal.last_feedback, bytes):
            goal.last_feedback = self.format.read(goal.last_feedback)

    def _emit(self, goal: Goal, feedback: object) -> bool:
        """Write feedback as the body gives it, where nobody in this process reads any."""
        publication = self.publication
        if goal.is_streamed or goal.on_feedback or goal.ended or publication.has_near_readers:
            return False
        data = self.format.write_unchecked(goal.id or self._server.name_goal(goal), feedback)
        if data is None:
            return False
        goal.published += 1
        goal.last_feedback = data  # `read_last` reads it, if somebody comes
        publication.send(data)
        return True

    def _publish(self, goal: Goal, feedback: Any) -> None:  # noqa: ANN401  # of the action's own class
        goal.published += 1
        goal_id, publication = goal.id or self._server.name_goal(goal), self.publication
        if publication.has_near_readers:
            publication.publish(self._message(UUID(goal_id), feedback))
        else:
            publication.send(self.format.write(goal_id, feedback))

    @cached_property
    def _message(self) -> type[Any]:
        return implied(self._action).feedback_message
