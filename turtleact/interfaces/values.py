"""Values against types: what a field takes, and the text that says why it does not.

A path grows from the inside out: a check raises with the path below it, and whoever called it puts
its own name before. This is the slow and exact way; ``copying`` generates the fast one, which falls
back to this one for whatever is not exactly of the expected Python type.

A ``byte`` is an int from 0 to 255; ``bytes`` of length one are taken for it. The elements of a
sequence come back as a plain list; only ``bytes`` given for bytes stay ``bytes``.
"""

from __future__ import annotations

import array
import functools
import math
import numbers
import operator
import reprlib
import sys
from typing import TYPE_CHECKING

from turtleact.errors import InvalidMessage
from turtleact.interfaces.definition import BYTE_TYPES, INTEGER_RANGES, ArrayForm

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Sequence

    from turtleact.interfaces.definition import FieldType

    Convert = Callable[[object], object]

__all__ = ["FLOAT32_LIMIT", "Spelled", "converter", "describe", "expected", "misfit"]

#: Where rounding to float32 turns to infinity: half a step above the largest float32.
FLOAT32_LIMIT = (2 - 2**-24) * 2.0**127

EXPECTED = {
    "bool": "true or false (bool)",
    **{name: f"a whole number ({name})" for name in INTEGER_RANGES},
    "float32": "a number (float32)",
    "float64": "a number (float64)",
    "string": "text (string)",
    "wstring": "text (wstring)",
}


def expected(field_type: FieldType) -> str:
    """What a value of this type is, in words."""
    if not field_type.is_sequence:
        return EXPECTED.get(field_type.name, f"a message ({field_type.name})")
    count = f"{field_type.size} " if field_type.form is ArrayForm.FIXED else ""
    return f"a list of {count}{field_type.element}"


def misfit(field_type: FieldType, value: object) -> InvalidMessage:
    """The error for a value of another sort."""
    return InvalidMessage("", f"expected {expected(field_type)}, got {describe(value)}")


def describe(value: object) -> str:
    """A value for an error's text: as Python writes it, cut where it is long."""
    return SHORT.repr(value)


class ShortRepr(reprlib.Repr):
    """Python's short repr, that also bears numbers too long to write."""

    def __init__(self) -> None:
        super().__init__()
        self.maxstring = self.maxother = 60

    def repr_int(self, x: int, level: int) -> str:  # noqa: ARG002  the base class's signature
        """A number; one that no ROS type could hold by far is only measured."""
        return repr(x) if x.bit_length() <= 128 else f"a number of {x.bit_length()} bits"


SHORT = ShortRepr()


class Spelled:
    """What a text says and no field takes; an error names it as it was written.

    Attributes:
        word: As it was written, or what it is.
        fits: Names of the types that would take it if it were not too large.
    """

    def __init__(self, word: str, fits: Collection[str] = ()) -> None:
        self.word = word
        self.fits = fits

    def __repr__(self) -> str:
        return self.word


def converter(field_type: FieldType, element: Convert | None = None) -> Convert:
    """A function that gives the value a field of this type would hold, or raises.

    Args:
        field_type: The type.
        element: What converts one message, where the type is a message.
    """
    if element is None:
        element = functools.partial(PRIMITIVE[field_type.name], field_type.element)
    if not field_type.is_sequence:
        return element
    return functools.partial(sequence, field_type, element)


def whole_number(field_type: FieldType, value: object) -> int:
    """An int in range; numpy's integers and whatever else is an index are converted."""
    name = field_type.name
    if name == "byte" and isinstance(value, bytes) and len(value) == 1:
        return value[0]
    low, high = INTEGER_RANGES[name]
    if is_too_large(field_type, value):
        raise out_of_range(field_type, value, low, high)
    if is_bool(value) or not hasattr(value, "__index__"):
        raise misfit(field_type, value)
    try:
        number = int(operator.index(value))
    except TypeError as error:
        raise misfit(field_type, value) from error
    if not low <= number <= high:
        raise out_of_range(field_type, number, low, high)
    return number


