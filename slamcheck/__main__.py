"""The command line: `slamcheck` and `python -m slamcheck`."""

import atexit
import gc
import sys

from slamcheck._packages import check_packages


def main() -> None:
    """Run a command, or say in one line that another distribution hides one of our packages."""
    try:
        check_packages()
    except ImportError as error:
        print(f"slamcheck: {error}", file=sys.stderr)
        sys.exit(2)
    from comparisons.cli.app import main as command_line

    # Python searches all objects for garbage twice while it exits, 0.3 s after a run.
    atexit.register(gc.freeze)
    command_line()


if __name__ == "__main__":
    main()
