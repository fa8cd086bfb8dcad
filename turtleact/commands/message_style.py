"""How the ``echo`` verbs print messages: as YAML or comma-separated, in full or in part.

Source: rosidl_runtime_py ``convert.py``; recordings of ROS 2 Jazzy.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from turtleact.commands.message_text import yaml_lines
from turtleact.interfaces import to_dict
from turtleact.interfaces.definition import ArrayForm
from turtleact.interfaces.text import flow
from turtleact.interfaces.types import fields, nested_classes

if TYPE_CHECKING:
    from turtleact.interfaces import Message
    from turtleact.interfaces.definition import FieldType

__all__ = ["Style"]

IDL_NAMES = {
    "bool": "boolean",
    "byte": "octet",
    "char": "uint8",
    "float32": "float",
    "float64": "double",
}
"""Types that have another name in IDL, which ``--no-arr`` prints."""


class Style(NamedTuple):
    """How messages are printed.

    Attributes:
        csv: Whether to print comma-separated values instead of YAML.
        flow: Whether to print YAML on one line.
        longest: The length to which lists and strings are cut; None cuts none.
        arrays: Whether to print the elements of lists, or only their type.
        strings: Whether to print strings, or only their length.
    """

    csv: bool = False
    flow: bool = False
    longest: int | None = 128
    arrays: bool = True
    strings: bool = True

    def values(self, message: Message) -> dict[str, object]:
        """A message as plain values; fields that are left out are only described."""
        values = to_dict(message)
        if self.arrays and self.strings:
            return values
        return self._described(type(message), values)

    def text(self, value: object) -> str:
        """The text of plain values; a YAML document ends with three dashes."""
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


def _kind_of_list(kind: FieldType, length: int) -> str:
    name = IDL_NAMES.get(kind.name, kind.name)
    if kind.form is ArrayForm.FIXED:
        return f"<array type: {name}[{kind.size}]>"
    bound = f"[{kind.size}]" if kind.form is ArrayForm.BOUNDED else ""
    return f"<sequence type: {name}{bound}, length: {length}>"


def _cut(value: object, longest: int) -> object:
    """A value with its lists and strings cut; three dots stand for the rest."""
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
