"""Reads what a class body declares: the fields and constants of a message class.

An annotation says the ROS type of a field. ``Annotated[int, Scalar("int32")]`` is an int32, which a
type checker reads as ``int``. The only attribute of another message class that this module reads is
the type name.
"""

from __future__ import annotations

import contextlib
import functools
import keyword
import math
import sys
from collections import ChainMap
from operator import getitem
from types import GenericAlias
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    ForwardRef,
    NamedTuple,
    TypeAlias,
    cast,
    get_args,
    get_origin,
)

import msgspec

from turtleact.errors import InvalidInterface, InvalidMessage
from turtleact.interfaces.definition import (
    PRIMITIVES,
    ArrayForm,
    Constant,
    Field,
    FieldType,
    Primitive,
    constant_name_pattern,
    did_you_mean,
    is_bytes,
    zero,
)
from turtleact.interfaces.values import converter, describe

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from types import FrameType

    Default = Primitive | tuple[Primitive, ...] | None

__all__ = [
    "Limit",
    "Reading",
    "Scalar",
    "Shape",
    "annotation_of",
    "is_message_class",
    "limited",
    "read",
    "read_body",
    "scope_of",
]


class Scalar(msgspec.Struct, frozen=True):
    """Marks an annotation with the name of a primitive ROS type."""

    name: str


class Limit(msgspec.Struct, frozen=True):
    """Marks an annotation with a maximum length or a fixed length."""

    form: ArrayForm
    size: int


class Shape(msgspec.Struct, frozen=True):
    """The declaration of a message class.

    Attributes:
        type_name: The full name of the class; empty until it has one.
        fields: The fields, in order of declaration.
        constants: The constants, in order of declaration.
        nested: For each field, the class of its messages; None if the field's type is primitive.
        bytes_fields: The names of fields declared as ``bytes``.
    """

    type_name: str = ""
    fields: tuple[Field, ...] = ()
    constants: tuple[Constant, ...] = ()
    nested: tuple[Any, ...] = ()
    bytes_fields: frozenset[str] = frozenset()


def read_body(namespace: dict[str, object], frame: FrameType, type_name: str) -> Shape:
    """Read the fields and constants that a class body declares.

    Args:
        namespace: The namespace of the class body. This function changes the namespace: it adds a
            default for every field.
        frame: The frame that runs the class statement.
        type_name: The full name of the class, or an empty string.

    Raises:
        InvalidInterface: if a field or constant is wrong. The error names the class and the member.
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
    """Return the annotations in a class body, in order of declaration."""
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
    """Add the names of the class and the member to errors about an annotation or default."""
    try:
        yield
    except InvalidInterface as inner:
        raise InvalidInterface(f"{name}: {inner.problem}", source=source) from inner.__cause__


def read_constant(
    name: str, annotation: object, namespace: Mapping[str, object], scope: Scope
) -> list[Constant]:
    """Return a list with the constant that an upper-case ClassVar declares.

    The list is empty for other ClassVars, because they declare no constant.
    """
    if not constant_name_pattern.fullmatch(name):
        return []
    reading = read(next(iter(get_args(annotation)), annotation), scope)
    if name not in namespace:
        raise InvalidInterface("a constant needs a value", source="")
    return [
        Constant(name, reading.field_type, cast("Primitive", as_default(reading, namespace[name])))
    ]


def read_field(name: str, reading: Reading, namespace: dict[str, object]) -> Field:
    """Return a field, and replace its default in the class body by one that msgspec can use."""
    default: Default = None
    if name in namespace:
        default = as_default(reading, given_default(namespace[name]))
    ros_name = name[:-1] if name.endswith("_") and keyword.iskeyword(name[:-1]) else name
    field = Field(ros_name, reading.field_type, default)
    namespace[name] = initial(reading, field.default)
    return field


def given_default(given: object) -> object:
    """Return a field's default, which may be a plain value or wrapped in ``msgspec.field``."""
    if not isinstance(given, FIELD_SPECIFIER):
        return given
    value: Any = given  # msgspec does not export its type
    if value.name is not None or (value.default, value.default_factory) == NOTHING:
        problem = "msgspec.field may only have default or default_factory"
        raise InvalidInterface(problem, source="")
    return value.default if value.default_factory is msgspec.NODEFAULT else value.default_factory()


