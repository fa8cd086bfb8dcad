"""Holds docs/complaints.md to its word: every row names an issue and a test.

``test_conformance.py`` says what is wrong with a test that proves nothing.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from .tables import together
from .test_conformance import PROOF, fault_of, tables_of

PAGE = (Path(__file__).parents[1] / "docs" / "complaints.md").read_text("utf-8")
COLUMNS = ["complaint", "in turtleact", "proved by"]
TABLES = tables_of(PAGE)
ROWS = [row for _, *rows in TABLES for row in rows]
PROOFS = sorted({proof for row in ROWS for proof in PROOF.findall(row[-1])})
THREAD = re.compile(r"\[([\w.-]+)(#\d+)?\]\(https://github\.com/[\w-]+/([\w.-]+)(/\w+/(\d+))?\)")


def test_all_tables_of_the_page_have_the_same_columns():
    assert [head for head, *_ in TABLES] == [COLUMNS] * 4
    assert len(ROWS) > 25


@together
@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0].partition(" (")[0])
def test_a_row_names_issues_and_tests(row):
    complaint, answer, proofs = row
    assert THREAD.search(complaint)
    assert answer
    assert all(PROOF.fullmatch(proof) for proof in proofs.split("<br>"))


def test_a_link_leads_to_the_issue_that_it_names():
    for text, number, repository, _, linked in THREAD.findall(PAGE):
        assert (text, number) == (repository, f"#{linked}" if linked else "")
    assert len(THREAD.findall(PAGE)) == PAGE.count("](https://")


@together
@pytest.mark.parametrize("proof", PROOFS)
def test_a_proof_is_a_test(proof):
    assert fault_of(proof, every_loop=False) == ""
