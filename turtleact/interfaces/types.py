"""Message, Service and Action: interfaces as Python classes.

A class statement declares an interface. Its annotations are the fields, and its ``ClassVar`` values
in capitals are the constants. A field without a default gets the zero of its type. Generated
modules import from here. This module knows no text, wire format or file.

>>> class Goal(Message, type_name="example_msgs/msg/Goal"):
...     order: int32
...     name: string = "turtle1"
>>> Goal()
Goal(order=0, name='turtle1')
"""

from __future__ import annotations

import contextlib
import functools
import keyword
import math
import sys
from copy import copy
from typing import (
    TYPE_CHECKING,
    Any,
    ClassVar,
    TypeAlias,
    cast,
    dataclass_transform,
    get_args,
    get_origin,
    overload,
)

import msgspec
from msgspec import field

from turtleact.errors import InvalidInterface, InvalidMessage
from turtleact.interfaces.annotations import (
    array,
    bool_,
    bounded,
    byte,
    char,
    float32,
    float64,
    int8,
    int16,
    int32,
    int64,
    is_message_class,
    read,
    resolve,
    scope_of,
    string,
    uint8,
    uint16,
    uint32,
    uint64,
    wstring,
)
from turtleact.interfaces.definition import (
    ActionDefinition,
    ArrayForm,
    Constant,
    Definition,
    Field,
    MessageDefinition,
    Primitive,
    ServiceDefinition,
    check_type_name,
    constant_name_pattern,
    did_you_mean,
    zero,
)
from turtleact.interfaces.values import converter, describe

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from types import FrameType

    from turtleact.interfaces.annotations import Reading, Scope

    Default = Primitive | tuple[Primitive, ...] | None

__all__ = [
    "PARTS",
    "REGISTRY",
    "Action",
    "Interface",
    "Message",
    "MessageMeta",
    "Registry",
    "Service",
    "array",
    "bool_",
    "bounded",
    "byte",
    "char",
    "constants",
    "definition",
    "field",
    "fields",
    "float32",
    "float64",
    "int8",
    "int16",
    "int32",
    "int64",
    "nested_classes",
    "string",
    "uint8",
    "uint16",
    "uint32",
    "uint64",
    "wstring",
]


class Shape(msgspec.Struct, frozen=True):
    """The declaration of a message class.

    Attributes:
        type_name: The full name of the class; empty until it has one.
        fields: Its fields, in order.
        constants: Its constants, in order.
        nested: For each field, the class of the messages in it, or None.
        bytes_fields: The names of fields declared as ``bytes``.
    """

    type_name: str = ""
    fields: tuple[Field, ...] = ()
    constants: tuple[Constant, ...] = ()
    nested: tuple[type[Message] | None, ...] = ()
    bytes_fields: frozenset[str] = frozenset()


class Registry:
    """Interface classes by type name, and places to look for more.

    A class statement with a type name registers its class here. If an equal class is already known,
    the known class stays, so that ``get_interface`` always returns the same class. A class with
    other fields replaces the known class for later look-ups. Built-in classes never replace a
    user's class.

    Attributes:
        files: The interface files that `load_interfaces` has found, by type name.
        prefixes: The folders where ROS packages are installed, in order of precedence.
        nearby: The interface files that `offer_interfaces` was given, by type name.
        on_nearby: Called with the type name and the file when a file of ``nearby`` is first used.
        settled: The built-in interfaces that no file outside of turtleact replaces.
    """

    def __init__(self) -> None:
        self._known: dict[str, tuple[Interface, Definition]] = {}
        self.files: dict[str, str] = {}
        self.prefixes: tuple[str, ...] = ()
        self.nearby: dict[str, str] = {}
        self.on_nearby: Callable[[str, str], object] | None = None
        self.settled: set[str] = set()

    def add(self, interface: Interface, definition: Definition) -> None:
        """Register a class."""
        name = definition.type_name
        held = self._known.get(name)
        if held is not None:
            if held[1] == definition or interface.__module__.startswith(SHIPPED):
                return
            self.forget(name)
        self._known[name] = (interface, definition)

    def get(self, type_name: str) -> Interface | None:
        """Return the class with that name, or None."""
        held = self._known.get(type_name)
        return None if held is None else held[0]

    def forget(self, type_name: str) -> None:
        """Drop an interface and the types derived from it (``NAME_Goal``, ``NAME_SendGoal`` …)."""
        for name in [n for n in self._known if n == type_name or n.startswith(f"{type_name}_")]:
            del self._known[name]

    def names(self) -> list[str]:
        """All names known so far."""
        return list(self._known)

    def state(self) -> dict[str, object]:
        """Return everything that is registered now, for `restore`."""
        return {name: copy(value) for name, value in vars(self).items()}

    def restore(self, state: Mapping[str, object]) -> None:
        """Restore what was registered when `state` was called.

        Everything registered later is forgotten.
        """
        vars(self).update({name: copy(value) for name, value in state.items()})

    @contextlib.contextmanager
    def isolated(self) -> Iterator[None]:
        """At the end of the block, forget everything that was registered inside it.

        Tests use this.
        """
        kept = self.state()
        try:
            yield
        finally:
            self.restore(kept)


