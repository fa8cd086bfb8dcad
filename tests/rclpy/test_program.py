"""What surrounds a program: its options, its interfaces, its threads and its end."""

from __future__ import annotations

import os
import signal
import sys

import pytest

from turtleact.rclpy import ament_index, program
from turtleact.rclpy.__main__ import main
from turtleact.rclpy.face import SETTINGS

from ..registry import isolated_registry


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Runs a program with options as ``python -m turtleact.rclpy`` does."""
    handler = signal.getsignal(signal.SIGINT)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.meta_path", list(sys.meta_path))
    monkeypatch.setattr("sys.path", ["", *sys.path])

    def run(*arguments: str) -> None:
        monkeypatch.setattr("sys.argv", ["turtleact.rclpy", *arguments])
        with isolated_registry():
            main()

    yield run
    monkeypatch.undo()
    signal.signal(signal.SIGINT, handler)


def test_a_file_is_run_with_its_arguments_and_folder(run, tmp_path, capsys):
    folder = tmp_path / "lab"
    folder.mkdir()
    (folder / "parts.py").write_text("NAME = 'arm'\n")
    file = folder / "arm.py"
    file.write_text("import sys\nfrom parts import NAME\nprint(__name__, NAME, sys.argv[1:])\n")
    run("--face=turtleact", "--connect=tcp/a:1,tcp/b:2", str(file), "--fast", "--connect=no")
    assert capsys.readouterr().out == "__main__ arm ['--fast', '--connect=no']\n"
    assert SETTINGS.place.connect == ("tcp/a:1", "tcp/b:2")
    assert sys.path[0] == str(folder)


def test_a_module_is_run_and_finds_interfaces_in_a_folder(run, tmp_path, capsys):
    message = tmp_path / "more" / "hall_interfaces" / "msg" / "Door.msg"
    message.parent.mkdir(parents=True)
    message.write_text("bool open\n")
    (tmp_path / "door.py").write_text("from hall_interfaces.msg import Door\nprint(Door())\n")
    run("--face=turtleact", "--interfaces=more", "-m", "door")
    assert capsys.readouterr().out == "hall_interfaces.msg.Door(open=False)\n"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nothing.py"], "there is no file 'nothing.py'"),
        (["--face=ros", "-m", "door"], "the genuine rclpy cannot be imported"),
        (["--alone", "--embedded", "-m", "door"], "--embedded needs a graph"),
    ],
)
def test_options_that_make_no_sense_are_refused(run, capsys, arguments, said):
    with pytest.raises(SystemExit, match="2"):
        run(*arguments)
    assert said in capsys.readouterr().err


class Left(BaseException):
    """The process was left."""


@pytest.fixture
def leaving(monkeypatch):
    """Notes how the process is left instead of leaving it."""
    done: list[object] = []

    def leave(status: int) -> None:
        done.append(status)
        raise Left

    monkeypatch.setattr(os, "_exit", leave)
    monkeypatch.setattr(signal, "raise_signal", done.append)
    monkeypatch.setattr(signal, "signal", lambda number, handler: done.append(handler))
    return done


@pytest.mark.parametrize(
    ("error", "done"),
    [
        (None, [0]),
        (SystemExit(), [0]),
        (SystemExit(3), [3]),
        (SystemExit("no arm"), [1]),
        (ValueError("broken"), [1]),
        (KeyboardInterrupt(), [signal.SIG_DFL, signal.SIGINT, 1]),
    ],
)
def test_a_process_is_left_with_the_status_of_its_exception(leaving, capsys, error, done):
    with pytest.raises(Left):
        program.leave(error)
    assert leaving == done
    is_shown = error is not None and not isinstance(error, SystemExit)
    assert bool(capsys.readouterr().err) is is_shown


def test_packages_are_found_where_they_are_installed_or_written(tmp_path, monkeypatch):
    prefix = tmp_path / "install"
    (prefix / "share" / "arm").mkdir(parents=True)
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path / 'other'}{os.pathsep}{prefix}")
    assert ament_index.get_package_prefix("arm") == str(prefix)
    assert ament_index.get_package_share_path("arm") == prefix / "share" / "arm"
    sources = tmp_path / "src" / "hand"
    sources.mkdir(parents=True)
    (sources / "package.xml").write_text("<package><name>hand</name></package>")
    monkeypatch.chdir(tmp_path)
    assert ament_index.get_package_share_directory("hand") == str(sources)
    with pytest.raises(ament_index.PackageNotFoundError, match="'leg' not found"):
        ament_index.get_package_prefix("leg")
