"""What does a message cost as CDR, compared with msgpack and another CDR codec in Python?

msgspec's msgpack is compiled C and checks less, so it is the minimum cost of a message in bytes.
rosbags also reads and writes CDR in Python, with numpy arrays for sequences of numbers. It is
measured if it is installed.

Rounds are interleaved. A ratio is the median of the rounds' ratios, and a time is the median.
"""

from __future__ import annotations

import gc
import importlib
import importlib.util
import os
import platform
import statistics
import timeit
from collections.abc import Callable
from functools import partial
from typing import Any, TypeAlias

import msgspec

from turtleact import Message
from turtleact.interfaces import decode, encode, get_interface

ROUNDS = 21
SECONDS = 0.01

Contender: TypeAlias = Callable[[], object]


def samples() -> dict[str, Message]:
    made: dict[str, Any] = {
        name: get_interface(name)
        for name in (
            "geometry_msgs/msg/Twist",
            "geometry_msgs/msg/PoseStamped",
            "geometry_msgs/msg/Point",
            "action_msgs/msg/GoalStatus",
            "action_msgs/msg/GoalStatusArray",
            "std_msgs/msg/Int32MultiArray",
        )
    }
    twist, stamped, _, status, statuses, numbers = made.values()
    return {
        "Twist": twist(),
        "PoseStamped": stamped(),
        "20 statuses": statuses(status_list=[status() for _ in range(20)]),
        "1,000 ints": numbers(data=list(range(1000))),
    }


def contenders(message: Message) -> tuple[dict[str, Contender], dict[str, Contender]]:
    """The functions that write and read the message. The others are compared with the first."""
    cls, data = type(message), encode(message)
    packed = msgspec.msgpack.encode(message)
    writers: dict[str, Contender] = {
        "turtleact": partial(encode, message),
        "turtleact, numpy": partial(encode, decode(cls, data, arrays="numpy")),
        "msgpack": partial(msgspec.msgpack.Encoder().encode, message),
    }
    readers: dict[str, Contender] = {
        "turtleact": partial(decode, cls, data),
        "turtleact, numpy": partial(decode, cls, data, arrays="numpy"),
        "msgpack": partial(msgspec.msgpack.Decoder(cls).decode, packed),
    }
    if importlib.util.find_spec("rosbags") is not None:
        typesys = importlib.import_module("rosbags.typesys")
        store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
        theirs = store.deserialize_cdr(data, cls.type_name)
        assert bytes(store.serialize_cdr(theirs, cls.type_name)) == data
        writers["rosbags"] = partial(store.serialize_cdr, theirs, cls.type_name)
        readers["rosbags"] = partial(store.deserialize_cdr, data, cls.type_name)
    return writers, readers


def seconds_each(contender: Contender, times: int) -> float:
    return timeit.Timer(contender).timeit(times) / times


def print_rows(title: str, row: dict[str, Contender]) -> None:
    gc.collect()
    times = [max(1, round(SECONDS / seconds_each(contender, 100))) for contender in row.values()]
    rounds = [list(map(seconds_each, row.values(), times)) for _ in range(ROUNDS)]
    for number, name in enumerate(row):
        median = statistics.median(taken[number] for taken in rounds)
        ratio = statistics.median(taken[number] / taken[0] for taken in rounds)
        print(f"{title:<20} {name:<18} {median * 1e6:>8.2f} {ratio:>12.2f}x", flush=True)


def main() -> None:
    print(f"{os.cpu_count()} cores, Python {platform.python_version()}")
    print(f"{'':<39} {'us':>8} {'to the first':>13}")
    for name, message in samples().items():
        writers, readers = contenders(message)
        print_rows(f"write {name}", writers)
        print_rows(f"read {name}", readers)


if __name__ == "__main__":
    main()
