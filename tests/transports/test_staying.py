"""Which threads keep their thread state."""

from __future__ import annotations

import ctypes
import threading

from turtleact.transports.rmw_zenoh import staying


def test_each_thread_that_looks_stays_once_and_no_other(monkeypatch):
    asked: list[int] = []
    monkeypatch.setattr(
        ctypes.pythonapi,
        "PyGILState_Ensure",
        lambda: asked.append(threading.get_ident()),
    )
    here = type(staying.HERE)()
    assert asked == []

    def look() -> None:
        assert here.stays
        assert here.stays

    look()
    other = threading.Thread(target=look)
    other.start()
    other.join()
    assert asked == [threading.get_ident(), other.ident]