#: The package with the built-in classes.
SHIPPED = "turtleact.interfaces.standard."

#: The only registry of the process. It is global because a class statement has no other place to
#: register its class, just as modules register in ``sys.modules``. It holds only classes, files and
#: folders, nothing that belongs to a node or event loop. `Registry.isolated` resets it.
REGISTRY = Registry()


@dataclass_transform(field_specifiers=(msgspec.field,))
class MessageMeta(msgspec.StructMeta):
    """The metaclass of messages; ``Message`` describes their behaviour."""

    _shape: Shape

    def __new__(
        mcls,
        name: str,
        bases: tuple[type, ...],
        namespace: dict[str, Any],
        *,
        type_name: str = "",
    ) -> MessageMeta:
        """Read the class body before msgspec makes a class of it."""
        if bases == (msgspec.Struct,):
            # A message is a tree and never part of a cycle, so the garbage collector can ignore it.
            base = super().__new__(mcls, name, bases, namespace, gc=False)
            base._shape = Shape()
            return base
        namespace.setdefault("__qualname__", name)
        if bases != (Message,):
            problem = "derive a message only from Message"
            raise InvalidInterface(problem, source=namespace["__qualname__"])
        shape = read_body(namespace, sys._getframe(1), type_name)
        cls = super().__new__(mcls, name, bases, namespace)
        cls._shape = shape
        if type_name:
            message = cast("type[Message]", cls)
            REGISTRY.add(message, definition(message))
        return cls

    @property
    def type_name(cls) -> str:
        """The full name, ``package/kind/Name``; empty if the class has none."""
        return cls._shape.type_name


class Message(msgspec.Struct, metaclass=MessageMeta):
    """The base of all messages. Messages are mutable, compared by value, and cheap to create.

    Creating a message checks nothing; ``snapshot`` checks the message when it is sent. A field
    without a default gets the zero of its type. For type checkers, however, an argument is required
    if the class gives no default. Write ``order: int32 = 0`` if the argument may be left out.
    Constants are ``ClassVar[int8]`` and the like. If a field's ROS name is a Python keyword, add an
    underscore (``from_``).

    >>> class Pair(Message, type_name="example_msgs/msg/Pair"):
    ...     left: bounded[list[int32], 3]
    ...     right: array[list[float64], 2]
    >>> Pair(left=[1])
    Pair(left=[1], right=[0.0, 0.0])
    """


class Action:
    """The base of all actions: a class with Goal, Result and Feedback inside.

    Each of these three parts is a Message. A part that is left out has no fields.

    >>> class Count(Action, type_name="example_msgs/action/Count"):
    ...     class Goal(Message):
    ...         target: int32 = 0
    >>> Count.Goal(target=3), Count.Result()
    (Goal(target=3), Result())
    """

    type_name: ClassVar[str] = ""
    Goal: ClassVar[type[Message]] = Message
    Result: ClassVar[type[Message]] = Message
    Feedback: ClassVar[type[Message]] = Message

    def __init_subclass__(cls, *, type_name: str = "") -> None:
        """Name the parts after the action and register them all."""
        super().__init_subclass__()
        declare(cls, type_name, base=Action, kind="action")


class Service:
    """The base of all services: a class with Request and Response inside, as in ``Action``."""

    type_name: ClassVar[str] = ""
    Request: ClassVar[type[Message]] = Message
    Response: ClassVar[type[Message]] = Message

    def __init_subclass__(cls, *, type_name: str = "") -> None:
        """Name the parts after the service and register them all."""
        super().__init_subclass__()
        declare(cls, type_name, base=Service, kind="srv")


Interface: TypeAlias = type[Message] | type[Service] | type[Action]


def fields(cls: type[Message]) -> tuple[Field, ...]:
    """Return the fields of a message class, in the order they are sent."""
    return cls._shape.fields


def constants(cls: type[Message]) -> tuple[Constant, ...]:
    """Return the constants of a message class."""
    return cls._shape.constants


