"""The verbs of ``interface``, which list and show interfaces and print prototypes.

Only ``fetch``, and ``show`` for the name of an action or with ``--connect``, need a graph. The
others know the interfaces that ship with turtleact, and those in the folder of ``--interfaces``, in
the sourced ROS workspace, and near the working directory.

Source: ros2cli ``ros2interface/verb/*.py`` (Jazzy), for the printed text.
"""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from turtleact.commands import completion
from turtleact.commands.app import new_group, verb
from turtleact.commands.interface_search import first_message
from turtleact.commands.options import argument, flag, only_one, value
from turtleact.commands.output import say
from turtleact.commands.settings import WrongOptions
from turtleact.errors import TurtleactError, UnknownInterface, UsageError
from turtleact.interfaces import Action, known_interfaces, to_dict, to_yaml
from turtleact.interfaces.comments import commented_text
from turtleact.interfaces.definition import did_you_mean
from turtleact.interfaces.loading import find_interface
from turtleact.interfaces.parse import Line, parse_member, without_comment
from turtleact.interfaces.text import flow

if TYPE_CHECKING:
    from turtleact.commands.settings import ConnectOptions
    from turtleact.interfaces.types import Interface
    from turtleact.node import Node

__all__ = ["app"]

KINDS: Final = {"msg": "Messages", "srv": "Services", "action": "Actions"}
"""The kinds of interfaces with their headings, in the order in which they are listed."""

_CONTROL: Final = re.compile(r"[\x00-\x08\x0a-\x1f\x7f-\x9f]")
"""The characters of a file that could change the terminal's state."""

LONGEST_LINE: Final = 2**12
"""At most this many bytes of an interface name are read from a pipe. No such name is longer."""


Messages = Annotated[bool, flag("--only-msgs", "-m", text="Messages only.")]
Services = Annotated[bool, flag("--only-srvs", "-s", text="Services only.")]
Actions = Annotated[bool, flag("--only-actions", "-a", text="Actions only.")]
Packages = Annotated[
    list[str], argument("PACKAGE", "The packages, such as nav2_msgs.", completion.packages)
]

app = new_group("interface")


@verb(app, "list", knows=True)
def list_(
    *,
    msgs: Messages = False,
    srvs: Services = False,
    actions: Actions = False,
    learned: Annotated[
        bool, flag("--learned", text="Only what was learned from nodes, and from which.")
    ] = False,
) -> None:
    """List all interfaces."""
    if learned:
        from turtleact.commands.interface_fetch import print_learned

        print_learned()
        return
    for kind in _kinds(msgs=msgs, srvs=srvs, actions=actions):
        names = [name for name in known_interfaces() if name.split("/")[1] == kind]
        say(
            "".join(f"{line}\n" for line in (f"{KINDS[kind]}:", *(f"    {each}" for each in names)))
        )


@verb(app, knows=True)
def package(
    name: Annotated[
        str, argument("PACKAGE", "The package, such as geometry_msgs.", completion.packages)
    ],
    *,
    msgs: Messages = False,
    srvs: Services = False,
    actions: Actions = False,
) -> None:
    """List the interfaces of a package."""
    _check_package(name)
    known = _by_package(_kinds(msgs=msgs, srvs=srvs, actions=actions))
    say("".join(f"{each}\n" for each in known.get(name, ())))


@verb(app, knows=True)
def packages(*, msgs: Messages = False, srvs: Services = False, actions: Actions = False) -> None:
    """List the packages that have interfaces."""
    known = _by_package(_kinds(msgs=msgs, srvs=srvs, actions=actions))
    say("".join(f"{each}\n" for each in known))


@verb(app, knows=True)
def proto(
    type_name: Annotated[
        str, argument("TYPE", "The interface, such as std_msgs/msg/String.", completion.interfaces)
    ],
    *,
    no_quotes: Annotated[
        bool, flag("--no-quotes", text="Print the message without quotes.")
    ] = False,
) -> None:
    """Print a message with its default values, as YAML."""
    quote = "" if no_quotes else '"'
    say(f"{quote}{to_yaml(first_message(type_name))}{quote}\n")


