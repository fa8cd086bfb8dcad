"""Makes and reads the schema of a topic: the definitions of its type and of all nested types.

In a schema, a type is written as ``pkg/Name``, both in fields and in headings, because some readers
accept only this form. The topic's own type, called the root, comes first and has no heading. Each
nested type then appears once, after a line of 80 equals signs and a line ``MSG: pkg/Name``.

If the program has a class with the schema's name and layout, messages are decoded with this class.
Otherwise, a class is made from the schema. The new class is not registered, so reading a file does
not change the types that the program knows.

Source: rosbag2 ``docs/message_definition_encoding.md``. Tests with rosbags,
@foxglove/rosmsg and mcap-ros2-support showed what readers accept.
"""

from __future__ import annotations

import re
from typing import Final, cast

import msgspec

from turtleact.errors import InvalidInterface, UnknownInterface
from turtleact.interfaces import Message, get_interface, type_hash
from turtleact.interfaces.classes import make_message
from turtleact.interfaces.definition import MessageDefinition, definition_text
from turtleact.interfaces.parse import parse
from turtleact.interfaces.types import definition, fields, nested_classes

__all__ = ["Schema", "class_of", "schema_of", "short_name"]

SEPARATOR: Final = "=" * 80

SAME: Final = {"byte": "uint8", "char": "uint8"}
"""For each of these types, the type that other writers write instead.

Both types have the same encoding.
"""

FILLER: Final = "structure_needs_at_least_one_member"
"""The field that ROS 2 gives to a message without fields."""

UNDERSCORE: Final = "0x5f"
"""Replaces ``_`` in type names during parsing, because the parser refuses names with ``_``."""

_PART = re.compile(r"^\s*(?:\w+/)*[A-Z][A-Za-z0-9]*_\w+", re.MULTILINE)
_HEADING = re.compile(rf"^{SEPARATOR}\r?\nMSG: *(\S+)[^\n]*\n?", re.MULTILINE)


class Schema(msgspec.Struct, frozen=True):
    """The definition of a type in a file.

    Attributes:
        name: The full name, ``pkg/kind/Name``.
        encoding: The format of ``text``; empty if there is no text. This module can read only
            ``"ros2msg"``.
        text: The definitions of the type and of all nested types.
    """

    name: str
    encoding: str = ""
    text: str = ""


def schema_of(cls: type[Message]) -> Schema:
    """Return the schema of a message class.

    >>> from turtleact.interfaces.standard import Time
    >>> print(schema_of(Time).text)
    int32 sec
    uint32 nanosec
    """
    found = dict[str, type[Message]]()
    _collect(cls, found)
    [root, *others] = found.values()
    texts = [_text(root)]
    texts += [f"{SEPARATOR}\nMSG: {short_name(each.type_name)}\n{_text(each)}" for each in others]
    return Schema(cls.type_name, "ros2msg", "\n".join(texts))


def class_of(schema: Schema, known_hash: str = "") -> type[Message] | None:
    """Return the class that decodes the messages of a schema; None if they cannot be decoded.

    Args:
        schema: The schema.
        known_hash: The type hash in the file, or empty. This argument matters only if the schema
            has no text in the format ``"ros2msg"``. The function then returns the program's own
            class with the schema's name, if there is one. The type hash of this class must equal
            ``known_hash``, unless ``known_hash`` is empty.
    """
    known = _known(schema.name)
    if schema.encoding == "ros2msg" and schema.text:
        try:
            return _from_text(schema, known)
        except (InvalidInterface, UnknownInterface, RecursionError, ValueError):
            return None
    if known is not None and known_hash and type_hash(known) != known_hash:
        return None
    return known


def short_name(name: str) -> str:
    """Return the name of a type without its kind.

    >>> short_name("geometry_msgs/msg/Point"), short_name("Point")
    ('geometry_msgs/Point', 'Point')
    """
    package, slash, rest = name.partition("/")
    return f"{package}/{rest.rpartition('/')[2]}" if slash else name


