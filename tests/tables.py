"""Tests of many cases that are one test, because pytest takes 3 ms for each.

`together` is for pure functions, where a hundred cases take less time than pytest takes for one. A
failure names its cases, as pytest does.
"""

from __future__ import annotations

import functools
import inspect
import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import pytest

SHOWN = 5
"""So many cases that fail are shown, the others counted."""


def together(test: Callable[..., None]) -> Callable[..., None]:
    """Run all cases of a parametrized test in one test; it stands above ``parametrize``.

    All cases run, also after one that fails. They share the fixtures of the test. A table above
    this one makes several tests, as always.
    """
    marks = [*test.pytestmark]  # type: ignore[attr-defined]  # what pytest.mark leaves
    tables = [list(cases_of(mark)) for mark in marks if mark.name == "parametrize"]

    @functools.wraps(test)
    def run(**fixtures: object) -> None:
        failures: list[Exception] = []
        cases = [*itertools.product(*tables)]
        assert cases, "there are no cases"
        for case in cases:
            values = {name: value for part, _ in case for name, value in part.items()}
            try:
                test(**fixtures, **values)
            except Exception as error:
                error.add_note(f"in the case [{'-'.join(name for _, name in case)}]")
                failures.append(error)
        if len(failures) == 1:
            raise failures[0]
        if failures:
            raise ExceptionGroup(f"{len(failures)} of {len(cases)} cases failed", failures[:SHOWN])

    given = {name for table in tables for values, _ in table[:1] for name in values}
    signature = inspect.signature(test)
    left = [each for each in signature.parameters.values() if each.name not in given]
    run.__signature__ = signature.replace(parameters=left)  # type: ignore[attr-defined]
    run.pytestmark = [  # type: ignore[attr-defined]
        mark for mark in marks if mark.name != "parametrize"
    ]
    return run


def cases_of(mark: pytest.Mark) -> Iterator[tuple[dict[str, Any], str]]:
    """What a table gives to a test, case by case, and the name of the case."""
    names, table = mark.args
    if isinstance(names, str):
        names = [name.strip() for name in names.split(",")]
    ids = mark.kwargs.get("ids")
    for number, row in enumerate(table):
        values, name = row, None
        if hasattr(row, "marks"):  # a pytest.param
            assert not row.marks, "a case has no marks of its own here"
            values, name = row.values, row.id
        elif len(names) == 1:
            values = (row,)
        if name is None and isinstance(ids, Sequence):
            name = ids[number]
        if name is None:
            name = "-".join(str((ids and ids(each)) or shortened(each)) for each in values)
        yield dict(zip(names, values, strict=True)), name


def shortened(value: object) -> str:
    """A value as a case of it is named."""
    text = getattr(value, "__name__", None) or repr(value)
    return text if len(text) <= 80 else f"{text[:79]}…"
