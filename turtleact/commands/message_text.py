"""Finds the interfaces that verbs need, reads messages that the user writes, and prints messages.

The user writes a message on the command line, in a file or to stdin. The ``echo`` verbs print
messages as YAML or comma-separated values, in full or in part (`Style`). ``topic pub`` and
``service call`` print messages as rclpy's ``repr`` does. In rclpy's notation, fixed-length arrays
look like numpy arrays, but always stay on one line.

Source: rosidl_runtime_py ``convert.py``; rosidl_generator_py ``resource/_msg.py.em`` for the
notation of ``repr``; recordings of ROS 2 Jazzy.
"""

from __future__ import annotations

import os
import sys
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from turtleact.commands.output import note
from turtleact.errors import UsageError
from turtleact.interfaces import (
    Action,
    Service,
    load_interfaces,
    load_workspace,
    offer_interfaces,
    to_dict,
)
from turtleact.interfaces.definition import ArrayForm
from turtleact.interfaces.finders import find_interfaces
from turtleact.interfaces.loading import find_interface
from turtleact.interfaces.text import block, flow, listed
from turtleact.interfaces.types import fields, nested_classes

if TYPE_CHECKING:
    from turtleact.interfaces import Message
    from turtleact.interfaces.definition import Field, FieldType

__all__ = [
    "GoalText",
    "Style",
    "first_message",
    "make_found",
    "make_known",
    "python_text",
    "read_text_file",
    "yaml_lines",
]

MOST = 2**22
"""At most this many bytes of a file or a pipe are read. No valid message is longer."""

IDL_NAMES = {
    "bool": "boolean",
    "byte": "octet",
    "char": "uint8",
    "float32": "float",
    "float64": "double",
}
"""Types that have another name in IDL. ``--no-arr`` prints the names in IDL."""


def make_known(folder: str | None, *, is_silent: bool = False) -> None:
    """Register turtleact's own interfaces, and those that `make_found` registers.

    Args:
        folder: A folder with interface files, or None.
        is_silent: Whether to leave out the note on stderr.

    Raises:
        InvalidInterface: if the folder does not exist.
    """
    for module in ("actions", "sim.world_services"):  # they declare interfaces
        import_module(f"turtleact.{module}")
    make_found(folder, is_silent=is_silent)


