"""Interfaces found by their name, or loaded from a file or text.

``get_interface`` takes the first of these that knows the name: the classes declared in Python, the
folders given to ``load_interfaces``, the classes that ship in ``standard``, and the ROS packages of
``load_workspace``. A class is imported, or made from its text, when it is first asked for. The one
module of its row that opens files.
"""

from __future__ import annotations

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
from turtleact.interfaces.types import REGISTRY, Action, Message, Service, definition

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable
    from typing import Any, ClassVar

    from turtleact.interfaces.definition import Definition
    from turtleact.interfaces.types import Interface

    class DynamicMessage(Message):
        """What a type checker sees of a message that is loaded at run time: any fields."""

        def __init__(self, *args: object, **kwargs: object) -> None: ...
        def __getattr__(self, name: str) -> Any: ...  # noqa: ANN401  # any field
        def __setattr__(self, name: str, value: object) -> None: ...

    class DynamicService(Service):
        """What a type checker sees of a service that is loaded at run time."""

        Request: ClassVar[type[DynamicMessage]]
        Response: ClassVar[type[DynamicMessage]]

    class DynamicAction(Action):
        """What a type checker sees of an action that is loaded at run time."""

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
    "package_texts",
]

KINDS = ("msg", "srv", "action")

#: Where packages lie in a folder: side by side, in a ROS prefix, or in one of several prefixes.
LAYOUTS = ("*", "share/*", "*/share/*")


def get_interface(type_name: str) -> Interface:
    """The class of an interface, by its full name or by ``package/Name``.

    Types that an action or service implies are found too (``NAME_SendGoal_Request``). The same
    class is given every time, unless another definition takes the name over.

    Raises:
        UnknownInterface: with the nearest known name.
        InvalidInterface: if the file that holds it is malformed.

    >>> get_interface("geometry_msgs/msg/Point")(x=1.0)
    Point(x=1.0, y=0.0, z=0.0)
    """
    return first_found(type_name, KINDS)


def get_action(type_name: str) -> type[DynamicAction]:
    """The class of an action, by its full name or by ``package/Name``; as `get_interface`.

    Type checkers let its messages have any fields, so that no cast is needed.

    Raises:
        UnknownInterface: with the nearest known name.
        InvalidInterface: if it is a message or a service, or the file that holds it is malformed.
    """
    return of_kind(first_found(type_name, ("action", "msg", "srv")), Action)  # type: ignore[return-value]  # DynamicAction is no more than Action


def get_message(type_name: str) -> type[DynamicMessage]:
    """The class of a message; as `get_action`."""
    return of_kind(first_found(type_name, ("msg", "srv", "action")), Message)  # type: ignore[return-value]  # as above


def get_service(type_name: str) -> type[DynamicService]:
    """The class of a service; as `get_action`."""
    return of_kind(first_found(type_name, ("srv", "msg", "action")), Service)  # type: ignore[return-value]  # as above


