"""Writes the pages of the site that are made from the source: examples, API, commands, interfaces.

Each function returns pages: Markdown by path, relative to the folder of all pages.
"""

from __future__ import annotations

import ast
import inspect
import re
from itertools import groupby
from pathlib import Path
from typing import Any, TypeAlias

from turtleact import interfaces
from turtleact.commands import GROUPS, VERBS
from turtleact.commands.app import load

__all__ = ["Pages", "api", "commands", "examples", "interface_packages"]

Pages: TypeAlias = dict[str, str]
"""The text of each page, by its path."""

ROOT = Path(__file__).parents[1]
STANDARD = ROOT / "turtleact" / "interfaces" / "standard"
MODULES = {
    "turtleact.interfaces": "Field types, conversion, CDR and type hashes.",
    "turtleact.telemetry": "Traces, metrics, and goals in log records.",
    "turtleact.testing": "Virtual time, and a network with faults.",
    "turtleact.web": "rosbridge, and the page.",
}
"""The modules with public names that are not in `turtleact` itself."""


def examples() -> Pages:
    """A page for each example, and their list."""
    pages: Pages = {}
    rows = []
    for path in sorted((ROOT / "examples").glob("[0-9]*.py")):
        source = path.read_text("utf-8")
        summary = (ast.get_docstring(ast.parse(source)) or "").partition("\n\n")[0]
        title = path.stem[3:].replace("_", " ").capitalize()
        rows.append(f"| [{title}]({path.stem}.md) | {_one_line(summary)} |")
        parts = [f"# {title}", _code(summary), f"`examples/{path.name}`:", _fence(source, "python")]
        pages[f"examples/{path.stem}.md"] = "\n\n".join(parts)
    intro = "Each example is a program that you can run. One idea each."
    pages["examples/index.md"] = _table("Examples", intro, "example | idea", rows)
    return pages


def api() -> Pages:
    """A page for each group of public names, and one for each module in `MODULES`."""
    page = (ROOT / "docs" / "architecture.md").read_text("utf-8")
    section = page.partition("## Public names\n")[2].partition("\n## ")[0]
    table = [row.split("|")[1:3] for row in section.splitlines() if row.startswith("| ")][1:]
    groups = {title.strip().capitalize(): re.findall(r"`(\w+)`", names) for title, names in table}
    pages: Pages = {}
    rows = []
    for title, names in groups.items():
        path = f"{re.sub('[^a-z]+', '-', title.lower())}.md"
        body = "\n\n".join(f"::: turtleact.{name}" for name in names)
        pages[f"reference/api/{path}"] = f"# {title}\n\n{body}\n"
        rows.append(f"| [{title}]({path}) | {', '.join(f'`{name}`' for name in names)} |")
    for module, summary in MODULES.items():
        path = f"{module.partition('.')[2]}-module.md"
        options = "    options:\n      show_root_heading: false\n      show_root_toc_entry: false\n"
        pages[f"reference/api/{path}"] = f"# {module}\n\n::: {module}\n{options}"
        rows.append(f"| [`{module}`]({path}) | {summary} |")
    intro = "These names are public. All others may move."
    pages["reference/api/index.md"] = _table("Python", intro, "page | names", rows)
    return pages


def commands() -> Pages:
    """A page for each verb or group of verbs."""
    pages: Pages = {}
    rows = []
    for verb, summary in VERBS.items():
        command = load(verb)
        if verb in GROUPS:
            parts = [f"# turtleact {verb}", f"{_code(summary)}\n"]
            parts += [_command(f"{verb} {name}", each) for name, each in command.commands.items()]
            text = "\n\n".join(parts)
        else:
            text = _command(verb, command, "#")
        pages[f"reference/cli/{verb}.md"] = text
        rows.append(f"| [`{verb}`]({verb}.md) | {_code(summary)} |")
    intro = (
        "These pages list every option, as `--help` does. "
        "[The command line](../../cli.md) shows what you can do with them."
    )
    pages["reference/cli/index.md"] = _table("Every option", intro, "verb | does", rows)
    return pages


