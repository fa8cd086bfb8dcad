"""The arguments between ``--ros-args`` and ``--``."""

from __future__ import annotations

import pytest

from turtleact.rclpy.exceptions import RCLError, UnknownROSArgsError
from turtleact.rclpy.impl.arguments import (
    Arguments,
    arguments_of,
    parse_arguments,
    parse_value,
    read_parameters,
    split_arguments,
)


def parse(text: str) -> Arguments:
    return parse_arguments(["program", "--ros-args", *text.split()])


def test_only_what_is_between_the_marks_is_for_ros():
    args = ["program", "-x", "--ros-args", "-r", "a:=b", "--", "-y", "--ros-args", "-p", "c:=1"]
    assert split_arguments(args)[0] == ["program", "-x", "-y"]
    found = parse_arguments(args)
    assert found.remap("/a", "node", "/") == "/b"
    assert found.parameters_for("/node") == {"c": 1}


def test_names_are_replaced_by_the_first_rule_that_fits():
    found = parse("-r talker:chatter:=words -r chatter:=noise -r ~/private:=/open")
    assert found.remap("/chatter", "talker", "/") == "/words"
    assert found.remap("/chatter", "listener", "/") == "/noise"
    assert found.remap("/lab/chatter", "listener", "/lab") == "/lab/noise"
    assert found.remap("/lab/n/private", "n", "/lab") == "/open"
    assert found.remap("/other", "n", "/") == "/other"
    assert parse("-r rostopic://a:=b").remap("/a", "n", "/") == "/b"


def test_nodes_are_renamed():
    found = parse("-r __node:=new -r old:__ns:=/space")
    assert found.node_name("old") == "new"
    assert found.namespace("/", "old") == "/space"
    assert found.namespace("/", "other") == "/"


@pytest.mark.parametrize(
    ("text", "full_name", "values"),
    [
        ("-p speed:=1.5", "/a/b", {"speed": 1.5}),
        ("-p b:speed:=1.5", "/a/b", {"speed": 1.5}),
        ("-p b:speed:=1.5", "/a/c", {}),
        ("-p /a/b:speed:=[1,2]", "/a/b", {"speed": [1, 2]}),
        ("-p on:=true -p on:=false", "/n", {"on": False}),
        ("-p name:=text", "/n", {"name": "text"}),
    ],
)
def test_parameters_are_for_the_nodes_that_fit(text, full_name, values):
    assert parse(text).parameters_for(full_name) == values


def test_levels_and_switches_are_read():
    found = parse("--log-level debug --log-level talker:=WARN --disable-rosout-logs")
    assert found.log_levels == (("", 10), ("talker", 30))
    assert found.flags == {"--disable-rosout-logs"}
    assert parse("--log-config-file x -e y") == Arguments()


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("-r ab", "'ab' is no remap rule"),
        ("-r a:=", "no remap rule"),
        ("-p speed", "no parameter name:=value"),
        ("--log-level loud", "'loud' is no log level"),
        ("--params-file /nowhere.yaml", "/nowhere.yaml: No such file"),
        ("-p", "no value after -p"),
        ("-p a:=[1", "Failed to parse ROS arguments"),
    ],
)
def test_what_cannot_be_read_is_told(text, problem):
    with pytest.raises(RCLError, match=problem.replace("[", r"\[")):
        parse(text)


def test_unknown_arguments_are_named():
    with pytest.raises(UnknownROSArgsError, match=r"\['--speed', '3'\]"):
        parse("--speed 3")


def test_own_arguments_come_first():
    shared = parse("-r a:=shared -p p:=1 --log-level debug")
    own = ["--ros-args", "-r", "a:=own", "-p", "p:=2"]
    both = arguments_of(own, shared, use_shared=True)
    assert both.remap("/a", "n", "/") == "/own"
    assert both.parameters_for("/n") == {"p": 2}
    assert both.log_levels == (("", 10),)
    assert arguments_of(None, shared, use_shared=True) == shared
    assert arguments_of(None, shared, use_shared=False) == Arguments()
    assert arguments_of(own, shared, use_shared=False).log_levels == ()


def test_a_file_of_parameters_is_read(tmp_path):
    path = tmp_path / "p.yaml"
    path.write_text(
        "/**:\n  ros__parameters: {all: 1}\n"
        "lab:\n  arm:\n    ros__parameters: {speed: 2.5, nested: {deep: x}}\n"
    )
    found = parse(f"--params-file {path}")
    assert found.parameters_for("/lab/arm") == {"all": 1, "speed": 2.5, "nested.deep": "x"}
    assert found.parameters_for("/leg") == {"all": 1}


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("a: 1", "'a' has no 'ros__parameters'"),
        ("[1, 2]", "has no parameters"),
        ("a: {", "Failed to parse"),
        (b"\xff", "Failed to parse"),
    ],
)
def test_a_file_without_parameters_is_told(tmp_path, text, problem):
    path = tmp_path / "p.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(RCLError, match=problem):
        read_parameters(path)


@pytest.mark.parametrize(
    ("text", "value"),
    [("null", None), ("1e3", 1000.0), ("'1'", "1"), ("[a, 1]", ["a", 1]), (".inf", float("inf"))],
)
def test_a_value_is_read_as_yaml(text, value):
    assert parse_value(text) == value
