"""Finds interfaces by name, or loads them from a file or text.

``get_interface`` returns the class that exists already. If there is none, it asks the finders of
``REGISTRY.finders`` in their order: folders given to ``load_interfaces``, the ROS packages of
``load_workspace``, the files of ``offer_interfaces``, and the built-in classes in ``standard``. If
a file has the same definition as a built-in class, the built-in class is used. A class is imported,
or made from its text, when it is first used. Of ``turtleact.interfaces``, only this module,
``finders`` and ``learned`` open files.
"""

from __future__ import annotations

import inspect
import re
import textwrap
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from msgspec.structs import replace

from turtleact.errors import InvalidInterface, TurtleactError, UnknownInterface
from turtleact.interfaces.classes import (
    make_interface,
    owner_and_part,
    part_of,
)
from turtleact.interfaces.definition import (
    definition_text,
    nearest,
    part_lines,
    type_name_pattern,
)
from turtleact.interfaces.finders import (
    KINDS,
    Files,
    Workspace,
    built_in_class,
    built_in_file,
    files_in,
    interface_files,
    name_of,
    proper_name,
)
from turtleact.interfaces.parse import Comments, parse, read_comments
from turtleact.interfaces.types import REGISTRY, Action, Message, Service, definition, parts

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from typing import Any, ClassVar

    from turtleact.interfaces.definition import Definition
    from turtleact.interfaces.types import Interface

    class DynamicMessage(Message):
        """The static type of a message loaded at run time. Type checkers accept any field."""

        def __init__(self, *args: object, **kwargs: object) -> None: ...
        def __getattr__(self, name: str) -> Any: ...  # noqa: ANN401  # any field
        def __setattr__(self, name: str, value: object) -> None: ...

    class DynamicService(Service):
        """The static type of a service loaded at run time."""

        Request: ClassVar[type[DynamicMessage]]
        Response: ClassVar[type[DynamicMessage]]

    class DynamicAction(Action):
        """The static type of an action loaded at run time."""

        Goal: ClassVar[type[DynamicMessage]]
        Result: ClassVar[type[DynamicMessage]]
        Feedback: ClassVar[type[DynamicMessage]]


__all__ = [
    "authored_text",
    "class_of",
    "commented_text",
    "comments",
    "find_interface",
    "get_action",
    "get_interface",
    "get_message",
    "get_service",
    "installed_class",
    "interface_source",
    "interface_text",
    "introduction",
    "known_classes",
    "known_interfaces",
    "learned_classes",
    "load_action",
    "load_interface",
    "load_interfaces",
    "load_message",
    "load_service",
    "load_workspace",
    "offer_interfaces",
    "text_of",
]

WIDTH = 80
"""Comments in the text of a class are wrapped to this many characters."""

attribute_pattern = re.compile(r" {4}(\w+): (.*)")

#: Where a folder has packages: directly inside, in a ROS prefix, or in one of several prefixes.
LAYOUTS = ("*", "share/*", "*/share/*")


def get_interface(type_name: str) -> Interface:
    """Return the class of an interface, by its full name or by ``package/Name``.

    The types derived from actions and services have classes too, such as ``NAME_SendGoal_Request``.
    Every call returns the same class, until a class with the same name and another definition
    replaces it.

    Raises:
        UnknownInterface: if the name is unknown; the error suggests the most similar name.
        InvalidInterface: if the interface's file is malformed.

    >>> get_interface("geometry_msgs/msg/Point")(x=1.0)
    Point(x=1.0, y=0.0, z=0.0)
    """
    return needed(installed_class(type_name), type_name)


def known_classes(type_name: str) -> Iterator[Interface]:
    """Yield all classes of this name: the one of `get_interface`, then those that were learned."""
    with suppress(InvalidInterface):
        found = installed_class(type_name)
        if found is not None:
            yield found
    yield from learned_classes(type_name)


