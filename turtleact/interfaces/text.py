"""Messages as YAML or JSON, and back, with every mistake told by its place.

YAML 1.1 reads ``no`` as false, ``y`` as true, ``1:30`` as ninety and ``017`` as fifteen; a goal
that means a turtle's name or a coordinate must not. So only its syntax is used: a bare word is
true, false, null or a number as JSON and YAML 1.2 say (and ``.5``, ``5.``, ``0x1F``), and text in
every other case, dates included. JSON is read as JSON, which is faster. The one door to PyYAML.

Source: YAML 1.2.2, section 10.3, the core schema; PyYAML's scanner, parser and composer.
"""

from __future__ import annotations

import json
import math
import re
from typing import TYPE_CHECKING, NoReturn, TypeVar

import msgspec
import yaml
from yaml.composer import Composer
from yaml.parser import Parser
from yaml.reader import Reader, ReaderError
from yaml.resolver import BaseResolver
from yaml.scanner import Scanner

from turtleact.interfaces.conversion import error_class, from_dict, to_dict
from turtleact.interfaces.definition import INTEGER_RANGES
from turtleact.interfaces.types import Message
from turtleact.interfaces.values import Spelled, describe

if TYPE_CHECKING:
    from collections.abc import Iterator

    from yaml.error import Mark
    from yaml.nodes import Node

__all__ = ["from_text", "to_json", "to_yaml"]

M = TypeVar("M", bound=Message)

#: Longest text taken. PyYAML reads some 200 kB a second, and nobody shall wait longer than that.
MOST_JSON = 2**20
MOST_YAML = 2**17
#: Most values after aliases are followed, and deepest nesting.
MOST_NODES = 100_000
DEEPEST = 100
TOO_DEEP = f"nested more than {DEEPEST} levels deep"

WORDS = {
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}
NULLS = frozenset({"", "~", "null", "Null", "NULL"})
integer_pattern = re.compile(r"[-+]?(?:0|[1-9][0-9]*)|0x[0-9a-fA-F]+")
#: Python takes long to read longer ones, or refuses them.
LONGEST_INTEGER = 1000
float_pattern = re.compile(
    r"[-+]?(?:(?:0|[1-9][0-9]*)(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
    r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)"
)
FLOATS = frozenset({"float32", "float64"})
NUMBERS = FLOATS | set(INTEGER_RANGES)
#: Text that needs no quotes in any YAML, but for the words that YAML 1.1 takes for others.
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
    """The message that a YAML or JSON text says; no text says the default message.

    Nothing is bent to fit: a number in quotes is text, ``3.7`` is no integer, ``no`` is no bool.
    Tags, merge keys and further documents are refused, and so are texts that are overlong, too
    deeply nested, or blow up by their aliases.

    Args:
        cls: The class.
        text: Up to 1 MiB of JSON or 128 KiB of YAML.
        root: The first word of the path in errors; ``goal`` makes them ``InvalidGoal``.
        source: What is named before line and column of malformed text.
        allow_nonfinite: Whether ``.nan`` and ``.inf`` are numbers.

    Raises:
        InvalidMessage: for the first mistake.

    >>> from turtleact.interfaces.standard import Point
    >>> from_text(Point, "{x: 1, y: 1e3}")
    Point(x=1.0, y=1000.0, z=0.0)
    """
    document = Document(text.removeprefix("\ufeff"), root, source, allow_nonfinite)
    return from_dict(cls, tree_of(document), root=root)  # type: ignore[arg-type]  # it checks that


def to_yaml(message: Message) -> str:
    """A message as block YAML, as ``ros2`` prints it, with a line break at its end.

    >>> from turtleact.interfaces.standard import PatrolCommandInterface, Point
    >>> print(to_yaml(PatrolCommandInterface.Goal(targets=[Point(x=9.0, y=7.0)])), end="")
    targets:
    - x: 9.0
      y: 7.0
      z: 0.0
    """
    return "\n".join(block(to_dict(message))) + "\n"


