"""What an unchanged roslibpy does against a bridge: a program, which says on each line what it saw.

It runs in a process of its own, as roslibpy's Twisted wants to be alone. Its one argument is the
port. It waits for nothing but what the bridge sends.
"""

from __future__ import annotations

import json
import queue
import sys
from typing import Any

import roslibpy  # type: ignore[import-untyped]  # it has no types

SECONDS = 20


def tell(name: str, value: object) -> None:
    print(json.dumps([name, value]), flush=True)


def topics(ros: Any) -> None:
    """Publishes what it hears, one up."""
    done = queue.SimpleQueue[object]()
    up = roslibpy.Topic(ros, "/up", "geometry_msgs/Point")
    down = roslibpy.Topic(ros, "/down", "geometry_msgs/msg/Point")

    def answer(message: Any) -> None:
        up.publish(roslibpy.Message({"x": message["x"] + 1}))
        done.put(dict(message))

    up.advertise()
    down.subscribe(answer)
    tell("heard", done.get(timeout=SECONDS))
    down.unsubscribe()


def services(ros: Any) -> None:
    """Calls a service, and serves one."""
    add = roslibpy.Service(ros, "/add", "example_interfaces/AddTwoInts")
    tell("sum", dict(add.call(roslibpy.ServiceRequest({"a": 1, "b": 2}), timeout=SECONDS)))
    try:
        add.call(roslibpy.ServiceRequest({"a": "one"}), timeout=SECONDS)
    except roslibpy.core.ServiceException as error:
        tell("refused", str(error))
    asked = queue.SimpleQueue[object]()

    def multiply(request: Any, response: Any) -> bool:
        asked.put(dict(request))
        response["sum"] = request["a"] * request["b"]
        return bool(request["a"] >= 0)

    served = roslibpy.Service(ros, "/multiply", "example_interfaces/AddTwoInts")
    served.advertise(multiply)
    tell("asked", [asked.get(timeout=SECONDS), asked.get(timeout=SECONDS)])
    served.unadvertise()


def actions(ros: Any) -> None:
    """Sends goals that succeed, are canceled, aborted and rejected."""
    client = roslibpy.ActionClient(ros, "/count", "lab_interfaces/Count")
    for name, upto in (("succeeded", 2), ("canceled", 1000), ("aborted", -2), ("rejected", -1)):
        seen = queue.SimpleQueue[tuple[str, Any]]()
        goal_id = client.send_goal(
            roslibpy.Goal({"upto": upto}),
            lambda result, seen=seen: seen.put(("result", dict(result))),
            lambda feedback, seen=seen: seen.put(("feedback", dict(feedback))),
            lambda error, seen=seen: seen.put(("error", dict(error))),
        )
        heard: list[Any] = []
        while not heard or heard[-1][0] == "feedback":
            heard.append(seen.get(timeout=SECONDS))
            if heard == [("feedback", {"so_far": [0]})] and name == "canceled":
                client.cancel_goal(goal_id)
        client.wait_goal(goal_id, timeout=SECONDS)
        for _, each in heard:
            if "status" in each:
                each["status"] = each["status"].name
        tell(name, heard)


def rosapi(ros: Any) -> None:
    """Asks for what roslibpy has a method for."""
    tell("topics", sorted(ros.get_topics()))
    tell("time", ros.get_time().secs > 0)
    tell("nodes", ros.get_nodes())
    told = queue.SimpleQueue[Any]()
    ros.get_action_servers(told.put)
    tell("actions", told.get(timeout=SECONDS)["action_servers"])
    parameter = roslibpy.Param(ros, "/speed")
    parameter.set([1.5, "fast"], timeout=SECONDS)
    tell("parameter", parameter.get(timeout=SECONDS))


def main() -> None:
    ros = roslibpy.Ros("127.0.0.1", int(sys.argv[1]))
    ros.run(timeout=SECONDS)
    for part in (topics, services, actions, rosapi):
        part(ros)
    ros.terminate()


if __name__ == "__main__":
    main()
