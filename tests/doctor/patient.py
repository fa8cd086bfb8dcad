"""``turtleact serve`` on a machine with a full disk and a clock that is five seconds ahead."""

import shutil
import sys
import time
from typing import Any

from turtleact import cli

now = time.time_ns
time.time_ns = lambda: now() + 5 * 10**9
usage: Any = type(shutil.disk_usage("/"))
shutil.disk_usage = lambda _: usage(10**12, 10**12, 0)  # type: ignore[assignment]  # it takes anything
sys.exit(cli.main())
