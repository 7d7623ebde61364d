"""`slamcheck/_options.py`, generated: `python -m tools.options_types > FILE`."""

from __future__ import annotations

import sys

from comparisons.options import Flag
from comparisons.options.table import of_job

_HEAD = '''\
"""The jobs' options from Python, by type; generated from their settings by `make settings`."""

# fmt: off
# ruff: noqa

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, TypedDict
'''
_ARGUMENTS = ("estimate",)
"""What a job takes by a parameter of its own."""
_CLASSES = {
    "run": "RunOptions",
    "check": "CheckOptions",
    "solve": "SolveOptions",
    "odometry": "OdometryOptions",
    "map": "MapOptions",
}


def source() -> str:
    """Return the text of the module."""
    parts = [_HEAD]
    for job, name in _CLASSES.items():
        parts.append(f"\n\nclass {name}(TypedDict, total=False):\n")
        parts.append(f'    """Options of `slamcheck {job}`."""\n\n')
        parts += [
            f"    {flag.name.rstrip('_')}: {_type(flag)}\n"
            for flag in of_job(job)
            if not flag.field.startswith("log.") and flag.field not in _ARGUMENTS
        ]
    return "".join(parts)


def _type(flag: Flag) -> str:
    """Return the type of an option's value, as source."""
    one = f"Literal[{', '.join(map(repr, flag.words))}]" if flag.words else flag.kind.__name__
    if flag.metavar == "FILE":
        one += " | Path"
    return f"Sequence[{one}]" if flag.many else one


if __name__ == "__main__":
    sys.stdout.write(source())
