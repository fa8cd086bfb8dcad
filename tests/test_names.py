from __future__ import annotations

import re
from typing import cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact.errors import InvalidName
from turtleact.names import action_names, resolve_name, validate_name, validate_node_name

from .tables import together


@pytest.mark.parametrize(
    "name", ["pose", "/pose", "/turtle1/pose", "~", "~/pose", "_hidden/_action", "A_b/c9", "/_"]
)
def test_a_name_of_tokens_is_legal(name):
    validate_name(name)


@together
@pytest.mark.parametrize(
    ("name", "position", "problem"),
    [
        ("", 0, "it is empty"),
        ("/", 0, "it ends in a slash"),
        ("/pose/", 5, "it ends in a slash"),
        ("a//b", 2, "a slash follows a slash"),
        ("1a", 0, "a part begins with a digit"),
        ("/a/1b", 3, "a part begins with a digit"),
        ("a__b", 2, "an underscore follows an underscore"),
        ("~pose", 1, "'~' must be followed by a slash"),
        ("a/~", 2, "'~' is only allowed at the beginning"),
        ("/fib onacci", 4, "only letters, digits"),
        ("żółw", 0, "only letters, digits"),
        ("pose\n", 4, "only letters, digits"),
        ("{node}/pose", 0, "only letters, digits"),
        ("a b//c", 1, "only letters, digits"),
    ],
)
def test_an_illegal_name_is_told_with_its_place(name, position, problem):
    with pytest.raises(InvalidName, match=re.escape(problem)) as caught:
        validate_name(name)
    assert caught.value.position == position


def test_the_caret_stands_under_the_wrong_character():
    with pytest.raises(InvalidName) as caught:
        validate_name("/fib onacci")
    assert str(caught.value).endswith("\n  /fib onacci\n      ^")


@pytest.mark.parametrize("name", ["turtlesim", "_hidden", "a__b", "N1"])
def test_a_node_name_is_one_part(name):
    validate_node_name(name)


@pytest.mark.parametrize(
    ("name", "position", "problem"),
    [
        ("", 0, "it is empty"),
        ("a/b", 1, "only letters, digits and '_' are allowed in a node's name"),
        ("~", 0, "only letters"),
        ("1a", 0, "it begins with a digit"),
    ],
)
def test_an_illegal_node_name_is_told_with_its_place(name, position, problem):
    with pytest.raises(InvalidName, match=problem) as caught:
        validate_node_name(name)
    assert caught.value.position == position


@pytest.mark.parametrize(
    ("name", "namespace", "node", "absolute"),
    [
        ("pose", "/", "", "/pose"),
        ("pose", "/sim/a", "", "/sim/a/pose"),
        ("/pose", "/sim", "", "/pose"),
        ("~/pose", "/", "turtle", "/turtle/pose"),
        ("~/pose", "/sim", "turtle", "/sim/turtle/pose"),
        ("~", "/sim", "turtle", "/sim/turtle"),
    ],
)
def test_a_name_is_resolved_in_its_namespace(name, namespace, node, absolute):
    assert resolve_name(name, namespace, node) == absolute


@pytest.mark.parametrize(
    ("name", "namespace", "node", "problem"),
    [
        ("a b", "/", "", "only letters"),
        ("pose", "sim", "", "a namespace begins with a slash"),
        ("pose", "", "", "it is empty"),
        ("pose", "/sim/", "", "it ends in a slash"),
        ("~/pose", "/", "", "there is no node here"),
        ("~/pose", "/", "a/b", "in a node's name"),
        ("~/pose", "/", "a__b", "an underscore follows an underscore"),
    ],
)
def test_what_cannot_be_resolved_is_refused(name, namespace, node, problem):
    with pytest.raises(InvalidName, match=problem):
        resolve_name(name, namespace, node)


def test_an_action_has_five_endpoints():
    names = action_names("/fibonacci")
    assert (names.send_goal, names.cancel_goal, names.get_result, names.feedback, names.status) == (
        "/fibonacci/_action/send_goal",
        "/fibonacci/_action/cancel_goal",
        "/fibonacci/_action/get_result",
        "/fibonacci/_action/feedback",
        "/fibonacci/_action/status",
    )


@pytest.mark.parametrize("name", ["fibonacci", "~/fibonacci"])
def test_an_action_is_named_absolutely(name):
    with pytest.raises(InvalidName, match="an absolute name begins with a slash"):
        action_names(name)


tokens = st.from_regex(r"\A[A-Za-z](_?[A-Za-z0-9]){0,5}\Z")


@given(st.lists(tokens, min_size=1).map("/".join), st.lists(tokens).map("/".join))
def test_what_is_resolved_is_absolute_and_stays(name, namespace):
    absolute = resolve_name(name, f"/{namespace}")
    assert absolute == resolve_name(absolute, "/other") == f"/{namespace}/{name}".replace("//", "/")


@given(st.text())
def test_any_text_is_a_name_or_told_why_not(name):
    try:
        validate_name(name)
    except InvalidName as error:
        position = error.position
    else:
        position = 0
    assert 0 <= position <= len(name)


@pytest.mark.parametrize("validate", [validate_name, validate_node_name, resolve_name])
def test_what_is_no_text_is_refused_with_what_would_be_a_name(validate):
    with pytest.raises(InvalidName, match=r"^invalid name: expected text such as 'patrol'\n  7\n"):
        validate(cast("str", 7))
    validate("patrol")
