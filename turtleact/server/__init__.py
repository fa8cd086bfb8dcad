"""The server's side of an action: goals are taken, carried out, canceled and told of.

::

    endpoints                         answers those who are not in this process
    status | lazy_service | feedback  how all goals stand; one of the services; their feedback
    action_server                     takes goals, and lets go of them when it is closed
    reception                         asks about goals, checks and holds them, gives them a place
    canceling | hooks | claim         which are canceled; who is told of changes; claims to a place
    execution                         a body is run, and its end made the goal's end
    goal_handle | callbacks           what a body holds; what the user is asked
    stepping                          coroutines step by step
"""

from turtleact.server.action_server import ActionServer
from turtleact.server.goal_handle import ServerGoalHandle

__all__ = ["ActionServer", "ServerGoalHandle"]
