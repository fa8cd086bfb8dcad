from __future__ import annotations

import array
import enum
import fractions
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact.errors import InvalidMessage
from turtleact.interfaces.definition import INTEGER_RANGES, ArrayForm, FieldType
from turtleact.interfaces.values import converter, describe

from ..tables import together


class Level(enum.IntEnum):
    LOW = 1


class Name(enum.StrEnum):
    FIRST = "turtle1"


def convert(name: str, value: object, **options: Any) -> Any:
    return converter(FieldType(name, **options))(value)


@together
@pytest.mark.parametrize(
    ("name", "value", "result"),
    [
        ("int32", 5, 5),
        ("int32", np.int64(5), 5),
        ("int8", Level.LOW, 1),
        ("byte", b"a", 97),
        ("float64", 5, 5.0),
        ("float64", np.float32(0.5), 0.5),
        ("float64", fractions.Fraction(1, 2), 0.5),
        ("float32", 3.4028235e38, 3.4028235e38),
        ("float32", math.inf, math.inf),
        ("bool", True, True),
        ("bool", np.False_, False),
        ("string", "żółw", "żółw"),
        ("string", Name.FIRST, "turtle1"),
        ("wstring", "🐢", "🐢"),
    ],
)
def test_a_value_that_fits_becomes_pythons_own(name, value, result):
    converted = convert(name, value)
    assert (converted, type(converted)) == (result, type(result))


def test_a_bound_of_a_string_counts_characters():
    assert convert("string", "żółw", string_bound=4) == "żółw"
    with pytest.raises(InvalidMessage, match="at most 4 characters, got 5"):
        convert("string", "abcde", string_bound=4)


@pytest.mark.parametrize(
    "value",
    [[1, 2], (1, 2), array.array("q", [1, 2]), np.array([1, 2]), np.array([1, 2], np.uint8)],
)
def test_a_sequence_becomes_a_list(value):
    assert convert("int32", value, form=ArrayForm.UNBOUNDED) == [1, 2]


@pytest.mark.parametrize("value", [b"ab", bytearray(b"ab")])
@pytest.mark.parametrize("name", ["uint8", "byte", "char"])
def test_bytes_stay_bytes(name, value):
    converted = convert(name, value, form=ArrayForm.UNBOUNDED)
    assert (converted, type(converted)) == (b"ab", bytes)


@pytest.mark.parametrize(
    "value", ["abc", b"abc", {1, 2}, {1: 2}, 5, None, range(3), iter([1]), np.float64(1)]
)
def test_what_is_no_sequence_is_refused(value):
    with pytest.raises(InvalidMessage, match="expected a list of int32, got"):
        convert("int32", value, form=ArrayForm.UNBOUNDED)


def test_an_array_has_one_dimension():
    with pytest.raises(InvalidMessage, match="got an array of 2 dimensions"):
        convert("int32", np.zeros((2, 2), int), form=ArrayForm.UNBOUNDED)


def test_a_long_value_is_cut():
    assert len(describe("x" * 1000)) <= 60


@given(st.sampled_from(sorted(INTEGER_RANGES)), st.integers())
def test_an_integer_fits_exactly_in_its_range(name, value):
    low, high = INTEGER_RANGES[name]
    if low <= value <= high:
        assert convert(name, value) == value
    else:
        with pytest.raises(InvalidMessage, match="out of range"):
            convert(name, value)