def to_json(message: Message) -> str:
    """A message as one line of JSON; nan and infinity, which JSON cannot say, become null."""
    return json.dumps(sayable(to_dict(message)), ensure_ascii=False)


class Document(msgspec.Struct, frozen=True):
    """A text, and how to speak of it."""

    text: str
    root: str
    source: str
    allow_nonfinite: bool

    def refuse(self, problem: str, place: tuple[int, int] | None = None) -> NoReturn:
        """Raises for a mistake in the text itself; its place is line and column from 0."""
        error = error_class(self.root)
        if place is None:
            raise error(self.source, problem)
        number, column = place
        lines = self.text.splitlines() or [""]
        if not "".join(lines[number:])[column:]:  # the end: shown where the last word ends
            written = self.text.rstrip().splitlines() or [""]
            number, column = len(written) - 1, len(written[-1])
        line = lines[number]
        start = max(0, column - 60)
        shown = "".join(c if c.isprintable() else " " for c in line[start : column + 60])
        caret = " " * (column - start) + "^"
        where = f"{self.source}:{number + 1}:{column + 1}"
        raise error(where, f"{problem}\n  {shown}\n  {caret}")


class Loader(Reader, Scanner, Parser, Composer, BaseResolver):
    """PyYAML up to its nodes: it makes no objects, so there is nothing to be safe from."""

    def __init__(self, document: Document) -> None:
        Reader.__init__(self, document.text)
        Scanner.__init__(self)
        Parser.__init__(self)
        Composer.__init__(self)
        BaseResolver.__init__(self)
        self.document = document
        self.depth = 0

    def compose_node(self, parent: Node | None, index: int) -> Node | None:
        """One node; refuses tags and deep nesting before Python's stack runs out."""
        event = self.peek_event()  # type: ignore[no-untyped-call]  # as the stubs leave it
        if getattr(event, "tag", None) is not None:
            self.document.refuse(f"a tag ({event.tag}) is not taken", place_of(event.start_mark))
        if self.depth > DEEPEST:
            self.document.refuse(TOO_DEEP, place_of(event.start_mark))
        self.depth += 1
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node


def tree_of(document: Document) -> object:
    """The plain values that a text says."""
    text = document.text
    if len(text) > MOST_JSON:
        document.refuse(f"{len(text)} characters are too many: at most {MOST_JSON}")
    if text.lstrip()[:1] == "{":
        try:
            return json_tree(document)
        except (ValueError, RecursionError) as error:
            # YAML takes most of it, and knows the place of the mistake.
            if len(text) > MOST_YAML:
                refuse_json(document, error)
    if len(text) > MOST_YAML:
        problem = f"{len(text)} characters of YAML are too many: at most {MOST_YAML}"
        document.refuse(f"{problem}; as JSON it may have {MOST_JSON}")
    node = compose(document)
    return {} if node is None else Expansion(document).value(node, 0)


def json_tree(document: Document) -> object:
    """The plain values that a JSON text says; raises what `json.loads` does."""

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
    return sounded(document, value, 0)


def refuse_json(document: Document, error: ValueError | RecursionError) -> NoReturn:
    """Raises for what is wrong with a JSON text that is too long to be read as YAML."""
    if isinstance(error, json.JSONDecodeError):
        place = error.lineno - 1, error.colno - 1
        document.refuse(f"{error.msg}; it is too long to be YAML", place)
    document.refuse(TOO_DEEP if isinstance(error, RecursionError) else str(error))


