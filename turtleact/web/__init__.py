"""The browser's and rosbridge's door: a node behind a WebSocket, and a page to see it on.

What is served is an ordinary `turtleact.Node`; nothing here knows what lies below it. Nothing else
in turtleact imports this package until it is used.
"""

from __future__ import annotations

from turtleact.web.bridge import Bridge, Statistics, open_bridge
from turtleact.web.server import PORT, Web, open_web
from turtleact.web.shared import Limits

__all__ = ["PORT", "Bridge", "Limits", "Statistics", "Web", "open_bridge", "open_web"]
