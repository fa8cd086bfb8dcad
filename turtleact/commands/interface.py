"""The verbs of ``interface``, which list, show, fetch and generate interfaces.

Only ``fetch``, and ``show`` for the name of an action or with ``--connect``, need a graph. The
others know the interfaces that ship with turtleact, and those in the folder of ``--interfaces``, in
the sourced ROS workspace, and near the working directory.

Source: ros2cli ``ros2interface/verb/*.py`` (Jazzy), for the printed text;
``rosidl_default_generators`` for the files of an interface package.
"""

from __future__ import annotations

import re
import shlex
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from turtleact.commands import completion
from turtleact.commands.app import new_group, verb
from turtleact.commands.message_text import first_message
from turtleact.commands.options import argument, flag, only_one, value
from turtleact.commands.output import note, say, say_lines, write_file
from turtleact.commands.settings import WrongOptions
from turtleact.errors import TurtleactError, UnknownInterface, UsageError
from turtleact.interfaces import (
    Action,
    Message,
    get_interface,
    known_interfaces,
    to_dict,
    to_yaml,
    type_hash,
)
from turtleact.interfaces.definition import did_you_mean
from turtleact.interfaces.loading import commented_text, find_interface, text_of
from turtleact.interfaces.parse import Line, parse_member, without_comment
from turtleact.interfaces.text import flow
from turtleact.interfaces.type_hash import referenced
from turtleact.interfaces.types import REGISTRY, nested_classes

if TYPE_CHECKING:
    from turtleact.commands.settings import ConnectOptions
    from turtleact.interfaces.types import Interface
    from turtleact.node import Node
    from turtleact.transports.graph import Kind

__all__ = ["app"]

KINDS: Final = {"msg": "Messages", "srv": "Services", "action": "Actions"}
"""The kinds of interfaces with their headings, in the order in which they are listed."""

_CONTROL: Final = re.compile(r"[\x00-\x08\x0a-\x1f\x7f-\x9f]")
"""The characters of a file that could change the terminal's state."""


Packages = Annotated[
    list[str], argument("PACKAGE", "The packages, such as nav2_msgs.", completion.packages)
]


def _kinds(
    *,
    msgs: Annotated[bool, flag("--only-msgs", "-m", text="Messages only.")] = False,
    srvs: Annotated[bool, flag("--only-srvs", "-s", text="Services only.")] = False,
    actions: Annotated[bool, flag("--only-actions", "-a", text="Actions only.")] = False,
) -> list[str]:
    """Return the kinds that the user wants; all if none is given."""
    given = {"msg": msgs, "srv": srvs, "action": actions}
    return [kind for kind, is_wanted in given.items() if is_wanted] or [*KINDS]


BY_KIND: Final = {"kinds": _kinds}
"""The parameter of verbs that stands for the kinds of interfaces."""

app = new_group("interface")


@verb(app, "list", knows=True, bundles=BY_KIND)
def list_(
    *,
    kinds: list[str],
    learned: Annotated[
        bool, flag("--learned", text="Only what was learned from nodes, and from which.")
    ] = False,
) -> None:
    """List all interfaces."""
    if learned:
        from turtleact.interfaces.learned import cached_types

        for each in cached_types():
            say(f"{each.interface.type_name} {each.type_hash} {each.node}\n")
        return
    for kind in kinds:
        names = [name for name in known_interfaces() if name.split("/")[1] == kind]
        say(f"{KINDS[kind]}:\n")
        say("".join(f"    {each}\n" for each in names))


@verb(app, knows=True, bundles=BY_KIND)
def package(
    name: Annotated[
        str, argument("PACKAGE", "The package, such as geometry_msgs.", completion.packages)
    ],
    *,
    kinds: list[str],
) -> None:
    """List the interfaces of a package."""
    _check_package(name)
    say_lines(_by_package(kinds).get(name, ()))


@verb(app, knows=True, bundles=BY_KIND)
def packages(*, kinds: list[str]) -> None:
    """List the packages that have interfaces."""
    say_lines(_by_package(kinds))


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
        argument("NODE", "The nodes.", completion.nodes),
    ] = None,
    *,
    everything: Annotated[bool, flag("--all", text="Fetch the interfaces of all nodes.")] = False,
    output: Annotated[
        Path, value("--output", "-o", metavar="DIR", text="Write DIR/PACKAGE/KIND/NAME.EXT.")
    ],
) -> int:
    """Write the interfaces that only nodes have as packages for a workspace."""
    if everything == bool(names):
        raise WrongOptions("give the names of nodes, or --all")
    wanted = {name if name.startswith("/") else f"/{name}" for name in names or ()}
    if missing := wanted - {*node.transport.nodes()}:
        raise TurtleactError(f"there is no node {', '.join(sorted(missing))}")
    ends = [each for each in node.transport.endpoints() if everything or each.node in wanted]
    used = {each.name.partition("/_action/")[0] for each in ends}
    node.learner.note = note

    def wants(_: Kind, name: str) -> bool:
        return name in used

    await node.learner.learn_all(wants)
    files = dict(_learned_files())
    for path, text in sorted({**files, **dict(_packages(files))}.items()):
        write_file(output / path, text)
        say(f"{output / path}\n")
    return 0


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
    from turtleact.interfaces.generator import MARK, generate, package_texts

    for package in names:
        _check_package(package)
    # The packages that these use are written too. Files that would not change are left alone.
    files = generate(package_texts(*names)).items()
    wanted = {output / path: text for path, text in files}
    init = output / "__init__.py"
    if not init.exists():
        wanted[init] = f"{MARK} PACKAGE -o DIR`.\n"
    held = {path: path.read_text("utf-8") for path in wanted if path.exists()}
    changed = [path for path in sorted(wanted) if held.get(path) != wanted[path]]
    for path in changed:
        if not held.get(path, MARK).startswith(MARK):
            raise UsageError(f"{path} was not generated: choose another folder, or remove it")
    for path in changed:
        if not check:
            write_file(path, wanted[path])
        say(f"{'would change ' if check else ''}{path}\n")
    return int(check and bool(changed))


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
    name = sys.stdin.readline().strip() if type_name == "-" else type_name
    print_type = partial(_print_type, comments=not no_comments, nested_comments=all_comments)
    is_type = "/" in name[1:]  # otherwise it is the name of an action
    try:
        if is_type:
            print_type(name)
            return 0
    except UnknownInterface:
        if not (reach.connect and reach.learns):
            raise
    from turtleact.commands import graph

    look = _print_learned if is_type else _print_action
    return graph.run(reach, lambda node: look(node, name, print_type))


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


