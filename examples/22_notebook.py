# In a checkout: pip install .
"""A notebook has no block to stay in: one cell opens a world, others use it, and one closes it.

The cells (``# %%``) also run as plain Python. In plain Python, ``run`` runs the event loop until a
cell is done, and time stands still between the cells. In a notebook, the event loop is already
running. Leave out the two cells that say so, write ``await …`` instead of ``run(…)``, and open the
world with ``speed=1``, because time continues between the cells and ``"max"`` would race through
hours.

Prints:

    EXECUTING
    1.7 m to go
    SUCCEEDED, 3.7 m
    CANCELED, 0.7 m
"""

# %% Imports
import asyncio
from contextlib import AsyncExitStack

from turtleact import open_world
from turtleact.actions.patrol import Patrol
from turtleact.interfaces.standard import Point

# %% Not in a notebook: an event loop that lasts
runner = asyncio.Runner()
run = runner.run

# %% Open a world
stack = AsyncExitStack()
node = run(stack.enter_async_context(open_world(speed="max")))
patrol = node.action_client(Patrol, "patrol")

# %% Send a goal
there = Patrol.Goal(targets=[Point(x=9.0, y=7.0)])
goal = run(stack.enter_async_context(patrol.send_goal(there)))
print(goal.status.name)

# %% Read its feedback
feedback = run(anext(goal))
print(f"{feedback.distance_remaining:.1f} m to go")

# %% Wait for its result
result = run(goal.result())
print(f"{goal.status.name}, {result.distance:.1f} m")

# %% Send another one, and think better of it
back = Patrol.Goal(targets=[Point(x=1.0, y=7.0)])
goal = run(stack.enter_async_context(patrol.send_goal(back)))
run(node.clock.sleep(1))
run(goal.cancel())
outcome = run(goal.outcome())
print(f"{outcome.status.name}, {outcome.result.distance:.1f} m")

# %% Close the world
run(stack.aclose())

# %% Not in a notebook
runner.close()
