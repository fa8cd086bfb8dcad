from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact.errors import InvalidInterface
from turtleact.interfaces.definition import (
    ArrayForm,
    Constant,
    Field,
    FieldType,
    MessageDefinition,
    definition_text,
)
from turtleact.interfaces.parse import parse


def message(*fields: Field, name: str = "example_msgs/msg/Sample") -> MessageDefinition:
    return MessageDefinition(name, fields)


def test_minus_zero_is_a_default():
    assert Field("x", FieldType("float64"), -0.0).default is not None


@pytest.mark.parametrize(
    "name", ["Point", "a/B", "a/msg/b", "A/msg/B", "a/idl/B", "a__b/msg/C", "a/msg/B/C"]
)
def test_a_full_name_is_package_kind_and_name(name):
    with pytest.raises(InvalidInterface, match="is not a full interface name"):
        MessageDefinition(name)


@pytest.mark.parametrize("value", ["a\nb", "a\rb", "ends in \\", "\"'\\"])
def test_a_default_that_no_text_can_say_is_refused(value):
    with pytest.raises(InvalidInterface, match="cannot be written in the text"):
        definition_text(message(Field("x", FieldType("string"), value)))


def test_text_says_messages_as_short_as_ros_does():
    names = "geometry_msgs/msg/Point", "example_msgs/msg/Other", "my_example_msgs/msg/Other"
    fields = [Field(f"f{index}", FieldType(name)) for index, name in enumerate(names)]
    text = "geometry_msgs/Point f0\nOther f1\nmy_example_msgs/Other f2"
    assert definition_text(message(*fields)) == text


texts = st.text(st.characters(exclude_characters="\\\n\r", exclude_categories=["Cs"]))
floats = st.floats(allow_nan=False, allow_infinity=False)
ints = st.integers(-(2**31), 2**31 - 1)


@given(
    st.lists(
        st.one_of(
            st.builds(Field, st.just("x"), st.just(FieldType("string")), texts),
            st.builds(Field, st.just("x"), st.just(FieldType("float64")), floats),
            st.builds(Field, st.just("x"), st.just(FieldType("bool")), st.booleans()),
            st.builds(
                Field,
                st.just("x"),
                st.just(FieldType("int32", None, ArrayForm.UNBOUNDED)),
                st.lists(ints).map(tuple),
            ),
            st.builds(
                Field,
                st.just("x"),
                st.just(FieldType("string", None, ArrayForm.UNBOUNDED)),
                st.lists(texts).map(tuple),
            ),
        ),
        max_size=4,
    ),
    texts,
)
def test_what_is_written_is_read_back(drawn, constant):
    fields = tuple(Field(f"x{i}", f.type, f.default) for i, f in enumerate(drawn))
    constants = (Constant("A", FieldType("string"), constant),)
    written = MessageDefinition("example_msgs/msg/Sample", fields, constants)
    assert parse(definition_text(written), written.type_name) == written
