"""Run golden cases in this process; `python -m tests.golden.run` keeps their fingerprints anew."""

from __future__ import annotations

import contextlib
import io
import json
import os
import sys
import tempfile
from pathlib import Path
from unittest.mock import patch

from tests.golden.cases import CASES, MADE, Case
from tests.golden.fingerprint import Fingerprint, of_folder
from tests.golden.processor import processor
from tests.graphslam.skips import pass_on

KEPT = Path(__file__).parent / "kept"
KEEPER = Path(__file__).parent / "keeper.json"
"""The processor that kept them, as numpy and its BLAS see it, and the versions of both."""
SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"


def run_case(case: Case, work: Path) -> dict[str, Fingerprint]:
    """Run a case and what comes before it in a folder for both, and look at what it left."""
    for name, make in MADE.items():
        folder = Path(name.format(work=work))
        if name in case.argv and not folder.exists():
            make(folder)
    if case.before and not (work / case.before).exists():
        run_case(CASES[case.before], work)
    out = work / case.name
    argv = [word.format(shared=SHARED, work=work) for word in case.argv.split()]
    printed = _slamcheck([*argv, "--out", str(out)])
    return of_folder(out, printed)


def read_kept(name: str) -> dict[str, Fingerprint]:
    """The fingerprints that were kept of a case."""
    found: dict[str, Fingerprint] = json.loads((KEPT / f"{name}.json").read_text(encoding="utf-8"))
    return found


def write_kept(name: str, fingerprints: dict[str, Fingerprint]) -> None:
    """Keep fingerprints, one a line."""
    rows = (f"{json.dumps(k)}: {json.dumps(v)}" for k, v in fingerprints.items())
    text = "{\n" + ",\n".join(rows) + "\n}\n"
    KEPT.mkdir(exist_ok=True)
    (KEPT / f"{name}.json").write_text(text, encoding="utf-8")


def _slamcheck(argv: list[str]) -> str:
    """What a command printed. Raises AssertionError where it ended in an error."""
    from comparisons.cli.app import main

    printed, said = io.StringIO(), io.StringIO()
    with (
        patch.object(sys, "argv", ["slamcheck", *argv]),
        patch.dict(os.environ, {"COLUMNS": "200", "NO_COLOR": "1", "TERM": "dumb"}),
        contextlib.redirect_stdout(printed),
        contextlib.redirect_stderr(said),
    ):
        try:
            main()
            code: object = 0
        except SystemExit as stop:
            code = stop.code
    pass_on(said.getvalue())
    assert code in (0, 1, 3), f"{argv} ended with {code}: {said.getvalue()}"
    return printed.getvalue() + f"exit code {code}\n"


def is_keeper() -> bool:
    """Whether results must be equal to the bit: what rounds is as it was where they were kept."""
    return bool(json.loads(KEEPER.read_text(encoding="utf-8")) == processor())


def main(names: list[str]) -> None:
    """Keep the fingerprints of some cases, or of all; of some only where the others were kept."""
    if names and not is_keeper():
        sys.exit("another processor kept the results, keep all of them: python -m tests.golden.run")
    KEEPER.write_text(json.dumps(processor(), indent=2) + "\n", encoding="utf-8")
    with tempfile.TemporaryDirectory() as work:
        for name in names or list(CASES):
            fingerprints = run_case(CASES[name], Path(work))
            write_kept(name, fingerprints)
            print(name, len(fingerprints), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
