"""An action is declared without its type or its name, or with something else in their place."""

from __future__ import annotations

import turtleact
from turtleact.interfaces.standard import Fibonacci


@turtleact.action(Fibonacci)  # error
async def without_a_name(goal: Fibonacci.Goal) -> Fibonacci.Result:
    return Fibonacci.Result(sequence=[goal.order])


@turtleact.action  # error
async def without_arguments(goal: Fibonacci.Goal) -> Fibonacci.Result:
    return Fibonacci.Result(sequence=[goal.order])


@turtleact.action(Fibonacci, 5)  # error
async def with_a_number(goal: Fibonacci.Goal) -> Fibonacci.Result:
    return Fibonacci.Result(sequence=[goal.order])


@turtleact.action("fibonacci", Fibonacci)  # error
async def swapped(goal: Fibonacci.Goal) -> Fibonacci.Result:
    return Fibonacci.Result(sequence=[goal.order])


@turtleact.action(Fibonacci, "fibonacci", polcy="queue")  # error
async def with_an_unknown_option(goal: Fibonacci.Goal) -> Fibonacci.Result:
    return Fibonacci.Result(sequence=[goal.order])
