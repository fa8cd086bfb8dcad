"""The rules for parameters: kinds of values, ranges, and which values a parameter may have.

This module does no I/O. `turtleact.node.parameters` serves parameters on the graph.

==================  =============================  =============================================
ROS 2               Python                         example
==================  =============================  =============================================
bool                `bool`                         ``True``
integer             `int`                          ``3``
double              `float`                        ``0.5``
string              `str`                          ``"fast"``
array of the above  a `list` of one of the above   ``[0.5, 1.0]``
byte array          `bytes`                        ``b"on"``
==================  =============================  =============================================

If a value is refused, the reason starts with rclcpp's words, because programs may search for these
words.

Source: rclcpp 28.1 (ROS 2 Jazzy), ``node_parameters.cpp``; rcl_interfaces.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from inspect import iscoroutinefunction
from numbers import Integral, Real
from typing import Final, Generic, NamedTuple, TypeAlias, TypeVar, cast

import msgspec

from turtleact.errors import InvalidMessage, InvalidOption, InvalidParameter
from turtleact.interfaces import snapshotter
from turtleact.interfaces.standard.rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    ParameterType,
    ParameterValue,
)

__all__ = [
    "KINDS",
    "Bounds",
    "ParameterDeclaration",
    "Value",
    "descriptor_of",
    "fitted",
    "flattened",
    "is_listed",
    "message_of",
    "misfit",
    "out_of_range",
    "parameter",
    "value_of",
]

Value: TypeAlias = (
    "bool | int | float | str | bytes | list[bool] | list[int] | list[float] | list[str]"
)
"""The Python types of a parameter's value."""

Bounds: TypeAlias = tuple[float, float] | tuple[float, float, float]
"""The range of a number: the least, the greatest, and perhaps the step between allowed numbers."""

P = TypeVar("P", bound=Value)


class Kind(NamedTuple):
    """A kind of value.

    Attributes:
        word: rclcpp's name for the kind.
        name: ros2cli's name for the kind.
        field: The field of ``ParameterValue`` that holds the value.
        expected: A description of the Python values of this kind, for error messages.
    """

    word: str
    name: str
    field: str
    expected: str


KINDS: Final = (
    Kind("not set", "not set", "", "nothing"),
    Kind("bool", "boolean", "bool_value", "True or False"),
    Kind("integer", "integer", "integer_value", "a whole number"),
    Kind("double", "double", "double_value", "a number"),
    Kind("string", "string", "string_value", "a string"),
    Kind("byte_array", "byte array", "byte_array_value", "bytes"),
    Kind("bool_array", "boolean array", "bool_array_value", "a list of bools"),
    Kind("integer_array", "integer array", "integer_array_value", "a list of whole numbers"),
    Kind("double_array", "double array", "double_array_value", "a list of numbers"),
    Kind("string_array", "string array", "string_array_value", "a list of strings"),
)
"""The kinds of values, by the numbers of ``ParameterType``."""

_NOT_SET = ParameterType.PARAMETER_NOT_SET
_INTEGER = ParameterType.PARAMETER_INTEGER
_DOUBLE = ParameterType.PARAMETER_DOUBLE
_BYTES = ParameterType.PARAMETER_BYTE_ARRAY
_ARRAY = ParameterType.PARAMETER_BOOL_ARRAY - ParameterType.PARAMETER_BOOL
"""What to add to the number of a type, such as a bool, to get the number of its array type."""


class ParameterDeclaration(Generic[P]):
    """A parameter that a module declares. `turtleact.parameter` makes one.

    Attributes:
        name: The name of the parameter.
        descriptor: The parameter's name, kind, description and range, as a message.
        message: The parameter's initial value, as a message.
        validate: A function that checks values; see `turtleact.parameter`.
    """

    def __init__(
        self,
        descriptor: ParameterDescriptor,
        message: ParameterValue,
        validate: Callable[[P], object] | None,
    ) -> None:
        self.name = descriptor.name
        self.descriptor = descriptor
        self.message = message
        self.validate = validate

    @property
    def default(self) -> P:
        """The parameter's initial value."""
        return cast("P", value_of(self.message))

    def __repr__(self) -> str:
        return f"<ParameterDeclaration '{self.name}'>"


