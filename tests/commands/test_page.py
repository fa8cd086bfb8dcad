"""The examples of docs/ that need a graph, run on one of ``graphs.py``.

Above such a block stands ``<!-- not run: on the graph NAME -->``, with ``, exit status N`` behind
the name if its commands end otherwise than with 0. In the output ``...`` stands for anything.
"""

from __future__ import annotations

import doctest
import re
import shlex
from pathlib import Path

import pytest

from turtleact.commands import GROUPS, VERBS

from ..tables import together

DOCS = Path(__file__).parents[2] / "docs"
PAGE = DOCS / "cli.md"
BLOCK = re.compile(
    r"^<!-- not run: on the graph (?P<graph>\w+)(?:, exit status (?P<status>\d+))? -->\n"
    r"```console\n(?P<text>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
EXAMPLES = [
    pytest.param(
        block["graph"], int(block["status"] or 0), *part.split("\n", 1), id=part.split("\n")[0]
    )
    for page in (PAGE, DOCS / "nodes.md")
    for block in BLOCK.finditer(page.read_text("utf-8"))
    for part in re.split(r"^\$ turtleact ", block["text"], flags=re.MULTILINE)[1:]
]
SECONDS = 4.5
"""When Ctrl-C comes, if it ends an example (s)."""


@pytest.mark.parametrize(("name", "status", "line", "output"), EXAMPLES)
def test_an_example_of_the_page_prints_what_it_shows(on_graph, graphs, name, status, line, output):
    nodes = getattr(graphs, name)
    if status == 130:
        start = 95 if name == "goals" else 0
        nodes = graphs.in_turn(nodes, graphs.interrupted(start + SECONDS))
    ran = on_graph(nodes, *shlex.split(line))
    assert ran.status == status
    shown, printed = (f"{text.rstrip()}\n" for text in (output, ran.out + ran.err))
    assert doctest.OutputChecker().check_output(shown, printed, doctest.ELLIPSIS), printed


def verbs():
    """All verbs, as they are typed."""
    for name in VERBS:
        inner = GROUPS.get(name, ("",))
        yield from (f"turtleact {name} {verb}".strip() for verb in inner)


@together
@pytest.mark.parametrize("verb", list(verbs()))
def test_the_page_shows_every_verb(verb):
    assert re.search(rf"{verb}\b", PAGE.read_text("utf-8"))
