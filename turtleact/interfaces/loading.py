"""Finds interfaces by name, or loads them from a file or text.

``get_interface`` searches these places in order: classes declared in Python, folders given to
``load_interfaces``, the ROS packages of ``load_workspace``, the files of ``offer_interfaces``, and
the built-in classes in ``standard``. A file does not replace a built-in class with the same
definition. A class is imported, or made from its text, on first use. In this package, only this
module opens files.
"""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from turtleact.errors import InvalidInterface, UnknownInterface
from turtleact.interfaces import standard
from turtleact.interfaces.classes import (
    make_action,
    make_message,
    make_service,
    owner_and_part,
    part_of,
)
from turtleact.interfaces.definition import (
    MessageDefinition,
    ServiceDefinition,
    definition_text,
    nearest,
    parts_of,
    type_name_pattern,
)
from turtleact.interfaces.parse import parse
from turtleact.interfaces.types import REGISTRY, SHIPPED, Action, Message, Service, definition
from turtleact.workspace import interface_files, proper_name

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from importlib.resources.abc import Traversable
    from typing import Any, ClassVar

    from turtleact.interfaces.definition import Definition
    from turtleact.interfaces.types import Interface

    class DynamicMessage(Message):
        """A message loaded at run time, as type checkers see it: any fields."""

        def __init__(self, *args: object, **kwargs: object) -> None: ...
        def __getattr__(self, name: str) -> Any: ...  # noqa: ANN401  # any field
        def __setattr__(self, name: str, value: object) -> None: ...

    class DynamicService(Service):
        """A service loaded at run time, as type checkers see it."""

        Request: ClassVar[type[DynamicMessage]]
        Response: ClassVar[type[DynamicMessage]]

    class DynamicAction(Action):
        """An action loaded at run time, as type checkers see it."""

        Goal: ClassVar[type[DynamicMessage]]
        Result: ClassVar[type[DynamicMessage]]
        Feedback: ClassVar[type[DynamicMessage]]


__all__ = [
    "class_of",
    "get_action",
    "get_interface",
    "get_message",
    "get_service",
    "interface_source",
    "interface_text",
    "known_interfaces",
    "load_action",
    "load_interface",
    "load_interfaces",
    "load_message",
    "load_service",
    "load_workspace",
    "offer_interfaces",
    "package_texts",
]

KINDS = ("msg", "srv", "action")

#: Where a folder has packages: directly inside, in a ROS prefix, or in one of several prefixes.
LAYOUTS = ("*", "share/*", "*/share/*")


def get_interface(type_name: str) -> Interface:
    """Return the class of an interface, by its full name or by ``package/Name``.

    Types that an action or service implies are found too (``NAME_SendGoal_Request``). The result is
    always the same class, unless another definition takes over the name.

    Raises:
        UnknownInterface: if the name is unknown; the error suggests the nearest one.
        InvalidInterface: if its file is malformed.

    >>> get_interface("geometry_msgs/msg/Point")(x=1.0)
    Point(x=1.0, y=0.0, z=0.0)
    """
    return first_found(type_name, KINDS)


def get_action(type_name: str) -> type[DynamicAction]:
    """Return the class of an action, by its full name or by ``package/Name``; see `get_interface`.

    Type checkers allow any fields in its messages, so no cast is needed.

    Raises:
        UnknownInterface: if the name is unknown; the error suggests the nearest one.
        InvalidInterface: if it is a message or a service, or its file is malformed.
    """
    return of_kind(first_found(type_name, ("action", "msg", "srv")), Action)  # type: ignore[return-value]  # DynamicAction is no more than Action


def get_message(type_name: str) -> type[DynamicMessage]:
    """Return the class of a message by name; see `get_action` for names and errors."""
    return of_kind(first_found(type_name, ("msg", "srv", "action")), Message)  # type: ignore[return-value]  # as above


def get_service(type_name: str) -> type[DynamicService]:
    """Return the class of a service by name; see `get_action` for names and errors."""
    return of_kind(first_found(type_name, ("srv", "msg", "action")), Service)  # type: ignore[return-value]  # as above


