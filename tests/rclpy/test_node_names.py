"""Names of nodes, topics and services, and the default context."""

from __future__ import annotations

import pytest

from turtleact.rclpy import toplevel as rclpy
from turtleact.rclpy.exceptions import (
    InvalidNamespaceException,
    InvalidNodeNameException,
    InvalidParameterException,
    InvalidServiceNameException,
    InvalidTopicNameException,
)
from turtleact.rclpy.names import (
    expand_topic_name,
    topic_or_service_is_hidden,
    validate_full_topic_name,
    validate_namespace,
    validate_node_name,
    validate_parameter_name,
    validate_topic_name,
)


def test_a_node_has_the_names_that_it_was_given(context):
    arguments = ["--ros-args", "-r", "__node:=bob", "-r", "__ns:=/lab", "-r", "chatter:=gossip"]
    arguments += ["-r", "~/pose:=/pose", "-r", "other:add:=sum"]
    node = rclpy.create_node("arm", context=context, cli_args=arguments)
    assert node.get_fully_qualified_name() == "/lab/bob"
    assert node.resolve_topic_name("chatter") == "/lab/gossip"
    assert node.resolve_topic_name("chatter", only_expand=True) == "/lab/chatter"
    assert node.resolve_topic_name("~/pose") == "/pose"
    assert node.resolve_service_name("add") == "/lab/add"


# --- names --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("check", "name", "error", "index"),
    [
        (validate_topic_name, "", InvalidTopicNameException, 0),
        (validate_topic_name, "cha ter", InvalidTopicNameException, 3),
        (validate_topic_name, "chatter/", InvalidTopicNameException, 7),
        (validate_topic_name, "a//b", InvalidTopicNameException, 2),
        (validate_topic_name, "a~b", InvalidTopicNameException, 1),
        (validate_topic_name, "~b", InvalidTopicNameException, 1),
        (validate_topic_name, "1a", InvalidTopicNameException, 0),
        (validate_full_topic_name, "chatter", InvalidTopicNameException, 0),
        (validate_full_topic_name, "/1a", InvalidTopicNameException, 1),
        (validate_namespace, "lab", InvalidNamespaceException, 0),
        (validate_namespace, "", InvalidNamespaceException, 0),
        (validate_node_name, "", InvalidNodeNameException, 0),
        (validate_node_name, "a/b", InvalidNodeNameException, 1),
        (validate_node_name, "a" * 256, InvalidNodeNameException, 255),
    ],
)
def test_a_name_that_breaks_the_rules_is_refused_with_its_place(check, name, error, index):
    with pytest.raises(error, match="must") as caught:
        check(name)
    assert caught.value.invalid_index == index


def test_a_service_name_has_an_exception_of_its_own():
    for check in (validate_topic_name, validate_full_topic_name):
        with pytest.raises(InvalidServiceNameException):
            check("a b", is_service=True)
    with pytest.raises(InvalidParameterException):
        validate_parameter_name("")


def test_good_names_pass():
    assert validate_topic_name("~/{node}/a_1")
    assert validate_full_topic_name("/a/b")
    assert validate_namespace("/")
    assert validate_node_name("_lab")
    assert topic_or_service_is_hidden("/a/_b")
    assert not topic_or_service_is_hidden("/a_/b")


def test_a_name_is_expanded():
    assert expand_topic_name("{node}/{ns}", "arm", "/lab") == "/lab/arm//lab"
    for words in (("a?", "arm", "/lab"), ("a", "arm?", "/lab"), ("a", "arm", "lab")):
        with pytest.raises(ValueError, match="must"):
            expand_topic_name(*words)
    with pytest.raises(ValueError, match="unknown substitution"):
        expand_topic_name("{me}", "arm", "/lab")
