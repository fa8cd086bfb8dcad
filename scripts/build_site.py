"""Builds the site of the documentation in ``build/site``: ``python -m scripts.build_site``.

The links of the pages in docs/ lead to files of the repository, so that its readers can follow
them. This script copies the pages to ``build/pages``, changes the links to those of the site, adds
the pages that are made from the source, and runs Zensical. It needs the extra ``docs`` and no
network. A link that leads nowhere fails the build.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import TypeAlias

import yaml

from scripts import site_reference

ROOT = Path(__file__).parents[1]
STAGE = ROOT / "build" / "pages"
SITE = ROOT / "build" / "site"

Nav: TypeAlias = "str | list[Nav] | dict[str, Nav]"

MOVED = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "LICENSE": "LICENSE.txt",
    "examples": "examples/index.md",
}
"""Where the site has files that are not in docs/."""

REMOTE_WORKER = "https://unpkg.com/iframe-worker/shim"
"""The script that Zensical's pages load if opened as files. docs/theme/search.js replaces it."""

REMOTE_SCRIPT = re.compile(r"<script[^>]* src=[\"']?(\w+://[^\"'\s>]+)")

CODE = re.compile(r"<code>.*?</code>", re.DOTALL)
DOTS = re.compile("[\u2800-\u28ff\u2190-\u2199\u25cf\u2713]")
"""Braille, arrows and marks: many fonts draw them too wide, so the style gives them a width."""

FENCED = re.compile(r"(^```.*?^```$)", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"(?<=\]\()(?!\w+:|#)([^)#\s]+)")
PIPE = re.compile(r"(?<=`)\\\|(?=[^|`]*`)")
"""A bar inside code in a table.

In the repository it needs a backslash, which the site would show.
"""

PROOFS = re.compile(r"(?<=\| )(?:`[\w/]+\.py::\w+`(?:<br>)?)+(?= \|)")
"""A cell of a table that names tests. The site folds it, because it is longer than the others."""

DRAWING = re.compile(r"^!\[(?P<text>[^\]]*)\]\((?P<path>\w+\.svg)\)$", re.MULTILINE)
HEADING = re.compile(r"^# (.+)$", re.MULTILINE)


class DeadLink(Exception):
    """A page has a link to a file that the site does not have."""

    def __init__(self, page: str, target: str) -> None:
        super().__init__(f"{page}: the site has no page for the link to {target}")


class RemoteScript(Exception):
    """A page of the site loads a script from the internet, so it needs a network."""

    def __init__(self, page: str, address: str) -> None:
        super().__init__(f"{page} loads {address}: put the script into docs/theme instead")


def main() -> int:
    """Write the pages, then build the site from them."""
    shutil.rmtree(STAGE, ignore_errors=True)
    stage(STAGE)
    build = [sys.executable, "-m", "zensical", "build", "--strict"]
    ran = subprocess.run(build, cwd=STAGE, check=False)  # noqa: S603  # our own command
    if ran.returncode == 0:
        finish(STAGE / "site")
        shutil.rmtree(SITE, ignore_errors=True)
        shutil.copytree(STAGE / "site", SITE)
        print(f"{len(list(SITE.rglob('*.html')))} pages in {SITE.relative_to(ROOT)}/")
    return ran.returncode


def finish(folder: Path) -> None:
    """Mend the pages that Zensical has built.

    At file://, the pages load the search from the site, not from a server on the internet. Each dot
    of a drawing in a terminal is marked, so that the style can give it a width.

    Raises:
        RemoteScript: if a page would still load a script from the internet.
    """
    for path in folder.rglob("*.html"):
        script = os.path.relpath(folder / "theme" / "search.js", path.parent)
        text = path.read_text("utf-8").replace(REMOTE_WORKER, script)
        text = CODE.sub(lambda code: DOTS.sub(r"<i>\g<0></i>", code[0]), text)
        if remote := REMOTE_SCRIPT.search(text):
            raise RemoteScript(path.name, remote[1])
        path.write_text(text, "utf-8")