def parameter(
    name: str,
    default: P,
    *,
    description: str = "",
    range: Bounds | None = None,
    read_only: bool = False,
    validate: Callable[[P], object] | None = None,
) -> ParameterDeclaration[P]:
    """Declare a parameter in a module, for every node that serves the module's actions.

    ``turtleact serve`` declares the parameter on its node. A body reads it with
    ``handle.node.parameter(declaration).value``. If the node does not have the parameter yet, this
    expression declares it.

    Args:
        name: The parameter's name. Dots form groups: ``camera.width`` is in the group ``camera``.
        default: The initial value. It sets the kind that all later values must have: `bool`, `int`,
            `float`, `str`, `bytes`, or a list of `bool`, `int`, `float` or `str`. Later values of a
            `float` may also be whole numbers.
        description: What the parameter is for, with its unit.
        range: The least and the greatest allowed number, and optionally the step between allowed
            numbers. Only an `int` or `float` can have a range. Both ends are always allowed.
        read_only: Whether the parameter keeps its initial value.
        validate: A function that is called with each new value, including the initial one. To
            refuse a value, it raises `ValueError` with the reason, or returns False.

    Raises:
        InvalidParameter: if ``name`` is not allowed, or ``default`` has an unsupported type or is
            out of range.
        InvalidOption: if ``description``, ``range`` or ``validate`` is not allowed.

    >>> max_speed = parameter("max_speed", 1.0, range=(0.0, 2.0))
    >>> max_speed.name, max_speed.default
    ('max_speed', 1.0)
    """
    made = message_of(name, default)
    descriptor = descriptor_of(name, made.type, description, bounds=range, read_only=read_only)
    if problem := out_of_range(descriptor, made):
        raise InvalidParameter(name, problem)
    if validate is not None and (not callable(validate) or iscoroutinefunction(validate)):
        raise InvalidOption("validate", f"expected a plain function, not {validate!r}")
    return ParameterDeclaration(descriptor, made, validate)


def descriptor_of(
    name: str,
    kind: int,
    description: str = "",
    *,
    bounds: Bounds | None = None,
    read_only: bool = False,
) -> ParameterDescriptor:
    """Make the message that describes a parameter.

    Args:
        name: The parameter's name. Dots form groups: ``camera.width`` is in the group ``camera``.
        kind: The number of the parameter's kind in `KINDS`.
        description: What the parameter is for.
        bounds: The range of an integer or double, including both ends.
        read_only: Whether the parameter keeps its initial value for ever.

    Raises:
        InvalidParameter: if the name is empty or not a string.
        InvalidOption: if the description is not a string, or the range is not valid for the kind.
    """
    if not isinstance(name, str) or not name:
        raise InvalidParameter(name, "its name must be a string that is not empty")
    if not isinstance(description, str):
        raise InvalidOption("description", f"expected a string, not {description!r}")
    described = ParameterDescriptor(name, kind, description, read_only=bool(read_only))
    if bounds is None:
        return described
    if kind not in (_INTEGER, _DOUBLE):
        problem = f"parameter '{name}' is of type {KINDS[kind].word}; only numbers have a range"
        raise InvalidOption("range", problem)
    first, last, step = _checked_bounds(bounds, is_whole=kind == _INTEGER)
    if kind == _INTEGER:
        described.integer_range = [IntegerRange(int(first), int(last), int(step))]
    else:
        described.floating_point_range = [
            FloatingPointRange(float(first), float(last), float(step))
        ]
    return described


def _checked_bounds(bounds: Bounds, *, is_whole: bool) -> tuple[float, float, float]:
    numbers = list(bounds) if isinstance(bounds, tuple | list) else []
    wanted = Integral if is_whole else Real
    fit = all(isinstance(each, wanted) and not isinstance(each, bool) for each in numbers)
    if len(numbers) not in (2, 3) or not fit:
        kind = "whole numbers" if is_whole else "numbers"
        raise InvalidOption("range", f"expected two {kind}, and perhaps a step, not {bounds!r}")
    first, last, step = (*numbers, 0)[:3]
    if not (first <= last and 0 <= step < math.inf):
        problem = f"expected the lower number first, and a step of 0 or more, not {bounds}"
        raise InvalidOption("range", problem)
    return first, last, step


