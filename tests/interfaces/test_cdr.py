from __future__ import annotations

import functools
import json
import struct
import tracemalloc
from array import array as numbers
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact.errors import InvalidMessage, InvalidOption
from turtleact.interfaces import (
    decode,
    encode,
    from_dict,
    get_interface,
    known_interfaces,
    load_interfaces,
)
from turtleact.interfaces.definition import INTEGER_RANGES, ArrayForm
from turtleact.interfaces.standard import UUID, GoalInfo, Point, Time
from turtleact.interfaces.types import (
    Action,
    Message,
    Service,
    array,
    bool_,
    bounded,
    byte,
    char,
    fields,
    float32,
    float64,
    int8,
    int16,
    int32,
    int64,
    nested_classes,
    string,
    uint8,
    uint16,
    uint32,
    uint64,
    wstring,
)

from ..registry import isolated_registry
from ..tables import together

if TYPE_CHECKING:
    from turtleact.interfaces.definition import FieldType

HERE = Path(__file__).parent
FORMATS = {
    **{"bool": "?", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h"},
    **{"uint16": "H", "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q"},
    **{"float32": "f", "float64": "d"},
}


class Nothing(Message, type_name="example_msgs/msg/Nothing"):
    pass


class Scalars(Message, type_name="example_msgs/msg/Scalars"):
    a: bool_ = False
    b: byte = 0
    c: char = 0
    d: int8 = 0
    e: uint8 = 0
    f: int16 = 0
    g: uint16 = 0
    h: int32 = 0
    i: uint32 = 0
    j: int64 = 0
    k: uint64 = 0
    m: float32 = 0.0
    n: float64 = 0.0
    o: string = ""
    p: wstring = ""
    q: bounded[string, 3] = ""
    r: bounded[wstring, 3] = ""


class Numbers(Message, type_name="example_msgs/msg/Numbers"):
    a: list[bool_] = []
    b: list[byte] = []
    c: bounded[list[char], 5] = []
    d: list[int8] = []
    e: list[uint8] = []
    f: list[int16] = []
    g: list[uint16] = []
    h: list[int32] = []
    i: list[uint32] = []
    j: bounded[list[int64], 3] = []
    k: list[uint64] = []
    m: list[float32] = []
    n: list[float64] = []
    raw: bytes = b""
    key: array[bytes, 3] = bytes(3)
    octets: array[list[uint8], 3] = [0] * 3
    three: array[list[float64], 3] = [0.0] * 3
    flags: array[list[bool_], 2] = [False] * 2


class Texts(Message, type_name="example_msgs/msg/Texts"):
    names: list[string] = []
    pair: array[list[string], 2] = [""] * 2
    few: bounded[list[bounded[wstring, 4]], 2] = []
    from_: int64 = 0


class Pair(Message, type_name="example_msgs/msg/Pair"):
    """Its messages stand at unequal distances: the byte comes first."""

    small: int8 = 0
    large: int64 = 0


class Twin(Message, type_name="example_msgs/msg/Twin"):
    """Has the fields of a pair, and is none."""

    small: int8 = 0
    large: int64 = 0


class Messages(Message, type_name="example_msgs/msg/Messages"):
    points: list[Point] = []
    corners: array[list[Point], 2] = [Point(), Point()]
    infos: list[GoalInfo] = []
    keys: array[list[GoalInfo], 2] = [GoalInfo(), GoalInfo()]
    pairs: list[Pair] = []
    nothings: bounded[list[Nothing], 4] = []
    nothing: Nothing = Nothing()
    texts: list[Texts] = []
    from_: int16 = 0


class Uneven(Message, type_name="example_msgs/msg/Uneven"):
    """Its sequences of messages start at any place."""

    first: list[Pair] = []
    name: string = ""
    keys: array[list[GoalInfo], 2] = [GoalInfo(), GoalInfo()]
    pairs: array[list[Pair], 2] = [Pair(), Pair()]
    last: list[Pair] = []


class Fixed(Message, type_name="example_msgs/msg/Fixed"):
    """Begins with what has neither a length nor a place in a run."""

    three: array[list[float64], 3] = [0.0] * 3
    pair: array[list[string], 2] = [""] * 2
    ranks: array[list[int32], 2] = [0] * 2


class Behind(Message, type_name="example_msgs/msg/Behind"):
    """Where its numbers stand is known in part only: by the sequences before them."""

    wide: list[float64] = []
    small: int32 = 0
    large: float64 = 0.0
    narrow: list[int16] = []
    middle: list[int32] = []
    both: array[list[int64], 2] = [0, 0]
    name: wstring = ""
    rank: int32 = 0
    stamp: int64 = 0
    infos: list[GoalInfo] = []
    last: float64 = 0.0


OWN = [Nothing, Scalars, Numbers, Texts, Pair, Messages, Uneven, Fixed, Behind, GoalInfo]
ARRAYS = ["list", "array", "numpy"]


def unchecked(value: object) -> Any:
    """A value that a type checker would not take here; making a message checks nothing."""
    return value


def data_of(text: str, *, order: str = "little") -> bytes:
    """CDR whose header stands for itself."""
    return bytes.fromhex(f"000{1 if order == 'little' else 0}0000 {text}")


# --- recorded from ROS 2 --------------------------------------------------------------------


def recorded(name: str) -> list[dict[str, Any]]:
    entries = json.loads((HERE / "cdr" / name).read_text("utf-8"))
    return [entry | {"cdr": bytes.fromhex(entry["cdr"])} for entry in entries]


@functools.cache
def recorded_types() -> dict[str, Any]:
    """The types of all messages that are recorded, by name."""
    with isolated_registry():
        load_interfaces(HERE / "golden")
        names = {entry["type"] for entry in (*recorded("cdr.json"), *FAST_CDR)}
        return {name: get_interface(name) for name in names}


def message_of(entry: dict[str, Any]) -> Any:
    return from_dict(recorded_types()[entry["type"]], entry["value"] or {})


RCLPY = [pytest.param(entry, id=entry["type"]) for entry in recorded("cdr.json")]
FAST_CDR = recorded("cdr_fastcdr.json")


@together
@pytest.mark.parametrize("entry", RCLPY)
def test_a_message_is_written_as_rclpy_writes_it(entry):
    assert encode(message_of(entry)).hex() == entry["cdr"].hex()


@together
@pytest.mark.parametrize("arrays", ARRAYS)
@pytest.mark.parametrize("entry", RCLPY)
def test_what_rclpy_has_written_is_read(entry, arrays):
    read = decode(type(message_of(entry)), entry["cdr"], arrays=arrays)
    assert encode(read) == entry["cdr"]


@together
@pytest.mark.parametrize("type_name", sorted({entry["type"] for entry in FAST_CDR}))
def test_what_fast_cdr_has_written_is_read_and_written_but_for_its_garbage(type_name):
    for entry in (entry for entry in FAST_CDR if entry["type"] == type_name):
        message = message_of(entry)
        assert decode(type(message), entry["cdr"]) == message
        written = encode(message)
        assert len(written) <= len(entry["cdr"])
        assert all(ours in (0, its) for ours, its in zip(written, entry["cdr"], strict=False))


# --- every type, against a codec that goes by the book --------------------------------------


class Book:
    """Plain CDR as the specification tells it, value by value."""

    def __init__(self, order: str) -> None:
        self.sign = "<" if order == "little" else ">"
        self.order = order
        self.body = b""

    def put(self, code: str, value: object) -> None:
        self.body += bytes(-len(self.body) % struct.calcsize(f"<{code}"))
        self.body += struct.pack(f"{self.sign}{code}", value)

    def message(self, message: Message) -> None:
        for field, nested in zip(fields(type(message)), nested_classes(type(message)), strict=True):
            value = getattr(message, field.attribute)
            if field.type.form in (ArrayForm.BOUNDED, ArrayForm.UNBOUNDED):
                self.put("I", len(value))
            for item in value if field.type.is_sequence else [value]:
                self.one(field.type, nested, item)
        if not fields(type(message)):
            self.body += b"\0"

    def one(self, field_type: FieldType, nested: type[Message] | None, value: Any) -> None:
        if nested is not None:
            self.message(value)
        elif field_type.name == "string":
            content = value.encode() + b"\0"
            self.put("I", len(content))
            self.body += content
        elif field_type.name == "wstring":
            content = value.encode("utf-16-le")
            self.put("I", len(content) // 2)
            for index in range(0, len(content), 2):
                self.put("I", int.from_bytes(content[index : index + 2], "little"))
        else:
            self.put(FORMATS[field_type.name], value)


def by_the_book(message: Message, *, order: str = "little") -> bytes:
    book = Book(order)
    book.message(message)
    return data_of("", order=order) + book.body


TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=3)
PRIMITIVES: dict[str, st.SearchStrategy[Any]] = {
    "bool": st.booleans(),
    **{name: st.integers(low, high) for name, (low, high) in INTEGER_RANGES.items()},
    "float32": st.floats(width=32, allow_nan=False),
    "float64": st.floats(allow_nan=False),
    "string": TEXT,
    "wstring": TEXT,
}


def values(field_type: FieldType, nested: type[Message] | None) -> st.SearchStrategy[Any]:
    one = PRIMITIVES[field_type.name] if nested is None else messages(nested)
    if not field_type.is_sequence:
        return one
    if field_type.form is ArrayForm.FIXED:
        return st.lists(one, min_size=field_type.size, max_size=field_type.size)
    return st.lists(one, max_size=min(field_type.size or 3, 3))


@functools.cache
def messages(cls: type[Message]) -> st.SearchStrategy[Any]:
    def made(members: dict[str, Any]) -> Message:
        as_bytes = {name: bytes(members[name]) for name in cls._shape.bytes_fields}
        return cls(**members | as_bytes)

    members = {
        field.attribute: values(field.type, nested)
        for field, nested in zip(fields(cls), nested_classes(cls), strict=True)
    }
    return st.fixed_dictionaries(members).map(made)


def message_classes(type_name: str) -> list[type[Message]]:
    found: Any = get_interface(type_name)
    if issubclass(found, Service):
        return [found.Request, found.Response]
    if issubclass(found, Action):
        send_goal: Any = get_interface(f"{type_name}_SendGoal")
        return [found.Goal, found.Result, found.Feedback, send_goal.Request, send_goal.Response]
    return [found]


SHIPPED = [cls for name in known_interfaces() for cls in message_classes(name)]
ANY_MESSAGE = st.sampled_from([*OWN, *OWN, *SHIPPED]).flatmap(messages)


@together
@pytest.mark.parametrize("arrays", ARRAYS)
@pytest.mark.parametrize("cls", [*OWN, *SHIPPED])
def test_a_default_message_is_written_and_read_by_the_book(cls, arrays):
    data = encode(cls())
    assert data == by_the_book(cls())
    assert encode(decode(cls, data, arrays=arrays)) == data


@given(ANY_MESSAGE)
def test_any_message_is_written_by_the_book(message):
    assert encode(message) == by_the_book(message)


@given(ANY_MESSAGE, st.sampled_from(["little", "big"]), st.sampled_from(ARRAYS))
def test_any_message_is_read_in_either_byte_order(message, order, arrays):
    read = decode(type(message), by_the_book(message, order=order), arrays=arrays)
    assert encode(read) == encode(message)


@given(ANY_MESSAGE, st.data())
def test_a_message_that_is_cut_off_is_refused_wherever_it_is_cut(message, data):
    whole = encode(message)
    cut = data.draw(st.integers(0, len(whole) - 1))
    with pytest.raises(InvalidMessage, match=r"^message: (these \d+ bytes are not|not plain)"):
        decode(type(message), whole[:cut])


@given(ANY_MESSAGE, st.data())
def test_changed_bytes_are_read_or_refused(message, data):
    changed = bytearray(encode(message))
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(4, max(4, len(changed) - 1)))
        changed[place : place + 1] = data.draw(st.sampled_from([b"", b"\0", b"\xff", b"\x02"]))
    read_or_refuse(type(message), bytes(changed))


