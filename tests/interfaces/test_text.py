from __future__ import annotations

import contextlib
import json
import math

import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st

from turtleact.errors import InvalidGoal, InvalidMessage
from turtleact.interfaces import from_text, to_json, to_yaml
from turtleact.interfaces.standard import (
    Fibonacci,
    PatrolCommandInterface,
    Point,
    TurtlePose,
)
from turtleact.interfaces.text import MOST_JSON, MOST_YAML
from turtleact.interfaces.types import (
    Message,
    bool_,
    bounded,
    float64,
    int32,
    int64,
    string,
)

from ..tables import together

Targets = PatrolCommandInterface.Goal


class Empty(Message, type_name="example_msgs/msg/Empty"):
    pass


class Sample(Message, type_name="example_msgs/msg/Sample"):
    x: float64 = 0.0
    y: float64 = 0.0
    n: int64 = 0
    on: bool_ = False
    name: string = ""
    at: Point = Point()
    path: bounded[list[Point], 2] = []
    names: list[string] = []
    raw: bytes = b""
    nothing: Empty = Empty()
    nothings: list[Empty] = []


class Orders(Message, type_name="example_msgs/msg/Orders"):
    order: int32 = 0


@together
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", Sample()),
        ("  # nothing\n", Sample()),
        ("{}", Sample()),
        ("{x: 1}", Sample(x=1.0)),
        ("x: 1e3", Sample(x=1000.0)),
        ("y: 2\nn: 3", Sample(y=2.0, n=3)),
        ("n: 0x1F", Sample(n=31)),
        ("on: true", Sample(on=True)),
        ("on: False", Sample()),
        ("name: no", Sample(name="no")),
        ("name: 2024-01-01", Sample(name="2024-01-01")),
        ("name: 007", Sample(name="007")),
        ("name: '5'", Sample(name="5")),
        ("name: 'null'", Sample(name="null")),
        ("name: |\n  a\n  b\n", Sample(name="a\nb\n")),
        ("name: <<", Sample(name="<<")),
        ("\ufeffname: żółw", Sample(name="żółw")),
        ("path: [{x: 1}]", Sample(path=[Point(1.0)])),
        ("raw: [1, 2]", Sample(raw=b"\1\2")),
        ("names: &a [p, q]\nname: r", Sample(names=["p", "q"], name="r")),
        ("path: [&a {x: 1}, *a]", Sample(path=[Point(1.0), Point(1.0)])),
        ("%YAML 1.1\n--- {x: 1}\n...", Sample(x=1.0)),
        ('{"x": 1, "path": [{"y": 2}], "name": "\\ud83d\\udc22"}', None),
        ('{"x": 1, }', Sample(x=1.0)),
    ],
)
def test_a_text_is_taken_as_meant(text, message):
    expected = Sample(x=1.0, path=[Point(y=2.0)], name="🐢") if message is None else message
    assert from_text(Sample, text) == expected


@together
@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("n: 3.7", "goal.n: expected a whole number (int64), got 3.7"),
        ("n: 1e3", "goal.n: expected a whole number (int64), got 1000.0"),
        ('n: "5"', "goal.n: expected a whole number (int64), got '5'"),
        ("n: true", "goal.n: expected a whole number (int64), got True"),
        ("n: 1_000", "goal.n: expected a whole number (int64), got '1_000'"),
        ("n: 9223372036854775808", "goal.n: 9223372036854775808 is out of range for int64"),
        (
            f"n: {'9' * 5000}",
            "goal.n: expected a whole number (int64), got a number of 5000 digits",
        ),
        (
            f'{{"n": {"9" * 5000}}}',
            "goal.n: expected a whole number (int64), got a number of 5000 digits",
        ),
        ("on: no", "goal.on: expected true or false (bool), got 'no'"),
        ('on: "no"', "goal.on: expected true or false (bool), got 'no'"),
        ("name: 5", "goal.name: expected text (string), got 5"),
        ('{"on": true, "n": false}', "goal.n: expected a whole number (int64), got False"),
        ("name: [True, 1]", "goal.name: expected text (string), got [True, 1]"),
        ("name:", "goal.name: expected text (string), got null"),
        ("x: .nan", "goal.x: expected a number (float64), got .nan"),
        ("x: 1e999", "goal.x: expected a number (float64), got 1e999"),
        ('{"x": -1e999}', "goal.x: expected a number (float64), got -1e999"),
        ('{"x": NaN}', "goal.x: expected a number (float64), got NaN"),
        ('{"x": null}', "goal.x: expected a number (float64), got null"),
        ("path: [{}, {x: abc}]", "goal.path[1].x: expected a number (float64), got 'abc'"),
        ("path: [{}, {}, {}]", "goal.path: at most 2 elements, got 3"),
        ("names: [a, 5]", "goal.names[1]: expected text (string), got 5"),
        ("nmae: a", "goal: unknown field 'nmae', did you mean 'name'?"),
        ("at: {q: 1}", "goal.at: unknown field 'q': the fields are x, y, z"),
        ("{1: 2}", "goal: unknown field '1': the fields are x, y"),
        ("nothing: 5", "goal.nothing: expected {}, because it has no fields, got 5"),
        ('{"name": "\\ud800"}', "goal.name: character 0 is half a surrogate pair"),
    ],
)
def test_what_does_not_fit_is_told_with_its_path(text, problem):
    with pytest.raises(InvalidGoal) as caught:
        from_text(Sample, text)
    assert str(caught.value).startswith(problem)


