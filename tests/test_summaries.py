"""What users' code raised or gave, in a line of text."""

from __future__ import annotations

from typing import Any

import pytest

from turtleact import Action, Message
from turtleact.interfaces import int32, string
from turtleact.summaries import LONGEST, encodable, field_hint, loggable, summary, text_of


def test_a_long_text_is_cut_and_its_length_said():
    assert text_of("a" * LONGEST) == "a" * LONGEST
    assert text_of("a" * 50_000) == "a" * LONGEST + "… (50,000 characters)"


def test_a_group_of_long_texts_is_cut_as_a_whole():
    group = ExceptionGroup("many", [ValueError("a" * 9_000) for _ in range(9)])
    assert len(summary(group)) < LONGEST + 40


@pytest.mark.parametrize("text", ["plain", "naïve 🐢", ""])
def test_a_text_that_can_be_encoded_stays(text):
    assert encodable(text) == text


def test_half_a_surrogate_pair_is_escaped():
    assert encodable("caf\udce9 🐢") == r"caf\udce9 🐢"


def test_an_exception_of_ordinary_size_is_logged_as_it_is():
    error = ValueError("a")
    error.__cause__ = error
    assert loggable(error) is error


class Mute(Exception):
    def __str__(self) -> str:
        raise LookupError


def test_an_exception_without_a_text_is_logged_as_it_is():
    error = Mute()
    assert loggable(error) is error


@pytest.mark.parametrize("where", ["itself", "cause", "context", "member"])
def test_a_huge_exception_is_logged_with_its_traceback_and_a_short_text(where):
    huge = ValueError("a" * 100_000)
    error: Exception = RuntimeError("b")
    if where == "itself":
        error = huge
    elif where == "cause":
        error.__cause__ = huge
    elif where == "context":
        error.__context__ = huge
    else:
        error = ExceptionGroup("c", [huge])
    try:
        raise error
    except Exception as caught:
        logged = loggable(caught)
    assert len(str(logged)) < LONGEST + 100
    assert logged.__traceback__ is error.__traceback__
    assert (logged.__cause__, logged.__context__) == (None, None)


class Order(Action, type_name="hint_msgs/action/Order"):
    class Result(Message):
        order: int32 = 0
        name: string = ""

    class Feedback(Message):
        pass


Made: Any = Order  # type checkers know the fields


def made_with(call):
    with pytest.raises(TypeError) as caught:
        call()
    return caught.value


@pytest.mark.parametrize(
    ("call", "hint"),
    [
        (lambda: Made.Result(ordr=3), "did you mean 'order'?"),
        (
            lambda: Made.Result(
                order=1,
                nome="ü",
            ),
            "did you mean 'name'?",
        ),
        (lambda: Made.Result(x=3), "Order.Result has 'order', 'name'"),
        (lambda: Made.Feedback(x=3), "Order.Feedback has no fields"),
        (lambda: (lambda result: result(ordr=3))(Made.Result), "did you mean 'order'?"),
        (lambda: [Made.Result][0](ordr=3), ""),  # an expression that would have to be run
        (lambda: Made.Result(1, 2, 3), ""),
        (lambda: Made(ordr=3), ""),
        (lambda: eval("Made.Result(ordr=3)"), ""),  # there is no source
    ],
)
def test_an_unknown_field_of_a_message_is_answered_with_the_nearest(call, hint):
    error = made_with(call)
    assert field_hint(error) == hint
    assert summary(error) == f"TypeError: {error}{f': {hint}' if hint else ''}"


def test_a_file_that_has_changed_since_gives_no_hint(tmp_path):
    file = tmp_path / "lab.py"
    code = compile("Made.Result(ordr=3)", str(file), "exec")
    file.write_text("def (")
    assert field_hint(made_with(lambda: exec(code, {"Made": Made}))) == ""
    assert field_hint(TypeError("Unexpected keyword argument 'x'")) == ""
