"""Handles the fields of a message class: names of types, initial values, conversions and checks.

Source: ``rosidl_generator_py``, whose behaviour was observed in ROS 2 Kilted.
"""

from __future__ import annotations

import array
from collections.abc import Callable
from functools import partial

from turtleact.interfaces.definition import INTEGER_RANGES, PRIMITIVES, ArrayForm, Field, FieldType
from turtleact.rclpy.impl.typing import Anything

__all__ = [
    "TYPECODES",
    "checker",
    "fitted",
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

    The function raises AssertionError if the value could not be sent.
    """

    def check(value: object) -> None:
        try:
            fitted(field.type, nested, value, field.name, _check_class)
        except TypeError as error:
            raise AssertionError(f"The '{field.name}' field does not fit: {error}") from error

    return check


def _check_class(message: object, message_class: type, path: str) -> None:
    if not isinstance(message, message_class):
        module, name = message_class.__module__, message_class.__name__
        raise TypeError(f"{path}: expected {module}.{name}, got {type(message)}")


def fitted(
    field_type: FieldType, nested: Anything, value: Anything, path: str, fit_message: Anything
) -> object:
    """Return a field's value as turtleact's codecs take it.

    Args:
        field_type: The type of the field.
        nested: The class of the field's messages; None if it holds no messages.
        value: The value that the program has set.
        path: The names of the field and of the fields around it, for errors.
        fit_message: Called with each nested message, its class and its path.

    Raises:
        TypeError: if the value does not fit.
    """
    if not field_type.is_sequence:
        return _fitted_value(field_type, nested, value, path, fit_message)
    if isinstance(value, str) or not hasattr(value, "__iter__"):
        raise TypeError(f"{path}: expected a sequence, got {value!r}")
    if field_type.name in TYPECODES:
        return _sized(field_type, _converted(field_type, value, path), path)
    element = field_type.element
    values = [_fitted_value(element, nested, each, path, fit_message) for each in value]
    return _sized(field_type, values, path)


def _converted(field_type: FieldType, value: Anything, path: str) -> list[object]:
    try:
        converted: Anything = sequence_of(field_type)(value)
        listed: list[object] = converted.tolist()
    except (TypeError, ValueError, OverflowError) as error:
        raise TypeError(f"{path}: {error}") from error
    return listed


def _sized(field_type: FieldType, values: list[object], path: str) -> object:
    size, form = field_type.size, field_type.form
    if form is ArrayForm.FIXED and len(values) != size:
        raise TypeError(f"{path}: expected {size} elements, got {len(values)}")
    if form is ArrayForm.BOUNDED and len(values) > size:
        raise TypeError(f"{path}: expected at most {size} elements, got {len(values)}")
    return values


def _fitted_value(
    field_type: FieldType, nested: Anything, value: Anything, path: str, fit_message: Anything
) -> object:
    kind = field_type.name
    if nested is not None:
        found: object = fit_message(value, nested, path)
        return found
    if kind == "byte" and isinstance(value, bytes) and len(value) == 1:
        return value[0]
    if kind == "bool" and (isinstance(value, bool) or type(value).__name__ in ("bool", "bool_")):
        return bool(value)
    if field_type.is_string and isinstance(value, str):
        bound = field_type.string_bound
        if bound is None or len(value) <= bound:
            return str(value)
    elif kind in INTEGER_RANGES and hasattr(value, "__index__"):
        low, high = INTEGER_RANGES[kind]
        if low <= (number := value.__index__()) <= high:
            return number
    elif kind in ("float32", "float64") and hasattr(value, "__float__"):
        return float(value)
    raise TypeError(f"{path}: a {field_type} cannot be {value!r}")
