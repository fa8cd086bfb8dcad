"""The site of the documentation: its navigation, its links, and the pages made from the source.

The site itself is built by ``scripts/check``, which takes ten seconds.
"""

from __future__ import annotations

import configparser
import importlib
import re
import runpy
import shlex
from pathlib import Path

import pytest
import yaml

import turtleact
from turtleact.commands import GROUPS, VERBS

ROOT = Path(__file__).parents[1]
CONFIG = yaml.safe_load((ROOT / "mkdocs.yml").read_text("utf-8"))
PAGES = {path.name for path in (ROOT / "docs").glob("*.md")}
DIAGRAMS = runpy.run_path(str(ROOT / "scripts" / "draw_diagrams.py"))
WORKFLOW = yaml.safe_load((ROOT / ".github" / "workflows" / "pages.yml").read_text("utf-8"))


@pytest.fixture(scope="module")
def build():
    """The script that builds the site."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT)
        yield importlib.import_module("scripts.build_site")


@pytest.fixture(scope="module")
def made(build):
    return build.made()


def headings(text: str) -> set[str]:
    return {line.removeprefix("## ") for line in text.splitlines() if line.startswith("## ")}


# --- navigation ---------------------------------------------------------------------------------


def test_the_navigation_has_every_page(build):
    missing = PAGES - set(build.leaves(CONFIG["nav"]))
    assert not missing, f"add {sorted(missing)} to nav in mkdocs.yml"


def test_the_navigation_has_only_pages_that_exist(build, made):
    pages = {*made, *build.written()}
    assert set(build.leaves(build.expanded(CONFIG["nav"], [*pages]))) == pages


# --- links --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("source", "link", "target"),
    [
        ("README.md", "docs/cli.md#goals", "cli.md#goals"),
        ("docs/cli.md", "../README.md", "index.md"),
        ("docs/cli.md", "wire.md", "wire.md"),
        ("docs/cli.md", "../examples/04_cancel.py", "examples/04_cancel.md"),
        ("docs/tutorial.md", "../examples", "examples/index.md"),
        ("README.md", "LICENSE", "LICENSE.txt"),
        ("docs/cli.md", "#help", "#help"),
        ("docs/cli.md", "https://zenoh.io", "https://zenoh.io"),
    ],
)
def test_a_link_of_the_repository_leads_to_a_page_of_the_site(build, source, link, target):
    assert build.relinked(source, f"see [it]({link})") == f"see [it]({target})"


@pytest.mark.parametrize("link", ["missing.md", "../pyproject.toml", "../examples/99_none.py"])
def test_a_link_to_what_the_site_does_not_have_is_an_error(build, link):
    with pytest.raises(build.DeadLink, match=f"docs/cli.md: .* {link}"):
        build.relinked("docs/cli.md", f"[it]({link})")


# --- pages from the source ----------------------------------------------------------------------


def test_the_reference_has_every_public_name(made):
    text = "\n".join(text for path, text in made.items() if path.startswith("reference/api/"))
    documented = [line for line in text.splitlines() if line.startswith("::: turtleact.")]
    for name in turtleact.__all__:
        assert documented.count(f"::: turtleact.{name}") == 1


def test_the_reference_has_every_verb(made):
    for verb in VERBS:
        page = made[f"reference/cli/{verb}.md"]
        assert page.startswith(f"# turtleact {verb}\n")
        assert headings(page) == {f"turtleact {verb} {name}" for name in GROUPS.get(verb, ())}


def test_a_verb_is_shown_with_its_arguments_options_and_examples(made):
    page = made["reference/cli/serve.md"]
    assert "turtleact serve [OPTIONS] [TARGET]" in page
    assert (
        "| `--speed` FACTOR | How fast time passes: 2 is twice as fast as real time; up to 100. "
        "Default: `1.0`. |" in page
    )
    assert "0 to 232. Default: `ROS_DOMAIN_ID` or `0`. |" in page
    assert "\nturtleact serve --web\n" in page


def test_the_reference_has_every_interface_with_its_type_hash(made):
    pages = [text for path, text in made.items() if path.startswith("reference/interfaces/")]
    names = {name for text in pages for name in headings(text)}
    standard = ROOT / "turtleact" / "interfaces" / "standard"
    files = [path for each in ("msg", "srv", "action") for path in standard.rglob(f"*.{each}")]
    assert names == {"/".join([*path.parts[-3:-1], path.stem]) for path in files}
    page = made["reference/interfaces/turtlesim.md"]
    assert "RIHS01_739beba26bcba6920404ba722b7b8321348512f92ea5be235c47251940dd8aa9" in page


def test_the_site_has_every_example(made):
    examples = {f"examples/{path.stem}.md" for path in (ROOT / "examples").glob("[0-9]*.py")}
    assert examples < made.keys()


# --- drawings -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", DIAGRAMS["DRAWINGS"])
def test_a_drawing_is_what_its_script_draws(name):
    stored = (ROOT / "docs" / f"{name}.svg").read_text("utf-8")
    assert stored == DIAGRAMS["DRAWINGS"][name]() + "\n", (
        f"run: python scripts/draw_diagrams.py {name} > docs/{name}.svg"
    )


def test_the_drawing_of_the_layers_has_the_rows_of_the_import_contract_in_their_order():
    contract = configparser.ConfigParser()
    contract.read(ROOT / ".importlinter", "utf-8")
    rows = re.findall(r"\w+", contract["importlinter:contract:layers"]["layers"])
    drawn = re.findall(r'<text class="code"[^>]*>(\w+)<', DIAGRAMS["layers"]())
    assert drawn == [row for row in rows if row != "__main__"]


def test_a_drawing_is_part_of_the_page_so_that_its_colours_follow_the_page(build):
    page = build.relinked("docs/architecture.md", "![All layers](layers.svg)")
    assert page.startswith('<div class="drawing" role="img" aria-label="All layers">\n<svg')
    assert "\n\n" not in page


# --- the tools ----------------------------------------------------------------------------------


def test_the_build_and_the_site_need_no_network():
    assert CONFIG["theme"]["font"] is False
    assert "offline" in CONFIG["plugins"]
    (options,) = [each["mkdocstrings"] for each in CONFIG["plugins"] if "mkdocstrings" in each]
    assert options["handlers"]["python"]["inventories"] == []


def test_the_search_of_a_page_that_is_opened_as_a_file_needs_no_network(build, tmp_path):
    page = tmp_path / "reference" / "api" / "index.html"
    page.parent.mkdir(parents=True)
    page.write_text(f'<script src="{build.REMOTE_WORKER}"></script>')
    build.finish(tmp_path)
    assert page.read_text() == '<script src="../../theme/search.js"></script>'
    assert (ROOT / "docs" / "theme" / "search.js").exists()


def test_a_page_that_loads_another_script_from_the_internet_is_an_error(build, tmp_path):
    (tmp_path / "a.html").write_text('<script defer src="https://cdn.example/x.js"></script>')
    with pytest.raises(build.RemoteScript, match=r"a\.html loads https://cdn\.example/x\.js"):
        build.finish(tmp_path)


def test_the_workflow_builds_the_site_as_a_developer_does():
    steps = [step for job in WORKFLOW["jobs"].values() for step in job["steps"]]
    commands = [shlex.split(step["run"]) for step in steps if "run" in step]
    assert commands == [
        ["python", "-m", "pip", "install", ".[docs]"],
        ["python", "-m", "scripts.build_site"],
    ]
    assert "step site python -m scripts.build_site\n" in (ROOT / "scripts" / "check").read_text()


def test_the_workflow_publishes_only_main():
    publish = WORKFLOW["jobs"]["publish"]
    assert publish["if"] == "github.ref == 'refs/heads/main'"
    assert publish["needs"] == "build"
    assert "permissions" not in WORKFLOW["jobs"]["build"]
