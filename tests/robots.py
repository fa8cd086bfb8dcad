"""Robots whose interfaces this process does not know, and robots that lie about them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import anyio
import msgspec

from turtleact.interfaces import (
    Action,
    WireFormat,
    get_interface,
    implied,
    load_interfaces,
    type_hash,
)
from turtleact.interfaces.learned import describe
from turtleact.interfaces.standard.type_description_interfaces.srv import GetTypeDescription
from turtleact.transports import Transport
from turtleact.transports.base import Endpoint, Reply, ServiceHandler

from .registry import isolated_registry

FILES = {
    "action/Dig.action": """# Digs a hole.
uint8 SLOW=1
uint8 FAST=2

# How deep to dig (m)
float64 depth
uint8 speed
geometry_msgs/Point where
Tool[] tools
---
int32 dug
---
int32 so_far  # how much was dug
""",
    "msg/Tool.msg": "string name\nfloat32[3] size\n",
    "msg/Battery.msg": "# What is left (%)\nfloat32 charge\n",
    "srv/Grip.srv": "# How hard (N)\nfloat32 force\n---\nbool held\n",
}


class Robot(ServiceHandler):
    """A node that describes its types, or does what ``answer`` does.

    Attributes:
        asked: The hash in each request, in order.
        notes: What its client told the user.
        answer: Takes a request and the true answer, and returns what is sent; None never answers.
    """

    def __init__(self, transport: Transport, folder: Path, node: str = "/robot") -> None:
        self.asked: list[str] = []
        self.notes: list[str] = []
        self.answer: Callable[[Any, Any], Any] = lambda request, truth: truth
        self.transport = transport
        self.node = node
        self._answers: dict[str, Any] = {}
        self._hashes: dict[str, str] = {}
        self._kinds: dict[str, type] = {}
        with isolated_registry():
            for name in load_interfaces(folder):
                self._describe(get_interface(name))
        name = f"{node}/get_type_description"
        end = Endpoint("service", name, GetTypeDescription.type_name, node)
        self.service = transport.serve(end, WireFormat(GetTypeDescription), self)

    def _describe(self, found: Any) -> None:
        types = [found]
        if issubclass(found, Action):
            parts = implied(found)
            types += [parts.send_goal, parts.get_result, parts.feedback_message]
        for each in types:
            self._hashes[each.type_name] = type_hash(each)
            self._answers[type_hash(each)] = describe(each, has_sources=True)

    def truth_about(self, type_name: str) -> Any:
        """The answer that describes a type."""
        return self._answers[self._hashes[type_name]]

    def hash_of(self, type_name: str) -> str:
        return self._hashes[type_name]

    def open(self, kind: Any, name: str, type_name: str, type_hash: str | None = None) -> Any:
        """Show an endpoint on the graph."""
        found = self._hashes[type_name] if type_hash is None else type_hash
        end = Endpoint(kind, name, type_name, self.node, type_hash=found)
        if kind == "service":
            return self.transport.serve(end, WireFormat(GetTypeDescription), ServiceHandler())
        return self.transport.advertise(end, WireFormat(GetTypeDescription))

    def serve_action(self, name: str, type_name: str) -> None:
        """Show the endpoints of an action on the graph."""
        self.open("service", f"{name}/_action/send_goal", f"{type_name}_SendGoal")
        self.open("service", f"{name}/_action/get_result", f"{type_name}_GetResult")
        self.open("publisher", f"{name}/_action/feedback", f"{type_name}_FeedbackMessage")

    async def reply(self, request: Any, caller: bytes) -> Reply:
        self.asked.append(request.type_hash)
        truth = self._answers.get(request.type_hash)
        if truth is None:
            reason = "Type not currently in use by this node"
            truth = GetTypeDescription.Response(failure_reason=reason)
        elif not request.include_type_sources:
            truth = msgspec.structs.replace(truth, type_sources=[])
        said = self.answer(request, truth)
        if said is None:
            await anyio.sleep_forever()
        return Reply(said)


def write_package(folder: Path, files: dict[str, str] | None = None) -> Path:
    """Write a package ``robot_msgs`` with interface files, and return its folder."""
    package = folder / "robot_msgs"
    for name, text in (FILES if files is None else files).items():
        path = package / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, "utf-8")
    return package
