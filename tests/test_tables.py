"""A test of many cases runs each, and names those that fail."""

from __future__ import annotations

import inspect

import pytest

from .tables import together


def outcome(test, **fixtures):
    with pytest.raises((AssertionError, ExceptionGroup)) as caught:
        together(test)(**fixtures)
    return caught.value


def test_each_case_of_all_tables_is_run():
    seen: list[tuple[int, int, int]] = []

    @together
    @pytest.mark.parametrize("c", [5, pytest.param(6, id="six")])
    @pytest.mark.parametrize(("a", "b"), [(1, 2), (3, 4)])
    def test(a, b, c, seen):
        seen.append((a, b, c))

    assert list(inspect.signature(test).parameters) == ["seen"]
    test(seen=seen)
    assert sorted(seen) == [(1, 2, 5), (1, 2, 6), (3, 4, 5), (3, 4, 6)]


@pytest.mark.parametrize(
    ("table", "options", "name"),
    [
        ([1, 2], {}, "2"),
        ([1, 2], {"ids": ["one", "two"]}, "two"),
        ([1, 2], {"ids": lambda value: f"n{value}"}, "n2"),
        ([1, pytest.param(2, id="the second")], {}, "the second"),
        (["x", int], {}, "int"),
    ],
)
def test_a_case_that_fails_is_named(table, options, name):
    @pytest.mark.parametrize("value", table, **options)
    def test(value):
        assert value == table[0]

    failure = outcome(test)
    assert isinstance(failure, AssertionError)
    assert failure.__notes__[-1] == f"in the case [{name}]"


def test_all_cases_are_run_and_the_first_that_fail_are_shown():
    @pytest.mark.parametrize("a", range(3))
    @pytest.mark.parametrize("b", range(4))
    def test(a, b):
        assert b == 0

    failure = outcome(test)
    assert isinstance(failure, ExceptionGroup)
    assert failure.message == "9 of 12 cases failed"
    assert [each.__notes__[-1] for each in failure.exceptions[:2]] == [
        "in the case [1-0]",
        "in the case [1-1]",
    ]


def test_a_test_without_cases_fails():
    @pytest.mark.parametrize("a", [])
    def test(a):
        pass

    assert "there are no cases" in str(outcome(test))


def test_other_marks_stay():
    @together
    @pytest.mark.timeout(5)
    @pytest.mark.parametrize("a", [1])
    def test(a):
        pass

    assert [mark.name for mark in vars(test)["pytestmark"]] == ["timeout"]


@together
@pytest.mark.parametrize("text", ["a", "b"])
def test_pytest_gives_it_its_fixtures(tmp_path, text):
    (tmp_path / text).write_text(text)
    assert (tmp_path / "a").exists()
