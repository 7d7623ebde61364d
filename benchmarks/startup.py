"""Processor time of start-up, of a run on a log of ten seconds, and the report's share of runs.

    python benchmarks/startup.py [--repeat N] [--share LOG ...]

Each figure is the median of N runs (5) in processes of their own, one of each kind after the other,
so that a busy machine slows all alike. `beside` is what comes on top of a bare Python. The report
is all from the last check to the process's end: loading matplotlib, pictures, page, estimates and
exit. --share LOG adds a run of that log. Compare figures within one call only.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

PLAIN = ["-m", "slamcheck"]
WATCHED = """
import os, sys
from contextlib import contextmanager
from pathlib import Path
from comparisons.cli import support

begin = support.progress_bar

@contextmanager
def watched(output):
    with begin(output) as progress:
        def watch(stage, done, total):
            if stage == "report":
                Path(os.environ["STARTUP_MARK"]).write_text(repr(sum(os.times()[:4])))
            progress(stage, done, total)
        yield watch

support.progress_bar = watched
from slamcheck.__main__ import main
main()
"""
"""A run that notes its processor time where the report begins."""


def spent(arguments: list[str], folder: Path) -> tuple[float, float]:
    """Processor seconds of a Python process and its children, in all and in the report.

    Raises SystemExit where it fails.
    """
    mark = folder / "mark"
    mark.unlink(missing_ok=True)
    process = subprocess.Popen(
        [sys.executable, *arguments],
        stdout=subprocess.DEVNULL,
        env=os.environ | {"STARTUP_MARK": str(mark), "OPENBLAS_NUM_THREADS": "1"},
    )
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = code = os.waitstatus_to_exitcode(status)
    if code not in (0, 1, 3):
        raise SystemExit(f"python {' '.join(arguments)[:80]} exited with {code}")
    total = usage.ru_utime + usage.ru_stime
    return total, total - float(mark.read_text()) if mark.exists() else 0.0


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--share", metavar="LOG", action="append", default=[])
    choices = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        short = folder / "ten-seconds"
        spent([*PLAIN, "convert", "simulated-loop", str(short), "--end", "10"], folder)
        kinds = {"python -c pass": ["-c", "pass"]}
        kinds |= {f"slamcheck {word}": [*PLAIN, word] for word in ("--help", "--version", "logs")}
        for log in (str(short), *choices.share):
            out = folder / f"run-{len(kinds)}"
            words = ["run", log, "--out", str(out), "--replace", "--quiet"]
            kinds[f"slamcheck run {Path(log).name}"] = ["-c", WATCHED, *words]
        found = {kind: list[tuple[float, float]]() for kind in kinds}
        for _ in range(choices.repeat):
            for kind, words in kinds.items():
                found[kind].append(spent(words, folder))
    print(f"{'processor time [s], median':34} {'all':>7} {'beside':>7} {'report':>7} {'share':>7}")
    bare = median(total for total, _ in found["python -c pass"])
    for kind, times in found.items():
        total, report = median(t for t, _ in times), median(r for _, r in times)
        share = median(r / t for t, r in times)
        row = f"{kind:34} {total:7.3f} {total - bare:7.3f}"
        print(f"{row} {report:7.3f} {share:7.1%}" if report else row)


if __name__ == "__main__":
    main()
