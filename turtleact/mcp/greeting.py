"""Answers ``initialize`` before the SDK is imported.

Importing the SDK takes longer than everything else at the start of ``turtleact mcp``. Meanwhile, a
client waits for an answer that is always the same: which version of the protocol the server speaks,
and what the server can do. So this module gives that answer itself. `turtleact.mcp.stdio` then
hands the same request to the SDK and drops the SDK's answer. A test compares the two answers for
every version of the protocol.

An unusual request, and everything after the first line, is left to the SDK.

Source: MCP 2025-11-25, "Lifecycle", for `initialize`. Later versions have no such request.
"""

from __future__ import annotations

from typing import Final, Literal

import msgspec

__all__ = ["INSTRUCTIONS", "NAME", "Greeting", "greet"]

NAME: Final = "turtleact"
INSTRUCTIONS: Final = (
    "Each tool that bears the name of a ROS 2 action sends one goal to a robot, and answers when "
    "the goal has ended. Cancel the call to stop the robot. Lengths are in metres, angles in "
    "radians, times in seconds, unless a description says otherwise."
)
VERSIONS: Final = ("2024-11-05", "2025-03-26", "2025-06-18", "2025-11-25")
"""The versions that begin with ``initialize``. A client that asks for another gets the last one."""


class Greeting(msgspec.Struct, frozen=True):
    """An answer that was given before the SDK was there.

    Attributes:
        request_id: The id of the request.
        line: The answer, as one line of JSON.
    """

    request_id: int | str
    line: bytes


class _Program(msgspec.Struct):
    name: str
    version: str


class _Params(msgspec.Struct, rename="camel"):
    protocol_version: str
    capabilities: dict[str, dict[str, object]]
    client_info: _Program


class _Initialize(msgspec.Struct):
    jsonrpc: Literal["2.0"]
    id: int | str
    method: Literal["initialize"]
    params: _Params


def greet(line: str, version: str) -> Greeting | None:
    """Answer the first line that a client has sent. Return None if the SDK must answer it.

    Args:
        line: The line.
        version: The version of turtleact.
    """
    try:
        request = msgspec.json.decode(line, type=_Initialize)
    except msgspec.MsgspecError:
        return None
    wanted = request.params.protocol_version
    result = {
        "protocolVersion": wanted if wanted in VERSIONS else VERSIONS[-1],
        "capabilities": {
            "resources": {"subscribe": False, "listChanged": False},
            "tools": {"listChanged": True},
        },
        "serverInfo": {"name": NAME, "version": version},
        "instructions": INSTRUCTIONS,
    }
    answer = {"jsonrpc": "2.0", "id": request.id, "result": result}
    return Greeting(request.id, msgspec.json.encode(answer) + b"\n")