@verb(app, knows=True)
async def fetch(
    node: Node,
    names: Annotated[
        list[str] | None,
        argument("NODE", "The nodes.", completion.nodes, show_default=False),
    ] = None,
    *,
    everything: Annotated[bool, flag("--all", text="Fetch the interfaces of all nodes.")] = False,
    output: Annotated[
        Path, value("--output", "-o", metavar="DIR", text="Write DIR/PACKAGE/KIND/NAME.EXT.")
    ],
) -> int:
    """Write the interfaces that only nodes have as packages for a workspace."""
    from turtleact.commands import interface_fetch

    if everything == bool(names):
        raise WrongOptions("give the names of nodes, or --all")
    return await interface_fetch.fetch(node, names or [], output, is_all=everything)


@verb(app, "python", knows=True)
def python_(
    names: Packages,
    *,
    output: Annotated[
        Path, value("--output", "-o", metavar="DIR", text="Write DIR/PACKAGE/KIND.py.")
    ],
    check: Annotated[
        bool, flag("--check", text="Write nothing; exit with 1 if a file would change.")
    ] = False,
) -> int:
    """Write the interfaces of packages as typed Python classes."""
    return _write_python(names, output, is_check=check)


@verb(app, knows=True)
def show(
    reach: ConnectOptions,
    type_name: Annotated[
        str,
        argument(
            "TYPE",
            "The interface, such as std_msgs/msg/String, or an action of the graph, such as "
            "/patrol. A dash (-) reads it from stdin.",
            completion.interfaces,
        ),
    ],
    *,
    all_comments: Annotated[
        bool, flag("--all-comments", text="Print the comments of nested messages too.")
    ] = False,
    no_comments: Annotated[
        bool, flag("--no-comments", text="Leave out comments and empty lines.")
    ] = False,
) -> int:
    """Print the definition of an interface."""
    only_one("what to do with comments", all_comments=all_comments, no_comments=no_comments)
    name = _type_of_pipe() if type_name == "-" else type_name

    def print_lines(type_name: str) -> None:
        lines = _lines(type_name, depth=0, comments=not no_comments, nested_comments=all_comments)
        say("".join(f"{line}\n" for line in lines))

    async def print_action(node: Node) -> int:
        from turtleact.commands.graph import chosen_class
        from turtleact.names import resolve_name

        action = await chosen_class(node, "action", Action, resolve_name(name), None)
        print_lines(action.type_name)
        goal = flow(to_dict(action.Goal()))
        say(f"\nTo send it:  turtleact send-goal {name} {shlex.quote(goal)}\n")
        return 0

    if name.startswith("/") or "/" not in name:  # otherwise it is a type
        from turtleact.commands import graph

        return graph.run(reach, print_action)

    async def learn_and_print(node: Node) -> int:
        from turtleact.commands.interface_fetch import find_shown

        await node.learner.learn_type(name)
        find_shown(name)
        print_lines(name)
        return 0

    try:
        print_lines(name)
    except UnknownInterface:
        if not (reach.connect and reach.learns):
            raise
        from turtleact.commands import graph

        return graph.run(reach, learn_and_print)
    return 0


def _kinds(*, msgs: bool, srvs: bool, actions: bool) -> list[str]:
    """Return the kinds that the user wants; all if none is given."""
    given = {"msg": msgs, "srv": srvs, "action": actions}
    return [kind for kind, is_wanted in given.items() if is_wanted] or [*KINDS]


def _type_of_pipe() -> str:
    """Return the first line of stdin.

    Raises:
        UsageError: if there is nothing to read.
    """
    if sys.stdin.isatty():
        raise UsageError("'-' reads the type from a pipe, but stdin is not a pipe")
    line = sys.stdin.readline(LONGEST_LINE).strip()
    if not line:
        raise UsageError("stdin: is empty; expected a type such as std_msgs/msg/String")
    return line


