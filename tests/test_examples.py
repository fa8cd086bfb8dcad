"""Each example runs as it stands and prints what the ``Prints:`` block of its docstring shows."""

from __future__ import annotations

import ast
import doctest
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = sorted(Path(__file__).parents[1].joinpath("examples").glob("[0-9][0-9]_*.py"))
SECONDS = 50


def printed(docstring: str) -> str | None:
    """The indented lines below ``Prints:``; None where there is no such block.

    >>> printed("Counts.\\n\\nPrints:\\n\\n    1\\n      2\\n\\nMore.")
    '1\\n  2\\n'
    """
    _, found, rest = docstring.partition("Prints:\n")
    if not found:
        return None
    lines = rest.strip("\n").splitlines()
    end = next((i for i, line in enumerate(lines) if line and not line.startswith(" ")), None)
    return inspect.cleandoc("\n" + "\n".join(lines[:end])).rstrip() + "\n"


@pytest.fixture(scope="module", params=EXAMPLES, ids=lambda path: path.name)
def example(request):
    """An example and how its run ended: warnings are errors, and nobody types anything."""
    outcome = subprocess.run(
        [sys.executable, "-W", "error", request.param],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
        timeout=SECONDS,
    )
    return request.param, outcome


def test_an_example_ends_well(example):
    _, outcome = example
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr


def test_an_example_leaves_stderr_empty(example):
    _, outcome = example
    assert outcome.stderr == ""


def test_an_example_prints_what_its_docstring_shows(example):
    path, outcome = example
    shown = printed(ast.get_docstring(ast.parse(path.read_text("utf-8"))) or "")
    if shown is None:
        pytest.skip("prints nothing that stays the same")
    checker = doctest.OutputChecker()
    assert checker.check_output(shown, outcome.stdout, doctest.ELLIPSIS), outcome.stdout


def test_the_block_below_prints_is_read_without_its_indentation():
    assert printed("Counts.\n\nPrints:\n\n    1\n      2\n\n    3\n\nMore.") == "1\n  2\n\n3\n"


def test_a_docstring_may_show_no_output():
    assert printed("Counts.") is None
