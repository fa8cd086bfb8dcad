"""What turtleact's peers tell each other of a goal beside ROS 2's messages.

ROS 2 has no field for it. A note travels as a short JSON text beside a response; peers of another
kind do not see it.
"""

from __future__ import annotations

import msgspec

from turtleact.summaries import encodable

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
        """The note as text.

        Only the first `LONGEST_REASON` characters of a reason are written. What UTF-8 cannot encode
        is escaped, since a reason must never cost the client its result.
        """
        reason = encodable(self.reason[:LONGEST_REASON])
        sent = self if reason == self.reason else msgspec.structs.replace(self, reason=reason)
        data = msgspec.json.encode(sent)
        while len(data) > LARGEST:  # of escapes, six bytes a character
            reason = reason[: len(reason) * 3 // 4]
            data = msgspec.json.encode(msgspec.structs.replace(self, reason=reason))
        return data.decode()

    @classmethod
    def read(cls, text: str) -> GoalNote:
        """The note of a text; an empty one if the text is none, as that of a stranger may be."""
        try:
            return msgspec.json.decode(text, type=cls)
        except msgspec.DecodeError:
            return cls()


LONGEST_REASON = 1000
"""So many characters of a reason travel."""

LARGEST = 4096
"""So many bytes of a note travel; half a note could not be read."""