def load_interface(source: str | Path, *, type_name: str = "") -> Interface:
    """Return the class of an interface in a file or text.

    Args:
        source: The path of a .msg, .srv or .action, or the text itself.
        type_name: The full name. You may leave it out for a file at ``PACKAGE/KIND/NAME.EXT``.

    Raises:
        InvalidInterface: if the source is malformed. The error has file, line and column.

    >>> Order = load_interface("int32 count 3", type_name="example_msgs/msg/Order")
    >>> Order()
    Order(count=3)
    """
    path = as_path(source)
    if path is None:
        return class_of(parse(str(source), named(type_name, "text")))
    name = type_name or name_of(path)
    text = read(path)
    return class_of(parse(text, named(name, str(path)), source=str(path)))


def load_action(source: str | Path, *, type_name: str = "") -> type[DynamicAction]:
    r"""Return the class of an action in a file or text; see `load_interface`.

    Type checkers allow any fields in its messages, so no cast is needed.

    Raises:
        InvalidInterface: if the source is a message or a service, or malformed. The error has file,
            line and column.

    >>> Count = load_action("int32 to\n---\n---", type_name="example_msgs/action/Count")
    >>> Count.Goal(to=3).to
    3
    """
    return of_kind(load_interface(source, type_name=type_name), Action)  # type: ignore[return-value]  # as above


def load_message(source: str | Path, *, type_name: str = "") -> type[DynamicMessage]:
    """Return the class of a message in a file or text; see `load_action`."""
    return of_kind(load_interface(source, type_name=type_name), Message)  # type: ignore[return-value]  # as above


def load_service(source: str | Path, *, type_name: str = "") -> type[DynamicService]:
    """Return the class of a service in a file or text; see `load_action`."""
    return of_kind(load_interface(source, type_name=type_name), Service)  # type: ignore[return-value]  # as above


def load_interfaces(folder: str | Path) -> tuple[str, ...]:
    """Make every ``PACKAGE/KIND/NAME.EXT`` in a folder known, and return their names.

    The folder may contain packages, like the ``src`` of a workspace. The folder may also be a place
    where ROS packages were installed: a prefix such as ``/opt/ros/jazzy``, with the packages in
    ``share``, or a folder of prefixes such as colcon's ``install``. A file is read when its
    interface is first used, and takes precedence over a built-in interface. If a class is already
    known and the file has the same definition, the class stays.

    Raises:
        InvalidInterface: if the folder does not exist, or a file's name is not an interface name.
    """
    root = Path(folder)
    if not root.is_dir():
        raise InvalidInterface("no such folder", source=str(folder))
    found = interface_files(root)
    found |= {file_name(path): path for path in files_in(root, *LAYOUTS)}
    for name, path in found.items():
        # A built-in class is imported now; later it would not be compared with the file.
        held = REGISTRY.get(name) or shipped_class(name)
        if held is not None and parse(read(path), name, source=str(path)) != definition(held):
            REGISTRY.forget(name)
    REGISTRY.files.update({name: str(path) for name, path in found.items()})
    return tuple(sorted(found))


def load_workspace(*prefixes: str | Path) -> None:
    """Make the interfaces of installed ROS packages known.

    When an interface is first used, its file ``share/PACKAGE/KIND/NAME.EXT`` is searched for. If a
    built-in interface has another definition, the file takes precedence. A prefix that does not
    exist is ignored, as in ROS.

    Args:
        prefixes: The folders in ``AMENT_PREFIX_PATH``. If two folders have the same interface, the
            first folder wins. Empty texts are ignored.
    """
    added = [str(prefix) for prefix in prefixes if prefix]
    REGISTRY.prefixes = tuple(dict.fromkeys((*REGISTRY.prefixes, *added)))
    REGISTRY.settled.clear()


def offer_interfaces(
    files: Mapping[str, Path], on_use: Callable[[str, str], object] | None = None
) -> None:
    """Make interface files known that the user has not chosen; `turtleact.workspace` finds them.

    A file is read when its interface is first used, so a malformed file does no harm before. A file
    takes precedence over a built-in interface with another definition.

    Args:
        files: The files by type name.
        on_use: Called with the type name and the file when one of the files is first used.
    """
    REGISTRY.nearby.update({name: str(path) for name, path in files.items()})
    REGISTRY.on_nearby = on_use
    REGISTRY.settled.clear()