def installed_class(type_name: str, kinds: tuple[str, ...] = KINDS) -> Interface | None:
    """Return what `get_interface` returns; None for an unknown name, without a look for others.

    If the name is ``package/Name``, return the class of the first kind in ``kinds`` that has one.

    Raises:
        InvalidInterface: if the interface's file is malformed.
    """
    found = (look_up(name, ()) for name in full_names(type_name, kinds))
    return next((each for each in found if each is not None), None)


def find_interface(type_name: str) -> Interface:
    """Return the class of `get_interface`; if there is none, the newest class that was learned.

    Raises:
        UnknownInterface: if the name is unknown; the error suggests the most similar name.
        InvalidInterface: if the interface's file is malformed.
    """
    return next(known_classes(type_name), None) or get_interface(type_name)


def learned_classes(type_name: str) -> Iterator[Interface]:
    """Yield the classes of this name that were learned, alone or inside another one."""
    from turtleact.interfaces.type_hash import referenced  # most programs learn nothing

    for held, _ in reversed(list(REGISTRY.learned.values())):
        found = {held.type_name: held} | referenced(held)
        if type_name in found:
            yield found[type_name]


def get_action(type_name: str) -> type[DynamicAction]:
    """Return the class of an action, by its full name or by ``package/Name``; see `get_interface`.

    Type checkers allow any fields in the action's messages, so you need no cast.

    Raises:
        UnknownInterface: if the name is unknown; the error suggests the most similar name.
        InvalidInterface: if the name belongs to a message or a service, or the interface's file is
            malformed.
    """
    return of_kind(needed(installed_class(type_name, ("action", "msg", "srv")), type_name), Action)  # type: ignore[return-value]  # DynamicAction is no more than Action


def get_message(type_name: str) -> type[DynamicMessage]:
    """Return the class of a message by name; see `get_action` for names and errors."""
    return of_kind(needed(installed_class(type_name, ("msg", "srv", "action")), type_name), Message)  # type: ignore[return-value]  # as above


def get_service(type_name: str) -> type[DynamicService]:
    """Return the class of a service by name; see `get_action` for names and errors."""
    return of_kind(needed(installed_class(type_name, ("srv", "msg", "action")), type_name), Service)  # type: ignore[return-value]  # as above


