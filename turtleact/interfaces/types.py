"""Declares interfaces as Python classes that derive from Message, Service or Action.

A class statement declares an interface. The annotations in its body are the fields, and the
``ClassVar`` values in capitals are the constants. A field without a default starts with the zero of
its type. ``int32`` is ``Annotated[int, …]``: a type checker reads it as ``int``, and a message
class takes the ROS type from it. Generated modules import the base classes and field types from
here. This module does not parse text, encode messages or read files.

>>> class Goal(Message, type_name="example_msgs/msg/Goal"):
...     order: int32
...     name: string = "turtle1"
>>> Goal()
Goal(order=0, name='turtle1')
"""

from __future__ import annotations

import sys
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    TypeAlias,
    TypeVar,
    cast,
    dataclass_transform,
    overload,
)

import msgspec
from msgspec import field

from turtleact.errors import InvalidInterface
from turtleact.interfaces.class_body import (
    Scalar,
    Shape,
    is_message_class,
    limited,
    read_body,
)
from turtleact.interfaces.definition import (
    INTEGER_RANGES,
    ArrayForm,
    CompoundDefinition,
    Constant,
    Definition,
    Field,
    MessageDefinition,
    Primitive,
    check_type_name,
    did_you_mean,
    zero,
)
from turtleact.interfaces.finders import BUILT_IN, Finders

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Annotated as array
    from typing import Annotated as bounded

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
    "are_flags",
    "array",
    "bool_",
    "bounded",
    "byte",
    "char",
    "choices",
    "constants",
    "definition",
    "expect_interface",
    "field",
    "fields",
    "float32",
    "float64",
    "int8",
    "int16",
    "int32",
    "int64",
    "named_values",
    "nested_classes",
    "parts",
    "string",
    "uint8",
    "uint16",
    "uint32",
    "uint64",
    "wstring",
]


bool_: TypeAlias = Annotated[bool, Scalar("bool")]
byte: TypeAlias = Annotated[int, Scalar("byte")]
char: TypeAlias = Annotated[int, Scalar("char")]
int8: TypeAlias = Annotated[int, Scalar("int8")]
uint8: TypeAlias = Annotated[int, Scalar("uint8")]
int16: TypeAlias = Annotated[int, Scalar("int16")]
uint16: TypeAlias = Annotated[int, Scalar("uint16")]
int32: TypeAlias = Annotated[int, Scalar("int32")]
uint32: TypeAlias = Annotated[int, Scalar("uint32")]
int64: TypeAlias = Annotated[int, Scalar("int64")]
uint64: TypeAlias = Annotated[int, Scalar("uint64")]
float32: TypeAlias = Annotated[float, Scalar("float32")]
float64: TypeAlias = Annotated[float, Scalar("float64")]
string: TypeAlias = Annotated[str, Scalar("string")]
wstring: TypeAlias = Annotated[str, Scalar("wstring")]

if not TYPE_CHECKING:  # pragma: no branch  always true at run time

    class bounded:
        """Declares a maximum length: ``bounded[list[int32], 5]``, ``bounded[string, 10]``."""

        def __class_getitem__(cls, item: object) -> object:
            return limited(item, ArrayForm.BOUNDED)

    class array:
        """Declares an exact length: ``array[list[float64], 9]``, ``array[bytes, 16]`` for uint8."""

        def __class_getitem__(cls, item: object) -> object:
            return limited(item, ArrayForm.FIXED)


class Registry:
    """Keeps interface classes by type name, and the places where more are looked for.

    A class statement with a type name registers its class here. If a class of that name with an
    equal definition is already known, the known class stays, so that ``get_interface`` always
    returns the same class. If the definitions differ, later look-ups find the new class. A built-in
    class registers only when a look-up has found it, because every finder goes before it.

    Attributes:
        finders: The places, in order. `look_in` replaces them.
        learned: The classes that were learned from other nodes, by type name and hash, each with
            the node whose defaults it has, if any. `get` returns none of them.
        texts: The text of each learned class, also for the parts of a service or action.
    """

    def __init__(self) -> None:
        self._known: dict[str, tuple[Interface, Definition]] = {}
        self.finders = Finders()
        self.learned: dict[tuple[str, str], tuple[Interface, str]] = {}
        self.texts: dict[object, str] = {}

    def look_in(self, finders: Finders) -> None:
        """Replace the finders, and look again for interfaces that the last one has found."""
        self.finders = finders
        self._known = {
            name: held
            for name, held in self._known.items()
            if not held[0].__module__.startswith(BUILT_IN)
        }

    def declare(self, interface: Interface, *parts: type[Message]) -> None:
        """Register the class of a class statement and its parts, unless they are built in."""
        if interface.__module__.startswith(BUILT_IN):
            return
        # The whole comes first, because a changed definition drops everything under the old name.
        for each in (interface, *parts):
            self.add(each, definition(each))

    def add(self, interface: Interface, definition: Definition) -> None:
        """Register a class."""
        name = definition.type_name
        held = self._known.get(name)
        if held is not None:
            if held[1] == definition:
                return
            self.forget(name)
        self._known[name] = (interface, definition)

    def get(self, type_name: str) -> Interface | None:
        """Return the class with this type name, or None if no such class is registered."""
        held = self._known.get(type_name)
        return None if held is None else held[0]

    def forget(self, type_name: str) -> None:
        """Forget an interface and the types derived from it, such as ``NAME_Goal``."""
        for name in [n for n in self._known if n == type_name or n.startswith(f"{type_name}_")]:
            del self._known[name]

    def names(self) -> list[str]:
        """Return the type names of all registered classes."""
        return list(self._known)