def known_interfaces() -> tuple[str, ...]:
    """Return the names of all available interfaces, without the types that they imply."""
    files = {*REGISTRY.files, *REGISTRY.nearby}
    names = {*REGISTRY.names(), *files, *shipped_names(), *installed_names()}
    return tuple(sorted(name for name in names if owner_and_part(name)[0] not in names))


def interface_text(cls: Interface) -> str:
    """Return an interface class as the text of a .msg, .srv or .action.

    >>> from turtleact.interfaces.standard import Fibonacci
    >>> print(interface_text(Fibonacci))
    int32 order
    ---
    int32[] sequence
    ---
    int32[] partial_sequence
    """
    return definition_text(definition(cls))


def interface_source(type_name: str) -> str:
    """Return the text of an interface as its author wrote it. Without a file, generate the text.

    If an installed file and the built-in file have the same definition, the installed file is used,
    because it has comments.

    Raises:
        UnknownInterface: if the name is unknown; the error suggests the nearest one.
        InvalidInterface: if its file is malformed.
    """
    cls = get_interface(type_name)
    said, name = definition(cls), cls.type_name
    for file in (given(name), installed(name), nearby(name), shipped(name)):
        text = "" if file is None else read(file)
        if file is not None and parse(text, name, source=str(file)) == said:
            return text
    return definition_text(said)


def package_texts(*packages: str) -> dict[str, str]:
    """Return the interface texts of these packages and of the packages that they use, by type name.

    A package that is used but not given is left out if its definitions are the built-in ones.

    Raises:
        UnknownInterface: if a package is not known; the error suggests the nearest name.
        InvalidInterface: if a file is malformed.
    """
    known = known_interfaces()
    all_packages = {name.partition("/")[0] for name in known}
    waiting, found = list(packages), dict[str, str]()
    done: set[str] = set()
    while waiting:
        package = waiting.pop()
        if package not in all_packages:
            raise UnknownInterface(package, nearest(package, all_packages))
        done.add(package)
        for name in (name for name in known if name.startswith(f"{package}/")):
            found[name] = interface_source(name)
            waiting += used_packages(name) - done - set(waiting)
        waiting = [each for each in waiting if each in packages or not ships(each, known)]
    return dict(sorted(found.items()))


def used_packages(type_name: str) -> set[str]:
    """Return the packages of the messages in an interface."""
    parts = parts_of(definition(get_interface(type_name)))
    types = [field.type for part in parts for field in part.fields]
    return {each.name.partition("/")[0] for each in types if each.is_nested}


def ships(package: str, known: tuple[str, ...]) -> bool:
    """Whether all known interfaces of a package are built in with the same definitions."""
    for name in (name for name in known if name.startswith(f"{package}/")):
        file = shipped(name)
        if file is None or parse(read(file), name) != definition(get_interface(name)):
            return False
    return True


def class_of(definition: Definition) -> Interface:
    """Return the class for a definition.

    If a known class has the same definition, that class is returned.

    Raises:
        InvalidInterface: if the definition uses an unknown message, or a message contains itself.
    """
    return build(definition, ())


def build(definition: Definition, making: tuple[str, ...]) -> Interface:
    """Make a class and the messages in it.

    Args:
        definition: The definition.
        making: The interfaces that are being made and contain this one.
    """

    def find(type_name: str) -> Interface:
        return needed(look_up(type_name, (*making, definition.type_name)), type_name)

    made: Interface
    if isinstance(definition, MessageDefinition):
        made = make_message(definition, find)
    elif isinstance(definition, ServiceDefinition):
        made = make_service(definition, find)
    else:
        made = make_action(definition, find)
    return REGISTRY.get(definition.type_name) or made


def look_up(type_name: str, making: tuple[str, ...]) -> Interface | None:
    """Return the class with that full name, or None. If necessary, make the class from its file."""
    if type_name in making:
        circle = " in ".join([type_name, *reversed(making[making.index(type_name) :])])
        raise InvalidInterface(f"a message contains itself: {circle}", source=making[0])
    owner, part = owner_and_part(type_name)
    found = part_of(look_up(owner, making), part) if part else None
    found = found or REGISTRY.get(type_name)
    if found is not None and not may_be_replaced(found, type_name):
        return found
    file = None if found is not None else given(type_name)
    if file is None:
        found = found or shipped_class(type_name)
        file = other_file(type_name, found)
    return found if file is None else built_from(file, type_name, making)