def read_or_refuse(cls: type[Message], data: bytes) -> None:
    try:
        read = decode(cls, data)
    except InvalidMessage:
        return
    assert encode(decode(cls, encode(read))) == encode(read)


# --- places ---------------------------------------------------------------------------------


def test_what_padding_holds_is_ignored():
    assert decode(Pair, data_of("01 ffffffffffffff 0200000000000000")) == Pair(1, 2)


# --- text -----------------------------------------------------------------------------------


class Text(Message, type_name="example_msgs/msg/Text"):
    data: string = ""


class Wide(Message, type_name="example_msgs/msg/Wide"):
    data: wstring = ""


@pytest.mark.parametrize(
    ("body", "text"),
    [
        ("00000000", ""),
        ("02000000 6162", "ab"),
        ("03000000 610000", "a\0"),
        ("03000000 61ff00", "a\ufffd"),
    ],
    ids=["no NUL", "no NUL at the end", "NUL inside", "no UTF-8"],
)
def test_odd_text_is_read(body, text):
    assert decode(Text, data_of(body)).data == text


def test_a_wstring_is_units_of_utf_16_in_four_bytes_each():
    assert encode(Wide("a🐢")) == data_of("03000000 61000000 3dd80000 22dc0000")


@pytest.mark.parametrize(
    ("units", "text"),
    [("3dd80000 22dc0000", "🐢"), ("22f40100", "🐢"), ("3dd80000", "\ufffd")],
    ids=["pair", "whole", "half"],
)
def test_odd_wide_text_is_read(units, text):
    count = len(bytes.fromhex(units)) // 4
    assert decode(Wide, data_of(f"0{count}000000 {units}")).data == text


