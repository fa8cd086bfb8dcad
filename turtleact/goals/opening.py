"""Opens an action server: puts the plain server and the options that the user has chosen together.

The order matters. Each module replaces steps of the server and calls what it replaced, so the later
a module comes, the further outside it is.
"""

from __future__ import annotations

from collections.abc import Callable

from turtleact.goals.body import ServerOptions, check_options
from turtleact.goals.callbacks import Callbacks, cancel_goals_of_lost_clients
from turtleact.goals.durable import DurableGoals
from turtleact.goals.pausing import Pauses
from turtleact.goals.policies import Rules, Slots
from turtleact.goals.running import BodyRunner
from turtleact.goals.server import LocalActionServer, ServerSpec
from turtleact.goals.slots import PlaceRequest, SlotUser
from turtleact.tasks import GRACE, Tasks

__all__ = ["open_server"]


def open_server(
    spec: ServerSpec,
    options: ServerOptions,
    tasks: Tasks,
    now: Callable[[], int],
    slots: Slots[PlaceRequest],
) -> tuple[LocalActionServer, DurableGoals | None]:
    """Make a server that runs its bodies in tasks of the event loop.

    With a journal, the result has the `DurableGoals` that restore the goals of an earlier process.

    Args:
        spec: The action, its name and its body.
        options: The user's options.
        tasks: The functions that start and manage tasks on asyncio or trio.
        now: Returns the current time (ns since the epoch).
        slots: The slots of the node, of which the options may name one.

    Raises:
        InvalidOption: if the value of an option is not allowed.
    """
    check_options(options)
    kept, grace = options.get("result_timeout", 10.0), options.get("grace", GRACE)
    server = LocalActionServer(spec, tasks, now, kept, grace)
    BodyRunner(server)
    server.slot_name = options.get("slot") or ""
    policy = options.get("policy", "parallel")
    rules = Rules(policy, options.get("max_active"), options.get("queue_limit"))
    slot = slots.find(rules, options.get("slot"))
    if slot is not None:
        SlotUser(server, slot)
    if options.get("on_client_lost") == "cancel":
        cancel_goals_of_lost_clients(server)
    consider = None
    if options.get("goal_callback") is not None or options.get("cancel_callback") is not None:
        callbacks = Callbacks(server, options)
        consider = callbacks.consider if options.get("goal_callback") is not None else None
    durable = None
    if options.get("journal") is not None:
        durable = DurableGoals(server, options, consider, starts_at_once=slot is None)
    server.pauses = Pauses(server, options)
    return server, durable