def make_found(folder: str | None, *, is_silent: bool = False) -> None:
    """Find and register interfaces in ``folder``, in the workspace and near the working directory.

    If an interface has several definitions, the search order decides: first ``folder``, then the
    sourced workspace, the folders near the working directory, and turtleact itself. When the first
    interface near the working directory is used, a note on stderr says where that interface was
    found.

    Args:
        folder: The folder to search, or None; see `turtleact.interfaces.load_interfaces`.
        is_silent: Whether to leave out the note on stderr.

    Raises:
        InvalidInterface: if the folder does not exist.
    """
    told: list[str] = []

    def tell(type_name: str, file: str) -> None:
        if not told:
            note(f"found {type_name} in {Path(file).absolute().parents[1]}")
        told.append(type_name)

    load_workspace(*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    if found := find_interfaces(Path()):
        offer_interfaces(found, None if is_silent else tell)
    if folder is not None:
        load_interfaces(folder)


def first_message(type_name: str) -> Message:
    """Return an action's goal, a service's request or a message, with default values.

    Raises:
        UnknownInterface: if the name is unknown. The error suggests the nearest name.
    """
    interface = find_interface(type_name)
    if issubclass(interface, Action):
        return interface.Goal()
    return interface.Request() if issubclass(interface, Service) else interface()


class GoalText(NamedTuple):
    """The text of a goal, a request or a message.

    Attributes:
        text: The text, in YAML or JSON.
        source: The name of the text in error messages, such as ``stdin``.
    """

    text: str
    source: str

    @classmethod
    def read(
        cls,
        given: str | None,
        *,
        stdin: bool,
        path: str | None,
        what: str = "goal",
    ) -> GoalText:
        """Read the text from an argument, stdin or a file.

        If there is none of these, the text is ``{}``.

        Args:
            given: The text from the command line; None if there is none.
            stdin: Whether to read stdin.
            path: The file to read; None for no file.
            what: The kind of text: "goal", "request" or "message".

        Raises:
            UsageError: if the text cannot be read, is empty, is too long, or is not UTF-8.
            KeyboardInterrupt: if a signal comes during the reading.
        """
        if path is not None:
            source = path if path.isprintable() else ascii(path)
            text = read_text_file(path, source)
        elif stdin:
            source = "stdin"
            text = _decoded(sys.stdin.buffer.read(MOST + 1), source)
        else:
            text, source = "{}" if given is None else given, what
        if not text.strip():  # the program that should have written it failed
            raise UsageError(f"{source}: is empty; the default {what} is {{}}")
        return cls(text, source)


def read_text_file(path: str, what: str) -> str:
    """Read a file, such as a configuration, and return its text.

    Args:
        path: The path of the file.
        what: The beginning of each error message, which names the option and the file.

    Raises:
        UsageError: if the file cannot be read, is longer than `MOST` bytes, or is not UTF-8.
    """
    try:
        with Path(path).open("rb") as file:
            data = file.read(MOST + 1)
    except OSError as error:
        raise UsageError(f"{what}: cannot be read: {error.strerror}") from None
    return _decoded(data, what)


def _decoded(data: bytes, source: str) -> str:
    if len(data) > MOST:
        raise UsageError(f"{source}: is longer than {MOST} bytes, which no message is")
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        byte = data[error.start]
        raise UsageError(f"{source}: is not UTF-8: byte 0x{byte:02X} at {error.start}") from None


SILENT = frozenset({"float64", "int64", "bool"})
"""The element types that numpy leaves out when it prints an array."""

DTYPES = {"byte": "uint8", "char": "uint8"}
"""Types that have another name in numpy."""


def python_text(message: Message) -> str:
    """Return a message as text, in the notation of rclpy's ``repr``.

    >>> from turtleact.interfaces.standard import Time
    >>> python_text(Time(sec=1))
    'builtin_interfaces.msg.Time(sec=1, nanosec=0)'
    """
    cls = type(message)
    values = ", ".join(
        f"{field.name}={_value(field, getattr(message, field.attribute))}" for field in fields(cls)
    )
    return f"{cls.type_name.replace('/', '.')}({values})"


def yaml_lines(value: object) -> list[str]:
    """Return a dict, list or single value as lines of YAML in block style.

    As in ros2, a single value is printed as in Python, such as ``True``.
    """
    if isinstance(value, dict) and value:
        return block(value)
    if isinstance(value, list | bytes) and value:
        return [line for item in value for line in listed(item)]
    return [str(list(value) if isinstance(value, bytes) else value)]


class Style(NamedTuple):
    """How messages are printed.

    Attributes:
        csv: Whether to print comma-separated values instead of YAML.
        flow: Whether to print YAML on one line.
        longest: How many elements of a list or characters of a string are printed; None for all.
        arrays: Whether to print the elements of lists, or only their type.
        strings: Whether to print strings, or only their length.
    """

    csv: bool = False
    flow: bool = False
    longest: int | None = 128
    arrays: bool = True
    strings: bool = True

    def values(self, message: Message) -> dict[str, object]:
        """Convert a message to a dict.

        Lists and strings that are not printed become texts such as ``<string length: <5>>``.
        """
        values = to_dict(message)
        if self.arrays and self.strings:
            return values
        return self._described(type(message), values)

    def text(self, value: object) -> str:
        """Return a dict or a single value as text. YAML ends with a line of three dashes."""
        if self.longest is not None:
            value = _cut(value, self.longest)
        if self.csv:
            return f"{_csv(value)}\n"
        lines = [flow(value)] if self.flow else yaml_lines(value)
        return "".join(f"{line}\n" for line in (*lines, "---"))

    def _described(self, cls: type[Message], values: dict[str, object]) -> dict[str, object]:
        described = dict(values)
        for field, nested in zip(fields(cls), nested_classes(cls), strict=True):
            value = values[field.name]
            if field.type.is_sequence and not self.arrays:
                described[field.name] = _kind_of_list(field.type, len(value))  # type: ignore[arg-type]  # a list
            elif isinstance(value, str) and not self.strings:
                described[field.name] = f"<string length: <{len(value)}>>"
            elif nested is not None and isinstance(value, dict):
                described[field.name] = self._described(nested, value)
            elif nested is not None and isinstance(value, list):
                described[field.name] = [self._described(nested, each) for each in value]
        return described


def _value(field: Field, value: object) -> str:
    kind = field.type
    if kind.is_nested:
        if not kind.is_sequence:
            return python_text(value)  # type: ignore[arg-type]  # a message, as declared
        return f"[{', '.join(map(python_text, value))}]"  # type: ignore[call-overload]  # likewise
    if kind.is_sequence:
        items = f"[{', '.join(map(repr, value))}]"  # type: ignore[call-overload]  # likewise
        if kind.form is not ArrayForm.FIXED or kind.is_string:
            return items
        name = DTYPES.get(kind.name, kind.name)
        return f"array({items})" if name in SILENT else f"array({items}, dtype={name})"
    return repr(value)


def _kind_of_list(kind: FieldType, length: int) -> str:
    name = IDL_NAMES.get(kind.name, kind.name)
    if kind.form is ArrayForm.FIXED:
        return f"<array type: {name}[{kind.size}]>"
    bound = f"[{kind.size}]" if kind.form is ArrayForm.BOUNDED else ""
    return f"<sequence type: {name}{bound}, length: {length}>"


def _cut(value: object, longest: int) -> object:
    """Shorten lists and strings of more than ``longest`` items, and append three dots to them."""
    if isinstance(value, dict):
        return {name: _cut(item, longest) for name, item in value.items()}
    if isinstance(value, str):
        return value if len(value) <= longest else f"{value[:longest]}..."
    if not isinstance(value, list | bytes):
        return value
    more = ["..."] if len(value) > longest else []
    return [_cut(item, longest) for item in value[:longest]] + more


def _csv(value: object) -> str:
    if isinstance(value, dict):
        return ",".join(map(_csv, value.values()))
    return ",".join(map(_csv, value)) if isinstance(value, list | bytes) else str(value)