@pytest.mark.parametrize(("text", "got"), [("5", "5"), ("[5]", "[5]"), ("~", "null"), ("a", "'a'")])
def test_a_goal_is_a_mapping(text, got):
    with pytest.raises(InvalidGoal) as caught:
        from_text(Orders, text)
    assert str(caught.value) == f"goal: expected fields such as {{order: 0}}, got {got}"


def test_malformed_text_is_told_with_line_column_and_caret():
    with pytest.raises(InvalidGoal) as caught:
        from_text(Orders, "# a goal\n{order: 5")
    assert str(caught.value) == (
        "goal:2:10: expected ',' or '}', got the end\n  {order: 5\n           ^"
    )


@together
@pytest.mark.parametrize(
    ("text", "place", "problem"),
    [
        ("x: : 5", "1:4", "a colon too many"),
        (
            "x: 3 y: 4",
            "1:7",
            "a colon too many: write fields in braces, {x: 1, y: 2}, or one per",
        ),
        ("x: 1\nx: 2", "2:1", "'x' appears twice"),
        ('{"x": 1, "x": 2}', "1:10", "'x' appears twice"),
        ("<<: {x: 1}", "1:1", "merge keys (<<) are not supported"),
        ("x: !!float 1", "1:4", "tags (tag:yaml.org,2002:float) are not supported"),
        ("!!python/object:os.system x", "1:1", "tags (tag:yaml.org,2002:python/object:os.sy"),
        ("x: 1\n---\nx: 2", "2:1", "more than one document"),
        ("x: *a", "1:4", "found undefined alias 'a'"),
        ("[a]: 1", "1:1", "a field's name must be a single word"),
        ("x\0: 1", "1:2", "character U+0000 is not allowed"),
        ("a\nb: \x07", "2:4", "character U+0007 is not allowed"),
        ('name: "\\Uffffffff"', "1:10", "a number here is too large"),
        (f"%YAML {'9' * 5000}", "1:7", "a number here is too large"),
        ("\tx: 1", "1:1", "found character '\\t' that cannot start any token"),
        ("x: 'a\n", "1:6", "found unexpected end of stream\n  x: 'a\n       ^"),
        ("at: [1\n\n \n", "1:7", "expected ',' or ']', got the end\n  at: [1\n        ^"),
    ],
)
def test_what_is_wrong_with_the_text_is_told_with_its_place(text, place, problem):
    with pytest.raises(InvalidGoal) as caught:
        from_text(Sample, text)
    assert caught.value.path.startswith(f"goal:{place}")
    assert caught.value.problem.startswith(problem)


@pytest.mark.parametrize("text", ["names: &a [*a]", "[" * 5000, "- " * 5000, '{"x":' * 5000])
def test_a_text_that_is_nested_too_deeply_is_refused(text):
    with pytest.raises(InvalidGoal, match=r"^goal: nested too deeply$"):
        from_text(Sample, text)


def test_a_finite_number_never_becomes_infinite():
    with pytest.raises(InvalidGoal, match="got 1e999"):
        from_text(Sample, "x: 1e999", allow_nonfinite=True)


def test_aliases_do_not_blow_up():
    rows = ["a0: &a0 [1]"] + [
        f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 30)
    ]
    with pytest.raises(InvalidGoal, match=r"^goal: unknown field 'a0'"):
        from_text(Sample, "\n".join(rows))


@pytest.mark.parametrize("text", ["x: 1 #" + " " * MOST_YAML, "{}" + " " * MOST_JSON])
def test_too_long_a_text_is_refused(text):
    limits = f"at most {MOST_YAML}, or {MOST_JSON} of JSON"
    with pytest.raises(
        InvalidGoal, match=f"^a.yaml: {len(text)} characters are too many: {limits}"
    ):
        from_text(Sample, text, source="a.yaml")


def test_json_may_be_longer_than_yaml():
    text = json.dumps({"targets": [{"x": 1.5}] * 20_000})
    assert len(text) > MOST_YAML
    assert len(from_text(Targets, text).targets) == 20_000