def nested_classes(cls: type[Message]) -> tuple[type[Message] | None, ...]:
    """Return, for each field, the class of the messages in it, or None."""
    return cls._shape.nested


@overload
def definition(cls: type[Message]) -> MessageDefinition: ...
@overload
def definition(cls: type[Service]) -> ServiceDefinition: ...
@overload
def definition(cls: type[Action]) -> ActionDefinition: ...
def definition(cls: type[Message] | type[Service] | type[Action]) -> Definition:
    """Return the definition of an interface class.

    Raises:
        InvalidInterface: if the class has no type name.
    """
    if issubclass(cls, Message):
        return MessageDefinition(cls.type_name, fields(cls), constants(cls))
    if issubclass(cls, Service):
        return ServiceDefinition(cls.type_name, definition(cls.Request), definition(cls.Response))
    return ActionDefinition(
        cls.type_name, definition(cls.Goal), definition(cls.Result), definition(cls.Feedback)
    )


#: The classes inside a service or action.
PARTS = {"srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}


def declare(cls: type[Service] | type[Action], type_name: str, *, base: type, kind: str) -> None:
    """Complete a service or action: name its parts, and register it with its parts."""
    source = cls.__qualname__
    if cls.__bases__ != (base,):
        raise InvalidInterface(f"derive it only from {base.__name__}", source=source)
    if not type_name:
        problem = (
            f"give it a name: class {cls.__name__}({base.__name__}, "
            f'type_name="package_name/{kind}/{cls.__name__}")'
        )
        raise InvalidInterface(problem, source=source)
    check_type_name(type_name, kinds=(kind,) if kind == "action" else ("action", "srv"))
    cls.type_name = type_name
    check_strays(cls, PARTS[kind])
    parts = [named_part(cls, part) for part in PARTS[kind]]
    # The whole comes first, because a changed definition drops everything under the old name.
    REGISTRY.add(cls, definition(cls))
    for part in parts:
        REGISTRY.add(part, definition(part))


def named_part(cls: type[Service] | type[Action], part: str) -> type[Message]:
    """Return one part of a service or action with its full name. A missing part has no fields."""
    type_name = f"{cls.type_name}_{part}"
    qualname = f"{cls.__qualname__}.{part}"
    message = vars(cls).get(part)
    if message is None:
        body = {"__module__": cls.__module__, "__qualname__": qualname}
        message = cast("type[Message]", MessageMeta(part, (Message,), body))
        setattr(cls, part, message)
    if not is_message_class(message) or message is Message:
        raise InvalidInterface(f"not a message: write class {part}(Message)", source=qualname)
    message = cast("type[Message]", message)
    if message.type_name not in ("", type_name):
        problem = (
            f"belongs to {message.type_name}: write class {part}(Message) inside {cls.__name__}"
        )
        raise InvalidInterface(problem, source=qualname)
    message._shape = msgspec.structs.replace(message._shape, type_name=type_name)
    return message


def check_strays(cls: type, parts: tuple[str, ...]) -> None:
    """Refuse an inner message class that is not a part; its name may be misspelled."""
    for name, member in vars(cls).items():
        if is_message_class(member) and name not in parts and member.__name__ == name:
            problem = f"the parts are {', '.join(parts)}{did_you_mean(name, parts)}"
            raise InvalidInterface(problem, source=f"{cls.__qualname__}.{name}")


def read_body(namespace: dict[str, object], frame: FrameType, type_name: str) -> Shape:
    """Return the declaration in a class body.

    Args:
        namespace: The body. This function adds a default for every field to it.
        frame: The frame that runs the class statement.
        type_name: The full name of the class, or an empty string.

    Raises:
        InvalidInterface: if a member is wrong. The error names the class and the member.
    """
    source = str(namespace["__qualname__"])
    scope = scope_of(frame, namespace)
    members: list[tuple[Field, Reading]] = []
    constants: list[Constant] = []
    meanings: dict[str, object] = {}
    for name, annotation in annotations_of(namespace, source).items():
        with naming(source, name):
            meaning = meanings[name] = resolve(annotation, scope)
            if meaning is ClassVar or get_origin(meaning) is ClassVar:
                constants += read_constant(name, meaning, namespace, scope)
            else:
                reading = read(meaning, scope)
                members.append((read_field(name, reading, namespace), reading))
    # Store the objects instead of the text, so that signatures and hints work for local classes.
    namespace["__annotations__"] = meanings
    return Shape(
        type_name,
        tuple(field for field, _ in members),
        tuple(constants),
        tuple(reading.nested for _, reading in members),
        frozenset(field.name for field, reading in members if reading.is_bytes),
    )


def annotations_of(namespace: Mapping[str, object], source: str) -> Mapping[str, object]:
    """Return the annotations in a class body, in order."""
    found = namespace.get("__annotations__")
    if found is None and sys.version_info >= (3, 14):  # pragma: no cover  no older one has it
        import annotationlib

        annotate = annotationlib.get_annotate_from_class_namespace(namespace)
        if annotate is not None:
            with naming(source, "__annotate__"):
                found = annotationlib.call_annotate_function(annotate, annotationlib.Format.VALUE)
    return found or {}  # type: ignore[return-value]  # a class body holds nothing else there


@contextlib.contextmanager
def naming(source: str, name: str) -> Iterator[None]:
    """Add class and member to errors about an annotation or default."""
    try:
        yield
    except InvalidInterface as inner:
        raise InvalidInterface(f"{name}: {inner.problem}", source=source) from inner.__cause__


def read_constant(
    name: str, annotation: object, namespace: Mapping[str, object], scope: Scope
) -> list[Constant]:
    """Return the constant that a ClassVar in capitals declares. Other ClassVars declare nothing."""
    if not constant_name_pattern.fullmatch(name):
        return []
    reading = read(next(iter(get_args(annotation)), annotation), scope)
    if name not in namespace:
        raise InvalidInterface("a constant needs a value", source="")
    return [
        Constant(name, reading.field_type, cast("Primitive", as_default(reading, namespace[name])))
    ]


def read_field(name: str, reading: Reading, namespace: dict[str, object]) -> Field:
    """Return one field, and turn its default in the class body into a form that msgspec can use."""
    default: Default = None
    if name in namespace:
        default = as_default(reading, given_default(namespace[name]))
    ros_name = name[:-1] if name.endswith("_") and keyword.iskeyword(name[:-1]) else name
    field = Field(ros_name, reading.field_type, default)
    namespace[name] = initial(reading, field.default)
    return field


def given_default(given: object) -> object:
    """Return the default in a class body, given directly or through ``msgspec.field``."""
    if not isinstance(given, FIELD_SPECIFIER):
        return given
    value: Any = given  # msgspec does not export its type
    if value.name is not None or (value.default, value.default_factory) == NOTHING:
        problem = "msgspec.field may only have default or default_factory"
        raise InvalidInterface(problem, source="")
    return value.default if value.default_factory is msgspec.NODEFAULT else value.default_factory()


def as_default(reading: Reading, value: object) -> Default:
    """Convert a default to the form in a definition."""
    if reading.nested is not None:
        check_nested_default(reading, value)
        return None
    try:
        default = converter(reading.field_type)(value)
    except InvalidMessage as misfit:
        raise InvalidInterface(f"its default{misfit.path}: {misfit.problem}", source="") from None
    values = default if isinstance(default, list | bytes) else [default]
    if any(isinstance(item, float) and not math.isfinite(item) for item in values):
        raise InvalidInterface(f"its default {describe(value)} is not finite", source="")
    return tuple(default) if isinstance(default, list | bytes) else cast("Primitive", default)


def check_nested_default(reading: Reading, value: object) -> None:
    """Accept a message as a default only if it equals a new message, which has zeros."""
    if value != zero_message(reading)():
        problem = "ROS has no defaults for messages: leave it out; every message starts with zeros"
        raise InvalidInterface(problem, source="")


def initial(reading: Reading, default: Default) -> object:
    """Return the default that msgspec needs for a field: a value, or a factory of values."""
    if reading.nested is not None:
        return msgspec.field(default_factory=zero_message(reading))
    value = zero(reading.field_type) if default is None else default
    if not isinstance(value, tuple):
        return value
    if reading.is_bytes:
        return bytes(cast("tuple[int, ...]", value))
    return msgspec.field(default_factory=functools.partial(list, value) if value else list)


def zero_message(reading: Reading) -> Callable[[], object]:
    """Return a function that makes a field's initial message, or list of messages."""
    nested = cast("Callable[[], object]", reading.nested)
    if not reading.field_type.is_sequence:
        return nested
    if reading.field_type.form is ArrayForm.FIXED:
        return functools.partial(several, nested, reading.field_type.size)
    return list


def several(make: Callable[[], object], size: int) -> list[object]:
    """Make a list of new messages."""
    return [make() for _ in range(size)]


#: The type that ``msgspec.field`` returns; msgspec does not export it.
FIELD_SPECIFIER = type(msgspec.field(default=None))
NOTHING = (msgspec.NODEFAULT, msgspec.NODEFAULT)
