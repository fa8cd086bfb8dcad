"""Describes types as nodes do, makes classes from the descriptions of other nodes, and keeps them.

A description has the fields of a type and of all types in it, but no constants and no comments.
Those are in the text of the interface, which a node may send too. Nothing here is trusted:
`LearnedTypes` refuses a description that is too large, contains itself, or has names or types that
no interface file may have. The caller compares the hash of the class with the hash that it asked
for.

The classes are not registered, so `get_interface` never returns them. A message in a learned type
is made only if it differs from the one that is known here. So a learned goal takes the poses that
the program already has.

Defaults are taken from the text of an interface alone, because the description of a text in ROS 2
garbles some letters.

The user's cache folder has one file for each type name and hash, with the description of the type
and the texts that came with it. A class from there has no defaults, because the hash does not cover
them: another node of the same hash may have others. A file is verified again whenever it is read,
so a file that was changed or that lies under a wrong name is not used.

Source: REP 2016; ``type_description_interfaces/msg/FieldType.msg``.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from turtleact.errors import InvalidInterface, TurtleactError
from turtleact.interfaces.classes import make_interface, make_message
from turtleact.interfaces.conversion import from_dict, to_dict
from turtleact.interfaces.definition import (
    ArrayForm,
    CompoundDefinition,
    Field,
    FieldType,
    MessageDefinition,
    parts_of,
    type_name_pattern,
)
from turtleact.interfaces.loading import installed_class, text_of
from turtleact.interfaces.parse import parse
from turtleact.interfaces.standard.type_description_interfaces.msg import (
    IndividualTypeDescription,
    TypeDescription,
    TypeSource,
)
from turtleact.interfaces.standard.type_description_interfaces.srv import GetTypeDescription
from turtleact.interfaces.type_hash import (
    BOUNDED_STRING,
    FORM_IDS,
    NESTED_ID,
    PLACEHOLDER,
    TYPE_IDS,
    description,
    field_type,
    referenced,
    type_hash,
)
from turtleact.interfaces.types import (
    PARTS,
    REGISTRY,
    Interface,
    Message,
    fields,
    nested_classes,
)

if TYPE_CHECKING:
    from turtleact.interfaces.standard.type_description_interfaces import msg

__all__ = [
    "Known",
    "LearnedTypes",
    "cached",
    "cached_names",
    "cached_types",
    "describe",
    "keep",
    "remember",
]

MOST_TYPES: Final = 1_000
MOST_FIELDS: Final = 10_000
LONGEST_TEXT: Final = 1_000_000
"""The most characters that the texts of a description may have together."""

LARGEST: Final = 1_000_000
"""The most values that the arrays of fixed length may have together."""

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
        with_defaults: Whether fields get the defaults in the texts. Without, a field starts with
            zero, unless its message is known here.

    Attributes:
        has_own_defaults: Whether a class that was made, not known, has a default.

    Raises:
        InvalidInterface: if the description is too large.
    """

    def __init__(
        self,
        described: Iterable[IndividualTypeDescription],
        sources: Iterable[TypeSource] = (),
        *,
        with_defaults: bool = True,
    ) -> None:
        self._described = {each.type_name: each for each in described}
        self._texts = {each.type_name: each for each in sources}
        self._with_defaults = with_defaults
        self._check_size()
        self._written = self._read_texts()
        self._made: dict[str, type[Message] | None] = {}  # None while it is made
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
        made = make_interface(CompoundDefinition(type_name, whole), self._message, register=False)
        self._keep(made, whole, [getattr(made, part) for part in names])
        return made

    def _message(self, type_name: str) -> type[Message]:
        """Return the class of a message: the one that is known here, or a new one."""
        if type_name not in self._made:
            self._made[type_name] = None
            said = self._definition(type_name)
            made = make_message(said, self._message, register=False)
            known = self._known(made)
            if known is None:
                self._keep(made, (said,))
            self._made[type_name] = known or made
        found = self._made[type_name]
        if found is None:
            raise InvalidInterface("a message contains itself", source=type_name)
        return found

    def _definition(self, type_name: str) -> MessageDefinition:
        """Return the definition of a message or of a part, with the constants of its text."""
        said = self._described.get(type_name)
        if said is None:
            raise InvalidInterface("it is used, but not described", source=type_name)
        found = tuple(
            Field(each.name, _type_of(each.type, f"{type_name}, field '{each.name}'"))
            for each in said.fields
            if each.name != PLACEHOLDER.name
        )
        written = self._written.get(type_name)
        if written is None or _shape(written.fields) != _shape(found):
            self._written.pop(type_name, None)
            return MessageDefinition(type_name, found)
        with_defaults = written.fields if self._with_defaults else found
        return MessageDefinition(type_name, with_defaults, written.constants)

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

    def _keep(
        self,
        made: Interface,
        said: tuple[MessageDefinition, ...],
        parts: Iterable[type[Message]] = (),
    ) -> None:
        """Keep the text of a new class, and look whether the class has defaults."""
        self.has_own_defaults |= any(any(_defaults(each.fields)) for each in said)
        if all(each.type_name in self._written for each in said):
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
        fields = [field for each in self._described.values() for field in each.fields]
        texts = [each.raw_file_contents for each in self._texts.values()]
        for count, most, what in (
            (len(self._described), MOST_TYPES, "types"),
            (len(fields), MOST_FIELDS, "fields"),
            (sum(field.type.capacity for field in fields if _is_fixed(field)), LARGEST, "values"),
            (sum(map(len, texts)), LONGEST_TEXT, "characters of text"),
        ):
            if count > most:
                problem = f"its description has more than {most:,} {what}"
                raise InvalidInterface(problem, source=next(iter(self._described), ""))


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