# showing


async def _print_action(node: Node, name: str, print_type: Callable[[str], None]) -> int:
    """Print the definition of an action on the graph, and a goal to copy."""
    from turtleact.commands.graph import chosen_class
    from turtleact.names import resolve_name

    action = await chosen_class(node, "action", Action, resolve_name(name), None)
    print_type(action.type_name)
    goal = flow(to_dict(action.Goal()))
    say(f"\nTo send it:  turtleact send-goal {name} {shlex.quote(goal)}\n")
    return 0


async def _print_learned(node: Node, name: str, print_type: Callable[[str], None]) -> int:
    """Print the definition of a type after asking the nodes that use it."""
    await node.learner.learn_type(name)
    _find_learned(name)
    print_type(name)
    return 0


def _print_type(type_name: str, *, comments: bool, nested_comments: bool) -> None:
    lines = _lines(type_name, depth=0, comments=comments, nested_comments=nested_comments)
    say("".join(f"{line}\n" for line in lines))


def _lines(type_name: str, *, depth: int, comments: bool, nested_comments: bool) -> Iterator[str]:
    """Yield the lines of a definition, with those of the messages in it."""
    try:
        interface = find_interface(type_name)
    except UnknownInterface:
        if not _find_learned(type_name):
            raise
        interface = find_interface(type_name)
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


def _find_learned(type_name: str) -> bool:
    """Find a type that no file here has in the cache, and say where it came from."""
    from turtleact.interfaces.learned import cached, remember

    found = list(cached(type_name))
    for each in found:
        note(f"{type_name} was learned from node {each.node} ({each.type_hash})")
    for each in reversed(found):  # the newest is found first
        remember(each)
    return bool(found)


# writing packages

_PACKAGE_XML: Final = """\
<?xml version="1.0"?>
<package format="3">
  <name>{name}</name>
  <version>0.0.0</version>
  <description>Interfaces that were fetched from a robot.</description>
  <maintainer email="todo@todo.todo">todo</maintainer>
  <license>unknown</license>

  <buildtool_depend>ament_cmake</buildtool_depend>
  <build_depend>rosidl_default_generators</build_depend>
  <exec_depend>rosidl_default_runtime</exec_depend>
{depends}  <member_of_group>rosidl_interface_packages</member_of_group>
  <export>
    <build_type>ament_cmake</build_type>
  </export>
</package>
"""

_CMAKE: Final = """\
cmake_minimum_required(VERSION 3.8)
project({name})
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
{finds}
rosidl_generate_interfaces(${{PROJECT_NAME}}
{files}{uses})
ament_package()
"""


def _learned_files() -> Iterator[tuple[Path, str]]:
    """Yield the path and the text of each interface that was learned now."""
    from turtleact.interfaces.learned import cached

    for held, _ in REGISTRY.learned.values():
        versions = [each for each in cached(held.type_name) if each.type_hash == type_hash(held)]
        sources = {source.type_name: source for each in versions for source in each.sources}
        for cls in (held, *referenced(held).values()):
            name = cls.type_name
            package, kind, last = name.split("/")
            if "_" in last or _is_known(cls):  # ROS derives it, or it is not the robot's own
                continue
            source = sources.get(name)
            if source is not None and source.encoding == "idl":
                yield Path(package, kind, f"{last}.idl"), source.raw_file_contents
            else:
                text = text_of(cls)
                yield Path(package, kind, f"{last}.{kind}"), f"{text.rstrip()}\n"


def _packages(files: Iterable[Path]) -> Iterator[tuple[Path, str]]:
    """Yield the files that make packages of the interface files."""
    packages = defaultdict[str, list[str]](list)
    for path in files:
        packages[path.parts[0]].append("/".join(path.parts[1:]))
    uses = defaultdict[str, set[str]](set)
    for held, _ in REGISTRY.learned.values():
        for cls in (held, *referenced(held).values()):
            package = cls.type_name.partition("/")[0]
            nested = nested_classes(cls) if issubclass(cls, Message) else ()
            uses[package] |= {each.type_name.partition("/")[0] for each in nested if each}
    for package, paths in packages.items():
        used = sorted(uses[package] - {package})
        depends = "".join(f"  <depend>{each}</depend>\n" for each in used)
        finds = "".join(f"find_package({each} REQUIRED)\n" for each in used)
        listed = "".join(f'  "{each}"\n' for each in sorted(paths))
        words = {"name": package, "depends": depends, "finds": finds, "files": listed}
        words["uses"] = f"  DEPENDENCIES {' '.join(used)}\n" if used else ""
        yield Path(package, "package.xml"), _PACKAGE_XML.format(**words)
        yield Path(package, "CMakeLists.txt"), _CMAKE.format(**words)


def _is_known(cls: Interface) -> bool:
    try:
        return get_interface(cls.type_name) is cls
    except TurtleactError:
        return False
