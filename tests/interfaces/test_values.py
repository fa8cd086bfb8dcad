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
from turtleact.interfaces.values import FLOAT32_LIMIT, converter, describe, expected

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
        ("int32", np.array(5), 5),
        ("int8", Level.LOW, 1),
        ("byte", b"a", 97),
        ("byte", 255, 255),
        ("char", 255, 255),
        ("float64", 5, 5.0),
        ("float64", np.float32(0.5), 0.5),
        ("float64", np.float64(0.5), 0.5),
        ("float64", np.int8(3), 3.0),
        ("float64", fractions.Fraction(1, 2), 0.5),
        ("float32", 3.4028235e38, 3.4028235e38),
        ("float32", 0.1, 0.1),
        ("float32", math.inf, math.inf),
        ("bool", True, True),
        ("bool", np.False_, False),
        ("string", "żółw", "żółw"),
        ("string", Name.FIRST, "turtle1"),
        ("string", np.str_("a"), "a"),
        ("wstring", "🐢", "🐢"),
    ],
)
def test_a_value_that_fits_becomes_pythons_own(name, value, result):
    converted = convert(name, value)
    assert (converted, type(converted)) == (result, type(result))


@together
@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("int32", True, r"expected a whole number \(int32\), got True"),
        ("int32", np.True_, r"expected a whole number \(int32\), got np.True_"),
        ("int32", 5.0, "got 5.0"),
        ("int32", "5", "got '5'"),
        ("int32", None, "got None"),
        ("int32", np.array([5]), r"got array\(\[5\]\)"),
        ("int32", b"a", "got b'a'"),
        ("byte", b"ab", "got b'ab'"),
        ("int32", 2**31, r"2147483648 is out of range for int32 \(-2147483648 to 2147483647\)"),
        ("uint8", -1, r"-1 is out of range for uint8 \(0 to 255\)"),
        (
            "uint64",
            2**2000,
            r"11481306952742.*\.\.\..* is out of range for uint64",
        ),
        ("float64", "abc", r"expected a number \(float64\), got 'abc'"),
        ("float64", False, "got False"),
        ("float64", 1j, "got 1j"),
        ("float64", 10**400, r"1000.*\.\.\.0000.* is out of range for float64"),
        (
            "float32",
            1e39,
            r"1e\+39 is out of range for float32 \(-3.4028235e\+38 to 3.4028235e\+38\)",
        ),
        ("float32", -FLOAT32_LIMIT, "is out of range for float32"),
        ("bool", 1, r"expected true or false \(bool\), got 1"),
        ("string", 5, r"expected text \(string\), got 5"),
        ("string", b"a", "got b'a'"),
        ("string", "a\ud800", "character 1 is half a surrogate pair"),
        ("string", "x" * 500, None),
    ],
)
def test_a_value_that_does_not_fit_is_told(name, value, problem):
    if problem is None:
        assert convert(name, value) == value
        return
    with pytest.raises(InvalidMessage, match=problem):
        convert(name, value)


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


def test_an_element_is_told_with_its_index():
    with pytest.raises(InvalidMessage, match=r"^\[1\]: expected a whole number") as caught:
        convert("int32", [1, 2.5], form=ArrayForm.UNBOUNDED)
    assert caught.value.path == "[1]"


@pytest.mark.parametrize(
    ("form", "count", "problem"),
    [
        (ArrayForm.BOUNDED, 3, "at most 2 elements, got 3"),
        (ArrayForm.FIXED, 3, "exactly 2 elements, got 3"),
        (ArrayForm.FIXED, 1, "exactly 2 elements, got 1"),
    ],
)
@pytest.mark.parametrize("make", [list, bytes])
def test_a_length_that_does_not_fit_is_told(form, count, problem, make):
    with pytest.raises(InvalidMessage, match=problem):
        convert("uint8", make([0] * count), form=form, size=2)


@pytest.mark.parametrize(
    ("field_type", "words"),
    [
        (FieldType("a/msg/B"), "a message (a/msg/B)"),
        (FieldType("int32", None, ArrayForm.FIXED, 3), "a list of 3 int32"),
        (FieldType("string", 4, ArrayForm.UNBOUNDED), "a list of string<=4"),
    ],
)
def test_what_is_expected_is_said_in_words(field_type, words):
    assert expected(field_type) == words


def test_a_long_value_is_cut():
    assert len(describe("x" * 1000)) <= 60


def test_an_object_whose_repr_breaks_can_be_named():
    class Broken:
        def __repr__(self) -> str:
            raise RuntimeError

    assert "Broken" in describe(Broken())


@given(st.sampled_from(sorted(INTEGER_RANGES)), st.integers())
def test_an_integer_fits_exactly_in_its_range(name, value):
    low, high = INTEGER_RANGES[name]
    if low <= value <= high:
        assert convert(name, value) == value
    else:
        with pytest.raises(InvalidMessage, match="out of range"):
            convert(name, value)