def test_a_unit_that_is_no_character_is_refused():
    with pytest.raises(
        InvalidMessage, match=r"^message: these 12 bytes are not of type example_msgs/msg/Wide$"
    ):
        decode(Wide, data_of("01000000 00001100"))


# --- limits ---------------------------------------------------------------------------------

#: A class with lengths, and how many bytes stand before one of them, all zero.
COUNTED: list[tuple[type[Message], int]] = [
    *[(Numbers, 4 * place) for place in range(14)],
    (Text, 0),
    (Wide, 0),
    (Texts, 0),
    (Messages, 0),
    (Messages, 56),
    (Messages, 108),
]


@together
@pytest.mark.parametrize("arrays", ARRAYS)
@pytest.mark.parametrize(("cls", "before"), COUNTED)
def test_a_length_that_the_data_cannot_hold_costs_no_memory(cls, before, arrays):
    decode(cls, encode(cls()), arrays=arrays)  # compiles
    data = data_of("00" * before + "feffffff")
    tracemalloc.start()
    with pytest.raises(InvalidMessage, match=f"are not of type {cls.type_name}$"):
        decode(cls, data, arrays=arrays)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 100_000


@pytest.mark.parametrize(
    "longer",
    [Scalars(q="abcd"), Scalars(r="abcd"), Numbers(c=[0] * 6), Numbers(j=[0] * 4)],
)
def test_what_is_beyond_its_bound_is_not_read(longer):
    with pytest.raises(InvalidMessage, match="bytes are not of type"):
        decode(type(longer), by_the_book(longer))


