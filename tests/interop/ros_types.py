"""A node of rclpy that answers requests from stdin; run by the Python that has rclpy.

Each line is a JSON object with the name of a service and the CDR of a request, in hexadecimal. The
answer is a line with the CDR of the response. So whoever carries the lines sees the node as it is:
its action ``/count``, its service ``/fill`` and its own ``get_type_description``.
"""

from __future__ import annotations

import json
import sys
import threading
from typing import Any

import rclpy
from rclpy.action import ActionServer
from rclpy.executors import MultiThreadedExecutor
from rclpy.serialization import deserialize_message, serialize_message
from test_msgs.action import Fibonacci
from test_msgs.msg import Defaults
from test_msgs.srv import BasicTypes
from type_description_interfaces.srv import GetTypeDescription

PATIENCE = 10.0
"""How long a call may take (s)."""


def execute(handle: Any) -> Fibonacci.Result:
    numbers = [0, 1]
    while len(numbers) < handle.request.order:
        numbers.append(numbers[-1] + numbers[-2])
    handle.succeed()
    return Fibonacci.Result(sequence=numbers)


def fill(request: Any, response: Any) -> Any:
    response.string_value = f"{request.int32_value}"
    return response


def main() -> None:
    """Answer until stdin ends."""
    rclpy.init()
    node, asker = rclpy.create_node("robot"), rclpy.create_node("asker")
    kept = [
        ActionServer(node, Fibonacci, "count", execute),
        node.create_service(BasicTypes, "fill", fill),
        node.create_publisher(Defaults, "defaults", 1),
    ]
    types = {
        "/robot/get_type_description": GetTypeDescription,
        "/count/_action/send_goal": Fibonacci.Impl.SendGoalService,
        "/count/_action/get_result": Fibonacci.Impl.GetResultService,
        "/fill": BasicTypes,
    }
    clients = {name: asker.create_client(each, name) for name, each in types.items()}
    executor = MultiThreadedExecutor()
    for each in (node, asker):
        executor.add_node(each)
    threading.Thread(target=executor.spin, daemon=True).start()
    for client in clients.values():
        if not client.wait_for_service(PATIENCE):
            print("no peer", flush=True)
            return
    print("ready", flush=True)
    for line in sys.stdin:
        asked = json.loads(line)
        name = asked["service"]
        request = deserialize_message(bytes.fromhex(asked["cdr"]), types[name].Request)
        response = clients[name].call(request, PATIENCE)
        print(serialize_message(response).hex(), flush=True)
    del kept


if __name__ == "__main__":
    main()
