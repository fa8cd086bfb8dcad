"""Makes ``python -m turtleact`` run the program ``turtleact``."""

from __future__ import annotations

import sys

from turtleact.cli import main

if __name__ == "__main__":
    sys.exit(main())
