"""Converts messages to YAML or JSON, and back.

YAML 1.1 reads ``no`` as false, ``y`` as true, ``1:30`` as ninety and ``017`` as fifteen. These
conversions must not change a turtle's name or a coordinate in a goal. Therefore this module uses
PyYAML only for YAML's syntax, and decides itself what a word means. A word without quotes is true,
false, null or a number if YAML 1.2 says so, and otherwise text. Dates, for example, are text.
Numbers like ``017`` and ``0o17`` are also text, because YAML 1.1 and YAML 1.2 read these numbers
differently. JSON is parsed as JSON, which is faster than parsing JSON as YAML.

An error names the field, or the line and column in the text.

Source: YAML 1.2.2, section 10.3, the core schema; PyYAML's scanner, parser and composer.
"""

from __future__ import annotations

import json
import math
import re
from contextlib import suppress
from typing import TYPE_CHECKING, NoReturn, TypeVar

import msgspec
import yaml
from yaml.composer import Composer
from yaml.parser import Parser
from yaml.reader import Reader, ReaderError
from yaml.resolver import BaseResolver
from yaml.scanner import Scanner

from turtleact.interfaces.conversion import error_class, from_dict, to_dict
from turtleact.interfaces.types import Message
from turtleact.interfaces.values import Spelled, describe

if TYPE_CHECKING:
    from collections.abc import Iterator

    from yaml.error import Mark
    from yaml.nodes import Node

__all__ = ["from_text", "to_json", "to_yaml"]

M = TypeVar("M", bound=Message)

#: The longest text accepted. PyYAML reads about 200 kB a second, and nobody should wait longer.
MOST_JSON = 2**20
MOST_YAML = 2**17
WORDS = {
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}
NULLS = frozenset({"", "~", "null", "Null", "NULL"})
integer_pattern = re.compile(r"[-+]?(?:0|[1-9][0-9]*)|0x[0-9a-fA-F]+")
#: Python is slow to read longer ones, or refuses them.
LONGEST_INTEGER = 1000
float_pattern = re.compile(
    r"[-+]?(?:(?:0|[1-9][0-9]*)(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
    r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)"
)
#: Text that needs no quotes in any YAML, except for the special words of YAML 1.1.
plain_pattern = re.compile(r"[A-Za-z_](?:[A-Za-z0-9_ ./()%!?+=;,-]*[A-Za-z0-9_./()%!?+=;,-])?")
misread_pattern = re.compile(r"y|n|yes|no|on|off|true|false|null", re.IGNORECASE)


def from_text(
    cls: type[M],
    text: str,
    *,
    root: str = "goal",
    source: str = "goal",
    allow_nonfinite: bool = False,
) -> M:
    """Parse a message from YAML or JSON. An empty text gives the message with its defaults.

    Values are not converted to the types of fields: a number in quotes is text, ``3.7`` is not an
    integer, and ``no`` is not a bool. Texts with tags, merge keys or more than one document are
    refused, and so are texts that are too long or too deeply nested.

    Args:
        cls: The class of the message.
        text: At most 1,048,576 characters of JSON, or 131,072 characters of YAML.
        root: The first word of the path in errors. If ``root`` is ``goal``, the errors are
            instances of ``InvalidGoal``.
        source: The name of the text, which errors show before line and column.
        allow_nonfinite: Whether ``.nan`` and ``.inf`` are accepted as numbers.

    Raises:
        InvalidMessage: if the text is malformed, or a value does not fit its field. The error
            describes only the first problem.

    >>> from turtleact.interfaces.standard import Point
    >>> from_text(Point, "{x: 1, y: 1e3}")
    Point(x=1.0, y=1000.0, z=0.0)
    """
    document = Document(text.removeprefix("\ufeff"), root, source, allow_nonfinite)
    try:
        return from_dict(cls, tree_of(document), root=root)  # type: ignore[arg-type]  # it checks that
    except RecursionError:
        document.refuse("nested too deeply")


def to_yaml(message: Message) -> str:
    """Convert a message to block YAML, as ``ros2`` prints it, with a final line break.

    >>> from turtleact.interfaces.standard import PatrolCommandInterface, Point
    >>> print(to_yaml(PatrolCommandInterface.Goal(targets=[Point(x=9.0, y=7.0)])), end="")
    targets:
    - x: 9.0
      y: 7.0
      z: 0.0
    """
    return "\n".join(block(to_dict(message))) + "\n"


def to_json(message: Message) -> str:
    """Convert a message to one line of JSON. nan and infinity become null."""
    return json.dumps(sayable(to_dict(message)), ensure_ascii=False)


