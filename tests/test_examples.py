"""Each example runs as it stands and prints what the ``Prints:`` block of its docstring shows.

Its first line says what to install. It can import only that here, whatever else is installed.
"""

from __future__ import annotations

import ast
import doctest
import inspect
import re
import subprocess
from pathlib import Path

import pytest

from . import installed, warm

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


def named(path: Path) -> list[str]:
    """What the first line of an example says to install."""
    first = path.read_text("utf-8").partition("\n")[0]
    found = re.fullmatch(r"# In a checkout: pip install \.( [\w -]+)?", first)
    assert found is not None, first
    return ["turtleact", *(found[1] or "").split()]


@pytest.fixture(scope="module", params=EXAMPLES, ids=lambda path: path.name)
def example(request):
    """An example and how its run ended: warnings are errors, and nobody types anything."""
    outcome = warm.run(
        installed.only(named(request.param), "-W", "error", script=request.param),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
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