def load_interface(source: str | Path, *, type_name: str = "") -> Interface:
    """The class of an interface that stands in a file or in a text.

    Args:
        source: The path of a .msg, .srv or .action, or the text itself.
        type_name: The full name; may be left out for a file at ``PACKAGE/KIND/NAME.EXT``.

    Raises:
        InvalidInterface: with file, line and column.

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
    r"""The class of an action that stands in a file or in a text; as `load_interface`.

    Type checkers let its messages have any fields, so that no cast is needed.

    Raises:
        InvalidInterface: if it is a message or a service, or malformed: with file, line and column.

    >>> Count = load_action("int32 to\n---\n---", type_name="example_msgs/action/Count")
    >>> Count.Goal(to=3).to
    3
    """
    return of_kind(load_interface(source, type_name=type_name), Action)  # type: ignore[return-value]  # as above


def load_message(source: str | Path, *, type_name: str = "") -> type[DynamicMessage]:
    """The class of a message that stands in a file or in a text; as `load_action`."""
    return of_kind(load_interface(source, type_name=type_name), Message)  # type: ignore[return-value]  # as above


def load_service(source: str | Path, *, type_name: str = "") -> type[DynamicService]:
    """The class of a service that stands in a file or in a text; as `load_action`."""
    return of_kind(load_interface(source, type_name=type_name), Service)  # type: ignore[return-value]  # as above


def load_interfaces(folder: str | Path) -> tuple[str, ...]:
    """Makes every ``PACKAGE/KIND/NAME.EXT`` in a folder known, and gives their names.

    The folder holds packages, as ``src`` of a workspace may, or is where ROS packages were
    installed: a prefix such as ``/opt/ros/jazzy``, with the packages in ``share``, or a folder of
    prefixes, as colcon's ``install``. A file is read when its interface is first asked for; it
    goes before one that ships. A class already known under a name stays, if the file says the same.

    Raises:
        InvalidInterface: if there is no such folder, or a file's name is no interface's name.
    """
    root = Path(folder)
    if not root.is_dir():
        raise InvalidInterface("no such folder", source=str(folder))
    found = {named(name_of(path), str(path)): path for path in files_in(root, *LAYOUTS)}
    for name, path in found.items():
        # A class that ships is imported now, as it would not be compared with the file later.
        held = REGISTRY.get(name) or shipped_class(name)
        if held is not None and parse(read(path), name, source=str(path)) != definition(held):
            REGISTRY.forget(name)
    REGISTRY.files.update({name: str(path) for name, path in found.items()})
    return tuple(sorted(found))


def load_workspace(*prefixes: str | Path) -> None:
    """Makes the interfaces of installed ROS packages known, after those that ship.

    Looks for ``share/PACKAGE/KIND/NAME.EXT`` when an interface is first asked for, not before.
    A prefix that does not exist is passed over, as ROS does.

    Args:
        prefixes: What ``AMENT_PREFIX_PATH`` lists; of two with the same interface, the first gives
            it. An empty text is none.
    """
    added = [str(prefix) for prefix in prefixes if prefix]
    REGISTRY.prefixes = tuple(dict.fromkeys((*REGISTRY.prefixes, *added)))


def known_interfaces() -> tuple[str, ...]:
    """The names of all interfaces that can be had, without the types that others imply."""
    names = {*REGISTRY.names(), *REGISTRY.files, *shipped_names(), *installed_names()}
    return tuple(sorted(name for name in names if owner_and_part(name)[0] not in names))


def interface_text(cls: Interface) -> str:
    """An interface class as the text of a .msg, .srv or .action.

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
    """The text of an interface as its author wrote it, where there is a file, else as is implied.

    A file in an installed ROS package goes before the one that ships, if both say the same: it has
    comments.

    Raises:
        UnknownInterface: with the nearest known name.
        InvalidInterface: if a file that holds it is malformed.
    """
    cls = get_interface(type_name)
    said, name = definition(cls), cls.type_name
    for file in (given(name), installed(name), shipped(name)):
        text = "" if file is None else read(file)
        if file is not None and parse(text, name, source=str(file)) == said:
            return text
    return definition_text(said)


def package_texts(*packages: str) -> dict[str, str]:
    """The texts of all interfaces of these packages, and of the packages that they use, by name.

    A package that is only used is left out if it ships and says the same.

    Raises:
        UnknownInterface: if nothing of a package is known; with the nearest package.
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
    """The packages of the messages in an interface."""
    parts = parts_of(definition(get_interface(type_name)))
    types = [field.type for part in parts for field in part.fields]
    return {each.name.partition("/")[0] for each in types if each.is_nested}


def ships(package: str, known: tuple[str, ...]) -> bool:
    """Whether all that is known of a package ships, and says the same."""
    for name in (name for name in known if name.startswith(f"{package}/")):
        file = shipped(name)
        if file is None or parse(read(file), name) != definition(get_interface(name)):
            return False
    return True


def class_of(definition: Definition) -> Interface:
    """The class that a definition describes; the one known already, if it says the same.

    Raises:
        InvalidInterface: if a message in it is unknown, or contains itself.
    """
    return build(definition, ())


def build(definition: Definition, making: tuple[str, ...]) -> Interface:
    """Makes a class, and the messages in it.

    Args:
        definition: What to make.
        making: The interfaces that are being made around it.
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
    """The class of that full name, known, read from its file, or None."""
    if type_name in making:
        circle = " in ".join([type_name, *reversed(making[making.index(type_name) :])])
        raise InvalidInterface(f"a message contains itself: {circle}", source=making[0])
    owner, part = owner_and_part(type_name)
    found = part_of(look_up(owner, making), part) if part else None
    found = found or REGISTRY.get(type_name)
    if found is not None:
        return found
    file = given(type_name)
    if file is None:
        found = shipped_class(type_name)
        if found is not None:
            return found
        file = installed(type_name)
    return None if file is None else build(parse(read(file), type_name, source=str(file)), making)