def interface_packages() -> Pages:
    """A page for each package of interfaces that ships, with the files and their type hashes."""
    files: Pages = {}
    rows = []
    names = sorted(STANDARD.glob("*/*/*.*[!y]"), key=lambda path: path.parts[-3:])
    names = [path for path in names if path.suffix in {".msg", ".srv", ".action"}]
    for package, paths in groupby(names, key=lambda path: path.parts[-3]):
        parts = [f"# {package}\n"]
        for path in paths:
            name = f"{package}/{path.parts[-2]}/{path.stem}"
            kind = interfaces.get_interface(name)
            text = _fence(path.read_text("utf-8"), "text")
            parts.append(f"## {name}\n\nType hash: `{interfaces.type_hash(kind)}`\n\n{text}")
        files[f"reference/interfaces/{package}.md"] = "\n".join(parts)
        rows.append(f"| [`{package}`]({package}.md) | {len(parts) - 1} |")
    intro = "These interfaces ship with turtleact. [Add your own](../../interfaces.md)."
    table = _table("Interfaces", intro, "package | interfaces", rows)
    return files | {"reference/interfaces/index.md": table}


def _command(name: str, command: Any, level: str = "##") -> str:  # noqa: ANN401  # of click, which Typer hides
    """The section of one verb: usage, arguments, options by heading, examples."""
    arguments = [each for each in command.params if not each.opts[0].startswith("-")]
    options = [each for each in command.params if each.opts[0].startswith("-")]
    usage = " ".join([each.metavar if each.required else f"[{each.metavar}]" for each in arguments])
    lines = [f"{level} turtleact {name}\n", f"{_code(command.help)}\n"]
    lines.append(_fence(f"turtleact {name} [OPTIONS] {usage}".rstrip(), "text"))
    if arguments:
        rows = [f"| `{each.metavar}` | {_code(each.help)} |" for each in arguments]
        lines.append("\n".join(["| argument | meaning |", "|---|---|", *rows, ""]))
    # A stable sort: the options of a heading keep their order.
    for (_, panel), grouped in groupby(sorted(options, key=_panel), key=_panel):
        rows = [_option(each) for each in grouped if not each.hidden]
        lines.append("\n".join([f"| {panel or 'option'} | meaning |", "|---|---|", *rows, ""]))
    if command.epilog:
        text = inspect.cleandoc(re.sub(r"\[/?\w*\]", "", command.epilog)).partition("\n")[2]
        lines.append(f"Examples:\n\n{_fence(inspect.cleandoc(text), 'sh')}")
    return "\n".join(lines)


def _panel(option: Any) -> tuple[bool, str]:  # noqa: ANN401  # as above
    """The sort key of an option by its heading. Options without a heading come first."""
    return bool(option.rich_help_panel), option.rich_help_panel or ""


def _option(option: Any) -> str:  # noqa: ANN401  # as above
    names = ", ".join(f"`{name}`" for name in [*option.opts, *option.secondary_opts])
    value = "" if option.is_flag else f" {option.metavar or 'VALUE'}"
    has_default = option.default is not None and option.default is not False
    notes = [f"`{option.envvar}`"] if option.envvar else []
    notes += [f"`{option.default}`"] if has_default else []
    default = f" Default: {' or '.join(notes)}." if notes else ""
    return f"| {names}{value} | {_code(option.help or '')}{default} |"


def _table(title: str, intro: str, heads: str, rows: list[str]) -> str:
    return "\n".join([f"# {title}\n", f"{intro}\n", f"| {heads} |", "|---|---|", *rows, ""])


def _fence(text: str, language: str) -> str:
    return f"```{language}\n{text.rstrip()}\n```\n"


def _one_line(text: str) -> str:
    return " ".join(_code(text).split())


def _code(text: str) -> str:
    """Text of a docstring or of Rich as Markdown."""
    plain = re.sub(r"``(.+?)``", r"`\1`", text)
    return plain.replace("|", "\\|").replace("<", "&lt;").replace("[bold]", "").replace("[/]", "")