class Document(msgspec.Struct, frozen=True):
    """A text to parse, with the options of `from_text`."""

    text: str
    root: str
    source: str
    allow_nonfinite: bool

    def refuse(self, problem: str, place: tuple[int, int] | None = None) -> NoReturn:
        """Raise an error that shows a place in the text: line and column, both counted from 0."""
        error = error_class(self.root)
        if place is None:
            raise error(self.source, problem)
        number, column = place
        lines = self.text.splitlines() or [""]
        if not "".join(lines[number:])[column:]:  # at the end: show the end of the last word
            written = self.text.rstrip().splitlines() or [""]
            number, column = len(written) - 1, len(written[-1])
        line = lines[number]
        start = max(0, column - 60)
        shown = "".join(c if c.isprintable() else " " for c in line[start : column + 60])
        caret = " " * (column - start) + "^"
        where = f"{self.source}:{number + 1}:{column + 1}"
        raise error(where, f"{problem}\n  {shown}\n  {caret}")


class Loader(Reader, Scanner, Parser, Composer, BaseResolver):
    """Parses YAML into PyYAML's nodes.

    It creates no Python objects from the nodes, so a text cannot run any code.
    """

    def __init__(self, document: Document) -> None:
        Reader.__init__(self, document.text)
        Scanner.__init__(self)
        Parser.__init__(self)
        Composer.__init__(self)
        BaseResolver.__init__(self)
        self.document = document

    def compose_node(self, parent: Node | None, index: int) -> Node | None:
        """Compose one node, and refuse tags."""
        event = self.peek_event()  # type: ignore[no-untyped-call]  # the stubs have no type here
        if getattr(event, "tag", None) is not None:
            self.document.refuse(
                f"tags ({event.tag}) are not supported", place_of(event.start_mark)
            )
        return super().compose_node(parent, index)


def tree_of(document: Document) -> object:
    """Parse a YAML or JSON text into plain values: dicts, lists, strings, numbers and bools."""
    text = document.text
    if text.lstrip()[:1] == "{" and len(text) <= MOST_JSON:
        # YAML accepts most JSON, and its parser knows the place of an error.
        with suppress(ValueError):
            return json_tree(document)
    if len(text) > MOST_YAML:
        problem = f"{len(text)} characters are too many: at most {MOST_YAML}"
        document.refuse(f"{problem}, or {MOST_JSON} of JSON")
    node = compose(document)
    return {} if node is None else value_of(document, node, {})


def json_tree(document: Document) -> object:
    """Parse a JSON text into plain values. Malformed JSON raises what `json.loads` raises."""

    def number(word: str) -> object:
        return scalar(word, document.allow_nonfinite)

    def oddity(word: str) -> object:
        return float(word) if document.allow_nonfinite else Spelled(word)

    value = json.loads(
        document.text,
        object_pairs_hook=unique,
        parse_int=number,
        parse_float=number,
        parse_constant=oddity,
    )
    return without_nulls(value)


