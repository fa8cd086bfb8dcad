"""``turtleact`` as in the lecture, on a router of its own and with turtles that do not dawdle.

The arguments begin with that router's port. Everything else is as on the command line: so a command
of the lecture can stand as it is, on a machine where other graphs are.
"""

from __future__ import annotations

import sys

from turtleact import cli
from turtleact.commands import serving
from turtleact.transports.rmw_zenoh import config

SPEED = 3.0
"""How fast time passes for the turtles."""

run = serving.run


def main() -> int:
    """Run a command line."""
    port = sys.argv.pop(1)
    router = f"tcp/127.0.0.1:{port}"
    serving.ROUTER = router
    config.CONNECT = dict.fromkeys(("peer", "client"), (router,)) | {"router": ()}

    def run_fast(service):
        fleet = service.fleet and service.fleet._replace(speed=SPEED)
        return run(service._replace(fleet=fleet))

    serving.run = run_fast
    return cli.main()


if __name__ == "__main__":
    sys.exit(main())
