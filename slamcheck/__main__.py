"""The command line: `slamcheck` and `python -m slamcheck`."""

import atexit
import gc
import os
import signal
import sys
from types import FrameType

from slamcheck._packages import check_packages


def main() -> None:
    """Run a command, or say in one line that another distribution hides one of our packages."""
    _stop_at_once()
    try:
        check_packages()
    except ImportError as error:
        print(f"slamcheck: {error}", file=sys.stderr)
        sys.exit(2)
    from comparisons.cli.app import main as command_line

    # Python searches all objects for garbage twice while it exits, 0.3 s after a run.
    atexit.register(gc.freeze)
    try:
        command_line()
    finally:
        _stop_at_once()


def _stop_at_once() -> None:
    """Exit with a signal's code and no traceback while there is nothing to clean up.

    That is while modules are loaded, before a command begins, and while Python exits. A signal that
    is ignored stays so.
    """

    def stop(number: int, frame: FrameType | None) -> None:
        os._exit(128 + number)

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, stop)


if __name__ == "__main__":
    main()
