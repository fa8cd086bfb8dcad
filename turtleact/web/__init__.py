"""The web server: gives browsers and rosbridge clients access to a node, and serves its page.

`add_error_handlers` is for web apps of your own.

The web server serves an ordinary `turtleact.Node` and knows nothing below that. The rest of
turtleact imports this package only when it is used.
"""

from __future__ import annotations

from turtleact.web.bridge import Bridge, Statistics, open_bridge
from turtleact.web.error_handlers import add_error_handlers
from turtleact.web.server import PORT, Web, open_web
from turtleact.web.shared import Limits

__all__ = [
    "PORT",
    "Bridge",
    "Limits",
    "Statistics",
    "Web",
    "add_error_handlers",
    "open_bridge",
    "open_web",
]
