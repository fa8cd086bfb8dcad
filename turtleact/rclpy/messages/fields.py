"""Handles the fields of a message class: names of types, initial values, conversions and checks.

Source: ``rosidl_generator_py``, whose behaviour was observed in ROS 2 Kilted.
"""

from __future__ import annotations

import array
from collections.abc import Callable, Collection
from functools import partial

from turtleact.interfaces.definition import INTEGER_RANGES, PRIMITIVES, ArrayForm, Field, FieldType
from turtleact.rclpy.impl.typing import Anything

__all__ = [
    "TYPECODES",
    "checker",
    "initial",
    "is_numeric_array",
    "is_numeric_sequence",
    "sequence_of",
    "type_text",
]

TYPECODES = {
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
"""The type code of `array.array` for each number type. Other sequences are lists."""

NAMES = {
    "bool": "boolean",
    "byte": "octet",
    "char": "uint8",
    "float32": "float",
    "float64": "double",
}
"""The types that have another name in IDL."""

LARGEST_FLOAT32 = 3.402823466e38


def type_text(field_type: FieldType) -> str:
    """Return the IDL name of a type, for `get_fields_and_field_types`.

    >>> type_text(FieldType("float64", form=ArrayForm.UNBOUNDED))
    'sequence<double>'
    """
    name = field_type.name.replace("/msg/", "/")
    element = NAMES.get(name, name)
    if field_type.string_bound is not None:
        element = f"{element}<{field_type.string_bound}>"
    if field_type.form is ArrayForm.FIXED:
        return f"{element}[{field_type.size}]"
    if field_type.form is ArrayForm.BOUNDED:
        return f"sequence<{element}, {field_type.size}>"
    return f"sequence<{element}>" if field_type.is_sequence else element


def is_numeric_sequence(field_type: FieldType) -> bool:
    """Whether a field of this type has an `array.array` as its value."""
    is_dynamic = field_type.form in (ArrayForm.BOUNDED, ArrayForm.UNBOUNDED)
    return is_dynamic and field_type.name in TYPECODES


def is_numeric_array(field_type: FieldType) -> bool:
    """Whether a field of this type has a numpy array as its value."""
    return field_type.form is ArrayForm.FIXED and field_type.name in TYPECODES


def sequence_of(field_type: FieldType) -> Callable[[Anything], object]:
    """Return a function that converts a sequence of numbers to the array that a field needs."""
    code = TYPECODES[field_type.name]
    if is_numeric_array(field_type):

        def convert_to_numpy(value: Anything) -> object:
            import numpy as np  # slow to import, and many programs need it in no message

            dtype = np.dtype(code)
            if isinstance(value, np.ndarray) and value.dtype == dtype:
                return value
            return np.array(value, dtype=dtype)

        return convert_to_numpy

    def convert(value: Anything) -> object:
        if type(value) is array.array and value.typecode == code:
            return value
        return array.array(code, value)

    return convert


def initial(field: Field, nested: type | None) -> Callable[[], object]:
    """Return a function that makes the initial value of a field."""
    field_type = field.type
    if nested is not None:
        if not field_type.is_sequence:
            return nested
        size = field_type.size if field_type.form is ArrayForm.FIXED else 0
        return lambda: [nested() for _ in range(size)]
    if field_type.name in TYPECODES and field_type.is_sequence:
        size = field_type.size if field_type.form is ArrayForm.FIXED else 0
        values: object = [0] * size if field.default is None else field.default
        return partial(sequence_of(field_type), values)
    if field_type.is_sequence:
        zero = b"\0" if field_type.name == "byte" else PRIMITIVES[field_type.name]
        size = field_type.size if field_type.form is ArrayForm.FIXED else 0
        given = [zero] * size if field.default is None else _listed(field)
        return lambda: list(given)
    value = PRIMITIVES[field_type.name] if field.default is None else field.default
    if field_type.name == "byte":
        value = bytes([int(value)])  # type: ignore[assignment, arg-type]  # bytes stand for a byte
    return lambda: value


def _listed(field: Field) -> list[object]:
    values = field.default if isinstance(field.default, tuple) else ()
    if field.type.name == "byte":
        return [bytes([int(value)]) for value in values]
    return list(values)


def checker(field: Field, nested: type | None) -> Callable[[object], None]:
    """Return a function that checks a value for a field. Messages with ``check_fields`` call it.

    The function raises AssertionError if the value does not fit, as in rclpy.
    """
    check = partial(_check_one, field.name, field.type.element, nested)
    if not field.type.is_sequence:
        return check

    def check_all(value: object) -> None:
        is_collection = isinstance(value, Collection) and not isinstance(value, str | bytes)
        _expect(is_collection, field.name, "a set or sequence")
        assert isinstance(value, Collection)  # noqa: S101  # checked above
        size, form = field.type.size, field.type.form
        if form is ArrayForm.FIXED:
            _expect(len(value) == size, field.name, f"a sequence of length {size}")
        elif form is ArrayForm.BOUNDED:
            _expect(len(value) <= size, field.name, f"a sequence of at most {size} elements")
        if not isinstance(value, array.array) and not hasattr(value, "dtype"):
            for element in value:
                check(element)

    return check_all


def _check_one(name: str, field_type: FieldType, nested: type | None, value: object) -> None:
    kind = field_type.name
    if nested is not None:
        _expect(isinstance(value, nested), name, f"a sub message of type '{nested.__name__}'")
    elif kind == "byte":
        _expect(isinstance(value, bytes) and len(value) == 1, name, "of type 'bytes', one byte")
    elif kind == "bool":
        _expect(isinstance(value, bool), name, "of type 'bool'")
    elif field_type.is_string:
        _expect(isinstance(value, str), name, "of type 'str'")
        bound = field_type.string_bound
        fits = bound is None or len(str(value)) <= bound
        _expect(fits, name, f"a string of at most {bound} characters")
    elif kind in INTEGER_RANGES:
        _expect(isinstance(value, int), name, "of type 'int'")
        low, high = INTEGER_RANGES[kind]
        _expect(low <= int(str(int(value))) <= high, name, f"an integer in [{low}, {high}]")  # type: ignore[call-overload]  # an int
    else:
        _expect(isinstance(value, float), name, "of type 'float'")
        small = kind == "float64" or not abs(value) > LARGEST_FLOAT32 or abs(value) == float("inf")  # type: ignore[arg-type]  # a float
        _expect(small, name, "a float of single precision")


def _expect(fits: bool, name: str, expected: str) -> None:
    if not fits:
        raise AssertionError(f"The '{name}' field must be {expected}")
