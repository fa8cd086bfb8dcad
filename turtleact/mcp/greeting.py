"""Answers a client's ``initialize`` request before the SDK is imported.

Importing the SDK takes most of the startup time of ``turtleact mcp``. Meanwhile, the client
waits for the answer to ``initialize``, which states the version of the protocol and what the server
can do. The answer does not depend on the node, so this module can give it. `turtleact.mcp.stdio`
then passes the same request to the SDK and drops the SDK's answer. A test compares this module's
answer with the SDK's answer for every version of the protocol.

If this module cannot parse the client's first line, the SDK answers that line. The SDK always
answers all later lines.

Source: MCP 2025-11-25, "Lifecycle", for ``initialize``. Later versions of MCP do not have this
request.
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
"""The versions of MCP in which a session begins with an ``initialize`` request.

A client that asks for any other version is offered the newest of these versions.
"""


class Greeting(msgspec.Struct, frozen=True):
    """An answer to an ``initialize`` request, made before the SDK is imported.

    Attributes:
        request_id: The id of the client's request.
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
    """Return the answer to the first line from a client, or None if the SDK must answer it.

    Args:
        line: The line that the client has sent.
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
