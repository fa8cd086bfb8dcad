"""Threads that are not Python's, and call it often.

A thread of a library that calls Python gets a thread state for the call and gives it up behind it.
Making one anew took 9 us a message, more than all that is done with the message (CPython 3.11).

Source: CPython ``Doc/c-api/init.rst``, "Non-Python created threads".
"""

from __future__ import annotations

import ctypes
import threading

__all__ = ["stay"]

_here = threading.local()


def stay() -> None:
    """Have the calling thread keep its thread state, as long as it lives.

    It is asked for once more than it is given up; the calls behind only count. The state of a
    thread that has ended stays until Python ends: for threads that live long.
    """
    try:
        _here.stays  # noqa: B018
    except AttributeError:
        _here.stays = True
        ctypes.pythonapi.PyGILState_Ensure()