def _is_fixed(said: msg.Field) -> bool:
    return FORMS.get(said.type.type_id // 48) is ArrayForm.FIXED


def _shape(members: Iterable[Field]) -> list[tuple[str, object]]:
    """Return what the hash of a message covers: the names and types of its fields."""
    return [(each.name, field_type(each.type)) for each in members]


def _defaults(members: Iterable[Field]) -> list[str]:
    return ["" if each.default is None else repr(each.default) for each in members]


def describe(found: Interface, *, has_sources: bool) -> GetTypeDescription.Response:
    """Return a node's answer that describes a class, perhaps with the texts of all its types."""
    others = referenced(found)
    types = [found, *(others[name] for name in sorted(others))]
    whole, *nested = [_described(each) for each in types]
    return GetTypeDescription.Response(
        successful=True,
        type_description=TypeDescription(whole, nested),
        type_sources=[_source(each) for each in types] if has_sources else [],
    )


def _described(cls: Interface) -> IndividualTypeDescription:
    said = from_dict(IndividualTypeDescription, description(cls))
    own = fields(cls) if issubclass(cls, Message) else ()
    for row, field in zip(said.fields, own, strict=False):  # an empty message has a row, no field
        row.default_value = "" if field.default is None else str(field.default)
    return said


def _source(cls: Interface) -> TypeSource:
    name = cls.type_name
    _package, kind, last = name.split("/")
    if "_" in last:  # no name in an interface file has one
        return TypeSource(name, "implicit", "")
    return TypeSource(name, kind, text_of(cls))


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
    content = {
        "node": known.node,
        "has_own_defaults": known.has_own_defaults,
        "types": [to_dict(each) for each in known.described],
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
        for path in sorted(files, key=lambda path: path.stat().st_mtime, reverse=True):
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
    content = json.loads(path.read_text("utf-8"))
    described = tuple(from_dict(IndividualTypeDescription, each) for each in content["types"])
    sources = tuple(from_dict(TypeSource, each) for each in content["sources"])
    types = LearnedTypes(described, sources, with_defaults=False)
    interface = types.interface(type_name)
    if type_hash(interface) != path.stem:
        raise ValueError(path)
    node, has_own = str(content["node"]), bool(content["has_own_defaults"])
    return Known(interface, path.stem, node, described, sources, has_own)