def shipped_class(type_name: str) -> Interface | None:
    """The class of that full name that ships, or None."""
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
    """The class of that name; where it is ``package/Name``, of the first of these kinds."""
    for name in full_names(type_name, kinds):
        found = look_up(name, ())
        if found is not None:
            return found
    return needed(None, type_name)


B = TypeVar("B", Message, Service, Action)
NOUNS = {Message: "message", Service: "service", Action: "action"}


def of_kind(interface: Interface, base: type[B]) -> type[B]:
    """The interface, if it is of this kind."""
    if issubclass(interface, base):
        return interface
    [kind] = [each for each in NOUNS if issubclass(interface, each)]
    problem = f"is a {NOUNS[kind]}, not a {NOUNS[base]}".replace("a action", "an action")
    hint = f"use get_{NOUNS[kind]} or load_{NOUNS[kind]}"
    raise InvalidInterface(f"{problem}: {hint}", source=interface.type_name)


def full_names(type_name: str, kinds: tuple[str, ...]) -> list[str]:
    """The full names that a name may stand for."""
    package, _, name = type_name.partition("/")
    candidates = [type_name] if "/" in name else [f"{package}/{kind}/{name}" for kind in kinds]
    return [name for name in candidates if type_name_pattern.fullmatch(name)]


def needed(found: Interface | None, type_name: str) -> Interface:
    """What was found under a name, if anything was."""
    if found is None:
        raise UnknownInterface(type_name, suggestion(type_name))
    return found


def suggestion(type_name: str) -> str:
    """The known interface that was most likely meant."""
    known = known_interfaces()
    ending = f"/{type_name.rpartition('/')[2]}"
    return next((name for name in known if name.endswith(ending)), "") or nearest(type_name, known)


def as_path(source: str | Path) -> Path | None:
    """The path that is meant, or None for a text."""
    if isinstance(source, Path):
        return source
    is_path = "\n" not in source and source.endswith(tuple(f".{kind}" for kind in KINDS))
    return Path(source) if is_path else None


def files_in(root: Path, *layouts: str) -> list[Path]:
    """The interface files under a folder, where packages lie as these patterns say."""
    patterns = [f"{packages}/{kind}/*.{kind}" for packages in layouts for kind in KINDS]
    return [path for pattern in patterns for path in sorted(root.glob(pattern))]


def name_of(path: Path) -> str:
    """The full name that a file's place says, or an empty string."""
    package, kind, _ = ("", "", "", *path.absolute().parts)[-3:]
    name = f"{package}/{kind}/{path.stem}"
    return name if type_name_pattern.fullmatch(name) and path.suffix == f".{kind}" else ""


def named(type_name: str, source: str) -> str:
    """The name, if there is one."""
    if not type_name:
        problem = (
            'say its full name: type_name="package_name/action/InterfaceName" '
            "(or keep the file at PACKAGE/KIND/NAME.EXT)"
        )
        raise InvalidInterface(problem, source=source)
    return type_name


def read(file: Traversable) -> str:
    """The text of a file."""
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidInterface(f"cannot be read: {error}", source=str(file)) from error


def given(type_name: str) -> Traversable | None:
    """The file that `load_interfaces` has found for an interface, or None."""
    path = REGISTRY.files.get(type_name)
    return None if path is None else Path(path)


def shipped(type_name: str) -> Traversable | None:
    """The file that ships for an interface, or None."""
    package, kind, name = type_name.split("/")
    file = shipped_files().joinpath(package, kind, f"{name}.{kind}")
    return file if is_there(file) else None


def shipped_files() -> Traversable:
    """The folder of the files that ship."""
    from importlib import resources  # costs a fifth of the package's start

    return resources.files(standard)


def shipped_names() -> set[str]:
    """The names of the interfaces that ship."""
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
    """The file of an interface in an installed ROS package, or None."""
    package, kind, name = type_name.split("/")
    places = [Path(prefix, "share", package, kind) for prefix in REGISTRY.prefixes]
    files = (place / f"{name}.{kind}" for place in places)
    return next((file for file in files if is_there(file)), None)


def is_there(file: Traversable) -> bool:
    """Whether a file exists; one whose name is too long for the system does not."""
    try:
        return file.is_file()
    except OSError:
        return False


def installed_names() -> set[str]:
    """The names of the interfaces of installed ROS packages."""
    files = [path for prefix in REGISTRY.prefixes for path in files_in(Path(prefix), "share/*")]
    return {name_of(path) for path in files} - {""}
