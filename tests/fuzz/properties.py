"""What must hold for any bytes at all, a function for each reader of what others write.

Each takes bytes, reads them, and raises for what must not be: an error that is not documented, or a
round trip that changes something. ``test_fuzz`` runs them with Hypothesis, ``run`` under Atheris.
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any

from turtleact.errors import InvalidInterface, InvalidMessage, InvalidName, TurtleactError
from turtleact.goals.wire import GoalMetadata
from turtleact.interfaces import cdr, from_text, get_interface, known_interfaces, to_json, to_yaml
from turtleact.interfaces.classes import make_message
from turtleact.interfaces.conversion import snapshot
from turtleact.interfaces.definition import (
    PRIMITIVES,
    ArrayForm,
    Field,
    FieldType,
    MessageDefinition,
    definition_text,
    parts_of,
)
from turtleact.interfaces.parse import parse
from turtleact.interfaces.types import REGISTRY, Action, Message, Service
from turtleact.names import action_names, resolve_name, validate_name, validate_node_name
from turtleact.transports.rmw_zenoh.wire import (
    data_key,
    decode_error,
    encode_error,
    endpoint_token,
    gid_in,
    gid_of,
    node_token,
    parse_token,
    read_attachment,
    write_attachment,
)

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["PROPERTIES"]

KINDS = ("msg", "srv", "action")


def message_classes(type_name: str) -> list[type[Message]]:
    found: Any = get_interface(type_name)
    if issubclass(found, Service):
        return [found.Request, found.Response]
    if issubclass(found, Action):
        implied = [get_interface(f"{type_name}_{part}") for part in ("SendGoal", "GetResult")]
        parts = [each for service in implied for each in (service.Request, service.Response)]  # type: ignore[union-attr]  # services
        return [found.Goal, found.Result, found.Feedback, *parts]
    return [found]


CLASSES = [cls for name in known_interfaces() for cls in message_classes(name)]
NAMES = sorted(PRIMITIVES)
NESTED = ["builtin_interfaces/msg/Time", "geometry_msgs/msg/Pose", "std_msgs/msg/String"]


def an_interface_is_read_or_refused(data: bytes) -> None:
    """The text of a .msg, .srv or .action; what is read is said and read again."""
    kind, text = KINDS[data[:1][0] % 3 if data else 0], data[1:].decode(errors="replace")
    name = f"fuzz_msgs/{kind}/Fuzz"
    try:
        definition = parse(text, name)
    except InvalidInterface as error:
        is_told(error)
        return
    said = ""
    with contextlib.suppress(InvalidInterface):  # not each default can be put in quotes
        said = definition_text(definition)
    assert not said or parse(said, name) == definition
    for part in parts_of(definition):
        if any(field.type.is_nested for field in part.fields):
            return
        if sum(field.type.size for field in part.fields) > 1000:
            return
        try:
            made = make_message(part, get_interface)
        except InvalidInterface:  # two fields of one attribute
            continue
        finally:
            forget()
        same(made, cdr.encode(made()))
        text_and_back(made())


def a_text_is_read_or_refused(data: bytes) -> None:
    """A goal in YAML or JSON; what is read is said and read again."""
    cls, text = a_class(data), data[2:].decode(errors="surrogateescape")
    try:
        message = from_text(cls, text, allow_nonfinite=bool(len(data) % 2))
    except InvalidMessage as error:
        is_told(error)
        return
    text_and_back(message)


def a_message_is_read_or_refused(data: bytes) -> None:
    """CDR of any type that ships."""
    same(a_class(data), data[2:])


def a_message_of_any_type_is_read_or_refused(data: bytes) -> None:
    """CDR of a type that the first bytes say."""
    count = (data[0] if data else 0) % 8
    fields = [a_field(index, data[1 + 3 * index :]) for index in range(count)]
    definition = MessageDefinition("fuzz_msgs/msg/Any", tuple(fields))
    try:
        made = make_message(definition, get_interface)
    finally:
        forget()
    same(made, data[1 + 3 * count :])
    same(made, cdr.encode(made()))


def an_attachment_is_read_or_refused(data: bytes) -> None:
    """What stands beside a message."""
    assert len(gid_in(data)) <= 16
    try:
        read = read_attachment(data)
    except InvalidMessage as error:
        is_told(error)
        return
    assert read_attachment(write_attachment(read.sequence, read.stamp, read.gid, read.note)) == read
    note = GoalMetadata.read(read.note)
    assert GoalMetadata.read(note.write()).feedback == note.feedback


def a_token_is_read_or_passed_over(data: bytes) -> None:
    """A liveliness token."""
    key = data.decode(errors="replace")
    token = parse_token(key)
    if token is None:
        return
    if token.endpoint is None:
        again = parse_token(node_token(0, token.zid, 1, token.node))
        assert again == token
        return
    endpoint = token.endpoint
    assert endpoint.gid == gid_of(key)
    data_key(0, endpoint)
    again = parse_token(endpoint_token(0, token.zid, 1, 2, endpoint))
    assert again is not None
    assert again.endpoint is not None
    assert (again.zid, again.node, again.endpoint.qos) == (token.zid, token.node, endpoint.qos)


def a_name_is_taken_or_refused(data: bytes) -> None:
    """The name of a topic, alone and in a namespace."""
    text = data.decode(errors="surrogateescape")
    name, _, rest = text.partition("\n")
    namespace, _, node = rest.partition("\n")
    for check in (validate_name, validate_node_name):
        with contextlib.suppress(InvalidName):
            check(name)
    try:
        resolved = resolve_name(name, namespace or "/", node)
    except InvalidName as error:
        is_told(error)
        position = error.position
    else:
        position = 0
        assert resolve_name(resolved, namespace or "/", node) == resolved
        assert action_names(resolved).name == resolved
    assert 0 <= position <= len(text)


def an_error_is_made_again(data: bytes) -> None:
    """What another process says of a failure."""
    kind, _, text = data.decode(errors="replace").partition("\n")
    error = decode_error("/name", text, kind)
    assert isinstance(error, TurtleactError)
    assert isinstance(str(error), str)
    told, again = encode_error(error)
    assert str(decode_error("/name", told, again)) == str(error)


def is_told(error: TurtleactError) -> None:
    """An error that is documented has a text."""
    assert str(error)


def a_class(data: bytes) -> type[Message]:
    """The class that two bytes choose."""
    return CLASSES[int.from_bytes(data[:2], "big") % len(CLASSES)]


def a_field(index: int, choice: bytes) -> Field:
    """The field that three bytes choose."""
    base, form, size = (*choice[:3], 0, 0, 0)[:3]
    names = [*NAMES, *NESTED]
    name = names[base % len(names)]
    shape = list(ArrayForm)[form % 4]
    length = 1 + size % 9 if shape in (ArrayForm.FIXED, ArrayForm.BOUNDED) else 0
    bound = 1 + size % 5 if name in ("string", "wstring") and form & 4 else None
    return Field(f"f{index}", FieldType(name, bound, shape, length))


def same(cls: type[Message], data: bytes) -> None:
    """What is read is written and read again, the same in each kind of array."""
    try:
        read = cdr.decode(cls, data)
    except InvalidMessage as error:
        is_told(error)
        for arrays in ("array", "numpy"):
            with contextlib.suppress(InvalidMessage):
                cdr.decode(cls, data, arrays=arrays)
                raise AssertionError(f"only lists are refused, not {arrays}") from error
        return
    written = cdr.encode(read)
    assert cdr.encode(cdr.decode(cls, written)) == written
    assert cdr.encode(snapshot(read)) == written
    for arrays in ("array", "numpy"):
        copied = cdr.encode(cdr.decode(cls, data, arrays=arrays))  # type: ignore[arg-type]
        # A signalling float32 is quiet once Python has held it, and an array never asks Python.
        assert cdr.encode(cdr.decode(cls, copied)) == written


def text_and_back(message: Message) -> None:
    """A message said as YAML and as JSON is the same message."""
    written = cdr.encode(message)
    yaml = to_yaml(message)
    if len(yaml) < 2**17:
        assert cdr.encode(from_text(type(message), yaml, allow_nonfinite=True)) == written
    said = to_json(message)
    if not any(word in yaml for word in (".nan", ".inf")):
        assert cdr.encode(from_text(type(message), said)) == written


def forget() -> None:
    """The registry keeps no class of ours."""
    for name in REGISTRY.names():
        if name.startswith("fuzz_msgs/"):
            REGISTRY.forget(name)


PROPERTIES: dict[str, Callable[[bytes], None]] = {
    "interface": an_interface_is_read_or_refused,
    "text": a_text_is_read_or_refused,
    "cdr": a_message_is_read_or_refused,
    "anytype": a_message_of_any_type_is_read_or_refused,
    "attachment": an_attachment_is_read_or_refused,
    "token": a_token_is_read_or_passed_over,
    "name": a_name_is_taken_or_refused,
    "error": an_error_is_made_again,
}
