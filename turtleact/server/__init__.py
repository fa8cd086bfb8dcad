"""The server side of actions: accepts goals, runs them, cancels them, and reports on them.

::

    endpoints                answers clients in other processes
    action_topics            publishes feedback, status and reasons while somebody reads them
    pause_endpoints          pauses goals for clients in other processes
    local_server             decides which goals are accepted and which are canceled
    goal_handle | callbacks  the handle given to bodies; the user's callbacks
    execution                runs a body and ends its goal when the body ends
    body_task | pausing      the task of a body; pausing and resuming goals
    durable                  keeps goals on disk, to continue them after a restart
"""