def value_of(message: ParameterValue) -> Value | None:
    """Return a parameter's value as a Python object; None if it is not set.

    >>> value_of(ParameterValue(3, double_value=0.5))
    0.5
    """
    if not _NOT_SET < message.type < len(KINDS):
        return None
    value = getattr(message, KINDS[message.type].field)
    if message.type == _BYTES:
        return bytes(value)
    return cast("Value", list(value) if message.type > _BYTES else value)


def message_of(name: str, value: object, kind: int = _NOT_SET) -> ParameterValue:
    """Return a Python value as a message.

    Args:
        name: The parameter's name, for error messages.
        value: The value. If ``kind`` is the number of doubles, an int is also allowed.
        kind: The number of the kind that the value must have. If left out, the value's own kind is
            used.

    Raises:
        InvalidParameter: if the value is of another kind, or of a type that parameters cannot have.

    >>> message_of("gains", [1, 0.5]).double_array_value
    [1.0, 0.5]
    """
    own = _kind_of(value)
    if own == _NOT_SET and value == [] and isinstance(value, list):
        if kind == _NOT_SET:
            raise InvalidParameter(name, "an empty list has no kind: put an item in it")
        own = kind if kind > _BYTES else own
    if own + 1 == kind and kind in (_DOUBLE, _DOUBLE + _ARRAY):  # integers, for doubles
        own = kind
    if own != (kind or own) or own == _NOT_SET:
        any_kind = "a bool, a number, a string, bytes, or a list of values of one kind"
        expected = KINDS[kind].expected if kind else any_kind
        raise InvalidParameter(name, f"expected {expected}, not {value!r}")
    plain = _convert(value, own)
    made = msgspec.structs.replace(ParameterValue(own), **{KINDS[own].field: plain})
    try:
        return snapshotter(ParameterValue)(made)
    except InvalidMessage as misfit:
        raise InvalidParameter(name, misfit.problem) from None


def fitted(name: str, value: object, kind: int) -> ParameterValue:
    """Return a value of JSON or YAML as a message of a parameter's kind, or else of its own kind.

    These formats write 1 for 1.0 and a list of numbers for bytes, and their empty lists may be of
    any kind.

    Args:
        name: The parameter's name, for error messages.
        value: The value.
        kind: The number of the parameter's kind.

    Raises:
        InvalidParameter: if parameters cannot have this value.
    """
    try:
        is_bytes = kind == _BYTES and isinstance(value, list)
        return message_of(name, bytes(cast("list[int]", value)) if is_bytes else value, kind)
    except (InvalidParameter, TypeError, ValueError):  # bytes() refuses text and numbers over 255
        if value == []:  # rclpy takes an empty list for bools
            return ParameterValue(ParameterType.PARAMETER_BOOL_ARRAY)
        return message_of(name, value)


def _kind_of(value: object) -> int:
    """Return a value's parameter type as in ``ParameterType``; 0 if no type fits."""
    for number, types in enumerate((bool, Integral, Real, str, bytes | bytearray), start=1):
        if isinstance(value, types):
            return number
    if not isinstance(value, list | tuple):
        return _NOT_SET
    kinds = {_kind_of(item) for item in value}
    if kinds == {_INTEGER, _DOUBLE}:
        kinds = {_DOUBLE}
    kind = kinds.pop() if len(kinds) == 1 else _NOT_SET
    return kind + _ARRAY if _NOT_SET < kind < _BYTES else _NOT_SET


def _convert(value: object, kind: int) -> object:
    """Convert numbers to `int` or `float`, and sequences to lists."""
    if kind >= _BYTES:
        items = cast("Iterable[object]", value)
        return [_convert(item, kind - _ARRAY) for item in items]
    if kind == _INTEGER:
        return int(cast("int", value))
    return float(cast("float", value)) if kind == _DOUBLE else value