#: The only registry of the process. It is global because a class statement has no other place to
#: register its class, just as modules register in ``sys.modules``. It holds only classes and
#: finders, nothing that belongs to a node or event loop.
REGISTRY = Registry()

M = TypeVar("M", bound="Message")


@dataclass_transform(field_specifiers=(msgspec.field,))
class MessageMeta(msgspec.StructMeta):
    """The metaclass of messages, which reads the class body of each message class."""

    _shape: Shape

    def __new__(
        mcls,
        name: str,
        bases: tuple[type, ...],
        namespace: dict[str, Any],
        *,
        type_name: str = "",
        register: bool = True,
    ) -> MessageMeta:
        """Read the class body before msgspec makes a class from it.

        Args:
            type_name: The full name; empty for a part of a service or action.
            register: Whether `get_interface` may return the class.
        """
        if bases == (msgspec.Struct,):
            # A message is a tree and never part of a cycle, so the garbage collector can ignore it.
            base = super().__new__(mcls, name, bases, namespace, gc=False)
            base._shape = Shape()
            return base
        if name == "Goal" and not type_name:  # a part of an action
            mcls = GoalMeta
        namespace.setdefault("__qualname__", name)
        if bases != (Message,):
            problem = "derive a message only from Message"
            raise InvalidInterface(problem, source=namespace["__qualname__"])
        shape = read_body(namespace, sys._getframe(1), type_name)
        cls = super().__new__(mcls, name, bases, namespace)
        cls._shape = shape
        if type_name and register:
            REGISTRY.declare(cast("type[Message]", cls))
        return cls

    @property
    def type_name(cls) -> str:
        """The full name, ``package/kind/Name``; empty if the class has none."""
        return cls._shape.type_name


class GoalMeta(MessageMeta):
    """The metaclass of the goal messages of actions, which suggests a field for a misspelt one.

    The check takes half a microsecond, so only the messages that programs write by hand have it.
    """

    def __call__(cls, *args: object, **values: object) -> object:
        """Create a goal message."""
        try:
            return super().__call__(*args, **values)
        except TypeError:
            fields = cls.__struct_fields__
            unknown = next((name for name in values if name not in fields), None)
            if unknown is None:
                raise
            hint = did_you_mean(unknown, fields) or f"; it has {', '.join(fields) or 'none'}"
            raise TypeError(f"{cls.__qualname__} has no field '{unknown}'{hint}") from None


def constructor(cls: type[M]) -> Callable[..., M]:
    """Return a function that makes messages of a class without the check of `GoalMeta`."""
    if not isinstance(cls, GoalMeta):
        return cls
    return cast("Callable[..., M]", msgspec.StructMeta.__call__.__get__(cls))


class Message(msgspec.Struct, metaclass=MessageMeta):
    """The base class of all messages. They are mutable, compared by value, and cheap to create.

    Creating a message does not check its values; ``snapshot`` checks them when the message is sent.
    A field without a default starts with the zero of its type. However, type checkers then require
    an argument for the field. To make the argument optional, declare a default:
    ``order: int32 = 0``. Declare a constant with ``ClassVar``: ``FAST: ClassVar[int8] = 1``. If a
    field's ROS name is a Python keyword, add an underscore to it (``from_``).

    >>> class Pair(Message, type_name="example_msgs/msg/Pair"):
    ...     left: bounded[list[int32], 3]
    ...     right: array[list[float64], 2]
    >>> Pair(left=[1])
    Pair(left=[1], right=[0.0, 0.0])
    """