def as_default(reading: Reading, value: object) -> Default:
    """Convert a default or a constant's value to the form that `Field` and `Constant` store."""
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
    """Raise an error if a field of messages has a default other than the initial value."""
    if value != zero_message(reading)():
        problem = "ROS has no defaults for messages: leave it out; every message starts with zeros"
        raise InvalidInterface(problem, source="")


def initial(reading: Reading, default: Default) -> object:
    """Return a default in the form that msgspec accepts: a value, or a field with a factory."""
    if reading.nested is not None:
        return msgspec.field(default_factory=zero_message(reading))
    value = zero(reading.field_type) if default is None else default
    if not isinstance(value, tuple):
        return value
    if reading.is_bytes:
        return bytes(cast("tuple[int, ...]", value))
    return msgspec.field(default_factory=functools.partial(list, value) if value else list)


def zero_message(reading: Reading) -> Callable[[], object]:
    """Return a function that makes a field's initial value: a message or a list of messages."""
    nested = cast("Callable[[], object]", reading.nested)
    if not reading.field_type.is_sequence:
        return nested
    if reading.field_type.form is ArrayForm.FIXED:
        return functools.partial(several, nested, reading.field_type.size)
    return list


def several(make: Callable[[], object], size: int) -> list[object]:
    """Make a list of ``size`` new messages."""
    return [make() for _ in range(size)]


#: The type that ``msgspec.field`` returns; msgspec does not export it.
FIELD_SPECIFIER = type(msgspec.field(default=None))
NOTHING = (msgspec.NODEFAULT, msgspec.NODEFAULT)


#: Python's own types with only one ROS type; ``int`` has several.
PLAIN = {bool: "bool", float: "float64", str: "string"}

#: The namespace in which the names of an annotation are looked up.
Scope: TypeAlias = "Mapping[str, object]"


class Reading(NamedTuple):
    """A field's ROS type and message class, as the field's annotation declares them."""

    field_type: FieldType
    nested: type | None = None
    is_bytes: bool = False


def read(annotation: object, scope: Scope) -> Reading:
    """Return the meaning of a field's annotation.

    Raises:
        InvalidInterface: if the annotation is not a ROS type. The caller must set the error's
            ``source``.
    """
    annotation = resolve(annotation, scope)
    marks: tuple[object, ...] = ()
    if get_origin(annotation) is Annotated:
        annotation, *rest = get_args(annotation)
        marks = tuple(rest)
    limit = next((m for m in marks if isinstance(m, Limit)), None)
    scalar = next((m.name for m in marks if isinstance(m, Scalar)), None)
    if scalar is not None:
        return Reading(with_limit(FieldType(scalar), limit))
    annotation = resolve(annotation, scope)
    if get_origin(annotation) is list:
        element = read(get_args(annotation)[0], scope)
        return Reading(with_form(element.field_type, limit), element.nested)
    if annotation is bytes:
        return Reading(with_form(FieldType("uint8"), limit), is_bytes=True)
    if isinstance(annotation, type) and annotation in PLAIN:
        return Reading(with_limit(FieldType(PLAIN[annotation]), limit))
    message, type_name = message_class(annotation)
    return Reading(with_limit(FieldType(type_name), limit), message)


def annotation_of(field_type: FieldType, nested: type | None) -> object:
    """Return the annotation that declares a field of this type."""
    if is_bytes(field_type):
        return marked(bytes, Limit(field_type.form, field_type.size))
    python = type(PRIMITIVES.get(field_type.name))
    annotation = marked(python, Scalar(field_type.name)) if nested is None else nested
    if field_type.string_bound is not None:
        annotation = marked(annotation, Limit(ArrayForm.BOUNDED, field_type.string_bound))
    if field_type.is_sequence:
        annotation = GenericAlias(list, (annotation,))
    if field_type.size:
        annotation = marked(annotation, Limit(field_type.form, field_type.size))
    return annotation


