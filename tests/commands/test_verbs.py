from __future__ import annotations

import subprocess
import sys

import pytest
import typer
from typer.core import TyperGroup
from typer.main import get_command

from turtleact.commands import VERBS, send_goal, verbs
from turtleact.commands.goal_text import GoalText
from turtleact.errors import UsageError

USAGE = [
    (["send-goal"], "missing argument 'NAME'"),
    (["send-goal", "x", "--fedback"], "no such option: --fedback .*--feedback"),
    (["send-goal", "x", "--timeout"], "requires an argument"),
    (["send-goal", "x", "-t", "abc"], "--timeout is a number of seconds, 0 or more, not 'abc'"),
    (["send-goal", "x", "-t", "-1"], "--timeout is a number of seconds, 0 or more, not '-1'"),
    (["send-goal", "x", "-t", "nan"], "not 'nan'"),
    (["send-goal", "x", "-t", "inf"], "not 'inf'"),
    (["send-goal", "x", "--speed", "0"], "--speed is a number above zero, or max, not '0'"),
    (["send-goal", "x", "--speed", "-1"], "not '-1'"),
    (["send-goal", "x", "--speed", "nan"], "not 'nan'"),
    (["send-goal", "x", "--speed", "fast"], "not 'fast'"),
    (["send-goal", "x", "--speed", "101"], "--speed is 100 at most, not '101'; max is as fast"),
    (["send-goal", "x", "--speed", "1e307"], "--speed is 100 at most, not '1e307'"),
    (["send-goal", "x", "--seed", "-1"], "whole number, 0 or more, of 18 digits at most, not '-1'"),
    (["send-goal", "x", "--seed", "9" * 19], "--seed is a whole number, .* not '9{19}'"),
    (["send-goal", "x", "--seed", "9" * 5000], "--seed is a whole number, .* not '9{60}…'"),
    (["send-goal", "x", "--seed", "1.5"], "not '1.5'"),
    (["send-goal", "x", "a/b", "1", "-5"], r"unexpected extra argument.*\(-5\)"),
    (["send-goal", "x", "order:", "5"], 'quote the goal: "order: 5"'),
    (["send-goal", "x", "{}", "--stdin"], "the goal is given twice"),
    (["send-goal", "x", "--stdin", "--goal-file", "f"], "the goal is given twice"),
    (["send-goal", "x", "--json", "--plain"], "give --json or --plain, not both"),
    (["send-gaol"], "no such command 'send-gaol'. Did you mean 'send-goal'?"),
    (["--frobnicate"], "no such option: --frobnicate"),
    (["send-goal", "--domain"], r"no such option: --domain\n"),
    (["action", "send_gaol"], "Did you mean 'send_goal'?"),
]


@pytest.mark.parametrize(("arguments", "problem"), USAGE, ids=lambda each: " ".join(each))
def test_a_command_line_that_makes_no_sense_is_refused(arguments, problem):
    with pytest.raises(UsageError, match=problem):
        verbs.parse(arguments)


def test_a_refusal_says_where_there_is_help():
    with pytest.raises(UsageError, match=r"\nTry 'turtleact action send_goal --help'\.\Z"):
        verbs.parse(["action", "send_goal"])


@pytest.fixture
def order(monkeypatch, interrupts):
    """The order that a command line makes."""

    def of(*arguments):
        orders = []

        def run(order, _):
            orders.append(order)
            return 9

        monkeypatch.setattr(send_goal, "run", run)
        assert verbs.parse(["send-goal", *arguments])(interrupts) == 9
        return orders[0]

    return of


def test_what_is_left_out_has_its_default(order):
    assert order("patrol") == send_goal.Order(
        name="patrol",
        type_name=None,
        text=GoalText("{}", "goal"),
        feedback=False,
        timeout=None,
        view="auto",
        speed=1.0,
        seed=0,
    )


@pytest.mark.parametrize(
    ("arguments", "type_name", "goal"),
    [
        (["pkg/action/Name"], "pkg/action/Name", "{}"),
        (["pkg/Name", "order: 5"], "pkg/Name", "order: 5"),
        (["order: 5"], None, "order: 5"),
        (["{}"], None, "{}"),
        (["-5"], None, "-5"),
        (["- x: 1"], None, "- x: 1"),
        (["-.5"], None, "-.5"),
        (["---\n{order: 5}"], None, "---\n{order: 5}"),
        (["pkg/Name", "-5"], "pkg/Name", "-5"),
        (["--", "-f"], None, "-f"),
    ],
)
def test_the_type_is_told_from_the_goal(order, arguments, type_name, goal):
    made = order("x", *arguments)
    assert (made.type_name, made.text.text) == (type_name, goal)


@pytest.mark.parametrize("arguments", [["-f", "x", "g:"], ["x", "-f", "g:"], ["x", "g:", "-f"]])
def test_options_stand_anywhere(order, arguments):
    made = order(*arguments)
    assert (made.name, made.text.text, made.feedback) == ("x", "g:", True)


def test_options_reach_the_order(order):
    made = order("x", "-ft0.5", "--json", "--speed", "max", "--seed=7", "--embedded")
    assert made[3:] == (True, 0.5, "json", "max", 7)


def test_plain_is_a_view(order):
    assert order("x", "--plain").view == "plain"


def test_a_goal_file_is_read_by_the_job(order, tmp_path):
    path = tmp_path / "goal.yaml"
    path.write_text("order: 5")
    assert order("x", "--goal-file", str(path)).text == ("order: 5", str(path))


@pytest.mark.parametrize("arguments", [["action"], ["action", "-h"], ["action", "--help"]])
def test_a_group_prints_what_there_is(arguments, capsys, interrupts):
    assert verbs.parse(arguments)(interrupts) == 0
    assert "send_goal  Send a goal" in capsys.readouterr().out


def test_only_the_group_that_is_asked_for_is_imported():
    code = (
        "import sys; from turtleact.commands.verbs import parse; parse(['interface', 'list']);"
        "print(*sorted(each for each in sys.modules if each.startswith('turtleact.')))"
    )
    assert subprocess.check_output([sys.executable, "-c", code], text=True).split() == [
        "turtleact.commands",
        "turtleact.commands.interrupts",
        "turtleact.commands.verbs",
        "turtleact.commands.verbs.arguments",
        "turtleact.commands.verbs.interface",
        "turtleact.errors",
    ]


def test_the_help_of_a_verb_shows_examples(capsys, interrupts):
    assert verbs.parse(["send-goal", "-h"])(interrupts) == 0
    assert '  turtleact send-goal fibonacci "order: 5" --feedback\n' in capsys.readouterr().out


def test_the_table_of_verbs_names_what_typer_knows():
    command = get_command(verbs.assemble(VERBS))
    assert isinstance(command, TyperGroup)
    assert list(command.commands) == list(VERBS)


@pytest.mark.parametrize("error", [KeyboardInterrupt(), BrokenPipeError()], ids=repr)
def test_what_stops_the_printing_of_help_is_not_for_typer_to_judge(monkeypatch, error):
    def stops(*_, **__):
        raise error

    monkeypatch.setattr(typer, "echo", stops)
    with pytest.raises(type(error)):
        verbs.parse(["action"])


def test_arguments_are_read_without_pydantic():
    code = (
        "import sys; from turtleact.commands.verbs import parse;"
        "parse(['send-goal', 'x', 'pkg/Name', '{}', '-t', '1']); print('pydantic' in sys.modules)"
    )
    assert subprocess.check_output([sys.executable, "-c", code], text=True) == "False\n"