def unique(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """Make a dict from the members of a JSON object. Raise an error if a name appears twice."""
    result = dict(pairs)
    if len(result) < len(pairs):
        raise ValueError("a name appears twice")
    return result


def without_nulls(value: object) -> object:
    """Replace each null in a JSON value by a `Spelled`."""
    if isinstance(value, dict):
        return {key: without_nulls(item) for key, item in value.items()}
    if isinstance(value, list):
        return [without_nulls(item) for item in value]
    return Spelled("null") if value is None else value


def compose(document: Document) -> Node | None:
    """Return the root node of a text with one YAML document; None if the text is empty."""
    try:
        loader = Loader(document)
    except ReaderError as error:
        before = document.text[: error.position].splitlines() or [""]
        problem = f"character U+{ord(document.text[error.position]):04X} is not allowed"
        document.refuse(problem, (len(before) - 1, len(before[-1])))
    try:
        return loader.get_single_node()
    except yaml.MarkedYAMLError as error:
        document.refuse(said(error), place_of(error.problem_mark or loader.get_mark()))
    except (ValueError, OverflowError):
        # PyYAML does not catch these if the number in an escape or directive is too large.
        document.refuse("a number here is too large", place_of(loader.get_mark()))


def said(error: yaml.MarkedYAMLError) -> str:
    """Describe an error of PyYAML in a few words."""
    if error.context == "expected a single document in the stream":
        return "more than one document"
    if error.problem == "mapping values are not allowed here":
        return "a colon too many: write fields in braces, {x: 1, y: 2}, or one per line"
    problem = (error.problem or "malformed").replace(", but got", ", got")
    return problem.replace("'<stream end>'", "the end")


def place_of(mark: Mark) -> tuple[int, int]:
    """Return the line and the column of a mark, both counted from 0."""
    return mark.line, mark.column


def value_of(document: Document, node: Node, made: dict[int, object]) -> object:
    """Convert a YAML node to a plain value. What has an alias is converted once."""
    if id(node) not in made:
        if isinstance(node, yaml.MappingNode):
            made[id(node)] = mapping(document, node, made)
        elif isinstance(node, yaml.SequenceNode):
            made[id(node)] = [value_of(document, item, made) for item in node.value]
        elif isinstance(node, yaml.ScalarNode) and not node.style:
            made[id(node)] = scalar(node.value, document.allow_nonfinite)
        else:
            made[id(node)] = node.value
    return made[id(node)]


def mapping(
    document: Document, node: yaml.MappingNode, made: dict[int, object]
) -> dict[str, object]:
    """Convert a mapping to a dict. The keys stay text, even those that look like numbers."""
    result: dict[str, object] = {}
    for key, item in node.value:
        place = place_of(key.start_mark)
        if not isinstance(key, yaml.ScalarNode):
            document.refuse("a field's name must be a single word", place)
        if key.value == "<<" and not key.style:
            document.refuse("merge keys (<<) are not supported", place)
        if key.value in result:
            document.refuse(f"{describe(key.value)} appears twice", place)
        result[key.value] = value_of(document, item, made)
    return result


def scalar(word: str, allow_nonfinite: bool) -> object:
    """Return the value that a word without quotes stands for."""
    if word in NULLS:
        return Spelled("null")
    if word in WORDS:
        return WORDS[word]
    if integer_pattern.fullmatch(word):
        if len(word) > LONGEST_INTEGER:
            return Spelled(f"a number of {len(word)} digits")
        return int(word, 16 if word.startswith("0x") else 10)
    if not float_pattern.fullmatch(word):
        return word
    if "n" not in word.lower():
        number = float(word)
        return number if math.isfinite(number) else Spelled(word)
    return float(word.lower().replace(".", "")) if allow_nonfinite else Spelled(word)


def block(mapping: dict[str, object]) -> list[str]:
    """Return the lines of a message in block YAML."""
    lines: list[str] = []
    for name, value in mapping.items():
        if isinstance(value, dict) and value:
            lines += [f"{name}:", *(f"  {line}" for line in block(value))]
        elif isinstance(value, list | bytes) and value:
            lines += [f"{name}:", *(line for item in value for line in listed(item))]
        else:
            lines.append(f"{name}: {inline(value)}")
    return lines or ["{}"]


def listed(item: object) -> Iterator[str]:
    """Return the lines of one element of a list in block YAML."""
    lines = block(item) if isinstance(item, dict) else [inline(item)]
    for index, line in enumerate(lines):
        yield f"  {line}" if index else f"- {line}"


def flow(value: object) -> str:
    """Convert a plain value to flow YAML, on one line.

    >>> flow({"at": {"x": 1.0}, "names": ["a", "b, c"]})
    "{at: {x: 1.0}, names: [a, 'b, c']}"
    """
    if isinstance(value, dict):
        return f"{{{', '.join(f'{name}: {flow(item)}' for name, item in value.items())}}}"
    if isinstance(value, list | bytes):
        return f"[{', '.join(map(flow, value))}]"
    shown = inline(value)
    return f"'{shown}'" if isinstance(value, str) and shown == value and "," in value else shown


def inline(value: object) -> str:
    """Write a single value, or an empty list or message, as YAML on one line."""
    if isinstance(value, dict):
        return "{}"
    if isinstance(value, list | bytes):
        return "[]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return quoted(value)
    if not isinstance(value, float):
        return str(value)
    if math.isnan(value):
        return ".nan"
    if math.isinf(value):
        return ".inf" if value > 0 else "-.inf"
    # YAML 1.1 reads 1e+16 as text.
    return repr(value) if "." in repr(value) else repr(value).replace("e", ".0e")


def quoted(text: str) -> str:
    """Return a text as it is written in YAML, with quotes if it needs them."""
    if plain_pattern.fullmatch(text) and not misread_pattern.fullmatch(text):
        return text
    style = "'" if text.isprintable() else '"'
    dumped: str = yaml.dump(text, default_style=style, allow_unicode=True, width=math.inf)
    return dumped.removesuffix("\n")


def sayable(value: object) -> object:
    """Convert a plain Python value to one that JSON can hold: nan and infinity become None."""
    if isinstance(value, dict):
        return {name: sayable(item) for name, item in value.items()}
    if isinstance(value, list | bytes):
        return [sayable(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
