"""Makes classes from the description of a type that another node has sent, and keeps them.

A description has the fields of a type and of all types in it, but no constants and no comments.
Those are in the text of the interface, which a node may send too. Nothing here is trusted:
`LearnedTypes` refuses a description that is too large, contains itself, or has names or types that
no interface file may have. The caller compares the hash of the class with the hash that it asked
for.

The classes are not registered, so `get_interface` never returns them. A message in a learned type
is made only if it differs from the one that is known here. So a learned goal takes the poses that
the program already has.

The user's cache folder has one file for each type name and hash, with the description of the type
and the texts that came with it. Defaults are left out, because the hash does not cover them:
another node of the same hash may have others. A file is verified again whenever it is read, so a
file that was changed or that lies under a wrong name is not used.

Source: REP 2016; ``type_description_interfaces/msg/FieldType.msg``; for the text of defaults,
``rosidl_generator_type_description/__init__.py``.
"""

from __future__ import annotations

import ast
import json
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple, cast

from turtleact.errors import InvalidInterface, InvalidMessage, TurtleactError
from turtleact.interfaces.classes import make_interface, make_message
from turtleact.interfaces.conversion import from_dict, to_dict
from turtleact.interfaces.definition import (
    ArrayForm,
    CompoundDefinition,
    Field,
    FieldType,
    MessageDefinition,
    Primitive,
    parts_of,
    type_name_pattern,
)
from turtleact.interfaces.loading import installed_class
from turtleact.interfaces.parse import literal, parse
from turtleact.interfaces.standard.type_description_interfaces.msg import (
    IndividualTypeDescription,
    TypeSource,
)
from turtleact.interfaces.type_hash import (
    BOUNDED_STRING,
    FORM_IDS,
    NESTED_ID,
    PLACEHOLDER,
    TYPE_IDS,
    field_type,
    type_hash,
)
from turtleact.interfaces.types import (
    PARTS,
    REGISTRY,
    Interface,
    Message,
    definition,
    fields,
    nested_classes,
)
from turtleact.interfaces.values import converter

if TYPE_CHECKING:
    from turtleact.interfaces.standard.type_description_interfaces import msg

__all__ = [
    "Known",
    "LearnedTypes",
    "cached",
    "cached_names",
    "cached_types",
    "default_text",
    "keep",
    "remember",
]

MOST_TYPES: Final = 1_000
MOST_FIELDS: Final = 10_000
LONGEST_TEXT: Final = 1_000_000
"""The most characters that the texts and defaults of a description may have together."""

DEEPEST: Final = 50
"""How deep messages may be nested. In ROS's own packages, no message is nested deeper than 8."""

LONGEST_FILE: Final = 4_000_000
"""The most bytes of a file that is read."""

LARGEST: Final = 1_000_000
"""The most values that a new message may have: the arrays of fixed length, multiplied."""

