"""What turtleact's peers tell each other of a goal beside ROS 2's messages.

ROS 2 has no field for it. A note travels as a short JSON text beside a response; peers of another
kind do not see it.
"""

from __future__ import annotations

import msgspec

__all__ = ["GoalNote"]


class GoalNote(msgspec.Struct, frozen=True, omit_defaults=True):
    """What stands beside the answer to a ``SendGoal`` or ``GetResult`` request.

    Attributes:
        reason: Why the goal was rejected or aborted.
        feedback: How many feedback messages were published for it.

    >>> GoalNote.read(GoalNote("no such place", 3).write())
    GoalNote(reason='no such place', feedback=3)
    >>> GoalNote.read("")
    GoalNote(reason='', feedback=0)
    """

    reason: str = ""
    feedback: int = 0

    def write(self) -> str:
        """The note as text; of a long reason the first `LONGEST_REASON` characters."""
        if len(self.reason) <= LONGEST_REASON:
            return msgspec.json.encode(self).decode()
        short = msgspec.structs.replace(self, reason=self.reason[:LONGEST_REASON])
        return msgspec.json.encode(short).decode()

    @classmethod
    def read(cls, text: str) -> GoalNote:
        """The note of a text; an empty one if the text is none, as that of a stranger may be."""
        try:
            return msgspec.json.decode(text, type=cls)
        except msgspec.DecodeError:
            return cls()


LONGEST_REASON = 1000
"""So many characters of a reason travel."""