def load_interface(source: str | Path, *, type_name: str = "") -> Interface:
    """Return the class of an interface in a file or text.

    Args:
        source: The path of a .msg, .srv or .action file, or the text itself.
        type_name: The full name, ``package/kind/Name``. You may leave it out for a file at
            ``PACKAGE/KIND/NAME.EXT``.

    Raises:
        InvalidInterface: if the name is missing, or the source is malformed or cannot be read. The
            exception gives the file, line and column of an error in the text.

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

    Type checkers allow any fields in the action's messages, so you need no cast.

    Raises:
        InvalidInterface: as in `load_interface`, and if the source is a message or a service.

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
    """Make the interface files in a folder known, and return the names of their interfaces.

    The folder may be a package, or may contain several packages, as the ``src`` of a workspace
    does. It may also be a prefix such as ``/opt/ros/jazzy``, which has packages in ``share``, or
    may contain several prefixes, as colcon's ``install`` does. Inside a package, a file has the
    path ``KIND/NAME.EXT``.

    A file is read at once if its interface already has a class that the program declared or loaded.
    If the class has another definition, the file replaces it. Any other file is read when its
    interface is first used.

    Raises:
        InvalidInterface: if the folder does not exist, a file's name is not an interface name, or a
            file that is read at once is malformed.
    """
    root = Path(folder)
    if not root.is_dir():
        raise InvalidInterface("no such folder", source=str(folder))
    found = interface_files(root)
    found |= {file_name(path): path for path in files_in(root, *LAYOUTS)}
    finders = REGISTRY.finders
    REGISTRY.look_in(replace(finders, loaded=Files({**finders.loaded.files, **found})))
    for name, path in found.items():
        held = REGISTRY.get(name)
        if held is not None and parse(read(path), name, source=str(path)) != definition(held):
            REGISTRY.forget(name)
    return tuple(sorted(found))


def load_workspace(*prefixes: str | Path) -> None:
    """Make the interfaces of installed ROS packages known.

    When an interface is first used, the prefixes are searched for its file,
    ``share/PACKAGE/KIND/NAME.EXT``. If a file and a built-in interface have different definitions,
    the file is used. A prefix that does not exist is ignored, as in ROS.

    Args:
        prefixes: The folders to search, for example those in ``AMENT_PREFIX_PATH``. If two folders
            have the same interface, the file in the first folder is used. Empty strings are
            ignored.
    """
    added = [str(prefix) for prefix in prefixes if prefix]
    finders = REGISTRY.finders
    folders = tuple(dict.fromkeys((*finders.workspace.prefixes, *added)))
    REGISTRY.look_in(replace(finders, workspace=Workspace(folders)))


def offer_interfaces(
    files: Mapping[str, Path], on_use: Callable[[str, str], object] | None = None
) -> None:
    """Register the interface files that `turtleact.interfaces.finders` has found.

    A file is read when its interface is first used, so a malformed file raises no error before
    then. If a file and a built-in interface have different definitions, the file is used.

    Args:
        files: The file of each interface, by type name.
        on_use: Called with the type name and the file whenever a file is used for the first time.
    """
    finders = REGISTRY.finders
    REGISTRY.look_in(replace(finders, nearby=Files({**finders.nearby.files, **files}, on_use)))


def known_interfaces() -> tuple[str, ...]:
    """Return the names of all available interfaces, without derived types such as ``NAME_Goal``."""
    names = set(REGISTRY.names()).union(*(finder.names() for finder in REGISTRY.finders))
    return tuple(sorted(name for name in names if owner_and_part(name)[0] not in names))


def interface_text(cls: Interface) -> str:
    """Return the text of an interface class, as a .msg, .srv or .action file would contain it.

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
    """Return the text of an interface as its author wrote it, or a generated text.

    The text is generated if the interface has no file. If an installed file and the built-in file
    have the same definition, the installed file is used, because it has comments.

    Raises:
        UnknownInterface: if the name is unknown; the error suggests the most similar name.
        InvalidInterface: if the interface's file is malformed.
    """
    return text_of(get_interface(type_name))


def text_of(cls: Interface) -> str:
    """Return the text of an interface as its author wrote it, or else a generated text."""
    return authored_text(cls) or interface_text(cls)


def authored_text(cls: Interface) -> str:
    """Return the text of an interface as its author wrote it.

    The text is empty if the interface has no file with the same definition. The text of a learned
    class came with it.

    Raises:
        InvalidInterface: if a file of this name is malformed.
    """
    if cls in REGISTRY.texts:
        return REGISTRY.texts[cls]
    said, name = definition(cls), cls.type_name
    found = [finder.find(name) for finder in REGISTRY.finders]
    own = [file for file in found if file is not None and not isinstance(file, type)]
    for file in filter(None, [*own, built_in_file(name)]):
        text = read(file)
        if parse(text, name, source=str(file)) == said:
            return text
    return ""


def comments(cls: type[Message]) -> dict[str, str]:
    """Return the comments on a message's fields, by field name.

    A comment in a file takes precedence over one in a docstring.

    >>> class Move(Message, type_name="example_msgs/msg/Move"):
    ...     '''A move.
    ...
    ...     Attributes:
    ...         speed: How fast to go
    ...             at most (m/s).
    ...     '''
    ...
    ...     speed: float = 1.0
    >>> comments(Move)
    {'speed': 'How fast to go at most (m/s).'}
    """
    whole, _, part = cls.type_name.rpartition("_")
    index = SECTIONS.get(part)
    if index is None or whole.count("/") != 2:
        whole, index = cls.type_name, 0
    text = REGISTRY.texts.get(cls)
    found = _in_file(whole) if text is None else read_comments(text, whole)
    return _in_docstring(cls) | (found[index].texts() if found else {})


SECTIONS = {"Goal": 0, "Result": 1, "Feedback": 2, "Request": 0, "Response": 1}


