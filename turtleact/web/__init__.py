"""The web server: a node behind a WebSocket for browsers and rosbridge clients, and its page.

It serves an ordinary `turtleact.Node` and knows nothing below that. The rest of turtleact imports
this package only when it is used.
"""

from __future__ import annotations

from turtleact.web.bridge import Bridge, Statistics, open_bridge
from turtleact.web.server import PORT, Web, open_web
from turtleact.web.shared import Limits

__all__ = ["PORT", "Bridge", "Limits", "Statistics", "Web", "open_bridge", "open_web"]
