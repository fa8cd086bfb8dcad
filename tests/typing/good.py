"""What a type checker must accept; `test_typing.py` runs mypy --strict and pyright on it."""

from __future__ import annotations

from collections.abc import AsyncGenerator, AsyncIterator
from typing import assert_type

import turtleact
from turtleact import ServerGoalHandle
from turtleact.interfaces import type_hash
from turtleact.interfaces.standard import Fibonacci, Point, RotateAbsolute
from turtleact.interfaces.standard.rcl_interfaces.srv import GetParameters


@turtleact.action(Fibonacci, "fibonacci")
async def generator(goal: Fibonacci.Goal) -> AsyncIterator[Fibonacci.Feedback | Fibonacci.Result]:
    yield Fibonacci.Feedback(partial_sequence=[goal.order])
    yield Fibonacci.Result(sequence=[0, 1])


@turtleact.action(Fibonacci, "fibonacci")
async def only_a_result(goal: Fibonacci.Goal) -> AsyncGenerator[Fibonacci.Result, None]:
    yield Fibonacci.Result(sequence=[goal.order])


@turtleact.action(Fibonacci, "fibonacci", policy="queue")
async def coroutine(
    goal: Fibonacci.Goal,
    handle: ServerGoalHandle[Fibonacci.Goal, Fibonacci.Result, Fibonacci.Feedback],
) -> Fibonacci.Result:
    handle.publish_feedback(Fibonacci.Feedback(partial_sequence=[goal.order]))
    return Fibonacci.Result()


@turtleact.action(RotateAbsolute, "rotate")
async def without_a_handle(goal: RotateAbsolute.Goal) -> RotateAbsolute.Result:
    return RotateAbsolute.Result(delta=goal.theta)


async def serve(node: turtleact.Node) -> None:
    node.serve(generator)
    node.serve(only_a_result, name="other")
    node.serve(coroutine)
    node.action_server(Fibonacci, "a", generator.execute)
    node.action_server(Fibonacci, "b", coroutine.execute)
    server = node.action_server(RotateAbsolute, "c", without_a_handle.execute)
    await server.aclose()


async def call(node: turtleact.Node) -> None:
    client = node.action_client(Fibonacci, "fibonacci")
    result = await client.send_goal(Fibonacci.Goal(order=3))
    assert_type(result, Fibonacci.Result)
    async with client.send_goal(Fibonacci.Goal(order=3)) as goal:
        async for feedback in goal:
            assert_type(feedback.partial_sequence, list[int])
    async for message in generator(Fibonacci.Goal(order=3)):
        print(message)
    service = node.service_client(GetParameters, "/turtlesim/get_parameters")
    response = await service.call(GetParameters.Request(names=["background_r"]))
    print(response.values[0].integer_value, Point(x=1.0).x)


async def load(node: turtleact.Node) -> None:
    patrol = turtleact.load_action("patrol_interfaces/action/Patrol.action")
    client = node.action_client(patrol, "patrol")
    result = await client.send_goal(patrol.Goal(targets=[]))
    print(result.message, type_hash(patrol))
    shape = turtleact.load_message("float64 area", type_name="shapes/msg/Shape")
    node.publisher(shape, "shape").publish(shape(area=1.0))
    clear = turtleact.get_service("std_srvs/srv/Empty")
    await node.service_client(clear, "clear").call(clear.Request())
    print(turtleact.get_message("turtlesim/msg/Pose")().x, turtleact.get_action("a/action/B").Goal)


max_speed = turtleact.parameter("max_speed", 1.0, range=(0, 2))


async def configure(node: turtleact.Node) -> None:
    assert_type(node.parameter(max_speed).value, float)
    count = node.parameter("count", 3, range=(0, 9, 3), validate=lambda value: value != 6)
    assert_type(count, turtleact.Parameter[int])
    count.value = 9
    node.parameter("is_open", default=False).on_change(print)
    async for gains in node.parameter("gains", [0.5]).changes():
        assert_type(gains, list[float])
    async for tick in node.every(0.5):
        assert_type(tick, turtleact.Tick)
