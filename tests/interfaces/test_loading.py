from __future__ import annotations

import builtins
import keyword
import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from turtleact import interfaces
from turtleact.errors import InvalidInterface, UnknownInterface
from turtleact.interfaces import from_dict, from_text, snapshot, to_dict, to_yaml
from turtleact.interfaces.definition import (
    PRIMITIVES,
    ArrayForm,
    Field,
    FieldType,
    MessageDefinition,
    zero,
)
from turtleact.interfaces.generator import package_texts
from turtleact.interfaces.loading import (
    class_of,
    get_action,
    get_interface,
    get_service,
    interface_source,
    interface_text,
    known_interfaces,
    load_action,
    load_interface,
    load_interfaces,
    load_message,
    load_service,
    load_workspace,
    offer_interfaces,
)
from turtleact.interfaces.parse import parse
from turtleact.interfaces.standard import Point, Time
from turtleact.interfaces.types import Message, definition, fields, nested_classes

GOLDEN = Path(__file__).parent / "golden"


def write(root: Path, name: str, text: str) -> Path:
    path = root / f"{name}.{name.split('/')[1]}"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def get_message(type_name: str) -> type[Message]:
    cls = get_interface(type_name)
    assert issubclass(cls, Message)
    return cls


@pytest.mark.parametrize(
    ("name", "full"),
    [
        ("geometry_msgs/Point", "geometry_msgs/msg/Point"),
        ("std_srvs/Trigger", "std_srvs/srv/Trigger"),
        ("turtlesim/RotateAbsolute", "turtlesim/action/RotateAbsolute"),
    ],
)
def test_an_interface_is_found_by_package_and_name(name, full):
    assert get_interface(name).type_name == full


def test_a_file_uses_the_classes_that_ship():
    assert nested_classes(get_message("std_msgs/msg/Header"))[0] is Time


@pytest.mark.parametrize(
    ("name", "near"),
    [
        ("geometry_msgs/msg/Piont", "geometry_msgs/msg/Point"),
        ("RotateAbsolute", "turtlesim/action/RotateAbsolute"),
        ("geometry_msg/Twist", "geometry_msgs/msg/Twist"),
        ("std_msgs/msg/String_Goal", "std_msgs/msg/String"),
        ("lab_interfaces/action/RotateAbsolute", "turtlesim/action/RotateAbsolute"),
    ],
)
def test_an_unknown_interface_gets_the_nearest(name, near):
    with pytest.raises(UnknownInterface, match=f"did you mean '{near}'"):
        get_interface(name)


@pytest.mark.parametrize("name", ["", "/", "a/b/c/d", "no_package/msg/Zzz", "../msg/Point", "\0"])
def test_what_is_no_interface_is_unknown(name):
    with pytest.raises(UnknownInterface):
        get_interface(name)


def test_loading_what_is_known_gives_the_class():
    text = "float64 x\nfloat64 y\nfloat64 z"
    assert load_interface(text, type_name="geometry_msgs/msg/Point") is Point


def test_loading_a_change_replaces_for_later_look_ups():
    changed = load_interface("float64 x", type_name="geometry_msgs/msg/Point")
    assert get_interface("geometry_msgs/msg/Point") is changed is not Point


@pytest.mark.parametrize("as_type", [str, Path])
def test_a_file_in_its_place_names_itself(tmp_path, as_type):
    path = write(tmp_path, "example_msgs/msg/Order", "int32 count")
    assert load_interface(as_type(path)).type_name == "example_msgs/msg/Order"


def test_a_file_anywhere_needs_a_name(tmp_path):
    path = tmp_path / "order.msg"
    path.write_text("int32 count")
    with pytest.raises(InvalidInterface, match=r'order.msg: give its full name: type_name="'):
        load_interface(path)
    order: Any = load_interface(path, type_name="example_msgs/msg/Order")
    assert order().count == 0


def test_a_text_needs_a_name():
    with pytest.raises(InvalidInterface, match=r"^text: give its full name"):
        load_interface("int32 x")


def test_a_mistake_in_a_file_names_it(tmp_path):
    path = write(tmp_path, "example_msgs/action/Patrol", "---\n---\nfloat46 x")
    with pytest.raises(InvalidInterface, match=r"Patrol.action:3:1: unknown type 'float46'"):
        load_interface(path)


@pytest.mark.parametrize("content", [None, b"\xff\xfe"])
def test_a_file_that_cannot_be_read_is_told(tmp_path, content):
    path = tmp_path / "example_msgs" / "msg" / "Order.msg"
    if content is not None:
        path.parent.mkdir(parents=True)
        path.write_bytes(content)
    with pytest.raises(InvalidInterface, match=r"Order.msg: cannot be read"):
        load_interface(path)