@pytest.mark.parametrize(
    ("data", "held"),
    [
        (b"", ""),
        (b"\x00\x01\x00", "000100"),
        (bytes.fromhex("00030000 00"), "00030000"),
        (bytes.fromhex("01000000 00"), "01000000"),
    ],
    ids=["empty", "short", "parameter list", "swapped"],
)
def test_another_header_is_refused(data, held):
    with pytest.raises(InvalidMessage, match=f"^message: not plain CDR: .* not '{held}'$"):
        decode(Nothing, data)


def test_the_last_two_bytes_of_the_header_are_ignored():
    assert decode(Time, bytes.fromhex("0001ffff 01000000 02000000")) == Time(1, 2)


# --- what is written ------------------------------------------------------------------------


@together
@pytest.mark.parametrize(
    ("message", "text"),
    [
        (Scalars(a=unchecked(1)), "a: expected true or false (bool), got 1"),
        (Scalars(m=1e39), "m: 1e+39 is out of range for float32"),
        (Scalars(o="\ud800"), "o: character 0 is half a surrogate pair"),
        (Scalars(p="\ud800"), "p: character 0 is half a surrogate pair"),
        (Scalars(q="abcd"), "q: at most 3 characters, got 4"),
        (Numbers(a=unchecked([1])), "a[0]: expected true or false (bool), got 1"),
        (Numbers(c=[0] * 6), "c: at most 5 elements, got 6"),
        (Numbers(e=unchecked({1: 2})), "e: expected a list of uint8, got {1: 2}"),
        (Numbers(e=[256]), "e[0]: 256 is out of range for uint8"),
        (Numbers(three=[1.0]), "three: exactly 3 elements, got 1"),
        (Numbers(key=b"ab"), "key: exactly 3 elements, got 2"),
        (
            Numbers(n=unchecked(np.zeros((2, 2)))),
            "n: expected a list of float64, got an array of 2",
        ),
        (Texts(names=unchecked("ab")), "names: expected a list of string, got 'ab'"),
        (Texts(few=["abcde"]), "few[0]: at most 4 characters, got 5"),
        (Messages(points=unchecked([Time()])), "points[0]: expected geometry_msgs/msg/Point, not "),
        (Messages(nothing=unchecked(None)), "nothing: expected a message"),
        (Uneven(first=unchecked([Twin()])), "first[0]: expected example_msgs/msg/Pair, not "),
    ],
)
def test_what_does_not_fit_is_told_with_its_path(message, text):
    with pytest.raises(InvalidMessage) as caught:
        encode(message)
    assert str(caught.value).startswith(f"message.{text}")


