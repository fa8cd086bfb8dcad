"""What a form is made from: each field with its type, default, bounds and comment."""

from __future__ import annotations

from typing import Any

import pytest

from turtleact.actions.patrol import Patrol
from turtleact.interfaces import get_action, load_action, load_interfaces, load_message
from turtleact.web.page_values import form

INNER = """\
float64 x 1.5   # where to go [m]
string<=3 tag "abc"
"""
OUTER = """\
# A comment of the whole goal.
bool[2] flags
lab_forms/Inner[<=4] many      # up to four
lab_forms/Inner one
uint64 large 18446744073709551615
string[] names ["a", "b"]
int8 KIND=1   # a constant is no field
---
---
float32 left  # how far it is [m]
"""


@pytest.fixture(scope="module")
def fields() -> dict[str, Any]:
    load_message(INNER, type_name="lab_forms/msg/Inner")
    described = form(load_action(OUTER, type_name="lab_forms/action/Outer"))
    return {field["name"]: field for field in described["goal"]}


def test_arrays_tell_their_form_and_bound(fields):
    assert fields["flags"]["array"] == {"form": "fixed", "size": 2}
    assert fields["many"]["array"] == {"form": "bounded", "size": 4}
    assert fields["names"]["array"] == {"form": "unbounded", "size": 0}


def test_defaults_are_filled_in(fields):
    assert fields["flags"]["default"] == [False, False]
    assert fields["names"]["default"] == ["a", "b"]
    assert fields["one"]["default"] == {"x": 1.5, "tag": "abc"}


def test_whole_numbers_tell_their_range_as_text(fields):
    large = fields["large"]
    assert (large["least"], large["most"], large["default"]) == (
        "0",
        str(2**64 - 1),
        str(2**64 - 1),
    )


def test_nested_fields_are_described(fields):
    x, tag = fields["one"]["fields"]
    assert (x["type"], x["default"]) == ("float64", 1.5)
    assert (tag["longest"], tag["default"]) == (3, "abc")


def test_the_comments_of_a_docstring_are_kept():
    described = form(Patrol)
    assert described["type"] == "turtleact_interfaces/action/Patrol"
    comments = {field["name"]: field["comment"] for field in described["goal"]}
    assert comments["tolerance"].endswith("(m), above zero.")
    (left,) = [each for each in described["feedback"] if each["name"] == "distance_remaining"]
    assert "(m)" in left["comment"]


def test_the_comments_of_a_file_are_kept(tmp_path):
    folder = tmp_path / "lab_notes" / "action"
    folder.mkdir(parents=True)
    (folder / "Outer.action").write_text(OUTER.replace("lab_forms/Inner", "geometry_msgs/Point"))
    load_interfaces(tmp_path)
    described = form(get_action("lab_notes/action/Outer"))
    comments = {field["name"]: field["comment"] for field in described["goal"]}
    assert comments["many"] == "up to four"
    assert comments["one"] == ""
    assert described["feedback"][0]["comment"] == "how far it is [m]"
