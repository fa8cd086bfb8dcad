"""Whose rclpy a program gets."""

from __future__ import annotations

import sys

import pytest

from turtleact.errors import UsageError
from turtleact.rclpy.face import chosen_face
from turtleact.rclpy.program import Options, offer_neighbours, prepare

from ..registry import isolated_registry


@pytest.fixture
def genuine(tmp_path, monkeypatch):
    """Makes a package that looks like a genuine rclpy, or a broken one."""

    def make(code: str) -> None:
        for name, text in (
            ("rclpy", f"{code}\ndef get_rmw_implementation_identifier(): return 'rmw_fast'\n"),
            ("builtin_interfaces", ""),
            (
                "builtin_interfaces/msg",
                "class M(type):\n"
                " @classmethod\n def __import_type_support__(c): pass\n"
                "class Time(metaclass=M): pass\n",
            ),
        ):
            (tmp_path / name).mkdir()
            (tmp_path / name / "__init__.py").write_text(text)
        monkeypatch.setenv("PYTHONPATH", str(tmp_path))
        monkeypatch.syspath_prepend(str(tmp_path))

    return make


@pytest.mark.parametrize("asked", ["auto", "ros"])
def test_a_genuine_rclpy_that_works_is_used(genuine, asked):
    genuine("pass")
    assert chosen_face(asked) == ("ros", "rmw_fast")


def test_a_program_with_another_middleware_is_told_so(genuine, capsys):
    genuine("pass")
    finders = list(sys.meta_path)
    prepare(Options())
    assert sys.meta_path == finders
    assert "uses the rclpy of ROS with rmw_fast" in capsys.readouterr().err


def test_a_broken_rclpy_is_not_used(genuine):
    genuine("raise ImportError('no libraries')")
    assert chosen_face("auto") == ("turtleact", "")
    with pytest.raises(UsageError, match="cannot be imported"):
        chosen_face("ros")


def test_ours_can_be_asked_for(genuine):
    genuine("pass")
    assert chosen_face("turtleact") == ("turtleact", "")
    with pytest.raises(UsageError, match="--face is one of"):
        chosen_face("theirs")


def test_interfaces_are_found_above_a_program_where_there_is_a_src(tmp_path, monkeypatch):
    from turtleact.interfaces import get_message

    file = tmp_path / "src" / "hall_interfaces" / "msg" / "Door.msg"
    file.parent.mkdir(parents=True)
    file.write_text("bool open\n")
    monkeypatch.chdir("/")
    with isolated_registry():
        offer_neighbours(tmp_path / "src" / "hall" / "hall")
        assert get_message("hall_interfaces/msg/Door")().open is False
