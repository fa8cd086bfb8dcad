"""Type hashes, against what ROS 2 gives the same types."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from turtleact.errors import InvalidInterface
from turtleact.interfaces import (
    Action,
    Message,
    Service,
    bounded,
    get_interface,
    int32,
    load_interface,
    load_interfaces,
    string,
    type_hash,
    wstring,
)

from ..registry import isolated_registry
from ..tables import together

GOLDEN = Path(__file__).parent / "golden"
RECORDED: dict[str, str] = json.loads((GOLDEN / "type_hashes.json").read_text())

PRIMITIVES = [
    *("bool", "byte", "char", "float32", "float64", "int8", "uint8", "int16", "uint16", "int32"),
    *("uint32", "int64", "uint64", "string", "wstring", "string<=10", "wstring<=7"),
]


def every_type(form: str) -> str:
    lines = [f"{name}{form} f{index}" for index, name in enumerate(PRIMITIVES)]
    return "\n".join([*lines, f"Inner{form} inner"])


# What is not among the recorded types: bounds, each type in each form, nothing at all.
TEXTS = {
    "example_msgs/msg/Inner": "",
    "example_msgs/msg/Single": every_type(""),
    "example_msgs/msg/Fixed": every_type("[3]"),
    "example_msgs/msg/Bounded": every_type("[<=5]"),
    "example_msgs/msg/Unbounded": every_type("[]"),
    "example_msgs/msg/Words": "int32 from\nint32 class\nint32 lambda\nint32 self",
    "example_msgs/msg/Diamond": "Words b\nSingle[] c\nInner a\nInner[2] d",
    "example_msgs/srv/Mixed": "string<=10[<=2] names\n---\nDiamond diamond",
    "example_msgs/action/Bare": "---\n---",
}

# By rosidl_generator_type_description of ROS 2 Rolling (rosidl 95739d5b), run on 2026-11-21.
GENERATED = {
    "example_msgs/msg/Inner": "144a47a484ca81e114c6a3135e2910e3692eebed0fedbcff718ac19a0beda0b8",
    "example_msgs/msg/Single": "f0eb3bbf2b7a6e407136d3af8c0997aa2d32fe97b2ebc0142f925f0b972e1e83",
    "example_msgs/msg/Fixed": "884805791f652d1b6b89793aaf3bc2604199e9ed98fccb2a6f3202e46ac38e26",
    "example_msgs/msg/Bounded": "496a87f1b62bfb0b96266b18f840d9e07edc3a7b7c0cae07269e0acd1fb1da62",
    "example_msgs/msg/Unbounded": (
        "1d1ab3cee7d3586cb232d6fb436a8ef7b13849462d0033830346c6388d0ca2ee"
    ),
    "example_msgs/msg/Words": "c5f577b4ef14c1d1f082c334b352b35cf8773549f9d5c6526fcc2119c75659b2",
    "example_msgs/msg/Diamond": "05c3998f606d9b58a5bbc855281d3deb9bd6ed3f722386ea7f510a8c4db267d0",
    "example_msgs/srv/Mixed": "e53a15be1fa60bb94ae79b17bb0b2b1c3d5070b3db68697f2b1633a13cf5b052",
    "example_msgs/srv/Mixed_Event": (
        "2685bfcc7f1ab2fc2661cdf28a89e8330d00cadaacc506ce061bfe1d97cd457e"
    ),
    "example_msgs/action/Bare": "4af758e28f72fc85d0b8074b82fc40d109253c4dfd9ddab5307443bf3ffc6093",
    "example_msgs/action/Bare_GetResult_Event": (
        "b0443fe4962091659a640e28ad0dd484a1e8d4817af4fd77ff1df8836f4e476b"
    ),
}


def hash_of(text: str, type_name: str = "example_msgs/msg/Sample") -> str:
    return type_hash(load_interface(text, type_name=type_name))


@pytest.fixture(scope="module")
def recorded_interfaces():
    with isolated_registry():
        load_interfaces(GOLDEN)
        return {name: get_interface(name) for name in RECORDED}


@together
@pytest.mark.parametrize("type_name", RECORDED)
def test_a_type_has_the_hash_that_ros_gives_it(recorded_interfaces, type_name):
    assert type_hash(recorded_interfaces[type_name]) == RECORDED[type_name]


@pytest.mark.parametrize("type_name", GENERATED)
def test_bounds_and_forms_hash_as_in_ros(type_name):
    for name, text in TEXTS.items():
        load_interface(text, type_name=name)
    assert type_hash(get_interface(type_name)) == f"RIHS01_{GENERATED[type_name]}"


def test_a_python_class_hashes_as_its_text_does():
    class Words(Message, type_name="example_msgs/msg/Words"):
        from_: int32
        class_: int32
        lambda_: int32
        self: int32

    assert type_hash(Words) == f"RIHS01_{GENERATED['example_msgs/msg/Words']}"


@pytest.mark.parametrize(
    "text",
    ["int32 x 5", "int32 LIMIT=3\nint32 x", "# a comment\nint32 x # [m]", "\ufeffint32\tx\r\n"],
)
def test_defaults_constants_and_comments_do_not_count(text):
    assert hash_of(text) == hash_of("int32 x")


def test_rosidl_takes_the_bound_of_a_wstring_for_that_of_the_list():
    assert hash_of("wstring<=7[] x") == hash_of("wstring<=7[<=7] x")
    assert hash_of("string<=7[] x") != hash_of("string<=7[<=7] x")


def test_a_bound_of_python_counts_as_one_of_text():
    class Sample(Message, type_name="example_msgs/msg/Sample"):
        a: bounded[string, 3]
        b: bounded[list[bounded[wstring, 4]], 5]

    assert type_hash(Sample) == hash_of("string<=3 a\nwstring<=4[<=5] b")


def test_a_changed_interface_has_a_hash_of_its_own():
    first = load_interface("int32 x", type_name="example_msgs/msg/Sample")
    before = type_hash(first)
    changed = load_interface("int64 x", type_name="example_msgs/msg/Sample")
    assert type_hash(changed) != before == type_hash(first)


@pytest.mark.parametrize("cls", [Message, Service, Action])
def test_a_class_without_a_name_has_no_hash(cls):
    with pytest.raises(InvalidInterface, match="'' is not a full interface name"):
        type_hash(cls)
