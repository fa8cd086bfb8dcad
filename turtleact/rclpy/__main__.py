"""``python -m turtleact.rclpy``; see `turtleact.rclpy.program`."""

from __future__ import annotations

import signal


def main() -> None:
    """Run the program that the command line names."""
    # Until the program runs, Ctrl-C ends the process silently, as in a C program. Some extension
    # modules swallow a KeyboardInterrupt that comes while they are imported.
    handler = signal.getsignal(signal.SIGINT)
    if handler is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)

    from turtleact.rclpy.program import run

    run(lambda: signal.signal(signal.SIGINT, handler))


if __name__ == "__main__":
    main()