def test_a_folder_is_made_known(tmp_path):
    write(tmp_path, "example_msgs/msg/Inner", "int32 x")
    write(tmp_path, "example_msgs/action/Outer", "Inner inner\n---\n---")
    (tmp_path / "example_msgs" / "msg" / "Inner.idl").touch()
    names = load_interfaces(tmp_path)
    assert names == ("example_msgs/action/Outer", "example_msgs/msg/Inner")
    outer: Any = get_interface("example_msgs/Outer")
    assert outer.Goal().inner.x == 0


def test_all_interfaces_of_ros_can_be_had():
    names = load_interfaces(os.fspath(GOLDEN))
    missing = "test_msgs/action/NestedMessage"  # its BasicTypes were not recorded
    assert all(get_interface(name).type_name == name for name in names if name != missing)
    with pytest.raises(InvalidInterface, match="unknown interface 'test_msgs/msg/BasicTypes'"):
        get_interface(missing)


def test_a_folder_must_be_there(tmp_path):
    with pytest.raises(InvalidInterface, match="no such folder"):
        load_interfaces(tmp_path / "nowhere")


def test_a_file_with_a_name_of_no_interface_is_told(tmp_path):
    write(tmp_path, "example_msgs/msg/order", "int32 x")
    with pytest.raises(InvalidInterface, match=r"order.msg: .*: rename the file to Order.msg$"):
        load_interfaces(tmp_path)


def test_a_file_in_a_package_with_a_name_of_no_package_is_told(tmp_path):
    write(tmp_path, "Example/msg/Order", "int32 x")
    with pytest.raises(InvalidInterface, match=r"Order.msg: give its full name"):
        load_interfaces(tmp_path)


@pytest.mark.parametrize("prefix", ["share", "install/example_msgs/share"])
def test_a_folder_may_be_where_ros_packages_are_installed(tmp_path, prefix):
    write(tmp_path / prefix, "example_msgs/msg/Inner", "int32 x")
    write(tmp_path / prefix, "example_msgs/srv/Outer", "Inner inner\n---")
    names = load_interfaces(tmp_path / prefix.split("/")[0].replace("share", ""))
    assert names == ("example_msgs/msg/Inner", "example_msgs/srv/Outer")
    outer: Any = get_interface("example_msgs/srv/Outer")
    assert outer.Request().inner.x == 0


def test_an_interface_of_an_installed_package_is_found(tmp_path):
    write(tmp_path / "share", "example_msgs/msg/Inner", "geometry_msgs/Point at")
    write(tmp_path / "share", "example_msgs/action/Outer", "Inner inner\n---\n---")
    load_workspace(tmp_path)
    assert {"example_msgs/msg/Inner", "example_msgs/action/Outer"} <= set(known_interfaces())
    outer: Any = get_interface("example_msgs/Outer")
    assert outer.Goal().inner.at == Point()
    with pytest.raises(UnknownInterface, match="did you mean 'example_msgs/action/Outer'"):
        get_interface("example_msgs/action/Outre")


def names_in(type_name: str) -> list[str]:
    return [field.name for field in fields(get_message(type_name))]


def test_what_was_loaded_comes_first_then_a_workspace_then_what_is_nearby(tmp_path):
    names = [f"example_msgs/msg/{name}" for name in ("Nearby", "Installed", "Own")]
    files = {name: write(tmp_path / "near", name, "int32 nearby") for name in names}
    for name in names[1:]:
        write(tmp_path / "share", name, "int32 installed")
    write(tmp_path / "own", names[2], "int32 own")
    offer_interfaces(files)
    load_workspace(tmp_path)
    load_interfaces(tmp_path / "own")
    assert [names_in(name) for name in names] == [["nearby"], ["installed"], ["own"]]


@pytest.mark.parametrize("is_known_before", [True, False])
@pytest.mark.parametrize("is_installed", [True, False])
def test_a_file_with_another_definition_replaces_what_ships(
    tmp_path, is_known_before, is_installed
):
    name = "std_msgs/msg/ColorRGBA"
    if is_known_before:
        assert names_in(name) == ["r", "g", "b", "a"]
    path = write(tmp_path / "share", name, "float32 hue")
    load_workspace(tmp_path) if is_installed else offer_interfaces({name: path})
    assert names_in(name) == ["hue"]
    assert interface_source(name) == "float32 hue"


