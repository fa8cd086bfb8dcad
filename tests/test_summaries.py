"""What users' code raised or gave, in a line of text."""

from __future__ import annotations

import pytest

from turtleact.summaries import LONGEST, encodable, loggable, summary, text_of


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