def introduction(cls: type[Message | Service | Action]) -> str:
    """Return what an interface is for: the first paragraph of its docstring.

    The text is empty if the class has no docstring of its own.
    """
    doc = inspect.cleandoc(cls.__dict__.get("__doc__") or "")
    return " ".join(doc.partition("\n\n")[0].split())


def commented_text(cls: Interface) -> str:
    """Return the text of an interface with its comments.

    If the interface has a file, the text is that of the file. If there is no file, the text is
    generated, with the comments from the docstrings of the classes.

    >>> class Move(Message, type_name="example_msgs/msg/Move"):
    ...     '''A move.
    ...
    ...     Attributes:
    ...         speed: How fast to go (m/s).
    ...     '''
    ...
    ...     speed: float = 1.0
    >>> print(commented_text(Move))
    # A move.
    <BLANKLINE>
    # How fast to go (m/s).
    float64 speed 1.0
    """
    text = authored_text(cls)
    if text:
        return text
    if issubclass(cls, Message):
        return "\n".join(_part_text(cls))
    first, *rest = map(_part_text, parts(cls))
    lines = [*_set_off(introduction(cls)), *first]
    for part in rest:
        lines += ["---", *part]
    return "\n".join(lines)


def _part_text(cls: type[Message]) -> list[str]:
    """Return the lines of one part of an interface, with the comments from its docstring."""
    part, notes = definition(cls), _in_docstring(cls)
    lines = _set_off(introduction(cls))
    names = [*(each.name for each in part.constants), *(each.name for each in part.fields)]
    for name, line in zip(names, part_lines(part), strict=True):
        lines += [*_as_comment(notes.get(name, "")), line]
    return lines


def _set_off(text: str) -> list[str]:
    """Return a text as comment lines and an empty line. An empty text gives no lines."""
    return [*_as_comment(text), ""] if text else []


def _as_comment(text: str) -> list[str]:
    """Wrap a text into lines that begin with ``#``. Double backticks become single ones."""
    plain = text.replace("``", "`")
    return textwrap.wrap(plain, WIDTH, initial_indent="# ", subsequent_indent="# ")


def _in_docstring(cls: type[Message]) -> dict[str, str]:
    doc = inspect.cleandoc(cls.__doc__ or "")
    found: dict[str, str] = {}
    name = ""
    for line in doc.partition("Attributes:\n")[2].splitlines():
        begun = attribute_pattern.fullmatch(line)
        if begun:
            name = begun[1]
            found[name] = begun[2]
        elif not line.startswith(" " * 8):
            break
        else:
            found[name] += f" {line.strip()}"
    return found


@cache
def _in_file(type_name: str) -> tuple[Comments, ...]:
    """Return the comments in an interface's file."""
    try:
        return read_comments(interface_source(type_name), type_name)
    except TurtleactError:  # the class was made by hand, or the type is derived
        return ()


def class_of(definition: Definition) -> Interface:
    """Return the class for a definition.

    If a known class has the same definition, that class is returned.

    Raises:
        InvalidInterface: if the definition uses an unknown message, or a message contains itself.
    """
    return same_built_in(definition) or build(definition, ())


def same_built_in(wanted: Definition) -> Interface | None:
    """Return the built-in class of that name if it has the same definition, or None."""
    found = built_in_class(wanted.type_name)
    return found if found is not None and definition(found) == wanted else None


def build(definition: Definition, making: tuple[str, ...]) -> Interface:
    """Make the class for a definition, and the classes of the messages in it.

    Args:
        definition: The definition of the interface.
        making: The names of the interfaces that contain this one and are still being made.
    """

    def find(type_name: str) -> Interface:
        return needed(look_up(type_name, (*making, definition.type_name)), type_name)

    made = make_interface(definition, find)
    return REGISTRY.get(definition.type_name) or made


