from __future__ import annotations

import contextlib
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact.errors import InvalidInterface
from turtleact.interfaces.definition import (
    ArrayForm,
    CompoundDefinition,
    Constant,
    Field,
    FieldType,
    MessageDefinition,
)
from turtleact.interfaces.parse import parse

from ..tables import together

GOLDEN = Path(__file__).parent / "golden"
FILES = sorted(GOLDEN.glob("*/*/*.*"))
NAME = "example_msgs/msg/Sample"


def message(text: str) -> MessageDefinition:
    said = parse(text, NAME, source="sample.msg")
    assert isinstance(said, MessageDefinition)
    return said


@together
@pytest.mark.parametrize("path", FILES, ids=[path.stem for path in FILES])
def test_each_interface_of_ros_is_read(path):
    package, kind, _ = path.parts[-3:]
    name = f"{package}/{kind}/{path.stem}"
    assert parse(path.read_text(), name).type_name == name


@together
@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("int32 x", Field("x", FieldType("int32"))),
        ("int32 x 5", Field("x", FieldType("int32"), 5)),
        ("int32 x -0x10", Field("x", FieldType("int32"), -16)),
        ("int32 x 007", Field("x", FieldType("int32"), 7)),
        ("int32 x 1_000", Field("x", FieldType("int32"), 1000)),
        ("uint8 x 0b101", Field("x", FieldType("uint8"), 5)),
        ("bool x True", Field("x", FieldType("bool"), True)),
        ("float64 x .5e3", Field("x", FieldType("float64"), 500.0)),
        ('string x "a b"', Field("x", FieldType("string"), "a b")),
        ("string x a b", Field("x", FieldType("string"), "a b")),
        ("string x 'a \"b\" \\' c'", Field("x", FieldType("string"), 'a "b" \' c')),
        ("string x don't", Field("x", FieldType("string"), "don't")),
        ("string<=10 x", Field("x", FieldType("string", 10))),
        ("wstring<=3 x 'äöü'", Field("x", FieldType("wstring", 3), "äöü")),
        ("int32[] x", Field("x", FieldType("int32", None, ArrayForm.UNBOUNDED))),
        ("int32[5] x", Field("x", FieldType("int32", None, ArrayForm.FIXED, 5))),
        ("int32[<=5] x", Field("x", FieldType("int32", None, ArrayForm.BOUNDED, 5))),
        ("string<=10[<=3] x", Field("x", FieldType("string", 10, ArrayForm.BOUNDED, 3))),
        ("int32[] x [1, 2]", Field("x", FieldType("int32", None, ArrayForm.UNBOUNDED), (1, 2))),
        (
            "string[] x ['a, b', \"c\"]",
            Field("x", FieldType("string", None, ArrayForm.UNBOUNDED), ("a, b", "c")),
        ),
        ("Other x", Field("x", FieldType("example_msgs/msg/Other"))),
        ("Header x", Field("x", FieldType("example_msgs/msg/Header"))),
        ("geometry_msgs/Point x", Field("x", FieldType("geometry_msgs/msg/Point"))),
        ("geometry_msgs/msg/Point x", Field("x", FieldType("geometry_msgs/msg/Point"))),
        ("int32 from", Field("from", FieldType("int32"))),
        ('string x "a=b"', Field("x", FieldType("string"), "a=b")),
    ],
)
def test_a_field_is_read(text, field):
    assert message(text).fields == (field,)


@pytest.mark.parametrize(
    ("text", "constant"),
    [
        ("uint8 X=5", Constant("X", FieldType("uint8"), 5)),
        ("string X='a = b'", Constant("X", FieldType("string"), "a = b")),
        ("string X=", Constant("X", FieldType("string"), "")),
        ("wstring X= # none", Constant("X", FieldType("wstring"), "")),
        ("char\tX\t=\t65\t# A", Constant("X", FieldType("char"), 65)),
    ],
)
def test_a_constant_is_read(text, constant):
    assert message(text).constants == (constant,)


@pytest.mark.parametrize(
    "text", ["", "# int32 y", "int32 x # int32 y", "\n\n   \n", "int32 x 0 # don't \"x"]
)
def test_comments_and_empty_lines_say_nothing(text):
    assert [field.name for field in message(text).fields] in ([], ["x"])


def test_a_hash_in_quotes_is_no_comment():
    assert message('string x "#1" # the first').fields[0].default == "#1"


