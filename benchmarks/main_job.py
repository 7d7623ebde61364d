"""Wall time, peak memory and stages of `slamcheck run`, each run in a process of its own.

    python benchmarks/main_job.py [--repeat N] [LOG [OPTION ...]]

LOG defaults to victoria-park. Imports and the report are part of the wall time. The last column
is the best of all runs. Absolute figures hold for one machine only; compare within one call.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

CODE = "from comparisons.cli.app import main; main()"


def measure(arguments: list[str]) -> dict[str, float]:
    """One run: wall seconds, peak memory in MiB, seconds by stage."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        start = time.perf_counter()
        process = subprocess.Popen(
            [sys.executable, "-c", CODE, "run", *arguments, "--out", str(out)],
            stdout=subprocess.DEVNULL,
        )
        _, status, usage = os.wait4(process.pid, 0)
        wall = time.perf_counter() - start
        code = os.waitstatus_to_exitcode(status)
        process.returncode = code
        if code not in (0, 1, 3):
            raise SystemExit(f"slamcheck exited with {code}")
        stages: dict[str, float] = json.loads((out / "result.json").read_text())["seconds"]
    in_bytes = 1 if sys.platform == "darwin" else 1024
    return {"wall": wall, "peak MiB": usage.ru_maxrss * in_bytes / 2**20, **stages}


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("run", nargs=argparse.REMAINDER, help="LOG and options of slamcheck run")
    choices = parser.parse_args()
    runs = [measure(choices.run or ["victoria-park"]) for _ in range(choices.repeat)]
    for name in runs[0]:
        values = [run[name] for run in runs]
        shown = "  ".join(f"{value:8.2f}" for value in values)
        print(f"{name:10} {shown}   best {min(values):8.2f}")


if __name__ == "__main__":
    main()
