"""Checks values against the types of fields, and explains why a value does not fit.

The path in an error is built from the inside out: a check raises an error with the inner path, and
each caller adds a field's name or an element's index in front. These checks are exact but slow. The
module ``conversion`` compiles faster ones, which call this module only for values that are not
exactly of the expected Python type.

A ``byte`` is an int from 0 to 255; ``bytes`` of length one are accepted too. A sequence becomes a
list, except that ``bytes`` and ``bytearray`` become ``bytes`` if the field is a sequence of bytes.
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
    from collections.abc import Callable, Iterable, Sequence

    from turtleact.interfaces.definition import FieldType

    Convert = Callable[[object], object]

__all__ = ["FLOAT32_LIMIT", "Spelled", "converter", "describe", "expected", "misfit"]

#: From here on, rounding to float32 gives infinity: half a step above the largest float32.
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
    """Describe in words which values a type accepts."""
    if not field_type.is_sequence:
        return EXPECTED.get(field_type.name, f"a message ({field_type.name})")
    count = f"{field_type.size} " if field_type.form is ArrayForm.FIXED else ""
    return f"a list of {count}{field_type.element}"


def misfit(field_type: FieldType, value: object) -> InvalidMessage:
    """Make the error for a value of the wrong type."""
    return InvalidMessage("", f"expected {expected(field_type)}, got {describe(value)}")


def describe(value: object) -> str:
    """Return a value in Python syntax, shortened for an error."""
    return SHORT.repr(value)


SHORT = reprlib.Repr()
SHORT.maxstring = SHORT.maxother = 60


class Spelled:
    """A YAML or JSON value that no field accepts, spelled as it was written."""

    def __init__(self, word: str) -> None:
        self.word = word

    def __repr__(self) -> str:
        return self.word


def converter(field_type: FieldType, element: Convert | None = None) -> Convert:
    """Return a function that converts a value for a field of this type, or raises an error.

    Args:
        field_type: The type of the field.
        element: A function that converts one message; needed only if the field holds messages.
    """
    if element is None:
        element = functools.partial(PRIMITIVE[field_type.name], field_type.element)
    if not field_type.is_sequence:
        return element
    return functools.partial(sequence, field_type, element)


def whole_number(field_type: FieldType, value: object) -> int:
    """Convert a value to an int, and check that it is in the type's range.

    The value may be an integer of numpy or any object with ``__index__``.
    """
    name = field_type.name
    if name == "byte" and isinstance(value, bytes) and len(value) == 1:
        return value[0]
    low, high = INTEGER_RANGES[name]
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
    """Convert a real number of Python or numpy to a float, which is not rounded to float32."""
    limit, edge = FLOAT_LIMITS[field_type.name]
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
    """Convert a bool of Python or numpy to a bool of Python."""
    if not is_bool(value):
        raise misfit(field_type, value)
    return bool(value)


def text(field_type: FieldType, value: object) -> str:
    """Check that a value is a str that can be sent, and return it.

    The bound of a string type limits the number of characters, as in rclpy.
    """
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
    """Convert a sequence to a list, and check its elements and its length.

    However, ``bytes`` and ``bytearray`` become ``bytes`` if the type is a sequence of bytes.
    """
    items = as_items(field_type, value)
    check_length(field_type, len(items))
    if isinstance(items, bytes):
        return items
    return list(converted(element, items))


def converted(element: Convert, items: Iterable[object]) -> Iterable[object]:
    """Convert each element. An error about an element contains the element's index."""
    for index, item in enumerate(items):
        try:
            yield element(item)
        except InvalidMessage as inner:
            raise InvalidMessage(f"[{index}]{inner.path}", inner.problem) from inner


def as_items(field_type: FieldType, value: object) -> Sequence[object]:
    """Return the elements of a list, tuple, byte string or one-dimensional array."""
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
    """Refuse a sequence that is longer than its bound, or does not have its fixed length."""
    size = field_type.size
    if field_type.form is ArrayForm.BOUNDED and length > size:
        raise InvalidMessage("", f"at most {size} elements, got {length}")
    if field_type.form is ArrayForm.FIXED and length != size:
        raise InvalidMessage("", f"exactly {size} elements, got {length}")


def out_of_range(field_type: FieldType, value: object, low: object, high: object) -> InvalidMessage:
    """Make the error for a number that is too small or too large."""
    problem = f"{describe(value)} is out of range for {field_type.name} ({low} to {high})"
    return InvalidMessage("", problem)


def is_bool(value: object) -> bool:
    """Whether a value is a bool or numpy's bool, which is not a subclass of ``bool``."""
    if isinstance(value, bool):
        return True
    numpy = sys.modules.get("numpy")
    return numpy is not None and isinstance(value, numpy.bool_)


#: The limits of floats, and how they are written.
FLOAT_LIMITS = {
    "float32": (FLOAT32_LIMIT, "3.4028235e+38"),
    "float64": (math.inf, "1.7976931348623157e+308"),
}

#: The function that converts one element of each primitive type.
PRIMITIVE: dict[str, Callable[[FieldType, object], object]] = {
    "bool": truth,
    **dict.fromkeys(INTEGER_RANGES, whole_number),
    "float32": number,
    "float64": number,
    "string": text,
    "wstring": text,
}
