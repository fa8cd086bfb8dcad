"""The browser's and rosbridge's door: a node behind a WebSocket, and a page to see it on.

What is served is an ordinary `turtleact.Node`; nothing here knows what lies below it. Needs the
extra ``turtleact[web]``.
"""

from __future__ import annotations

try:
    from turtleact.web.bridge import Bridge, Statistics, open_bridge
    from turtleact.web.server import PORT, Web, open_web
    from turtleact.web.shared import Limits
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        f"turtleact.web needs {error.name}: pip install 'turtleact[web]'", name=error.name
    ) from error

__all__ = ["PORT", "Bridge", "Limits", "Statistics", "Web", "open_bridge", "open_web"]
