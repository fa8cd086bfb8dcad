# In a checkout: pip install .
"""A service: one response for each request. Requests are handled side by side.

Prints:

    2 + 3 = 5
    [11, 21, 31]
    service '/divide': the handler failed: ZeroDivisionError: division by zero
    service '/add_two_ints': no response within 0.01 s
"""

import asyncio
import logging

import turtleact
from turtleact import Message, Service, ServiceError, ServiceTimeout
from turtleact.interfaces import float64, int64


class AddTwoInts(Service, type_name="example_interfaces/srv/AddTwoInts"):
    class Request(Message):
        a: int64 = 0
        b: int64 = 0

    class Response(Message):
        sum: int64 = 0


class Divide(Service, type_name="lab_interfaces/srv/Divide"):
    class Request(Message):
        dividend: int64 = 0
        divisor: int64 = 1

    class Response(Message):
        quotient: float64 = 0.0


async def add(request: AddTwoInts.Request) -> AddTwoInts.Response:
    await asyncio.sleep(0.1)  # does not hold up other requests
    return AddTwoInts.Response(sum=request.a + request.b)


def divide(request: Divide.Request) -> Divide.Response:  # a handler that never waits may be plain
    return Divide.Response(quotient=request.dividend / request.divisor)


async def main() -> None:
    logging.disable()  # the server would log the traceback of a failing handler
    async with turtleact.open_node("lab") as node:
        node.service(AddTwoInts, "add_two_ints", add)
        node.service(Divide, "divide", divide)

        adder = node.service_client(AddTwoInts, "add_two_ints")
        response = await adder.call(AddTwoInts.Request(a=2, b=3))
        print("2 + 3 =", response.sum)

        calls = [adder.call(AddTwoInts.Request(a=a, b=1)) for a in (10, 20, 30)]
        print([response.sum for response in await asyncio.gather(*calls)])

        divider = node.service_client(Divide, "divide")
        try:
            await divider.call(Divide.Request(dividend=6, divisor=0))
        except ServiceError as error:
            print(error)

        try:  # when the caller stops waiting, its handler is cancelled
            await adder.call(AddTwoInts.Request(a=2, b=3), timeout=0.01)
        except ServiceTimeout as error:
            print(error)


asyncio.run(main())
