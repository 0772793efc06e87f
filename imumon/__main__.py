"""``python -m imumon`` and the installed program: the command, which Ctrl-C may end from its first moment."""

import os
import signal

from .errors import EXIT_INTERRUPTED


def main() -> None:
    """Load the command line and run it; until it takes over, Ctrl-C ends the program without a word."""
    # Not where it is ignored, as under nohup.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, lambda *_: os._exit(EXIT_INTERRUPTED))
    from .cli import main as command_line

    command_line()


if __name__ == "__main__":
    main()