class Action:
    """The base class of all actions, which contain the message classes Goal, Result and Feedback.

    If an action omits Goal, Result or Feedback, that message class has no fields.

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

    def __init_subclass__(cls, *, type_name: str = "", register: bool = True) -> None:
        """Name the Goal, Result and Feedback classes after the action, and register all classes."""
        super().__init_subclass__()
        parts = name_parts(cls, type_name, base=Action, kind="action")
        if register:
            REGISTRY.declare(cls, *parts)


class Service:
    """The base class of all services, which contain the message classes Request and Response.

    If a service omits Request or Response, that message class has no fields.
    """

    type_name: ClassVar[str] = ""
    Request: ClassVar[type[Message]] = Message
    Response: ClassVar[type[Message]] = Message

    def __init_subclass__(cls, *, type_name: str = "", register: bool = True) -> None:
        """Name the Request and Response classes after the service, and register all classes."""
        super().__init_subclass__()
        parts = name_parts(cls, type_name, base=Service, kind="srv")
        if register:
            REGISTRY.declare(cls, *parts)


Interface: TypeAlias = type[Message] | type[Service] | type[Action]


def fields(cls: type[Message]) -> tuple[Field, ...]:
    """Return the fields of a message class, in the order in which they are sent."""
    return cls._shape.fields


def constants(cls: type[Message]) -> tuple[Constant, ...]:
    """Return the constants of a message class."""
    return cls._shape.constants


def named_values(cls: type[Message], field: Field) -> list[Constant]:
    """Return the constants that stand for values of a field.

    Their names begin with the field's name, as ``STATUS_OK`` does for ``status``.
    """
    prefix = f"{field.name.upper()}_"
    return [
        constant
        for constant in constants(cls)
        if constant.name.startswith(prefix) and constant.type.name == field.type.name
    ]


#: The types of text.
TEXTS = frozenset({"string", "wstring"})

#: At least this many constants that are single bits, or zero, are taken for flags.
FEWEST_FLAGS = 3


def are_flags(named: list[Constant]) -> bool:
    """Whether these constants seem to be flags: single bits (or zero) that may be combined."""
    values = [constant.value for constant in named if isinstance(constant.value, int)]
    are_bits = len(values) == len(named) and all(value & (value - 1) == 0 for value in values)
    return are_bits and len(values) >= FEWEST_FLAGS and max(values) > FEWEST_FLAGS


def choices(cls: type[Message], field: Field) -> list[Constant]:
    """Return the named constants that a field may take; an empty list if the field is not limited.

    A field is limited if it holds a single text or whole number, and the default is one of at least
    two named constants. However, constants that seem to be flags do not limit a field. A field that
    is not limited may also take values without a name. For example, ``TIMEOUT_NEVER`` names only
    one of many timeouts.
    """
    named = named_values(cls, field)
    default = zero(field.type) if field.default is None else field.default
    is_complete = len(named) > 1 and any(constant.value == default for constant in named)
    is_listable = field.type.name in TEXTS or field.type.name in INTEGER_RANGES
    return named if is_complete and is_listable and not are_flags(named) else []


def nested_classes(cls: type[Message]) -> tuple[type[Message] | None, ...]:
    """Return the class of each field's messages, or None for a field of primitive type."""
    return cls._shape.nested


@overload
def definition(cls: type[Message]) -> MessageDefinition: ...
@overload
def definition(cls: type[Service] | type[Action]) -> CompoundDefinition: ...
def definition(cls: Interface) -> Definition:
    """Return the definition of an interface class.

    Raises:
        InvalidInterface: if the class has no type name.
    """
    if issubclass(cls, Message):
        return MessageDefinition(cls.type_name, fields(cls), constants(cls))
    check_type_name(cls.type_name, kinds=("action", "srv"))
    return CompoundDefinition(cls.type_name, tuple(map(definition, parts(cls))))


#: The classes inside a service or action.
PARTS = {"srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}


def parts(cls: type[Service] | type[Action]) -> list[type[Message]]:
    """Return the message classes of a service or action."""
    return [getattr(cls, name) for name in PARTS["srv" if issubclass(cls, Service) else "action"]]


def expect_interface(kind: type, given: object) -> None:
    """Raise `TypeError` unless an object is a subclass of ``kind``.

    Args:
        kind: `Message`, `Service` or `Action`.
        given: The object, which may be anything.
    """
    if isinstance(given, type) and issubclass(given, kind):
        return
    named = getattr(given, "__qualname__", "") or repr(given)
    whole, dot, part = named.rpartition(".")
    hint, kinds = "", dict[type, str]({Service: "srv", Action: "action"})
    if isinstance(given, str):
        hint = f": give the class, for example turtleact.get_{kind.__name__.lower()}(TYPE)"
    elif dot and part in PARTS.get(kinds.get(kind, ""), ()):
        hint = f": give {whole} itself"
    raise TypeError(f"expected a subclass of turtleact.{kind.__name__}, not {named}{hint}")


def name_parts(
    cls: type[Service] | type[Action], type_name: str, *, base: type, kind: str
) -> list[type[Message]]:
    """Give a service or action and its parts their full names, and return the parts."""
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
    return [named_part(cls, part) for part in PARTS[kind]]


def named_part(cls: type[Service] | type[Action], part: str) -> type[Message]:
    """Give one part of a service or action its full name, and return the part.

    If the class does not declare the part, the part has no fields.
    """
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
    """Raise an error if a nested message class is not in ``parts``: its name may be misspelled."""
    for name, member in vars(cls).items():
        if is_message_class(member) and name not in parts and member.__name__ == name:
            problem = f"the parts are {', '.join(parts)}{did_you_mean(name, parts)}"
            raise InvalidInterface(problem, source=f"{cls.__qualname__}.{name}")