@pytest.mark.parametrize("is_installed", [True, False])
def test_a_file_with_the_same_definition_leaves_what_ships(tmp_path, is_installed):
    path = write(tmp_path / "share", "geometry_msgs/msg/Point", "float64 x\nfloat64 y\nfloat64 z")
    used: list[str] = []
    if is_installed:
        load_workspace(tmp_path)
    else:
        offer_interfaces({"geometry_msgs/msg/Point": path}, lambda name, _: used.append(name))
    assert get_interface("geometry_msgs/msg/Point") is Point
    path.write_text("float64 changed")  # it is not read again
    assert get_interface("geometry_msgs/msg/Point") is Point
    assert used == []


@pytest.mark.parametrize("name", ["example_msgs/msg/Bad", "std_msgs/msg/String"])
def test_a_malformed_nearby_file_is_an_error_each_time_it_is_asked_for(tmp_path, name):
    path = write(tmp_path, name, "int32 x\nfloat46 y")
    offer_interfaces({name: path})
    assert get_interface("std_msgs/msg/Bool")
    for _ in range(2):
        with pytest.raises(InvalidInterface, match=f"{path}:2:1: unknown type 'float46'"):
            get_interface(name)


def test_an_unknown_message_in_a_file_is_named_with_its_field(tmp_path):
    text = "# of others\nstring foo\n  other_msgs/Foo[] foos # Foo\n---\n---"
    path = write(tmp_path, "example_msgs/action/Go", text)
    offer_interfaces({"example_msgs/action/Go": path})
    with pytest.raises(InvalidInterface) as raised:
        get_interface("example_msgs/action/Go")
    said = "example_msgs/action/Go_Goal: foos: unknown interface 'other_msgs/msg/Foo'"
    assert str(raised.value).startswith(said)
    assert isinstance(raised.value.__cause__, UnknownInterface)


def test_a_folder_may_be_a_package_itself(tmp_path):
    write(tmp_path, "example_msgs/msg/Order", "int32 x")
    assert load_interfaces(tmp_path / "example_msgs") == ("example_msgs/msg/Order",)
    assert names_in("example_msgs/msg/Order") == ["x"]


def test_the_first_prefix_that_has_an_interface_gives_it(tmp_path):
    for prefix, field in (("overlay", "over"), ("underlay", "under")):
        write(tmp_path / prefix / "share", "example_msgs/msg/Order", f"int32 {field}")
    write(tmp_path / "underlay" / "share", "example_msgs/msg/Base", "int32 x")
    load_workspace(tmp_path / "overlay")
    load_workspace(os.fspath(tmp_path / "underlay"))
    assert [field.name for field in fields(get_message("example_msgs/Order"))] == ["over"]
    assert get_interface("example_msgs/Base").type_name == "example_msgs/msg/Base"


def test_what_is_no_prefix_is_passed_over(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "share", "stray_msgs/msg/Order", "int32 x")
    write(tmp_path / "prefix" / "share", "stray_msgs/msg/order", "int32 x")
    load_workspace("", tmp_path / "nowhere", tmp_path / "prefix")
    known = known_interfaces()
    assert "std_msgs/msg/Header" in known
    assert not [name for name in known if "stray_msgs" in name or not name]
    with pytest.raises(UnknownInterface):
        get_interface("stray_msgs/msg/Order")


def test_the_source_of_an_interface_is_the_installed_one_if_it_says_the_same(tmp_path):
    assert interface_source("std_msgs/Bool") == "bool data\n"
    write(tmp_path / "share", "std_msgs/msg/Bool", "# Yes or no.\nbool data")
    load_workspace(tmp_path)
    assert interface_source("std_msgs/msg/Bool") == "# Yes or no.\nbool data"


def test_an_interface_without_a_file_says_what_it_is():
    assert interface_source("example_interfaces/action/Fibonacci_SendGoal").endswith(
        "---\nbool accepted\nbuiltin_interfaces/Time stamp"
    )


def test_a_header_is_the_packages_own(tmp_path):
    write(tmp_path, "example_msgs/msg/Header", "int32 own")
    write(tmp_path, "example_msgs/msg/Order", "Header header")
    write(tmp_path, "other_msgs/msg/Order", "Header header")
    load_interfaces(tmp_path)
    order: Any = get_interface("example_msgs/msg/Order")
    assert order().header.own == 0
    with pytest.raises(InvalidInterface, match="did you mean 'std_msgs/msg/Header'"):
        get_interface("other_msgs/msg/Order")


def odd_names() -> list[str]:
    words = [*keyword.kwlist, *keyword.softkwlist, *dir(builtins), *dir(Message), *dir(type)]
    own = ["self", "cls", "type_name", "copy", "cls", "m", "v0", "fields", "int32", "classvar"]
    return sorted({w.lower() for w in [*words, *own] if w.isalnum() and not w[0].isdigit()})