def may_be_replaced(found: Interface, type_name: str) -> bool:
    """Whether a file may replace a class: it is built in, and not yet compared with a file."""
    if not (REGISTRY.prefixes or REGISTRY.nearby) or type_name in REGISTRY.settled:
        return False
    return found.__module__.startswith(SHIPPED)


def other_file(type_name: str, held: Interface | None) -> Traversable | None:
    """Return the file of an interface in a workspace or nearby, or None.

    Args:
        type_name: The full name.
        held: The built-in class. If the file has the same definition, the class stays, and this
            returns None. Otherwise the class is forgotten.

    Raises:
        InvalidInterface: if the file is malformed, and there is a built-in class to compare it
            with.
    """
    file, on_use = installed(type_name), None
    if file is None:
        file, on_use = nearby(type_name), REGISTRY.on_nearby
    if held is not None:
        same = file is None or parse(read(file), type_name, source=str(file)) == definition(held)
        if same:
            REGISTRY.settled.add(type_name)
            return None
        REGISTRY.forget(type_name)
    if file is not None and on_use is not None:
        on_use(type_name, str(file))
    return file


def built_from(file: Traversable, type_name: str, making: tuple[str, ...]) -> Interface:
    """Make the class of an interface from its file.

    Raises:
        InvalidInterface: if the file is malformed or uses an unknown message. The error has the
            line.
    """
    text = read(file)
    try:
        return build(parse(text, type_name, source=str(file)), making)
    except InvalidInterface as error:
        unknown = error.__cause__
        if error.line or not isinstance(unknown, UnknownInterface):
            raise
        package, _, name = unknown.type_name.split("/")
        used = re.compile(rf"\s*({package}/(msg/)?)?{name}\b")
        [number, line] = next(
            each for each in enumerate(text.splitlines(), 1) if used.match(each[1])
        )
        column = len(line) - len(line.lstrip()) + 1
        raise InvalidInterface(
            str(unknown), source=str(file), line=number, column=column, text=line
        ) from unknown


def shipped_class(type_name: str) -> Interface | None:
    """Return the built-in class with that full name, or None."""
    package, kind, name = type_name.split("/")
    try:
        module = import_module(f"{standard.__name__}.{package}.{kind}")
    except ModuleNotFoundError:
        return None
    found: Interface | None = vars(module).get(name) if name in module.__all__ else None
    if found is not None:
        REGISTRY.add(found, definition(found))
    return found


def first_found(type_name: str, kinds: tuple[str, ...]) -> Interface:
    """Return the class with that name. For ``package/Name``, try these kinds in order."""
    for name in full_names(type_name, kinds):
        found = look_up(name, ())
        if found is not None:
            return found
    return needed(None, type_name)


B = TypeVar("B", Message, Service, Action)
NOUNS = {Message: "message", Service: "service", Action: "action"}


def of_kind(interface: Interface, base: type[B]) -> type[B]:
    """Return the interface if it is of this kind; otherwise raise an error."""
    if issubclass(interface, base):
        return interface
    [kind] = [each for each in NOUNS if issubclass(interface, each)]
    problem = f"is a {NOUNS[kind]}, not a {NOUNS[base]}".replace("a action", "an action")
    hint = f"use get_{NOUNS[kind]} or load_{NOUNS[kind]}"
    raise InvalidInterface(f"{problem}: {hint}", source=interface.type_name)


def full_names(type_name: str, kinds: tuple[str, ...]) -> list[str]:
    """Return the full names that a name may mean."""
    package, _, name = type_name.partition("/")
    candidates = [type_name] if "/" in name else [f"{package}/{kind}/{name}" for kind in kinds]
    return [name for name in candidates if type_name_pattern.fullmatch(name)]


def needed(found: Interface | None, type_name: str) -> Interface:
    """Return the interface found under a name; raise an error if none was found."""
    if found is None:
        raise UnknownInterface(type_name, suggestion(type_name))
    return found


