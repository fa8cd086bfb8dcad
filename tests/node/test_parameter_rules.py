"""The rules for parameters: kinds, ranges, words. Their services are tested with the node."""

from __future__ import annotations

import math
import re
from typing import Any

import pytest

from turtleact import parameter
from turtleact.errors import InvalidOption, InvalidParameter
from turtleact.interfaces.standard.rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterValue,
)
from turtleact.node.parameter_rules import (
    KINDS,
    descriptor_of,
    fitted,
    message_of,
    misfit,
    out_of_range,
    value_of,
)

from ..tables import together

# --- values ---------------------------------------------------------------------------------

VALUES = [
    (True, 1),
    (3, 2),
    (0.5, 3),
    ("fast", 4),
    (b"on", 5),
    ([True, False], 6),
    ([1, 2], 7),
    ([0.5, 1.5], 8),
    (["a", "b"], 9),
]


@pytest.mark.parametrize(("value", "number"), VALUES)
def test_a_value_survives_the_way_through_its_message(value, number):
    made = message_of("x", value)
    assert (made.type, value_of(made)) == (number, value)
    assert type(value_of(made)) is type(value)


@pytest.mark.parametrize(
    ("value", "kind", "expected"),
    [(2, 3, 2.0), ([1, 2], 8, [1.0, 2.0]), ([1, 0.5], 0, [1.0, 0.5]), ([], 9, []), ((1,), 7, [1])],
)
def test_whole_numbers_are_taken_for_doubles_and_empty_lists_for_arrays(value, kind, expected):
    assert value_of(message_of("x", value, kind)) == expected


@pytest.mark.parametrize(
    ("value", "kind", "problem"),
    [
        (None, 0, "expected a bool, a number, a string, bytes, or a list of values of one kind"),
        ([1, "a"], 0, "or a list of values of one kind, not [1, 'a']"),
        ([[1]], 0, "or a list of values of one kind"),
        ([], 0, "an empty list has no kind: put an item in it"),
        ([], 5, "expected bytes, not []"),
        (0.5, 2, "expected a whole number, not 0.5"),
        (True, 2, "expected a whole number, not True"),
        (1, 1, "expected True or False, not 1"),
        ("1", 3, "expected a number, not '1'"),
        ([0.5], 7, "expected a list of whole numbers, not [0.5]"),
        (2**63, 2, "is out of range for int64"),
        ("\udce9", 4, "half a surrogate pair"),
    ],
)
def test_a_value_of_another_kind_is_refused(value, kind, problem):
    with pytest.raises(InvalidParameter, match=f"^parameter 'x': .*{re.escape(problem)}"):
        message_of("x", value, kind)


@pytest.mark.parametrize("number", [0, 99])
def test_a_message_of_no_known_kind_has_no_value(number):
    assert value_of(ParameterValue(number)) is None


# --- ranges ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("bounds", "taken", "refused"),
    [
        ((0, 9), [0, 5, 9], [-1, 10]),
        ((0, 10, 4), [0, 4, 8, 10], [1, 9, 12]),
        ((3, 3), [3], [2, 4]),
        ((0.0, 2.0), [0.0, 0.3, 2.0, 2.0 + 1e-15], [-0.1, 2.1, math.nan, math.inf]),
        ((0.0, 1.0, 0.1), [0.1, 0.3, 0.1 * 3, 0.7, 1.0], [0.05, 0.35]),
        ((0.0, math.inf), [0.0, 1e300, math.inf], [-1.0]),
        ((-math.inf, 0.0, 0.5), [-math.inf, -0.3], [0.1]),
    ],
)
def test_a_range_has_both_ends_and_steps_from_the_first(bounds, taken, refused):
    descriptor = descriptor_of("x", message_of("x", taken[0]).type, bounds=bounds)
    for value in taken:
        assert out_of_range(descriptor, message_of("x", value)) == ""
    for value in refused:
        assert "it takes " in out_of_range(descriptor, message_of("x", value))


def test_a_range_is_named_with_its_step():
    descriptor = descriptor_of("x", 3, bounds=(0, 2, 0.5))
    problem = out_of_range(descriptor, message_of("x", 0.3))
    assert problem == "it takes 0.0 to 2.0 in steps of 0.5, not 0.3"


