"""The server's side of an action: goals are taken, carried out, canceled and told of.

::

    endpoints                  answers those who are not in this process
    status                     tells them how all goals stand
    action_server              takes goals, and lets go of them when it is closed
    reception                  checks goals, holds them, and gives them a place
    canceling | hooks | claim  which goals are canceled; who is told of changes; claims to a place
    execution                  a body is run, and its end made the goal's end
    goal_handle | callbacks    what a body holds; what the user is asked
    stepping                   coroutines step by step
"""

from turtleact.server.action_server import ActionServer
from turtleact.server.goal_handle import ServerGoalHandle

__all__ = ["ActionServer", "ServerGoalHandle"]