def number(field_type: FieldType, value: object) -> float:
    """A float; ints and numpy's numbers are converted. Never rounded to float32."""
    limit, edge = FLOAT_LIMITS[field_type.name]
    if is_too_large(field_type, value):
        raise out_of_range(field_type, value, f"-{edge}", edge)
    if is_bool(value) or not isinstance(value, numbers.Real):
        raise misfit(field_type, value)
    try:
        result = float(value)
    except OverflowError:
        fits = False
    else:
        fits = abs(result) < limit or not math.isfinite(result)
    if not fits:
        raise out_of_range(field_type, value, f"-{edge}", edge)
    return result


def truth(field_type: FieldType, value: object) -> bool:
    """A bool; numpy's is converted."""
    if not is_bool(value):
        raise misfit(field_type, value)
    return bool(value)


def text(field_type: FieldType, value: object) -> str:
    """A str that can be sent and is not longer than its bound, in characters as rclpy counts."""
    if not isinstance(value, str):
        raise misfit(field_type, value)
    plain = str.__str__(value)
    try:
        plain.encode()
    except UnicodeEncodeError as error:
        problem = f"character {error.start} is half a surrogate pair, which cannot be sent"
        raise InvalidMessage("", problem) from error
    bound = field_type.string_bound
    if bound is not None and len(plain) > bound:
        raise InvalidMessage("", f"at most {bound} characters, got {len(plain)}")
    return plain


def sequence(field_type: FieldType, element: Convert, value: object) -> object:
    """A list whose elements and length fit; ``bytes`` for bytes."""
    items = as_items(field_type, value)
    check_length(field_type, len(items))
    if isinstance(items, bytes):
        return items
    return list(converted(element, items))


def converted(element: Convert, items: Iterable[object]) -> Iterable[object]:
    """Each element converted, its place named where one does not fit."""
    for index, item in enumerate(items):
        try:
            yield element(item)
        except InvalidMessage as inner:
            raise InvalidMessage(f"[{index}]{inner.path}", inner.problem) from inner


def as_items(field_type: FieldType, value: object) -> Sequence[object]:
    """The elements that a list, tuple or one-dimensional array holds."""
    if isinstance(value, list | tuple):
        return value
    if isinstance(value, bytes | bytearray) and field_type.name in BYTE_TYPES:
        return bytes(value)
    if isinstance(value, array.array):
        return value.tolist()
    numpy = sys.modules.get("numpy")
    if numpy is None or not isinstance(value, numpy.ndarray):
        raise misfit(field_type, value)
    if value.ndim != 1:
        problem = f"expected {expected(field_type)}, got an array of {value.ndim} dimensions"
        raise InvalidMessage("", problem)
    items: list[object] = value.tolist()
    return items


def check_length(field_type: FieldType, length: int) -> None:
    """Refuses a sequence that is too long, or not as long as it is fixed to be."""
    size = field_type.size
    if field_type.form is ArrayForm.BOUNDED and length > size:
        raise InvalidMessage("", f"at most {size} elements, got {length}")
    if field_type.form is ArrayForm.FIXED and length != size:
        raise InvalidMessage("", f"exactly {size} elements, got {length}")


def is_too_large(field_type: FieldType, value: object) -> bool:
    """Whether a text says a number that even Python does not take."""
    return isinstance(value, Spelled) and field_type.name in value.fits


def out_of_range(field_type: FieldType, value: object, low: object, high: object) -> InvalidMessage:
    """The error for a number that is too small or too large."""
    problem = f"{describe(value)} is out of range for {field_type.name} ({low} to {high})"
    return InvalidMessage("", problem)


def is_bool(value: object) -> bool:
    """Whether this is a bool, or numpy's bool, which is no subclass of it."""
    if isinstance(value, bool):
        return True
    numpy = sys.modules.get("numpy")
    return numpy is not None and isinstance(value, numpy.bool_)


#: Where a float is too large, and how that is written.
FLOAT_LIMITS = {
    "float32": (FLOAT32_LIMIT, "3.4028235e+38"),
    "float64": (math.inf, "1.7976931348623157e+308"),
}

#: What converts one element of each primitive type.
PRIMITIVE: dict[str, Callable[[FieldType, object], object]] = {
    "bool": truth,
    **dict.fromkeys(INTEGER_RANGES, whole_number),
    "float32": number,
    "float64": number,
    "string": text,
    "wstring": text,
}
