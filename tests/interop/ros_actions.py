"""Plays every scenario against an action server of rclpy; run by the Python that has rclpy.

Prints the transcripts as one JSON object. All of it is one process: an executor in a thread, and
the scenarios, one after another, in the main one.
"""

from __future__ import annotations

import asyncio
import json
import os
import queue
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import rclpy
from action_msgs.msg import GoalInfo, GoalStatusArray
from action_msgs.srv import CancelGoal
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.qos import qos_profile_action_status_default
from scenarios import (
    REJECTED,
    RESULT_TIMEOUT,
    SCENARIOS,
    STUBBORN,
    cancel_line,
    goal_id,
    label_of,
    result_line,
    shows,
    status_line,
)
from test_msgs.action import Fibonacci

PATIENCE = 3.0
"""How long anything may take (s)."""

NO_PEER = 77
"""The exit status that says that rclpy does not find its own endpoints."""


class RclpyPeer:
    """An action server and a client of its endpoints; the latter are rclpy's, too."""

    def __init__(self, node: Any, name: str) -> None:
        self.transcript: list[str] = []
        self._orders: dict[str, queue.Queue[tuple[str, list[int]]]] = {}
        self._stamps: dict[str, Any] = {}
        self._asked: list[tuple[str, Any]] = []
        self._statuses: queue.Queue[Any] = queue.Queue()
        self._newest: list[tuple[str, int]] = []
        self._heard: queue.Queue[Any] = queue.Queue()
        self._server = ActionServer(
            node,
            Fibonacci,
            name,
            self._execute,
            callback_group=ReentrantCallbackGroup(),
            goal_callback=lambda goal: (
                GoalResponse.REJECT if goal.order == REJECTED else GoalResponse.ACCEPT
            ),
            cancel_callback=lambda handle: (
                CancelResponse.REJECT if handle.request.order == STUBBORN else CancelResponse.ACCEPT
            ),
            result_timeout=RESULT_TIMEOUT,
        )
        impl, base = Fibonacci.Impl, f"{name}/_action"
        self._send = node.create_client(impl.SendGoalService, f"{base}/send_goal")
        self._get = node.create_client(impl.GetResultService, f"{base}/get_result")
        self._cancel = node.create_client(CancelGoal, f"{base}/cancel_goal")
        node.create_subscription(
            GoalStatusArray,
            f"{base}/status",
            self._statuses.put,
            qos_profile_action_status_default,
        )
        node.create_subscription(impl.FeedbackMessage, f"{base}/feedback", self._heard.put, 10)
        for client in (self._send, self._get, self._cancel):
            if not client.wait_for_service(PATIENCE):
                raise TimeoutError(f"{client.srv_name}: rclpy does not find its own service")
        matched(lambda: node.count_subscribers(f"{base}/feedback") == 1)

    def _execute(self, handle: Any) -> Any:
        result = Fibonacci.Result()
        orders = self._orders[label_of(handle.goal_id.uuid)]
        while True:
            word, numbers = orders.get(timeout=PATIENCE)
            if word == "feedback":
                feedback = Fibonacci.Feedback()
                feedback.sequence = numbers
                handle.publish_feedback(feedback)
                continue
            result.sequence = numbers
            if word == "raise":
                raise RuntimeError("as it was told")
            if word == "none":
                return None
            if word != "nothing":
                getattr(handle, word)()
            return result

    async def send(self, label: str, order: int = 3) -> None:
        request = Fibonacci.Impl.SendGoalService.Request()
        request.goal_id.uuid = list(goal_id(label))
        request.goal.order = order
        self._orders.setdefault(label, queue.Queue())
        answer = called(self._send, request)
        self.transcript.append(f"send {label}: {'accepted' if answer.accepted else 'rejected'}")
        if answer.accepted:
            self._stamps[label] = answer.stamp

    async def tell(self, label: str, word: str, *numbers: int) -> None:
        self._orders[label].put((word, list(numbers)))

    async def cancel(self, label: str | None = None, before: str | None = None) -> None:
        info = GoalInfo()
        if label is not None:
            info.goal_id.uuid = list(goal_id(label))
        if before is not None:
            stamp = self._stamps[before]
            nanoseconds = stamp.sec * 10**9 + stamp.nanosec - 1
            info.stamp.sec, info.stamp.nanosec = divmod(nanoseconds, 10**9)
        answer = called(self._cancel, CancelGoal.Request(goal_info=info))
        goals = [label_of(each.goal_id.uuid) for each in answer.goals_canceling]
        self.transcript.append(cancel_line(label, before, answer.return_code, goals))

    async def status(self, **goals: str) -> None:
        while not shows(self._newest, goals):
            array = self._statuses.get(timeout=PATIENCE)
            self._newest = [
                (label_of(each.goal_info.goal_id.uuid), each.status) for each in array.status_list
            ]
        self.transcript.append(status_line(self._newest))

    async def result(self, label: str) -> None:
        await self.ask(label)
        await self.answers()

    async def ask(self, label: str) -> None:
        request = Fibonacci.Impl.GetResultService.Request()
        request.goal_id.uuid = list(goal_id(label))
        self._asked.append((label, self._get.call_async(request)))

    async def answers(self) -> None:
        for label, future in self._asked:
            try:
                answer = awaited(future)
            except TimeoutError:
                self.transcript.append(f"result of {label}: no answer")
                continue
            line = result_line(label, answer.status, list(answer.result.sequence))
            self.transcript.append(line)
        self._asked.clear()

    async def feedback(self, count: int) -> None:
        for _ in range(count):
            heard = self._heard.get(timeout=PATIENCE)
            label = label_of(heard.goal_id.uuid)
            self.transcript.append(f"feedback of {label}: {list(heard.feedback.sequence)}")

    async def pause(self, seconds: float) -> None:
        time.sleep(seconds)


def called(client: Any, request: Any) -> Any:
    return awaited(client.call_async(request))


def awaited(future: Any) -> Any:
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    if not done.wait(PATIENCE):
        raise TimeoutError("no answer")
    return future.result()


def matched(found: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE
    while not found():
        if time.monotonic() > end:
            raise TimeoutError("rclpy does not find its own topics")
        time.sleep(0.01)


def spin(executor: Any) -> None:
    """Let an executor go on whatever comes out of a server."""
    while True:
        try:
            executor.spin()
        except Exception as error:
            print(f"out of spin: {type(error).__name__}: {error}", file=sys.stderr, flush=True)


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("interop")
    executor = MultiThreadedExecutor(8)
    executor.add_node(node)
    threading.Thread(target=spin, args=[executor], daemon=True).start()
    transcripts: dict[str, list[str]] = {}
    for name, scenario in SCENARIOS.items():
        try:
            peer = RclpyPeer(node, name)
        except TimeoutError as error:
            sys.exit(f"{error}" if transcripts else NO_PEER)
        try:
            asyncio.run(scenario(peer))
        except (TimeoutError, queue.Empty) as error:
            peer.transcript.append(f"{type(error).__name__}: {error}".rstrip(": "))
        transcripts[name] = peer.transcript
    print(json.dumps(transcripts), flush=True)
    os._exit(0)  # a regular end waits for the executor's threads, and crashes now and then


if __name__ == "__main__":
    main()