def out_of_range(descriptor: ParameterDescriptor, value: ParameterValue) -> str:
    """Return why a number is out of a parameter's range; "" if it is in the range.

    >>> speed = descriptor_of("speed", 2, bounds=(0, 10, 5))
    >>> out_of_range(speed, message_of("speed", 7))
    'it takes 0 to 10 in steps of 5, not 7'
    """
    if value.type == _INTEGER:
        number: float = value.integer_value
        ranges: Sequence[IntegerRange | FloatingPointRange] = descriptor.integer_range
    elif value.type == _DOUBLE:
        number, ranges = value.double_value, descriptor.floating_point_range
    else:
        return ""
    for bounds in ranges:
        if not _is_within(number, bounds):
            is_any = not bounds.step or (isinstance(bounds, IntegerRange) and bounds.step == 1)
            steps = "" if is_any else f" in steps of {bounds.step}"
            return f"it takes {bounds.from_value} to {bounds.to_value}{steps}, not {number}"
    return ""


def _is_within(number: float, bounds: IntegerRange | FloatingPointRange) -> bool:
    first, last, step = bounds.from_value, bounds.to_value, bounds.step
    if _is_same(number, first) or _is_same(number, last):  # allowed even if they are off the steps
        return True
    if not first <= number <= last:
        return False
    if not step or math.isinf(first):
        return True
    if isinstance(bounds, IntegerRange):
        return (number - first) % step == 0
    return _is_same(number, first + round((number - first) / step) * step)


def _is_same(one: float, other: float) -> bool:
    """Whether two numbers are equal, apart from rounding errors of doubles, as in rclcpp."""
    if isinstance(one, int) or math.isinf(one) or math.isinf(other):
        return one == other
    return abs(one - other) <= 2.220446049250313e-14 * abs(one + other)


def misfit(descriptor: ParameterDescriptor, value: ParameterValue) -> str:
    """Return rclcpp's error text if a parameter cannot be set to a value; otherwise ""."""
    name = descriptor.name
    if descriptor.read_only:
        return f"parameter '{name}' cannot be set because it is read-only"
    if value.type == _NOT_SET:
        return "cannot undeclare a statically typed parameter"
    if value.type != descriptor.type:
        number = value.type
        given = KINDS[number].word if number < len(KINDS) else f"unknown type {number}"
        return (
            f"Wrong parameter type, parameter {{{name}}} is of type"
            f" {{{KINDS[descriptor.type].word}}}, setting it to {{{given}}} is not allowed."
        )
    taken = out_of_range(descriptor, value)
    kind = "integer" if value.type == _INTEGER else "floating point"
    said = f"{taken[:1].upper()}{taken[1:]}."
    return f"Parameter {{{name}}} doesn't comply with {kind} range. {said}" if taken else ""


def is_listed(name: str, prefixes: Sequence[str], depth: int) -> bool:
    """Whether the service ``list_parameters`` lists a parameter for these prefixes and this depth.

    Args:
        name: The parameter's name.
        prefixes: The names of groups or parameters. A parameter is listed if ``prefixes`` contains
            the parameter's name or one of the parameter's groups. If ``prefixes`` is empty, only
            ``depth`` limits the list.
        depth: How many parts a name may have after its prefix; 0 for any number. Without prefixes,
            ``depth`` limits the parts of the whole name.
    """
    if not prefixes:
        return depth == 0 or name.count(".") < depth
    for prefix in prefixes:
        rest = name.removeprefix(f"{prefix}.")
        if name == prefix or (rest != name and (depth == 0 or rest.count(".") < depth)):
            return True
    return False


def flattened(tree: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, object]]:
    """Yield each value of a nested mapping with the dotted name of its parameter.

    >>> dict(flattened({"arm": {"speed": 2.0, "joint": {"count": 6}}, "name": "lab"}))
    {'arm.speed': 2.0, 'arm.joint.count': 6, 'name': 'lab'}
    """
    for name, value in tree.items():
        if isinstance(value, dict):
            yield from flattened(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value