def look_up(type_name: str, making: tuple[str, ...]) -> Interface | None:
    """Return the class with this full name, or None. If necessary, make the class from its file."""
    if type_name in making:
        circle = " in ".join([type_name, *reversed(making[making.index(type_name) :])])
        raise InvalidInterface(f"a message contains itself: {circle}", source=making[0])
    owner, part = owner_and_part(type_name)
    found = part_of(look_up(owner, making), part) if part else None
    found = found or REGISTRY.get(type_name)
    if found is None:
        found = found_by_finders(type_name, making)
    return found


def found_by_finders(type_name: str, making: tuple[str, ...]) -> Interface | None:
    """Return the class that the first finder gives, and register it; None if no finder has one."""
    for finder in REGISTRY.finders:
        found = finder.find(type_name)
        if found is None:
            continue
        if not isinstance(found, type):
            on_use = finder.on_use if isinstance(finder, Files) else None
            found = made_from(found, type_name, making, on_use)
        REGISTRY.add(found, definition(found))
        return found
    return None


def made_from(
    file: Path,
    type_name: str,
    making: tuple[str, ...],
    on_use: Callable[[str, str], object] | None,
) -> Interface:
    """Make the class of an interface from its file, or return the built-in class that equals it."""
    said = parse(read(file), type_name, source=str(file))
    built_in = same_built_in(said)
    if built_in is not None:
        return built_in
    if on_use is not None:
        on_use(type_name, str(file))
    return build(said, making)


B = TypeVar("B", Message, Service, Action)
NOUNS = {Message: "message", Service: "service", Action: "action"}


def of_kind(interface: Interface, base: type[B]) -> type[B]:
    """Return the interface if it derives from ``base``; otherwise raise an error."""
    if issubclass(interface, base):
        return interface
    [kind] = [each for each in NOUNS if issubclass(interface, each)]
    problem = f"is a {NOUNS[kind]}, not a {NOUNS[base]}".replace("a action", "an action")
    hint = f"use get_{NOUNS[kind]} or load_{NOUNS[kind]}"
    raise InvalidInterface(f"{problem}: {hint}", source=interface.type_name)


def full_names(type_name: str, kinds: tuple[str, ...]) -> list[str]:
    """Return the valid full names that a name may stand for.

    For a full name, the result contains only the name itself. For ``package/Name``, the result
    contains one full name of each kind.
    """
    package, _, name = type_name.partition("/")
    candidates = [type_name] if "/" in name else [f"{package}/{kind}/{name}" for kind in kinds]
    return [name for name in candidates if type_name_pattern.fullmatch(name)]


def needed(found: Interface | None, type_name: str) -> Interface:
    """Return the interface if it was found; otherwise raise an error that suggests a name."""
    if found is None:
        raise UnknownInterface(type_name, suggestion(type_name))
    return found


def suggestion(type_name: str) -> str:
    """Return the name of the known interface that was most likely meant, or an empty string.

    Its name must be similar even without the package, because packages often have similar names.
    """
    name = _last(type_name)
    return nearest(type_name, [each for each in known_interfaces() if nearest(name, [_last(each)])])


def _last(type_name: str) -> str:
    """Return the name of an interface without package and kind."""
    return type_name.rpartition("/")[2]


def as_path(source: str | Path) -> Path | None:
    """Return the path if the source is a path, or None if it is the text of an interface."""
    if isinstance(source, Path):
        return source
    is_path = "\n" not in source and source.endswith(tuple(f".{kind}" for kind in KINDS))
    return Path(source) if is_path else None


def file_name(path: Path) -> str:
    """Return the full name of an interface, derived from its file's path.

    Raises:
        InvalidInterface: if the path gives no valid name. The error suggests how to name the file.
    """
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
    """Return the type name if it is not empty; otherwise raise an error that asks for it."""
    if not type_name:
        problem = (
            'give its full name: type_name="package_name/action/InterfaceName" '
            "(or keep the file at PACKAGE/KIND/NAME.EXT)"
        )
        raise InvalidInterface(problem, source=source)
    return type_name


def read(file: Path) -> str:
    """Read the text of a file."""
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidInterface(f"cannot be read: {error}", source=str(file)) from error