def stage(folder: Path) -> None:
    """Write all pages and the configuration to a folder."""
    pages = written() | made()
    for path, text in pages.items():
        target = folder / "docs" / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text, "utf-8")
    for asset in (ROOT / "docs").rglob("*.*"):
        if asset.suffix != ".md":
            copy = folder / "docs" / asset.relative_to(ROOT / "docs")
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(asset, copy)
    shutil.copy(ROOT / "LICENSE", folder / "docs" / "LICENSE.txt")
    config = yaml.safe_load((ROOT / "mkdocs.yml").read_text("utf-8"))
    config["nav"] = expanded(config["nav"], list(pages))
    (folder / "mkdocs.yml").write_text(yaml.safe_dump(config, sort_keys=False), "utf-8")


def written() -> site_reference.Pages:
    """The pages that the repository has, with links that work in the site."""
    sources = [*(ROOT / "docs").glob("*.md")]
    sources += [ROOT / name for name in MOVED if name.endswith(".md")]
    return {
        address(path.relative_to(ROOT).as_posix()): relinked(
            path.relative_to(ROOT).as_posix(), path.read_text("utf-8")
        )
        for path in sources
    }


def made() -> site_reference.Pages:
    """The pages that are made from the source, and those that list the pages of a section."""
    return (
        site_reference.examples()
        | site_reference.api()
        | site_reference.commands()
        | site_reference.interface_packages()
    )


def address(path: str) -> str:
    """Where the site has a file of the repository; an empty string if it has no such file."""
    if path in MOVED:
        return MOVED[path]
    if path.startswith("docs/"):
        return path.removeprefix("docs/")
    if re.fullmatch(r"examples/\d\d_\w+\.py", path):
        return f"{path.removesuffix('.py')}.md"
    return ""


def relinked(source: str, text: str) -> str:
    """Return a page with links to pages of the site, and with its drawings as part of the page."""
    page = address(source)

    def lead(link: re.Match[str]) -> str:
        target = os.path.normpath(PurePosixPath(source).parent / link[1])
        found = address(target)
        if not found or not (ROOT / target).exists():
            raise DeadLink(source, link[1])
        return os.path.relpath(found, PurePosixPath(page).parent)

    parts = FENCED.split(PIPE.sub("|", text))
    for index, part in enumerate(parts[::2]):
        parts[2 * index] = PROOFS.sub(_folded, LINK.sub(lead, DRAWING.sub(_inline, part)))
    return "".join(parts)


def _folded(cell: re.Match[str]) -> str:
    """A cell with the number of its tests, which shows their names on a click."""
    count = cell[0].count("::")
    title = f"{count} test{'s' if count > 1 else ''}"
    return f"<details><summary>{title}</summary>{cell[0]}</details>"


def _inline(drawing: re.Match[str]) -> str:
    """A drawing as part of the page, so that its colours follow the page's."""
    text = (ROOT / "docs" / drawing["path"]).read_text("utf-8")
    if 'class="drawing"' not in text:
        return drawing[0]
    text = re.sub(r"\n\s*", "\n", text[text.index("<svg") :].strip())
    return f'<div class="drawing" role="img" aria-label="{drawing["text"]}">\n{text}\n</div>'


def expanded(nav: Nav, pages: list[str]) -> Nav:
    """The navigation, with the name of each folder replaced by the folder's pages."""
    if isinstance(nav, list):
        return [expanded(each, pages) for each in nav]
    if isinstance(nav, dict):
        return {title: expanded(each, pages) for title, each in nav.items()}
    if not nav.endswith("/"):
        return nav
    inside = [page for page in pages if page.startswith(nav) and page != f"{nav}index.md"]
    return [f"{nav}index.md", *inside]


def leaves(nav: Nav) -> Iterator[str]:
    """The pages that the navigation names."""
    if isinstance(nav, str):
        yield nav
    else:
        for each in nav.values() if isinstance(nav, dict) else nav:
            yield from leaves(each)


if __name__ == "__main__":
    sys.exit(main())
