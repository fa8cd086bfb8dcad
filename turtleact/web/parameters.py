"""Parameters, as rosapi has them: those of nodes, and the clients' own.

A name with a colon, ``/turtlesim:background_b``, is a node's parameter, and its services are asked.
Any other is the clients' own: the bridge keeps it as long as it runs. Values are JSON text.

Source: rosapi ``params.py``; package ``rcl_interfaces`` of ROS 2 Jazzy.
"""

from __future__ import annotations

import logging
from typing import Any, Final, Protocol, TypeAlias, TypeVar, cast

import msgspec

from turtleact.errors import InvalidMessage, TurtleactError
from turtleact.interfaces import Message, fields, from_dict
from turtleact.interfaces.standard import (
    GetParameters,
    ListParameters,
    Parameter,
    ParameterType,
    ParameterValue,
    SetParameters,
    SetParametersResult,
)
from turtleact.node import Node
from turtleact.services import ServiceType
from turtleact.web.spelling import absolute

__all__ = ["Parameters"]

logger = logging.getLogger("turtleact.web")

Values: TypeAlias = dict[str, Any]
Req = TypeVar("Req", bound=Message)
Res = TypeVar("Res", bound=Message)

LIST: Final = "/list_parameters"
MOST_PARAMETERS: Final = 1000
LONGEST_PARAMETER: Final = 2**16

FIELDS: Final = {number: field.name for number, field in enumerate(fields(ParameterValue))}
"""Which field holds a value, by the numbers of ``ParameterType``."""

KINDS: Final[dict[int, tuple[bool, type]]] = {
    ParameterType.PARAMETER_BOOL: (False, bool),
    ParameterType.PARAMETER_INTEGER: (False, int),
    ParameterType.PARAMETER_DOUBLE: (False, float),
    ParameterType.PARAMETER_STRING: (False, str),
    ParameterType.PARAMETER_BOOL_ARRAY: (True, bool),
    ParameterType.PARAMETER_INTEGER_ARRAY: (True, int),
    ParameterType.PARAMETER_BYTE_ARRAY: (True, int),
    ParameterType.PARAMETER_DOUBLE_ARRAY: (True, float),
    ParameterType.PARAMETER_STRING_ARRAY: (True, str),
}
"""Whether a kind of value is a list, and of what; the likelier ones first."""

PROBLEM: Final = "expected true, false, a number, text, or a list of one of these"


class Ask(Protocol):
    """Calls a service."""

    async def __call__(self, name: str, service_type: ServiceType[Req, Res], request: Req) -> Res:
        """Call the service of a name and type."""


class Parameters:
    """Gets and sets parameters.

    Args:
        node: Its graph has the nodes.
        ask: Calls its services.
    """

    def __init__(self, node: Node, ask: Ask) -> None:
        self._node = node
        self._ask = ask
        self._own: dict[str, str] = {}

    async def get(self, name: str, default: str) -> Values:
        """``get_param``."""
        value = await self._value(name)
        if value is None:
            return {"value": default or "null", "successful": bool(default)}
        return {"value": value, "successful": True}

    async def set(self, name: str, value: str) -> Values:
        """``set_param``."""
        if ":" in name:
            return await self._set_of_node(name, value)
        if name not in self._own and len(self._own) >= MOST_PARAMETERS:
            return {"successful": False, "reason": f"{MOST_PARAMETERS} parameters are set: delete"}
        if len(name) + len(value) > LONGEST_PARAMETER:
            reason = f"name and value are at most {LONGEST_PARAMETER} characters"
            return {"successful": False, "reason": reason}
        self._own[name] = value
        return {"successful": True, "reason": ""}

    async def has(self, name: str) -> Values:
        """``has_param``."""
        return {"exists": await self._value(name) is not None}

    async def delete(self, name: str) -> Values:
        """``delete_param``."""
        if await self._value(name) is None:
            return {"successful": False, "reason": "there is no such parameter"}
        if ":" in name:
            return await self._set_of_node(name, "null")
        del self._own[name]
        return {"successful": True, "reason": ""}

    async def names(self) -> Values:
        """``get_param_names``; a node that does not answer is left out."""
        found = sorted(self._own)
        for service, types in self._node.graph().services.items():
            if not service.endswith(LIST) or ListParameters.type_name not in types:
                continue
            try:
                listed = await self._ask(service, ListParameters, ListParameters.Request())
            except TurtleactError as error:
                logger.warning("parameters are left out: %s", error)
            else:
                node = service.removesuffix(LIST)
                found += [f"{node}:{name}" for name in listed.result.names]
        return {"names": found}

    async def _value(self, name: str) -> str | None:
        """The value of a parameter, as JSON; None if it is not set."""
        if ":" not in name:
            return self._own.get(name)
        held = await self._held(name)
        if held.type not in FIELDS or held.type == ParameterType.PARAMETER_NOT_SET:
            return None
        value = getattr(held, FIELDS[held.type])
        return msgspec.json.encode(list(value) if isinstance(value, bytes) else value).decode()

    async def _held(self, name: str) -> ParameterValue:
        """What a node says of its parameter; of no kind if it has none of that name.

        Raises:
            TurtleactError: if there is no answer.
        """
        node, _, parameter = name.partition(":")
        service = absolute(f"{node}/get_parameters")
        answer = await self._ask(service, GetParameters, GetParameters.Request([parameter]))
        return next(iter(answer.values), ParameterValue())

    async def _set_of_node(self, name: str, text: str) -> Values:
        try:
            value = msgspec.json.decode(text)
        except msgspec.DecodeError as error:
            raise InvalidMessage("args.value", f"expected a value as JSON text: {error}") from None
        wanted = _as_parameter(value, (await self._held(name)).type)
        node, _, parameter = name.partition(":")
        request = SetParameters.Request([Parameter(parameter, wanted)])
        answer = await self._ask(absolute(f"{node}/set_parameters"), SetParameters, request)
        result = next(iter(answer.results), SetParametersResult(reason="the node says nothing"))
        return {"successful": result.successful, "reason": result.reason}


def _as_parameter(value: object, declared: int) -> ParameterValue:
    """A value as a node takes it; of the kind that it has declared, where JSON leaves that open.

    Raises:
        InvalidMessage: if no parameter can be that.
    """
    if value is None:
        return ParameterValue()
    is_list = isinstance(value, list)
    kinds = {type(each) for each in cast("list[object]", value if is_list else [value])}
    if kinds == {int, float}:
        kinds = {float}
    fitting = [
        number
        for number, (is_array, element) in KINDS.items()
        if is_array == is_list and (kinds <= {element} or (kinds == {int} and element is float))
    ]
    if not fitting:
        raise InvalidMessage("args.value", PROBLEM)
    kind = declared if declared in fitting else fitting[0]
    return from_dict(ParameterValue, {"type": kind, FIELDS[kind]: value}, root="args")
