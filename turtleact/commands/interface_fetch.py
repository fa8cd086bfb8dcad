"""Learned interfaces on the command line: what the cache has, and a robot's own as packages.

Source: ``rosidl_default_generators`` for the files of an interface package.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

from turtleact.commands.output import note, say
from turtleact.errors import TurtleactError, UsageError
from turtleact.interfaces import Message, get_interface, interface_text, type_hash
from turtleact.interfaces.loading import authored_text
from turtleact.interfaces.type_hash import referenced
from turtleact.interfaces.types import REGISTRY, Interface, nested_classes
from turtleact.node.type_cache import cached, cached_types, remember

if TYPE_CHECKING:
    from turtleact.node import Node
    from turtleact.transports.graph import Kind

__all__ = ["fetch", "find_shown", "print_learned"]

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


def print_learned() -> None:
    """Print the learned types, each with its hash and the node that described it."""
    for each in cached_types():
        say(f"{each.interface.type_name} {each.type_hash} {each.node}\n")


def find_shown(type_name: str) -> bool:
    """Find a type that no file here has in the cache, and say where it came from."""
    found = list(cached(type_name))
    for each in found:
        note(f"{type_name} was learned from node {each.node} ({each.type_hash})")
    for each in reversed(found):  # the newest is found first
        remember(each)
    return bool(found)


async def fetch(node: Node, names: list[str], folder: Path, *, is_all: bool) -> int:
    """Write the interfaces of nodes that are not known here, as packages, and print their paths.

    Args:
        node: A node on the graph.
        names: The names of the nodes.
        folder: The folder of the packages.
        is_all: Whether to write the interfaces of all nodes.

    Raises:
        TurtleactError: if there is no such node.
        UsageError: if a file cannot be written.
    """
    wanted = {name if name.startswith("/") else f"/{name}" for name in names}
    if missing := wanted - {*node.transport.nodes()}:
        raise TurtleactError(f"there is no node {', '.join(sorted(missing))}")
    ends = [each for each in node.transport.endpoints() if is_all or each.node in wanted]
    used = {each.name.partition("/_action/")[0] for each in ends}
    node.learner.note = note

    def wants(_: Kind, name: str) -> bool:
        return name in used

    await node.learner.learn_all(wants)
    files = dict(_files())
    for path, text in sorted({**files, **dict(_packages(files))}.items()):
        place = folder / path
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_text(text, "utf-8")
        except OSError as error:
            raise UsageError(f"{place} cannot be written: {error.strerror}") from None
        say(f"{place}\n")
    return 0


def _files() -> Iterator[tuple[Path, str]]:
    """Yield the path and the text of each interface that was learned now."""
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
                text = authored_text(cls) or interface_text(cls)
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