def scope_of(frame: FrameType, namespace: Mapping[str, object]) -> Scope:
    """Return the names that the string annotations of a class body can refer to.

    The result contains the names in the enclosing class bodies, in the nearest enclosing function,
    and in the module. Local names of functions further out are not included. The names in the class
    body itself are looked up last. The annotation in ``byte: byte = 0`` therefore means the type.
    """
    maps = [dict(frame.f_locals)]
    while frame.f_back is not None and not frame.f_code.co_flags & FUNCTION:
        if frame.f_locals is frame.f_globals:
            break
        frame = frame.f_back
        maps.append(dict(frame.f_locals))
    return ChainMap(*maps, frame.f_globals, dict(namespace))


#: The code flag (CO_OPTIMIZED) that functions have and class bodies and modules do not.
FUNCTION = 0x1


def resolve(annotation: object, scope: Scope) -> object:
    """Evaluate an annotation if it is text."""
    if isinstance(annotation, ForwardRef):
        annotation = annotation.__forward_arg__
    if not isinstance(annotation, str):
        return annotation
    try:
        # The text is an annotation in the caller's own source, so Python would have run it anyway.
        return eval(annotation, {}, scope)  # noqa: S307
    except InvalidInterface:
        raise
    except Exception as error:
        problem = (
            f"cannot make out '{annotation}' ({error}): the names in it must be known to the "
            "module, or to the function, that declares the class"
        )
        raise InvalidInterface(problem, source="") from error


def limited(item: object, form: ArrayForm) -> object:
    """Return the annotation that ``bounded[…]`` or ``array[…]`` stands for."""
    match item:
        case (annotation, int(size)) if size > 0:
            return marked(annotation, Limit(form, size))
    word = "array" if form is ArrayForm.FIXED else "bounded"
    problem = f"write {word}[list[int32], 5]: a type, then a number above zero"
    raise InvalidInterface(problem, source=word)


def marked(annotation: object, mark: Limit | Scalar) -> object:
    """Add a mark to an annotation."""
    return getitem(cast("dict[object, object]", Annotated), (annotation, mark))


def with_form(element: FieldType, limit: Limit | None) -> FieldType:
    """Return the type of a sequence of ``element``, with the limit if there is one."""
    if element.is_sequence:
        problem = f"ROS has no lists of lists: put the {element} into a message of its own"
        raise InvalidInterface(problem, source="")
    form, size = (ArrayForm.UNBOUNDED, 0) if limit is None else (limit.form, limit.size)
    return FieldType(element.name, element.string_bound, form, size)


def with_limit(single: FieldType, limit: Limit | None) -> FieldType:
    """Add the limit, if any, to a type that is not a sequence. Only strings may have a limit."""
    if limit is None:
        return single
    if limit.form is ArrayForm.FIXED or not single.is_string:
        word = "array" if limit.form is ArrayForm.FIXED else "bounded"
        problem = f"{word}[…] is for a list, as in {word}[list[{single}], {limit.size}]"
        raise InvalidInterface(problem, source="")
    return FieldType(single.name, limit.size)


def message_class(annotation: object) -> tuple[type, str]:
    """Check that an annotation is a message class, and return the class and its type name.

    Raise an error if the annotation is not a message class with a type name.
    """
    if not is_message_class(annotation):
        raise InvalidInterface(f"{said(annotation)} is not a ROS type{hint(annotation)}", source="")
    message = cast("type", annotation)
    type_name: str = message.type_name  # type: ignore[attr-defined]  # a message class has one
    if not type_name:
        name = message.__name__
        problem = (
            f"{name} has no type name: add one, as in "
            f'class {name}(Message, type_name="package_name/msg/{name}")'
        )
        raise InvalidInterface(problem, source="")
    return message, type_name


def is_message_class(annotation: object) -> bool:
    """Whether this is a message class: a Struct with a type name, which may be empty."""
    is_struct = isinstance(annotation, type) and issubclass(annotation, msgspec.Struct)
    return is_struct and isinstance(getattr(annotation, "type_name", None), str)


def said(annotation: object) -> str:
    """Return an annotation as text, almost as its author wrote it."""
    return annotation.__name__ if isinstance(annotation, type) else str(annotation)


def hint(annotation: object) -> str:
    """Suggest what to write instead of an annotation that is not a ROS type."""
    if annotation is int:
        return ": say which, from int8 to uint64"
    if annotation is list:
        return ": say of what, as in list[int32]"
    return did_you_mean(said(annotation), ["bool_", *PRIMITIVES])
