"""Holds docs/turtlesim.md to its word: its proofs are tests, and every row has one.

What a proof is, and what is wrong with one that is none, stands in ``test_conformance.py``.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from .tables import together
from .test_conformance import PROOF, fault_of, tables_of

PAGE = (Path(__file__).parents[1] / "docs" / "turtlesim.md").read_text("utf-8")
COLUMNS = ["what", "turtlesim", "turtleact", "proved by"]
TABLES = tables_of(PAGE)
ROWS = [row for _, *rows in TABLES for row in rows]
PROOFS = sorted({proof for row in ROWS for proof in PROOF.findall(row[-1])})


def test_all_tables_of_the_page_compare():
    assert [head for head, *_ in TABLES] == [COLUMNS] * 8
    assert len(ROWS) > 40


@together
@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_a_row_is_full_and_names_nothing_but_proofs(row):
    assert len(row) == len(COLUMNS)
    assert all(row)
    assert all(PROOF.fullmatch(proof) for proof in row[-1].split("<br>"))


@together
@pytest.mark.parametrize("proof", PROOFS)
def test_a_proof_is_a_test(proof):
    assert fault_of(proof, every_loop=False) == ""