def test_line_ends_of_any_system_are_taken():
    assert len(message("\ufeffint32 a\r\nint32 b\rint32 c\n").fields) == 3


def test_an_action_has_three_parts():
    action = parse("int32 a\n---\n---\nOther b", "example_msgs/action/Sample")
    assert isinstance(action, CompoundDefinition)
    assert action.parts[2].fields == (Field("b", FieldType("example_msgs/msg/Other")),)


def test_an_error_shows_the_line_and_a_caret():
    with pytest.raises(InvalidInterface) as caught:
        parse("---\n---\nfloat46 x", "example_msgs/action/Patrol", source="patrol.action")
    assert str(caught.value) == (
        "patrol.action:3:1: unknown type 'float46', did you mean 'float64'?\n  float46 x\n  ^"
    )


@together
@pytest.mark.parametrize(
    ("text", "column", "problem"),
    [
        ("int32", 6, "expected a type and a name"),
        ("int32 X", 7, "'X' is not a valid field name"),
        ("int32 x = 5", 7, "'x' is not a valid constant name"),
        ("uint8 X =", 10, "expected a value after '='"),
        ("uint8 X=300", 9, r"300 is out of range for uint8 \(0 to 255\)"),
        ("Point X=3", 9, "cannot have a default"),
        ("uint8[] X=[1]", 9, "a constant is a number, a bool or a string, not uint8"),
        ("int32 x y", 9, r"expected a whole number \(int32\), got 'y'"),
        ("bool x maybe", 8, r"expected true or false \(bool\), got 'maybe'"),
        (f"int32 x {'9' * 5000}", 9, "expected a whole number"),
        ("int32[0] x", 1, "a bound or a length is at least 1"),
        ("int32[2000000] x", 1, "at most 1000000 elements"),
        ("int32<=5 x", 6, "only a string has a bound of its own"),
        ("int32[ x", 1, r"'int32\[' is not a type: write int32, int32\[5\]"),
        ("Point p 3", 9, r"a message \(example_msgs/msg/Point\) cannot have a default"),
        ("int32[] x 1", 11, r"must be in brackets, as in \[1, 2\]"),
        ("int32[] x [1,]", 11, "expected values separated by commas"),
        ("int32[] x [a]", 11, r"element \[0\]: expected a whole number"),
        ("string[] x ['a' 'b']", 12, "expected values separated by commas"),
        ("int32[2] x [1]", 12, "exactly 2 elements, got 1"),
        ("string<=2 x abc", 13, "at most 2 characters, got 3"),
        ("string x 'a", 10, "a quote is opened but not closed"),
        ("float64 x inf", 11, "inf is not finite"),
        ("float64 x 1,5", 11, r"expected a number \(float64\), got '1,5'"),
        ('@verbatim(language="comment", text="x")', 1, "is not a type"),
        ("float64 x 1e999", 11, "1e999 is not finite"),
        ("int32 x\nint32 x", 7, "'x' is declared twice"),
        ("double x", 1, "unknown type 'double', did you mean 'float64'"),
        ("time x", 1, "did you mean 'builtin_interfaces/Time'"),
        ("zebra x", 1, "unknown type 'zebra'$"),
        ("a/b/c/D x", 1, "unknown type 'a/b/c/D'"),
        ("int32 x\n---", 1, "this '---' begins part 2, but a message has only 1"),
    ],
)
def test_a_mistake_is_told_with_its_place(text, column, problem):
    with pytest.raises(InvalidInterface, match=problem.removesuffix("$")) as caught:
        message(text)
    line = text.count("\n") + 1
    assert (caught.value.line, caught.value.column) == (line, column)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (
            "",
            "sample:1:1: the file has 1 part, but an action has 3 (goal, result, feedback): write "
            "a line '---' between each two of them, also if one is empty",
        ),
        ("---", "sample:1:1: the file has 2 parts, but an action has 3"),
        ("---\n---\n---", "sample:3:1: this '---' begins part 4, but an action has 3 (goal, "),
    ],
)
def test_an_action_has_two_separators(text, problem):
    with pytest.raises(InvalidInterface, match=re.escape(problem)):
        parse(text, "example_msgs/action/Sample", source="sample")


@given(st.text())
def test_no_text_breaks_the_parser(text):
    with contextlib.suppress(InvalidInterface):
        message(text)