FORMS: Final = {number // 48: form for form, number in FORM_IDS.items()}
NAMES: Final = {number: name for name, number in TYPE_IDS.items() if name != "char"}

UNREADABLE: Final = {
    12: "long double",
    13: "the char of IDL",
    14: "wchar",
    19: "a string of fixed length",
    20: "a wstring of fixed length",
}
"""Types that no .msg file has and that turtleact cannot encode."""


class LearnedTypes:
    """The types in one description, and the classes made from them.

    Args:
        described: The descriptions of an interface and of all types in it.
        sources: The texts of these types. A text that does not fit its description is not used.
        with_defaults: Whether fields get the defaults in the description and the texts. Without, a
            field starts with zero, unless its message is known here.

    Attributes:
        has_own_defaults: Whether a class that was made, not known, has a default.

    Raises:
        InvalidInterface: if the description is too large.
    """

    def __init__(
        self,
        described: Iterable[msg.IndividualTypeDescription],
        sources: Iterable[msg.TypeSource] = (),
        *,
        with_defaults: bool = True,
    ) -> None:
        self._described = {each.type_name: each for each in described}
        self._texts = {each.type_name: each for each in sources}
        self._with_defaults = with_defaults
        self._check_size()
        self._written = self._read_texts()
        self._made: dict[str, type[Message]] = {}
        self._making: list[str] = []
        self._sizes: dict[str, int] = {}
        self.has_own_defaults = False

    def interface(self, type_name: str) -> Interface:
        """Return the class of the message, service or action with this name.

        Raises:
            InvalidInterface: if the description cannot be that of an interface. The error names the
                type and the field.
        """
        said = self._described.get(type_name)  # not that of an action, only of its parts
        is_service = said is not None and "request_message" in [each.name for each in said.fields]
        if (said is not None and not is_service) or "/msg/" in type_name:
            return self._message(type_name)
        names = PARTS["srv" if is_service else "action"]
        whole = tuple(self._definition(f"{type_name}_{part}") for part in names)
        definition = CompoundDefinition(type_name, whole)
        made = make_interface(definition, self._message, register=False)
        self._keep(made, *(getattr(made, part) for part in names))
        return made

    def _message(self, type_name: str) -> type[Message]:
        """Return the class of a message: the one that is known here, or a new one."""
        if type_name in self._made:
            return self._made[type_name]
        if type_name in self._making:
            raise InvalidInterface("a message contains itself", source=type_name)
        if len(self._making) == DEEPEST:
            problem = f"messages are nested more than {DEEPEST} deep"
            raise InvalidInterface(problem, source=type_name)
        self._making.append(type_name)
        made = make_message(self._definition(type_name), self._message, register=False)
        self._making.pop()
        known = self._known(made)
        if known is None:
            self._keep(made)
        self._made[type_name] = known or made
        return known or made

    def _definition(self, type_name: str) -> MessageDefinition:
        """Return the definition of a message or of a part, with the constants of its text."""
        said = self._described.get(type_name)
        if said is None:
            raise InvalidInterface("it is used, but not described", source=type_name)
        rows = [each for each in said.fields if each.name != PLACEHOLDER.name]
        found = tuple(self._field(type_name, each) for each in rows)
        written = self._written.get(type_name)
        if written is None or _shape(written.fields) != _shape(found):
            return MessageDefinition(type_name, found)
        # The text of a default is exact; the description of a text in ROS 2 garbles some letters.
        return (
            written
            if self._with_defaults
            else MessageDefinition(type_name, found, written.constants)
        )

    def _field(self, owner: str, said: msg.Field) -> Field:
        kind = _type_of(said.type, f"{owner}, field '{said.name}'")
        each = 1
        if kind.is_nested:
            self._message(kind.name)
            each = self._sizes.get(kind.name, 1)
        size = self._sizes.get(owner, 0) + each * (kind.size if _is_fixed(kind) else 1)
        if size > LARGEST:
            raise InvalidInterface(f"it has more than {LARGEST:,} values", source=owner)
        self._sizes[owner] = size
        return Field(said.name, kind, self._default(kind, said.default_value))

    def _default(self, kind: FieldType, text: str) -> Primitive | tuple[Primitive, ...] | None:
        """Return the default in a description; None if there is none, or if it cannot be read."""
        if not text or kind.is_nested or not self._with_defaults:
            return None
        try:
            value = ast.literal_eval(text) if kind.is_sequence else literal(text, kind)
            checked = converter(kind)(value)
        except (ValueError, SyntaxError, TypeError, RecursionError, MemoryError, InvalidMessage):
            return None
        return tuple(checked) if isinstance(checked, list | bytes) else cast("Primitive", checked)

    def _known(self, made: type[Message]) -> type[Message] | None:
        """Return the class of this name that is known here, if the two do not differ."""
        try:
            known = installed_class(made.type_name)
        except InvalidInterface:
            return None
        if known is None or not issubclass(known, Message):
            return None
        ours, theirs = fields(known), fields(made)
        is_same = _shape(ours) == _shape(theirs) and nested_classes(known) == nested_classes(made)
        defaults_fit = _defaults(ours) == _defaults(theirs) or not self._with_defaults
        return known if is_same and defaults_fit else None

    def _keep(self, made: Interface, *parts: type[Message]) -> None:
        """Keep the text of a new class, and look whether the class has defaults."""
        said = [definition(each) for each in parts or (cast("type[Message]", made),)]
        self.has_own_defaults |= any(any(_defaults(each.fields)) for each in said)
        written = [self._written.get(each.type_name) for each in said]
        if all(
            one and _shape(one.fields) == _shape(each.fields)
            for one, each in zip(written, said, strict=True)
        ):
            text = self._texts[made.type_name].raw_file_contents
            REGISTRY.texts |= dict.fromkeys((made, *parts), text)

    def _read_texts(self) -> dict[str, MessageDefinition]:
        """Return the definitions of all messages and parts whose texts can be parsed."""
        found: dict[str, MessageDefinition] = {}
        for name, source in self._texts.items():
            if f"/{source.encoding}/" in name:
                with suppress(InvalidInterface):
                    parts = parts_of(parse(source.raw_file_contents, name))
                    found |= {part.type_name: part for part in parts}
        return found

    def _check_size(self) -> None:
        types = self._described.values()
        lengths = [len(each.raw_file_contents) for each in self._texts.values()]
        lengths += [len(field.default_value) for each in types for field in each.fields]
        for count, most, what in (
            (len(self._described), MOST_TYPES, "types"),
            (sum(len(each.fields) for each in types), MOST_FIELDS, "fields"),
            (sum(lengths), LONGEST_TEXT, "characters of text"),
        ):
            if count > most:
                problem = f"its description has more than {most:,} {what}"
                raise InvalidInterface(problem, source=next(iter(self._described), ""))


def default_text(default: Primitive | tuple[Primitive, ...] | None) -> str:
    """Return a default as a description has it; empty if there is none."""
    return "" if default is None else str(default)


def _type_of(said: msg.FieldType, where: str) -> FieldType:
    form_number, number = divmod(said.type_id, 48)
    if number in UNREADABLE:
        problem = f"its type is {UNREADABLE[number]}, which turtleact cannot encode"
        raise InvalidInterface(problem, source=where)
    has_bound = number - BOUNDED_STRING in (TYPE_IDS["string"], TYPE_IDS["wstring"])
    name = NAMES.get(number - BOUNDED_STRING * has_bound, "")
    if number == NESTED_ID:
        name = said.nested_type_name
    if not name or form_number not in FORMS:
        raise InvalidInterface(f"its type {said.type_id} is not a type of ROS 2", source=where)
    bound = said.string_capacity if has_bound else None
    return FieldType(name, bound, FORMS[form_number], said.capacity)


def _is_fixed(kind: FieldType) -> bool:
    return kind.form is ArrayForm.FIXED


def _shape(members: Iterable[Field]) -> list[tuple[str, object]]:
    """Return what the hash of a message covers: the names and types of its fields."""
    return [(each.name, field_type(each.type)) for each in members]


def _defaults(members: Iterable[Field]) -> list[str]:
    return [default_text(each.default) for each in members]


class Known(NamedTuple):
    """A learned type, as the cache has it.

    Attributes:
        interface: The class.
        type_hash: The hash of the class.
        node: The node that described it.
        described: The descriptions of the type and of all types in it.
        sources: Their texts.
        has_own_defaults: Whether the node also sent defaults, which the cache does not keep.
    """

    interface: Interface
    type_hash: str
    node: str
    described: tuple[IndividualTypeDescription, ...]
    sources: tuple[TypeSource, ...] = ()
    has_own_defaults: bool = False


def folder() -> Path:
    """Return the folder with the files of all learned types."""
    import platformdirs  # only this module needs it

    return platformdirs.user_cache_path("turtleact") / "types"


def keep(known: Known) -> None:
    """Write a learned type to the cache. If that fails, it is learned again the next time."""
    described = [to_dict(each) for each in known.described]
    for each in described:
        for field in each["fields"]:  # type: ignore[attr-defined]  # a list of dicts
            field["default_value"] = ""
    content = {
        "node": known.node,
        "has_own_defaults": known.has_own_defaults,
        "types": described,
        "sources": [to_dict(each) for each in known.sources],
    }
    path = folder() / known.interface.type_name / f"{known.type_hash}.json"
    part = path.with_suffix(".part")
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_text(json.dumps(content), "utf-8")
        part.replace(path)


def remember(known: Known) -> Interface:
    """Keep a learned type for this process, and return its class."""
    holder = known.node if known.has_own_defaults else ""
    REGISTRY.learned[known.interface.type_name, known.type_hash] = known.interface, holder
    return known.interface


def cached(type_name: str) -> Iterator[Known]:
    """Yield every version of a type that the cache has, the one that was learned last first."""
    if type_name_pattern.fullmatch(type_name):
        files = (folder() / type_name).glob("RIHS01_*.json")
        for path in sorted(files, key=_changed, reverse=True):
            with suppress(OSError, ValueError, KeyError, TypeError, TurtleactError):
                yield _read(path, type_name)


def cached_names() -> list[str]:
    """Return the names of all types in the cache, sorted."""
    root = folder()
    names = ("/".join(path.relative_to(root).parts) for path in root.glob("*/*/*"))
    return sorted(name for name in names if type_name_pattern.fullmatch(name))


def cached_types() -> Iterator[Known]:
    """Yield all learned types in the cache, sorted by name."""
    for name in cached_names():
        yield from cached(name)


def _read(path: Path, type_name: str) -> Known:
    if path.stat().st_size > LONGEST_FILE:
        raise ValueError(path)
    content = json.loads(path.read_text("utf-8"))
    described = tuple(from_dict(IndividualTypeDescription, each) for each in content["types"])
    sources = tuple(from_dict(TypeSource, each) for each in content["sources"])
    types = LearnedTypes(described, sources, with_defaults=False)
    interface = types.interface(type_name)
    if type_hash(interface) != path.stem:
        raise ValueError(path)
    node, has_own = str(content["node"]), bool(content["has_own_defaults"])
    return Known(interface, path.stem, node, described, sources, has_own)


def _changed(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0