def test_a_field_may_have_any_name_that_ros_takes():
    names = odd_names()
    text = "\n".join(f"int32 {name} {value}" for value, name in enumerate(names, 1))
    cls: Any = load_interface(text, type_name="example_msgs/msg/Odd")
    message = cls()
    attributes = [f"{name}_" if keyword.iskeyword(name) else name for name in names]
    assert [getattr(message, name) for name in attributes] == list(range(1, len(names) + 1))
    assert list(to_dict(message)) == names
    assert snapshot(message) == message == from_dict(cls, to_dict(message))
    assert from_text(cls, to_yaml(message)) == message
    assert interface_text(cls) == text
    assert cls.type_name == "example_msgs/msg/Odd"


def test_a_message_that_contains_itself_is_refused(tmp_path):
    write(tmp_path, "example_msgs/msg/Hen", "Egg egg")
    write(tmp_path, "example_msgs/msg/Egg", "Hen hen")
    load_interfaces(tmp_path)
    circle = "example_msgs/msg/Hen in example_msgs/msg/Egg in example_msgs/msg/Hen"
    with pytest.raises(InvalidInterface, match=f"a message contains itself: {circle}"):
        get_interface("example_msgs/msg/Hen")


def forms(name: str, bound: int | None = None) -> st.SearchStrategy[FieldType]:
    sizes = st.integers(1, 4)
    return st.one_of(
        st.just(FieldType(name, bound)),
        st.just(FieldType(name, bound, ArrayForm.UNBOUNDED)),
        sizes.map(lambda size: FieldType(name, bound, ArrayForm.FIXED, size)),
        sizes.map(lambda size: FieldType(name, bound, ArrayForm.BOUNDED, size)),
    )


types = st.one_of(
    st.sampled_from([*PRIMITIVES, "geometry_msgs/msg/Point"]).flatmap(forms),
    st.integers(1, 9).flatmap(lambda bound: forms("string", bound)),
)
names = st.from_regex(r"\A[a-z](_?[a-z0-9]){0,5}\Z")


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.dictionaries(names, types, max_size=6))
def test_definition_class_and_text_say_the_same(members):
    said = MessageDefinition(
        "example_msgs/msg/Sample",
        tuple(Field(name, kind, zero(kind)) for name, kind in members.items()),
    )
    made = class_of(said)
    assert definition(made) == said == parse(interface_text(made), said.type_name)


TEXTS = {"msg": "int8 x", "srv": "int8 x\n---", "action": "int8 x\n---\n---"}
LOADERS = {
    "msg": (load_message, interfaces.get_message),
    "srv": (load_service, get_service),
    "action": (load_action, get_action),
}


@pytest.mark.parametrize("kind", TEXTS)
def test_a_typed_loader_gives_what_load_interface_gives(kind):
    name = f"example_msgs/{kind}/Sample"
    load, get = LOADERS[kind]
    cls = load(TEXTS[kind], type_name=name)
    assert cls is load_interface(TEXTS[kind], type_name=name) is get(name)


@pytest.mark.parametrize("kind", TEXTS)
@pytest.mark.parametrize("other", TEXTS)
def test_a_typed_loader_refuses_another_kind(kind, other):
    if kind == other:
        return
    nouns = {"msg": "a message", "srv": "a service", "action": "an action"}
    noun = nouns[kind].split()[1]
    expected = (
        f"example_msgs/{kind}/Sample: is {nouns[kind]}, not {nouns[other]}: "
        f"use get_{noun} or load_{noun}"
    )
    load, get = LOADERS[other]
    for attempt in (
        lambda: load(TEXTS[kind], type_name=f"example_msgs/{kind}/Sample"),
        lambda: get(f"example_msgs/{kind}/Sample"),
    ):
        with pytest.raises(InvalidInterface) as caught:
            attempt()
        assert str(caught.value) == expected


def test_a_typed_getter_prefers_its_own_kind():
    assert get_service("std_srvs/Empty").type_name == "std_srvs/srv/Empty"
    assert interfaces.get_message("std_msgs/Empty").type_name == "std_msgs/msg/Empty"
    assert (
        get_action("example_interfaces/Fibonacci").type_name
        == "example_interfaces/action/Fibonacci"
    )


def test_the_texts_of_an_unknown_package_are_refused_with_the_nearest():
    with pytest.raises(UnknownInterface, match="'geometry_msg', did you mean 'geometry_msgs'"):
        package_texts("geometry_msg")