def suggestion(type_name: str) -> str:
    """Return the known interface that was most likely meant, or an empty string.

    Names of packages are often similar, such as ``arm_interfaces`` and ``leg_interfaces``. An
    interface of another package is therefore suggested only if the interface's own name is similar.
    """
    known = known_interfaces()
    package, _, name = type_name.rpartition("/")
    same = next((each for each in known if each.endswith(f"/{name}")), "")
    found = same or nearest(type_name, known)
    is_similar = found.startswith(f"{package}/") or nearest(name, [found.rpartition("/")[2]])
    return found if is_similar else ""


def as_path(source: str | Path) -> Path | None:
    """Return the path if the source is a path, or None if it is a text."""
    if isinstance(source, Path):
        return source
    is_path = "\n" not in source and source.endswith(tuple(f".{kind}" for kind in KINDS))
    return Path(source) if is_path else None


def files_in(root: Path, *layouts: str) -> list[Path]:
    """Return the interface files under a folder. The layouts say where the packages are."""
    patterns = [f"{packages}/{kind}/*.{kind}" for packages in layouts for kind in KINDS]
    return [path for pattern in patterns for path in sorted(root.glob(pattern))]


def name_of(path: Path) -> str:
    """Return the full name that follows from a file's place, or an empty string."""
    package, kind, _ = ("", "", "", *path.absolute().parts)[-3:]
    name = f"{package}/{kind}/{path.stem}"
    return name if type_name_pattern.fullmatch(name) and path.suffix == f".{kind}" else ""


def file_name(path: Path) -> str:
    """Return the full name that follows from a file's place. The error suggests a better place."""
    if name := name_of(path):
        return name
    if (proper := proper_name(path.stem)) != path.stem:
        problem = (
            "the name of an interface begins with a capital letter and has only letters and digits"
        )
        raise InvalidInterface(
            f"{problem}: rename the file to {proper}{path.suffix}", source=str(path)
        )
    return named(name, str(path))


def named(type_name: str, source: str) -> str:
    """Return the type name if it is given; otherwise raise an error."""
    if not type_name:
        problem = (
            'give its full name: type_name="package_name/action/InterfaceName" '
            "(or keep the file at PACKAGE/KIND/NAME.EXT)"
        )
        raise InvalidInterface(problem, source=source)
    return type_name


def read(file: Traversable) -> str:
    """Read the text of a file."""
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidInterface(f"cannot be read: {error}", source=str(file)) from error


def given(type_name: str) -> Traversable | None:
    """Return the file of an interface that `load_interfaces` found, or None."""
    path = REGISTRY.files.get(type_name)
    return None if path is None else Path(path)


def nearby(type_name: str) -> Traversable | None:
    """Return the file of an interface that `offer_interfaces` was given, or None."""
    path = REGISTRY.nearby.get(type_name)
    return None if path is None else Path(path)


def shipped(type_name: str) -> Traversable | None:
    """Return the built-in file of an interface, or None."""
    package, kind, name = type_name.split("/")
    file = shipped_files().joinpath(package, kind, f"{name}.{kind}")
    return file if is_there(file) else None


def shipped_files() -> Traversable:
    """Return the folder of the built-in files."""
    from importlib import resources  # slow to import

    return resources.files(standard)


def shipped_names() -> set[str]:
    """Return the names of the built-in interfaces."""
    root = shipped_files()
    kinds = [
        (package.name, kind)
        for package in root.iterdir()
        if package.is_dir()
        for kind in package.iterdir()
        if kind.name in KINDS
    ]
    return {
        f"{package}/{kind.name}/{file.name.removesuffix(f'.{kind.name}')}"
        for package, kind in kinds
        for file in kind.iterdir()
    }


def installed(type_name: str) -> Traversable | None:
    """Return the file of an interface in an installed ROS package, or None."""
    package, kind, name = type_name.split("/")
    places = [Path(prefix, "share", package, kind) for prefix in REGISTRY.prefixes]
    files = (place / f"{name}.{kind}" for place in places)
    return next((file for file in files if is_there(file)), None)


def is_there(file: Traversable) -> bool:
    """Whether a file exists; false if its name is too long for the system."""
    try:
        return file.is_file()
    except OSError:
        return False


def installed_names() -> set[str]:
    """Return the names of the interfaces of installed ROS packages."""
    files = [path for prefix in REGISTRY.prefixes for path in files_in(Path(prefix), "share/*")]
    return {name_of(path) for path in files} - {""}
