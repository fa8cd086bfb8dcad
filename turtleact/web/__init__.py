"""The web server: gives browsers and rosbridge clients access to a node, and serves a web page.

Use `add_error_handlers` in your own Starlette or FastAPI apps.

The web server works on top of an ordinary `turtleact.Node`. Other modules of turtleact import this
package only when they use it.
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