def _write_python(packages: Sequence[str], folder: Path, *, is_check: bool) -> int:
    """Write typed Python classes for the interfaces of some packages, and of the packages they use.

    The path of each written file is printed. Files that would not change are left alone.

    Args:
        packages: The names of the packages.
        folder: The folder into which files ``PACKAGE/KIND.py`` are written. It is created if it
            does not exist.
        is_check: Whether to write nothing, and only print which files would change.

    Returns:
        The exit status: 1 if ``is_check`` is true and a file would change, otherwise 0.

    Raises:
        TurtleactError: if there is no such package. The error suggests the nearest name.
        InvalidInterface: if a file of an interface is malformed.
        UsageError: if an existing file was not generated, or a file cannot be written.
    """
    from turtleact.interfaces.generator import MARK, generate
    from turtleact.interfaces.loading import package_texts

    for package in packages:
        _check_package(package)
    wanted: dict[Path, str | None] = {
        folder / path: text for path, text in generate(package_texts(*packages)).items()
    }
    for place in {path.parent for path in wanted}:
        stale = (place / f"{kind}.py" for kind in KINDS)
        wanted.update({path: None for path in stale if path not in wanted and path.is_file()})
    init = folder / "__init__.py"
    if not init.exists():
        wanted[init] = f"{MARK} PACKAGE -o DIR`.\n"
    changed = [path for path in sorted(wanted) if _read(path) != wanted[path]]
    for path in changed:
        held = _read(path)
        if held is not None and not held.startswith(MARK):
            raise UsageError(f"{path} was not generated: choose another folder, or remove it")
    if not is_check:
        for path in changed:
            _replace(path, wanted[path])
    said = "would change " if is_check else ""
    say("".join(f"{said}{path}\n" for path in changed))
    return int(is_check and bool(changed))


def _read(path: Path) -> str | None:
    """Return the text of a file; None if the file does not exist."""
    try:
        return path.read_text("utf-8")
    except FileNotFoundError:
        return None
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path} cannot be read: {error}") from error


def _replace(path: Path, text: str | None) -> None:
    """Write ``text`` to a file. If ``text`` is None, remove the file."""
    try:
        if text is None:
            path.unlink()
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, "utf-8")
    except OSError as error:
        raise UsageError(f"{path} cannot be written: {error.strerror}") from error


def _check_package(package: str) -> None:
    """Raise an error if no interface of a package is known. The error suggests the nearest name."""
    packages = _by_package([*KINDS])
    if package not in packages:
        hint = did_you_mean(package, packages)
        raise TurtleactError(f"unknown package '{package}'{hint}")


def _by_package(kinds: Sequence[str]) -> dict[str, list[str]]:
    """Return the names of the interfaces of these kinds, by package."""
    packages: dict[str, list[str]] = {}
    for name in known_interfaces():
        package, kind, _ = name.split("/")
        if kind in kinds:
            packages.setdefault(package, []).append(name)
    return packages


def _find(type_name: str) -> Interface:
    """Return the class of an interface, if necessary one that was learned before."""
    try:
        return find_interface(type_name)
    except UnknownInterface:
        from turtleact.commands.interface_fetch import find_shown

        if not find_shown(type_name):
            raise
        return find_interface(type_name)


def _lines(type_name: str, *, depth: int, comments: bool, nested_comments: bool) -> Iterator[str]:
    """Yield the lines that `print_definition` prints."""
    interface = _find(type_name)
    package = interface.type_name.partition("/")[0]
    for number, text in enumerate(commented_text(interface).splitlines(), 1):
        shown = _CONTROL.sub("", text).rstrip()
        said = without_comment(shown).strip()
        if comments or said:
            kept = shown if comments else said
            yield f"{depth * chr(9)}{kept}" if kept else ""
        if not said or said == "---":
            continue
        member, _ = parse_member(Line(type_name, number, text), without_comment(text), package)
        if member.type.is_nested:
            yield from _lines(
                member.type.name,
                depth=depth + 1,
                comments=nested_comments,
                nested_comments=nested_comments,
            )