def test_nonfinite_numbers_are_taken_where_they_are_allowed():
    message = from_text(Point, "{x: .nan, y: -.INF, z: +.inf}", allow_nonfinite=True)
    assert math.isnan(message.x)
    assert (message.y, message.z) == (-math.inf, math.inf)


def test_another_root_is_no_goal():
    with pytest.raises(InvalidMessage, match=r"^message.x: expected") as caught:
        from_text(Point, "x: a", root="message")
    assert not isinstance(caught.value, InvalidGoal)


# What ros2 printed; its own mistakes in indenting a second line apart.
@pytest.mark.parametrize(
    ("message", "text"),
    [
        (Fibonacci.Goal(order=5), "order: 5\n"),
        (Fibonacci.Result(sequence=[0, 1, 1]), "sequence:\n- 0\n- 1\n- 1\n"),
        (Fibonacci.Result(), "sequence: []\n"),
        (
            Targets(targets=[Point(9.0, 7.0), Point(5.0, 1.0)]),
            "targets:\n- x: 9.0\n  y: 7.0\n  z: 0.0\n- x: 5.0\n  y: 1.0\n  z: 0.0\n",
        ),
        (PatrolCommandInterface.Feedback("Target 1 reached"), "feedback_msg: Target 1 reached\n"),
        (
            TurtlePose(5.544444561004639, 5.544444561004639),
            "x: 5.544444561004639\ny: 5.544444561004639\ntheta: 0.0\n"
            "linear_velocity: 0.0\nangular_velocity: 0.0\n",
        ),
        (Empty(), "{}\n"),
    ],
)
def test_a_message_prints_as_ros2_prints_it(message, text):
    assert to_yaml(message) == text


def test_an_empty_message_inside_prints_as_braces():
    assert to_yaml(Sample(nothings=[Empty()])).endswith("nothing: {}\nnothings:\n- {}\n")


@pytest.mark.parametrize(
    ("value", "text"),
    [(1e16, "1.0e+16"), (1.5e-7, "1.5e-07"), (math.nan, ".nan"), (-math.inf, "-.inf")],
)
def test_a_float_is_one_in_any_yaml(value, text):
    assert to_yaml(Point(x=value)).startswith(f"x: {text}\n")
    assert isinstance(yaml.safe_load(text), float)


@together
@pytest.mark.parametrize(
    ("value", "text"),
    [
        ("turtle1", "turtle1"),
        ("Target 1 reached", "Target 1 reached"),
        ("", "''"),
        ("5", "'5'"),
        ("1e3", "'1e3'"),
        ("no", "'no'"),
        ("a: b", "'a: b'"),
        ("it's", "'it''s'"),
        ("a\nb", '"a\\nb"'),
        ("\x85", '"\\N"'),
        ("żółw 🐢", "'żółw 🐢'"),
    ],
)
def test_text_is_quoted_only_where_yaml_needs_it(value, text):
    assert to_yaml(PatrolCommandInterface.Feedback(value)) == f"feedback_msg: {text}\n"


def test_json_says_bytes_as_numbers_and_nan_as_null():
    said = json.loads(to_json(Sample(x=math.nan, raw=b"ab", name="żółw", path=[Point(1.0)])))
    assert (said["x"], said["raw"], said["path"][0]["x"]) == (None, [97, 98], 1.0)


def test_json_is_one_line_of_plain_text():
    assert to_json(PatrolCommandInterface.Feedback("ż\nó")) == '{"feedback_msg": "ż\\nó"}'


words = st.text(st.characters(exclude_categories=["Cs"]))
points = st.builds(Point, st.floats(), st.floats(), st.floats())
samples = st.builds(
    Sample,
    x=st.floats(),
    n=st.integers(-(2**63), 2**63 - 1),
    on=st.booleans(),
    name=words,
    at=points,
    path=st.lists(points, max_size=2),
    names=st.lists(words | st.sampled_from(["5", "~", ".nan", "<<", "0x1", "- a", "#"])),
    raw=st.binary(),
    nothings=st.lists(st.builds(Empty)),
)


@given(samples)
def test_yaml_there_and_back_is_the_same(message):
    back = from_text(Sample, to_yaml(message), allow_nonfinite=True)
    assert repr(back) == repr(message)


@given(st.builds(Sample, x=st.floats(allow_nan=False, allow_infinity=False), name=words))
def test_json_there_and_back_is_the_same(message):
    assert from_text(Sample, to_json(message)) == message


@given(st.text() | st.text("{}[]:,-?&*!|>'\"%@`#~<.0159exy \n\t\\"))
@example("? ")
@example("%TAG ! x\n---\n!a b")
@example('"\\x')
def test_no_text_breaks_the_reader(text):
    with contextlib.suppress(InvalidGoal):
        from_text(Sample, text)
