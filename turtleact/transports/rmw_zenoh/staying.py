"""Threads that are not Python's, and call it often.

A thread of a library that calls Python gets a thread state for the call and gives it up behind it.
Making one anew took 9 us a message, more than all that is done with the message (CPython 3.11).

Source: CPython ``Doc/c-api/init.rst``, "Non-Python created threads".
"""

from __future__ import annotations

import ctypes
import threading
from functools import cached_property

__all__ = ["HERE"]


class _Here(threading.local):
    """What is kept for each thread by itself."""

    @cached_property
    def stays(self) -> bool:
        """True; made when a thread looks at it first."""
        ctypes.pythonapi.PyGILState_Ensure()
        return True


HERE = _Here()
"""Looking at ``HERE.stays`` has the calling thread keep its thread state, as long as it lives.

It is asked for once more than it is given up; the calls behind only count. The state of a thread
that has ended stays until Python ends: for threads that live long. It is looked at for each
message, so that is no call.
"""