def _collect(cls: type[Message], found: dict[str, type[Message]]) -> None:
    """Add a class and the classes of its fields to ``found``, in the order of their first use."""
    if cls.type_name in found:
        return
    found[cls.type_name] = cls
    for nested in nested_classes(cls):
        if nested is not None:
            _collect(nested, found)


def _text(cls: type[Message]) -> str:
    """Return the definition of one type as text.

    If the text cannot express one of the default values, all of them are left out.
    """
    said = definition(cls)
    spelled = [
        msgspec.structs.replace(
            field, type=msgspec.structs.replace(field.type, name=short_name(field.type.name))
        )
        for field in said.fields
    ]
    try:
        return definition_text(msgspec.structs.replace(said, fields=tuple(spelled)))
    except InvalidInterface:
        bare = [msgspec.structs.replace(field, default=None) for field in spelled]
        return definition_text(MessageDefinition(said.type_name, tuple(bare)))


def _known(name: str) -> type[Message] | None:
    """Return the message class that the program knows by this name, or None."""
    try:
        found = get_interface(name)
    except (UnknownInterface, InvalidInterface):
        return None
    return found if issubclass(found, Message) else None


def _from_text(schema: Schema, known: type[Message] | None) -> type[Message]:
    """Return ``known`` if it has the layout of the schema; otherwise make a class from the schema.

    Raises:
        InvalidInterface: if the text is malformed, or a type in it contains itself.
        UnknownInterface: if the text uses a type that neither the text nor the program defines.
    """
    root, *rest = _HEADING.split(schema.text)
    texts = {short_name(name): text for name, text in zip(rest[::2], rest[1::2], strict=True)}
    made = _Making(schema.name, texts).make(schema.name, root)
    return known if known is not None and _layout(known) == _layout(made) else made


class _Making:
    """Makes the classes of one schema.

    Args:
        root: The full name of the topic's own type, ``pkg/kind/Name``. In the schema, names of
            other types lack the kind. The kind of ``root`` also applies to other types of the same
            action or service, such as ``Name_Goal``. All remaining types have the kind ``msg``.
        texts: The definitions of the other types, by their names ``pkg/Name``.
    """

    def __init__(self, root: str, texts: dict[str, str]) -> None:
        self._package, self._kind, own = root.split("/")
        self._owner = own.partition("_")[0]
        self._texts = texts
        self._made = dict[str, type[Message]]()
        self._making = set[str]()

    def make(self, name: str, text: str) -> type[Message]:
        """Make a class from a type's full name and its definition."""
        package, _, own = name.split("/")
        # The parser reads a .msg, whatever the type belongs to.
        plain = _PART.sub(lambda found: found[0].replace("_", UNDERSCORE), text)
        said = cast("MessageDefinition", parse(plain, f"{package}/msg/{own}", source=name))
        said = msgspec.structs.replace(said, type_name=name)
        return make_message(said, self._find, register=False)

    def _find(self, name: str) -> type[Message]:
        name = name.replace(UNDERSCORE, "_")
        short = short_name(name)
        if short not in self._texts:
            found = _known(name)
            if found is None:
                raise UnknownInterface(name, "")
            return found
        if short not in self._made:
            if short in self._making:
                raise InvalidInterface(f"a message contains itself: {short}", source=short)
            self._making.add(short)
            self._made[short] = self.make(self._full(short), self._texts[short])
        return self._made[short]

    def _full(self, short: str) -> str:
        package, own = short.split("/")
        is_part = package == self._package and own.startswith(f"{self._owner}_")
        return f"{package}/{self._kind if is_part else 'msg'}/{own}"


def _layout(cls: type[Message]) -> tuple[object, ...]:
    """Return the layout of a message: the names of its fields, and how their bytes are decoded."""
    pairs = zip(fields(cls), nested_classes(cls), strict=True)
    return tuple(
        (
            field.name,
            field.type.form,
            field.type.size,
            field.type.string_bound,
            SAME.get(field.type.name, field.type.name) if nested is None else _layout(nested),
        )
        for field, nested in pairs
        if field.name != FILLER
    )