def test_a_description_has_the_range_of_its_kind():
    assert descriptor_of("n", 2, bounds=(0, 9)).integer_range == [IntegerRange(0, 9, 0)]
    described = descriptor_of("x", 3, "Speed (m/s)", bounds=(0, 2, 0.5), read_only=True)
    assert described.floating_point_range == [FloatingPointRange(0.0, 2.0, 0.5)]
    assert (described.description, described.read_only) == ("Speed (m/s)", True)


@pytest.mark.parametrize(
    ("default", "bounds", "problem"),
    [
        (3, (0.5, 9), "expected two whole numbers, and perhaps a step, not (0.5, 9)"),
        (3, (True, 9), "expected two whole numbers"),
        (0.5, (0,), "expected two numbers, and perhaps a step, not (0,)"),
        (0.5, 3, "expected two numbers, and perhaps a step, not 3"),
        (3, (9, 0), "expected the lower number first"),
        (3, (0, 9, -1), "a step of 0 or more"),
        (0.5, (0, math.nan), "expected the lower number first"),
        ("a", (0, 9), "parameter 'x' is of type string; only numbers have a range"),
        ([1], (0, 9), "is of type integer_array; only numbers have a range"),
    ],
)
def test_what_is_no_range_is_refused(default, bounds, problem):
    with pytest.raises(InvalidOption, match=f"^option 'range': .*{re.escape(problem)}"):
        parameter("x", default, range=bounds)


# --- declarations ---------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["", None, 3])
def test_a_parameter_needs_a_name(name):
    with pytest.raises(InvalidParameter, match="its name must be a string that is not empty"):
        parameter(name, 1)


def test_a_default_out_of_range_is_refused():
    with pytest.raises(InvalidParameter, match=r"^parameter 'x': it takes 0 to 9, not 10$"):
        parameter("x", 10, range=(0, 9))


@pytest.mark.parametrize("option", ["description", "validate"])
def test_what_is_no_description_or_function_is_refused(option):
    options: Any = {option: 3}
    with pytest.raises(InvalidOption, match=f"^option '{option}': expected a .*, not 3$"):
        parameter("x", 1, **options)


def test_a_coroutine_function_cannot_validate():
    async def check(value):
        pass

    with pytest.raises(InvalidOption, match=r"^option 'validate': expected a plain function"):
        parameter("x", 1, validate=check)


def test_a_declaration_keeps_its_default():
    declared = parameter("gains", [1.0])
    declared.default.append(2.0)
    assert (declared.default, repr(declared)) == ([1.0], "<ParameterDeclaration 'gains'>")


# --- what rclcpp says -----------------------------------------------------------------------

TABLE = {
    name: descriptor_of(name, kind, bounds=bounds, read_only=name == "fixed")
    for name, kind, bounds in [("depth", 2, (0, 9)), ("width", 3, (0, 1)), ("fixed", 2, None)]
}

WRONG = (
    "Wrong parameter type, parameter {depth} is of type {integer}, setting it to {%s} is not"
    " allowed."
)
WHOLE = "Parameter {depth} doesn't comply with integer range. It takes 0 to 9, not 10."
REAL = "Parameter {width} doesn't comply with floating point range. It takes 0.0 to 1.0, not 1.5."
OTHERS = [(message_of("", value), KINDS[number].word) for value, number in VALUES if number != 2]
REFUSED = [
    ("depth", message_of("", 10), WHOLE),
    ("width", message_of("", 1.5), REAL),
    *(("depth", message, WRONG % kind) for message, kind in OTHERS),
    ("depth", ParameterValue(99), WRONG % "unknown type 99"),
    ("depth", ParameterValue(), "cannot undeclare a statically typed parameter"),
    ("fixed", message_of("", 2), "parameter 'fixed' cannot be set because it is read-only"),
]


@together
@pytest.mark.parametrize(("name", "value", "reason"), REFUSED)
def test_what_a_parameter_cannot_be_is_refused_in_rclcpps_words(name, value, reason):
    assert misfit(TABLE[name], value) == reason


@together
@pytest.mark.parametrize(
    ("value", "kind", "held"),
    [
        (1, 3, 1.0),
        ([1, 2], 8, [1.0, 2.0]),
        ([1, 255], 5, b"\x01\xff"),
        ([1, 256], 5, [1, 256]),
        ([], 9, []),
        ([], 4, []),
        ("fast", 2, "fast"),
        (True, 2, True),
    ],
)
def test_a_value_of_json_takes_the_kind_of_its_parameter_if_it_fits(value, kind, held):
    assert value_of(fitted("it", value, kind)) == held
