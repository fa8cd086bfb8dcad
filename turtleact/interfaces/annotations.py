"""Python annotations for ROS types, and functions that read an annotation.

``int32`` is ``Annotated[int, …]``: a type checker reads it as ``int``, and a message class takes
the ROS type from it. A type checker reads ``bounded[list[int32], 5]`` and
``array[list[float64], 9]`` as lists. The only attribute of a message class that this module reads
is the type name.
"""

from __future__ import annotations

from collections import ChainMap
from operator import getitem
from types import GenericAlias
from typing import (
    TYPE_CHECKING,
    Annotated,
    ForwardRef,
    NamedTuple,
    TypeAlias,
    cast,
    get_args,
    get_origin,
)

import msgspec

from turtleact.errors import InvalidInterface
from turtleact.interfaces.definition import ArrayForm, FieldType, did_you_mean, is_bytes

if TYPE_CHECKING:
    from collections.abc import Mapping
    from types import FrameType
    from typing import Annotated as array
    from typing import Annotated as bounded

__all__ = [
    "SCALARS",
    "Reading",
    "Scope",
    "annotation_of",
    "array",
    "bool_",
    "bounded",
    "byte",
    "char",
    "float32",
    "float64",
    "int8",
    "int16",
    "int32",
    "int64",
    "is_message_class",
    "read",
    "resolve",
    "scope_of",
    "string",
    "uint8",
    "uint16",
    "uint32",
    "uint64",
    "wstring",
]


class Scalar(msgspec.Struct, frozen=True):
    """Marks an annotation with the name of a primitive ROS type."""

    name: str


class Limit(msgspec.Struct, frozen=True):
    """Marks an annotation with a maximum length or a fixed length."""

    form: ArrayForm
    size: int


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

#: The annotation of each primitive type.
SCALARS: Mapping[str, object] = {
    get_args(each)[1].name: each
    for each in (
        *(bool_, byte, char, int8, uint8, int16, uint16, int32, uint32, int64, uint64),
        *(float32, float64, string, wstring),
    )
}

#: Python's own types with only one ROS type; ``int`` has several.
PLAIN = {bool: "bool", float: "float64", str: "string"}

if not TYPE_CHECKING:  # pragma: no branch  always true at run time

    class bounded:
        """Declares a maximum length: ``bounded[list[int32], 5]``, ``bounded[string, 10]``."""

        def __class_getitem__(cls, item: object) -> object:
            return limited(item, ArrayForm.BOUNDED)

    class array:
        """Declares an exact length: ``array[list[float64], 9]``, ``array[bytes, 16]`` for uint8."""

        def __class_getitem__(cls, item: object) -> object:
            return limited(item, ArrayForm.FIXED)


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
    annotation = SCALARS[field_type.name] if nested is None else nested
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


def marked(annotation: object, mark: Limit) -> object:
    """Add a limit to an annotation."""
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
    return did_you_mean(said(annotation), SCALARS)