def test_what_is_no_message_is_refused():
    with pytest.raises(InvalidMessage, match="message: expected a message, got 5"):
        encode(unchecked(5))


def test_other_values_that_fit_are_converted():
    loose = Numbers(
        h=unchecked((1, 2)), n=unchecked([1, np.float32(0.5)]), key=unchecked([1, 2, 3])
    )
    exact = Numbers(h=[1, 2], n=[1.0, 0.5], key=b"\1\2\3")
    assert encode(loose) == encode(exact)


ALL = from_dict(
    Numbers,
    {
        **{"a": [True, False], "b": [1, 2], "c": [3], "d": [-4], "e": [5, 6], "f": [-7]},
        **{"g": [8], "h": [-9], "i": [10], "j": [-11], "k": [12], "m": [0.5, 1.5], "n": [2.5]},
        **{"raw": b"raw", "key": b"key", "octets": [1, 2, 3], "three": [0.5, 1.5, 2.5]},
        "flags": [True, False],
    },
)


@pytest.mark.parametrize(
    "values",
    [np.arange(6.0)[::2], np.array([0, 2, 4]), np.array([0.0, 2.0, 4.0], ">f8"), (0.0, 2.0, 4.0)],
    ids=["strided", "of integers", "big endian", "tuple"],
)
def test_any_array_that_fits_is_written(values):
    expected = encode(Numbers(n=[0.0, 2.0, 4.0], three=[0.0, 2.0, 4.0]))
    assert encode(Numbers(n=values, three=values)) == expected


# --- what is read ---------------------------------------------------------------------------


def test_lists_hold_plain_values():
    read = decode(Numbers, encode(ALL))
    assert [type(item) for item in (*read.a, *read.e, *read.h, *read.m)] == [
        *[bool] * 2,
        *[int] * 3,
        *[float] * 2,
    ]


@pytest.mark.parametrize("order", ["little", "big"])
def test_arrays_of_the_standard_library_are_read(order):
    read: Any = decode(Numbers, by_the_book(ALL, order=order), arrays="array")
    for field, nested in zip(fields(Numbers), nested_classes(Numbers), strict=True):
        assert nested is None
        value = getattr(read, field.name)
        if field.name in ("raw", "key") or field.type.name == "bool":
            assert value == getattr(ALL, field.name)
        else:
            assert value == numbers(FORMATS[field.type.name], getattr(ALL, field.name))


@pytest.mark.parametrize("order", ["little", "big"])
def test_arrays_of_numpy_are_read(order):
    read: Any = decode(Numbers, by_the_book(ALL, order=order), arrays="numpy")
    for field in fields(Numbers):
        value, expected = getattr(read, field.name), getattr(ALL, field.name)
        if field.name in ("raw", "key"):
            assert value == expected
            continue
        assert value.dtype == np.dtype(FORMATS[field.type.name])
        assert value.tolist() == expected
        assert value.flags.writeable
        assert value.flags.owndata


def test_a_bool_of_any_bits_is_true():
    read: Any = decode(Numbers, data_of("02000000 0200") + bytes(200), arrays="numpy")
    assert read.a.view("B").tolist() == [1, 0]
    assert decode(Numbers, data_of("02000000 0200") + bytes(200)).a == [True, False]


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview])
def test_any_bytes_are_read(kind):
    assert decode(UUID, kind(encode(UUID(bytes(range(16)))))).uuid == bytes(range(16))


def test_arrays_of_no_known_sort_are_refused():
    with pytest.raises(InvalidOption, match="'arrays': expected one of list, array, numpy, got 1"):
        decode(Time, encode(Time()), arrays=unchecked(1))
