"""The server's side of an action: goals are taken, carried out, canceled and told of.

::

    endpoints                answers those who are not in this process
    action_topics            feedback and status, for those who read the topics
    local_server             which goals are taken, and which are canceled
    goal_handle | callbacks  what a body holds of its goal; what the user is asked
    execution                a body is run, and its end made the goal's end
    body_task                the task of a body
"""
