# No `from __future__ import annotations` here: these annotations are objects.
from collections import ChainMap
from typing import Annotated, ForwardRef

import pytest

from turtleact.errors import InvalidInterface
from turtleact.interfaces import types
from turtleact.interfaces.class_body import read
from turtleact.interfaces.definition import PRIMITIVES, FieldType
from turtleact.interfaces.standard import Point
from turtleact.interfaces.types import Message, array, bool_, bounded, float64, int32, string

from ..tables import together

HERE = ChainMap(globals())


@together
@pytest.mark.parametrize(
    ("annotation", "text"),
    [
        (int32, "int32"),
        (bool_, "bool"),
        (bool, "bool"),
        (float, "float64"),
        (str, "string"),
        (bytes, "uint8[]"),
        (list[int32], "int32[]"),
        (list[Point], "geometry_msgs/msg/Point[]"),
        (Point, "geometry_msgs/msg/Point"),
        (bounded[list[int32], 5], "int32[<=5]"),
        (bounded[string, 10], "string<=10"),
        (bounded[str, 10], "string<=10"),
        (bounded[list[bounded[string, 4]], 2], "string<=4[<=2]"),
        (array[list[float64], 9], "float64[9]"),
        (array[bytes, 16], "uint8[16]"),
        ("list[Point]", "geometry_msgs/msg/Point[]"),
        (list["int32"], "int32[]"),
        (ForwardRef("int32"), "int32"),
        (bounded["list[int32]", 2], "int32[<=2]"),
        (Annotated[Point, "a note of one's own"], "geometry_msgs/msg/Point"),
    ],
)
def test_an_annotation_says_a_type(annotation, text):
    assert str(read(annotation, HERE).field_type) == text


@together
@pytest.mark.parametrize("name", PRIMITIVES)
def test_each_primitive_has_an_annotation(name):
    assert read(getattr(types, name if name != "bool" else "bool_"), HERE).field_type == FieldType(
        name
    )


class Nameless(Message):
    x: int32 = 0


@pytest.mark.parametrize(
    ("annotation", "problem"),
    [
        (int, "int is not a ROS type: say which, from int8 to uint64"),
        (list, r"list is not a ROS type: say of what, as in list\[int32\]"),
        (dict[str, int], r"dict\[str, int\] is not a ROS type"),
        (int | None, "is not a ROS type"),
        (list[list[int32]], r"no lists of lists: put the int32\[\] into a message"),
        (bounded[int32, 5], r"bounded\[…\] is for a list, as in bounded\[list\[int32\], 5\]"),
        (bounded[float, 5], r"bounded\[list\[float64\], 5\]"),
        (array[string, 5], r"array\[…\] is for a list"),
        (array[Point, 5], r"array\[list\[geometry_msgs/msg/Point\], 5\]"),
        ("Missing", "cannot make out 'Missing'.*must be known to the module"),
        ("bounded[string, 0]", "a number above zero"),
        (Nameless, 'Nameless has no type name: .*type_name="package_name/msg/Nameless"'),
        (Message, "Message has no type name"),
    ],
)
def test_what_says_no_type_is_refused(annotation, problem):
    with pytest.raises(InvalidInterface, match=problem):
        read(annotation, HERE)


def test_a_misspelled_type_class_gets_a_hint():
    class Int32: ...

    with pytest.raises(InvalidInterface, match="did you mean 'int32'"):
        read(Int32, HERE)


@pytest.mark.parametrize("item", [list[int32], (list[int32], 0), (list[int32], "5")])
def test_a_length_is_a_number_above_zero(item):
    with pytest.raises(InvalidInterface, match=r"array: write array\[list\[int32\], 5\]"):
        array[item]
