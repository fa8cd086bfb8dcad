"""Holds the pages that compare to their word: each row names tests, and they exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from turtleact.goals.state import TRANSITIONS, GoalEvent, GoalStatus

from .conftest import ONE_LOOP

TESTS = Path(__file__).parent
DOCS = TESTS.parent / "docs"
PROOF = re.compile(r"`((?:\w+/)*test_\w+\.py)::(test_\w+)`")

Table = list[list[str]]


def tables_of(page: str) -> list[Table]:
    """The tables of a page, each with its head first, as rows of cells."""
    text = (DOCS / page).read_text("utf-8")
    return [
        [cells_of(line) for number, line in enumerate(table.splitlines()) if number != 1]
        for table in re.findall(r"(?:^\|.*\n?)+", text, re.MULTILINE)
    ]


def cells_of(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def rows_of(page: str) -> Table:
    """The rows of the tables that name proofs."""
    return [row for head, *rows in tables_of(page) if head[-1] == "proved by" for row in rows]


@pytest.mark.parametrize(("page", "least"), [("conformance.md", 80), ("turtlesim.md", 40)])
def test_each_row_names_tests(page, least):
    rows = rows_of(page)
    assert len(rows) >= least
    for row in rows:
        assert all(row), row
        for proof in row[-1].split("<br>"):
            found = PROOF.fullmatch(proof)
            assert found is not None, row
            source = (TESTS / found[1]).read_text("utf-8")
            assert re.search(rf"^(async )?def {found[2]}\(", source, re.MULTILINE), proof


def test_the_proofs_of_conformance_run_on_every_event_loop():
    for row in rows_of("conformance.md"):
        (path, _) = PROOF.findall(row[-1])[0]
        assert path.split("/")[0] not in ONE_LOOP, row


def test_the_states_and_events_of_the_page_are_those_of_the_code():
    head, *rows = tables_of("conformance.md")[0]
    shown = {
        (GoalStatus[status], GoalEvent[event]): GoalStatus[after]
        for states, *cells in rows
        for status in states.split(", ")
        for event, after in zip(head[1:], cells, strict=True)
        if after != "–"
    }
    assert shown == TRANSITIONS
    assert head[1:] == [event.name for event in GoalEvent]
