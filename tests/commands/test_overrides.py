"""First values of parameters from the command line."""

from __future__ import annotations

import pytest

from turtleact.commands.node_parameters import of_node, read_overrides, unheard
from turtleact.commands.settings import Override
from turtleact.errors import UsageError

FILE = """
/**:
  ros__parameters:
    max_speed: 1.5
    names: [a, b]
lab:
  ros__parameters:
    pid: {gain: 2}
"""


def test_files_come_first_and_assignments_after_them(tmp_path):
    (tmp_path / "lab.yaml").write_text(FILE)
    found = read_overrides([str(tmp_path / "lab.yaml")], ["max_speed:=2", "arm:x:=true", "t:=a:=b"])
    assert found == [
        Override("/**", "max_speed", 1.5),
        Override("/**", "names", ["a", "b"]),
        Override("lab", "pid.gain", 2),
        Override("/**", "max_speed", 2),
        Override("arm", "x", True),
        Override("/**", "t", "a:=b"),
    ]
    assert of_node(found, "/lab") == {
        "max_speed": 2,
        "names": ["a", "b"],
        "pid.gain": 2,
        "t": "a:=b",
    }


@pytest.mark.parametrize("text", ["max_speed", "max_speed:=", ":=2", "lab::=2", "max_speed=2"])
def test_an_assignment_without_a_name_or_a_value_is_refused(text):
    with pytest.raises(UsageError, match=f"-p takes NAME:=VALUE, .* not '{text}'"):
        read_overrides([], [text])


@pytest.mark.parametrize(
    ("texts", "said"),
    [
        (["speed:=1", "other:speed:=2"], []),
        (["sped:=1"], ["no module declares a parameter 'sped', did you mean 'speed'?"]),
        (
            ["arm:speed:=1", "leg:speed:=1"],
            ["the node of this server is /lab, but the parameters are for arm, leg"],
        ),
    ],
)
def test_the_user_is_told_of_values_that_set_nothing(texts, said):
    assert unheard(read_overrides([], texts), "/lab", ["speed"]) == said


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["-p", "speed"], "turtleact: -p takes NAME:=VALUE, such as max_speed:=2.0, not 'speed'\n"),
        (["--params-file", "missing.yaml"], "turtleact: missing.yaml: "),
    ],
)
def test_a_mistake_in_them_ends_serve(turtleact, arguments, problem):
    ran = turtleact("serve", *arguments)
    assert (ran.status, ran.err.startswith(problem)) == (2, True)