def unique(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """A JSON object, if no name in it is given twice."""
    result = dict(pairs)
    if len(result) < len(pairs):
        raise ValueError("a name is given twice")
    return result


def sounded(document: Document, value: object, depth: int) -> object:
    """A JSON value, its depth measured, and null spelled as in the text."""
    if depth > DEEPEST:
        document.refuse(TOO_DEEP)
    if isinstance(value, dict):
        return {key: sounded(document, item, depth + 1) for key, item in value.items()}
    if isinstance(value, list):
        return [sounded(document, item, depth + 1) for item in value]
    return Spelled("null") if value is None else value


def compose(document: Document) -> Node | None:
    """The node of the one YAML document in a text; None where it is empty."""
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
        # PyYAML lets these out of an escape or directive whose number is too large.
        document.refuse("a number here is too large", place_of(loader.get_mark()))


def said(error: yaml.MarkedYAMLError) -> str:
    """What PyYAML found wrong, in a few words."""
    if error.context == "expected a single document in the stream":
        return "more than one document"
    if error.problem == "mapping values are not allowed here":
        return "a colon too many: fields stand in braces, {x: 1, y: 2}, or below each other"
    problem = (error.problem or "malformed").replace(", but got", ", got")
    return problem.replace("'<stream end>'", "the end")


def place_of(mark: Mark) -> tuple[int, int]:
    """Line and column, from 0."""
    return mark.line, mark.column


class Expansion:
    """Turns nodes into plain values, aliases followed, and counts them."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.left = MOST_NODES

    def value(self, node: Node, depth: int) -> object:
        """What a node says."""
        self.left -= 1
        if self.left < 0:
            self.document.refuse(f"too much: more than {MOST_NODES} values, aliases followed")
        if depth > DEEPEST:
            self.document.refuse(TOO_DEEP, place_of(node.start_mark))
        if isinstance(node, yaml.MappingNode):
            return self.mapping(node, depth + 1)
        if isinstance(node, yaml.SequenceNode):
            return [self.value(item, depth + 1) for item in node.value]
        if isinstance(node, yaml.ScalarNode) and not node.style:
            return scalar(node.value, self.document.allow_nonfinite)
        return node.value

    def mapping(self, node: yaml.MappingNode, depth: int) -> dict[str, object]:
        """What a mapping says; its keys are the words as they are written."""
        result: dict[str, object] = {}
        for key, item in node.value:
            place = place_of(key.start_mark)
            if not isinstance(key, yaml.ScalarNode):
                self.document.refuse("a field's name is one word", place)
            if key.value == "<<" and not key.style:
                self.document.refuse("a merge key (<<) is not taken", place)
            if key.value in result:
                self.document.refuse(f"{describe(key.value)} is given twice", place)
            result[key.value] = self.value(item, depth)
        return result


def scalar(word: str, allow_nonfinite: bool) -> object:
    """What a bare word says."""
    if word in NULLS:
        return Spelled("null")
    if word in WORDS:
        return WORDS[word]
    if integer_pattern.fullmatch(word):
        if len(word) > LONGEST_INTEGER:
            return Spelled(f"a number of {len(word)} digits", NUMBERS)
        return int(word, 16 if word.startswith("0x") else 10)
    if not float_pattern.fullmatch(word):
        return word
    if "n" not in word.lower():
        number = float(word)
        return number if math.isfinite(number) else Spelled(word, FLOATS)
    return float(word.lower().replace(".", "")) if allow_nonfinite else Spelled(word)


def block(mapping: dict[str, object]) -> list[str]:
    """The lines of a message."""
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
    """The lines of an element of a list."""
    lines = block(item) if isinstance(item, dict) else [inline(item)]
    for index, line in enumerate(lines):
        yield f"  {line}" if index else f"- {line}"


def flow(value: object) -> str:
    """A plain value as flow YAML, on one line.

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
    """A value on one line."""
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
    # YAML 1.1 takes 1e+16 for text.
    return repr(value) if "." in repr(value) else repr(value).replace("e", ".0e")


def quoted(text: str) -> str:
    """Text in the quotes it needs, if it needs any."""
    if plain_pattern.fullmatch(text) and not misread_pattern.fullmatch(text):
        return text
    style = "'" if text.isprintable() else '"'
    dumped: str = yaml.dump(text, default_style=style, allow_unicode=True, width=math.inf)
    return dumped.removesuffix("\n")


def sayable(value: object) -> object:
    """A plain value as JSON can say it."""
    if isinstance(value, dict):
        return {name: sayable(item) for name, item in value.items()}
    if isinstance(value, list | bytes):
        return [sayable(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
