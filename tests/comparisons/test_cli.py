"""The command line as a user meets it; in processes of its own what hangs on the process."""

import contextlib
import fcntl
import json
import os
import pty
import re
import shlex
import shutil
import struct
import subprocess
import sys
import termios
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from comparisons.cli import app
from comparisons.cli.app import PANELS
from comparisons.estimates.folder import read_estimate
from comparisons.estimates.trajectory_files import (
    Trajectory,
    read_trajectory_file,
    write_trajectory,
)
from comparisons.logs.log_folder import write_log_folder
from comparisons.report.models import Result
from tests.commands import files_in, flat, job_files, refused, slamcheck, works
from tests.helpers import simulated
from tests.processes import ROOT, python


@pytest.mark.slow
def test_a_run_leaves_a_whole_folder(tmp_path: Path) -> None:
    given = "run", "simulated-loop", "--seed", "3", "--out"
    assert "verdict: agree" in works(*given, "report", cwd=tmp_path)
    folder = tmp_path / "report"
    assert files_in(folder) == job_files("result.json", estimates=("ekf", "smoother"))
    text = (folder / "result.json").read_text()
    result = Result.model_validate_json(text)
    assert result.verdict == "agree"
    assert set(result.seconds) == {"read", "ekf", "frozen", "smoother", "marginals", "checks"}
    assert len(result.agreement.landmarks) == result.ekf.landmarks
    assert "NaN" not in text
    drawn = slamcheck(*given, "drawn", "--figures", "png", cwd=tmp_path)
    assert drawn.returncode == 0, drawn.stderr
    pictures = sorted((tmp_path / "drawn").glob("*.png"))
    assert [p.name for p in pictures] == ["consistency.png", "correlation.png", "map.png"]
    assert all(p.read_bytes().startswith(b"\x89PNG") for p in pictures)
    again = read_estimate(folder / "ekf")
    assert again.information == "filtered"
    assert again.landmark[0].tolist() == list(result.agreement.landmarks[0].ekf_m)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["drawn", "report"]


@pytest.mark.slow
def test_disagreement_exits_with_1_and_says_why(tmp_path: Path) -> None:
    done = slamcheck("run", cwd=tmp_path)
    assert done.returncode == 1, done.stderr
    assert "verdict: disagree" in done.stdout
    assert "linearisation gap: 151 of 151 landmarks are more than 1 sigma" in done.stdout
    lines = done.stdout.splitlines()
    assert max(map(len, lines)) <= 80
    assert "  also: the rest of the evidence, " in done.stdout
    assert "\x1b" not in done.stdout
    result = json.loads((tmp_path / "slamcheck-victoria-park" / "result.json").read_text())
    assert result["verdict"] == "disagree"
    assert abs(result["smoother"]["error"] - 3173.49) < 0.01


REFUSED = {
    "run nowhere": "nowhere: no such file or folder",
    "run empty": "empty: format not recognised",
    "run empty --format bag": "format 'bag' is unknown",
    "run --association magic": "'--association': 'magic' is not one of 'known', 'nn'",
    "run simulated-loop --out full": "full: already holds mine.txt; give a new folder",
    "run simulated-loop --out file": "file: is a file, expected a folder",
    "run simulated-loop --out file/x": "file/x: cannot be written",
    "run simulated-loop --out .": ".: is the current folder or holds it",
    "run simulated-loop --gps on": "holds no positions to fuse; use --gps off",
    "run simulated-loop --attributes on": "hold no diameter and no intensity; use",
    "run simulated-loop --motion scan": "simulated-loop: holds no scans",
    "run simulated-loop --robot 2": "--robot 2 does not apply; it takes --seed, ",
    "run simulated-loop --record run.txt": "run.txt: expected a file name that ends with .rrd",
    "run victoria-park --seed 5": "--seed 5 does not apply; --seed is for simulated",
    "run waypoint-run --loops 2": "--loops 2 does not apply; it takes --seed, --n",
    "run waypoint-run --filter misono --trace": "--trace is for filters of x, y and heading",
    "run scan-slam": "holds no measurements of landmarks",
    f"run {'n' * 300}": "no such file or folder",
    "run --bogus": "No such option: --bogus",
    "run --seed abc": "--seed",
    "solve --lag 5": "--lag 5 goes with --smoother fixed-lag",
    "solve simulated-loop --lag 0": "smoother.lag is 0: input should be greater than or equal to 1",
    "solve simulated-loop --robust tukey": "'--robust': 'tukey' is not one of",
    "solve simulated-loop --gps on": "holds no positions to fuse",
    "odometry simulated-loop": "simulated-loop: holds no scans",
    "map simulated-loop": "holds no scans",
    "check simulated-loop --estimate no.tum": "no.tum: no such file or folder",
    "baseline compare simulated-loop no.json": "no.json: ",
    "convert victoria-park out --loops 2": "--loops 2 does not apply",
    "convert simulated-loop": "FOLDER",
    "convert nowhere out": "nowhere: no such file or folder",
    "convert simulated-loop full": "full: already holds mine.txt",
    # Misuse is told with its remedy.
    "rum": "No such command 'rum'. Did you mean 'run'?",
    "run --associaton nn": "No such option: --associaton (Possible options: --association",
    "run simulated-loop another": "Got unexpected extra argument(s) (another)",
    "-- run": "expected the command as the first word",
    "run --filter": "Option '--filter' requires an argument.",
}


@pytest.mark.slow
def test_bad_input_is_one_line_and_exit_2(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("keep")
    (tmp_path / "file").write_text("")
    for words, message in REFUSED.items():
        assert message in refused(*words.split(), cwd=tmp_path), words
    assert sorted(p.name for p in tmp_path.iterdir()) == ["empty", "file", "full"]
    assert [p.name for p in (tmp_path / "full").iterdir()] == ["mine.txt"]


@pytest.mark.slow
def test_a_folder_of_another_run_is_not_replaced_in_silence(tmp_path: Path) -> None:
    write_log_folder(simulated(loop_s=5.0), tmp_path / "log")
    run = ("run", "log")
    for more in ((), (), ("--filter", "compressed"), ("slamcheck-simulated-loop/config.toml",)):
        asked = more if more[:1] == ("slamcheck-simulated-loop/config.toml",) else ("log", *more)
        assert slamcheck("run", *asked, cwd=tmp_path).returncode == 0, more
    names = ["log", "slamcheck-simulated-loop", "slamcheck-simulated-loop-filter-compressed"]
    assert sorted(p.name for p in tmp_path.iterdir()) == names
    other = (*run, "--association", "nn", "--out", "slamcheck-simulated-loop")
    kept = (tmp_path / "slamcheck-simulated-loop" / "result.json").read_bytes()
    assert refused(*other, cwd=tmp_path) == (
        "slamcheck: slamcheck-simulated-loop: holds a run with other settings "
        "(ekf.association unset there, nn here); give --replace, or --out "
        "slamcheck-simulated-loop-2"
    )
    assert (tmp_path / "slamcheck-simulated-loop" / "result.json").read_bytes() == kept
    assert slamcheck(*other, "--replace", cwd=tmp_path).returncode == 0


@pytest.mark.parametrize(
    ("fault", "code", "said"),
    [
        (ZeroDivisionError("planted"), 70, "ZeroDivisionError: planted"),
        (KeyboardInterrupt(), 130, ""),
    ],
)
def test_neither_a_crash_nor_an_interrupt_is_a_verdict(
    fault: BaseException, code: int, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An unforeseen failure shows its traceback; nothing is left of either."""

    def fails(*_: object, **__: object) -> None:
        raise fault

    monkeypatch.setattr("comparisons.jobs.run.compare", fails)
    done = slamcheck("run", "simulated-loop", "--out", "a/report", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (code, "")
    assert said in done.stderr
    assert bool(said) == bool(done.stderr)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_closed_pipe_keeps_the_verdict(tmp_path: Path) -> None:
    code = (
        "import os, sys\nos.close(1)\n"
        "sys.argv[1:] = ['run', 'simulated-loop', '--out', 'report']\n"
        "from comparisons.cli.app import main\nmain()\n"
    )
    assert python("-c", code, cwd=tmp_path).returncode == 0
    assert (tmp_path / "report" / "result.json").exists()


def unread(*arguments: str, cwd: Path) -> object:
    """The exit code of a command of whose output nothing is read, as `| head -0`."""
    code: object = None
    read, write = os.pipe()
    os.close(read)
    with (
        contextlib.suppress(BrokenPipeError),
        open(write, "w") as out,
        contextlib.chdir(cwd),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(out),
        patch.object(sys, "argv", ["slamcheck", *arguments]),
    ):
        try:
            app.main()
        except SystemExit as stop:
            code = stop.code
    return code


UNREAD = {
    "run simulated-loop --end 20 --trace -v --out agree": 0,
    "solve simulated-loop --end 20 --json --out solved": 0,
    "check simulated-loop --end 20 --estimate agree/ekf -v --out same": 0,
    "audit agree/ekf/filter.trace -v --out audited": 0,
    "compare agree same": 0,
    "baseline save simulated-loop kept.json --end 20 --runs 1": 0,
    "baseline compare simulated-loop kept.json": 0,
    "convert simulated-loop folder": 0,
    "logs": 0,
    "config run": 0,
    "explain": 0,
    "run --help": 0,
    "--help": 0,
    "run nowhere": 2,
    "run --associaton nn": 2,
}
"""Commands in an order that lets one use what another has written, with their exit codes."""


@pytest.mark.slow
def test_a_reader_who_leaves_changes_no_exit_code(tmp_path: Path) -> None:
    """1 is a verdict: neither rich's nor typer's code for a broken pipe."""
    works("run", "simulated-loop", "--end", "20", "--out", "read", cwd=tmp_path)
    assert {words: unread(*words.split(), cwd=tmp_path) for words in UNREAD} == UNREAD
    kept = tmp_path / "kept.json"
    other = json.loads(kept.read_text())
    other["metrics"]["smoother.poses"]["value"] += 1
    kept.write_text(json.dumps(other))
    assert unread("baseline", "compare", "simulated-loop", str(kept), cwd=tmp_path) == 1
    written = {file.name for file in (tmp_path / "read").iterdir()}
    assert written <= {file.name for file in (tmp_path / "agree").iterdir()}


def test_a_stream_that_tells_of_its_reader_would_be_noticed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert unread("logs", cwd=tmp_path) == 0
    monkeypatch.setattr(app, "_for_any_reader", lambda stream: stream)
    assert unread("logs", cwd=tmp_path) == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "redirected", "code"),
    [
        ("solve simulated-loop --end 20", ">&-", 0),
        ("solve simulated-loop --end 20", "<&- >&- 2>&-", 0),
        ("run --sede 2", "2>/dev/full", 2),
    ],
)
def test_what_nobody_reads_changes_no_exit_code(
    arguments: str, redirected: str, code: int, tmp_path: Path
) -> None:
    """Streams closed before the start, or full, are neither a fault nor a disagreement."""
    program = f'exec {sys.executable} -c "$MAIN" {arguments} {redirected}'
    main = "from comparisons.cli import app; app.main()"
    environment = {**os.environ, "MAIN": main, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(["sh", "-c", program], cwd=tmp_path, env=environment, check=False)
    assert done.returncode == code


@pytest.mark.slow
def test_convert_then_run(tmp_path: Path) -> None:
    printed = works("convert", "simulated-loop", "log", "--seed", "5", cwd=tmp_path)
    assert "3,400 odometry" in printed
    direct = slamcheck("run", "simulated-loop", "--seed", "5", "--out", "a", cwd=tmp_path)
    through = slamcheck("run", "log", "--out", "b", cwd=tmp_path)
    assert direct.returncode == through.returncode == 0
    results = [json.loads((tmp_path / n / "result.json").read_text()) for n in "ab"]
    assert results[0]["agreement"] == results[1]["agreement"]
    assert results[0]["log"]["sha256"] == results[1]["log"]["sha256"]


def test_lists_and_help(tmp_path: Path) -> None:
    listed = works("logs", cwd=tmp_path)
    for name in ("victoria-park", "simulated-loop", "gtsam-2d", "mrclam", "acfr-car-park"):
        assert name in listed
    helped = works("run", "--help", cwd=tmp_path)
    assert "slamcheck run simulated-loop --filter compressed" in helped
    for panel in ("Estimators", "Scans and dense maps", "Log, settings and report"):
        assert f"\u2500 {panel} \u2500" in helped
    assert "EKF variant: full, compressed, compressed-suboptimal" in flat(helped)
    assert "--optimiser" not in helped
    assert "All other options and settings: slamcheck config" in helped
    assert "\b" not in helped
    top = slamcheck("--help", cwd=tmp_path).stdout
    assert "Exit codes" in flat(top)
    for panel in PANELS:
        assert f"\n{panel}:\n" in top
    for line in top.partition("Main:")[2].partition("Options of")[0].splitlines():
        assert len(line) < 80
        assert "..." not in line  # no first line is cut
    for command in ("convert", "check"):  # examples after one paragraph, and after two
        assert f"\n   slamcheck {command} " in slamcheck(command, "--help", cwd=tmp_path).stdout
    assert "slamcheck new-log" in listed


@pytest.mark.parametrize("arguments", [(), ("baseline",)])
def test_without_a_command_the_help_is_shown(arguments: tuple[str, ...], tmp_path: Path) -> None:
    bare = slamcheck(*arguments, cwd=tmp_path)
    assert (bare.returncode, bare.stderr) == (2, "")
    assert bare.stdout.split() == slamcheck(*arguments, "--help", cwd=tmp_path).stdout.split()
    assert len(bare.stdout.splitlines()) > 10


@pytest.mark.slow
def test_warnings_go_to_a_log_that_is_asked_for(tmp_path: Path) -> None:
    code = (
        "import sys, warnings, numpy as np, comparisons.pipeline.solve as s\n"
        "whole = s.solve\n"
        "def warned(*a):\n"
        "    warnings.warn('planted')\n"
        "    np.float64(1.0) / np.float64(0.0)\n"
        "    return whole(*a)\n"
        "s.solve = warned\n"
        "from comparisons.cli import app, support\n"
        "support.QUIET_S = 1e9  # however long a stage takes on this machine\n"
        "app.main()\n"
    )
    quiet = python("-c", code, "solve", "simulated-loop", "--out", "a", cwd=tmp_path)
    assert (quiet.returncode, quiet.stderr) == (0, "")
    logged = ("--out", "b", "--log", "log.txt")
    kept = python("-c", code, "solve", "simulated-loop", *logged, cwd=tmp_path)
    assert (kept.returncode, kept.stderr) == (0, "")
    lines = (tmp_path / "log.txt").read_text()
    assert "planted" in lines
    assert "divide by zero" in lines


@pytest.mark.parametrize(
    ("typed", "words"),
    [
        ("run --robust ", ["none", "huber", "cauchy", "gnc"]),
        ("run --preset ", ["recommended", "guivant-2002", "misono-2007", "nieto-2005"]),
        ("run simulated", ["simulated-loop"]),
        ("convert scan-slam", ["scan-slam", "scan-slam-maps"]),
        ("solve --no-such", []),
        ("od", ["odometry"]),
    ],
)
def test_the_shell_completes(
    typed: str, words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("_SLAMCHECK_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", f"slamcheck {typed}")
    monkeypatch.setenv("COMP_CWORD", str(len(typed.split(" "))))
    assert slamcheck(cwd=tmp_path).stdout.split() == words


STAGES = """
import time
from comparisons.cli import support
support.QUIET_S = {quiet_s}
with support.progress_bar() as progress:
    time.sleep(0.3)
    for i in range(3):
        progress("first", i, 2)
    time.sleep({rest_s})
    progress("second", 0, 0)
    time.sleep(0.3)
print("done")
"""


def on_a_terminal(code: str, cwd: Path) -> str:
    """What a program shows on a terminal of 80 columns."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    environment = {"PYTHONPATH": str(ROOT), "TERM": "xterm"}
    child = subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=cwd, stdin=theirs, stdout=theirs, stderr=theirs, env=environment,
    )  # fmt: skip
    os.close(theirs)
    shown = b""
    with contextlib.suppress(OSError):  # the terminal's other end is closed
        while part := os.read(ours, 65536):
            shown += part
    os.close(ours)
    assert child.wait(60) == 0, shown
    return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", shown.decode())


def frames(shown: str, stage: str) -> list[str]:
    """The clock at each sight of a stage."""
    return re.findall(rf"{stage} [^\r\n]*?(\d:\d\d:\d\d)", shown)


@pytest.mark.slow
def test_the_clock_goes_on_after_a_stage_has_ended(tmp_path: Path) -> None:
    shown = on_a_terminal(STAGES.format(quiet_s=0.0, rest_s=2.5), tmp_path)
    assert frames(shown, "reading")[0] == "0:00:00"  # from the first moment
    assert frames(shown, "first")[-1] >= "0:00:02"
    assert frames(shown, "second")[-1] >= "0:00:02"  # of the whole job
    assert shown.rstrip().endswith("done")


@pytest.mark.slow
def test_a_clock_that_stops_would_be_found(tmp_path: Path) -> None:
    """What the test above rejects: rich's own column, which freezes with a finished task."""
    own = (
        "import rich.progress as r\n"
        "kept = r.Progress.__init__\n"
        "def plain(self, *columns, **more):\n"
        "    kept(self, *columns[:-1], r.TimeElapsedColumn(), **more)\n"
        "r.Progress.__init__ = plain\n"
    )
    frozen = own + STAGES.format(quiet_s=0.0, rest_s=2.5)
    shown = on_a_terminal(frozen, tmp_path)
    assert frames(shown, "first")[-1] < "0:00:02"


@pytest.mark.slow
def test_a_run_shows_that_it_reads(tmp_path: Path) -> None:
    code = (
        "import sys\n"
        "sys.argv[1:] = ['solve', 'simulated-loop']\n"
        "from comparisons.cli.app import main\nmain()\n"
    )
    shown = on_a_terminal(code, tmp_path)
    assert shown.index("reading ") < shown.index("report ") < shown.index("report:  ")


@pytest.mark.slow
def test_without_a_terminal_a_long_job_has_a_line_per_stage() -> None:
    long = python("-c", STAGES.format(quiet_s=0.5, rest_s=0.5))
    assert long.stdout == "done\n"
    lines = [re.sub(r"[\d.]+ s$", "N s", line) for line in long.stderr.splitlines()]
    assert lines == [f"slamcheck: {stage} N s" for stage in ("reading", "first", "second")]
    closed = (
        f"import os, sys\nos.close(2)\nsys.stderr = None\n{STAGES.format(quiet_s=0.5, rest_s=0.5)}"
    )
    assert python("-c", closed).stdout == "done\n"
    short = python("-c", STAGES.format(quiet_s=60.0, rest_s=0.0))
    assert (short.stdout, short.stderr) == ("done\n", "")


@pytest.mark.slow
def test_a_cloud_that_cannot_be_written_is_told_of_before_the_work(tmp_path: Path) -> None:
    without = (
        "import sys; sys.modules['open3d'] = None; from comparisons.cli import app; app.main()"
    )
    done = python("-c", without, "odometry", "no-such-log", "--cloud", "pcd", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == "slamcheck: --cloud needs Open3D: pip install 'slamcheck[scans]'\n"
    said = refused("odometry", "no-such-log", "--cloud", "", cwd=tmp_path)
    assert "'--cloud': '' is not one of 'pcd', 'ply'" in said


def test_without_gtsam_one_line_says_where_it_is_to_be_had(tmp_path: Path) -> None:
    without = "import sys; sys.modules['gtsam'] = None; "
    main = f"{without}from comparisons.cli import app; app.main()"
    done = python("-c", main, "run", cwd=tmp_path)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith("slamcheck: graphslam needs gtsam 4.3")
    done = python("-c", f"{without}import graphslam.smoother")
    assert done.stderr.splitlines()[-1].startswith("ModuleNotFoundError: graphslam needs gtsam")


def what_it_took(folder: Path) -> None:
    """Logs and estimates of two drives whose folders have the same names."""
    for name, seed in (("a", 0), ("b", 3)):
        log = replace(simulated(seed, loop_s=5.0), name="log")
        write_log_folder(log, folder / name / "log")
    times = np.arange(20.0)[:, None]
    poses = np.hstack((times, np.zeros((20, 6)), np.ones((20, 1))))
    (folder / "mine").mkdir()
    np.savetxt(folder / "mine" / "trajectory.tum", poses)
    np.savetxt(folder / "mine.tum", poses)
    np.savetxt(folder / "first.tum", poses[:, [0, 1, 2, 3, 7, 4, 5, 6]])
    for unit, factor in (("ms", 1e3), ("us", 1e6), ("ns", 1e9)):
        for start, since in ((0.0, ""), (1.7e9, "-1970")):
            late = np.hstack((factor * (start + times), poses[:, 1:]))
            np.savetxt(folder / f"{unit}{since}.tum", late, fmt="%.9f")
    seconds = np.hstack((1.7e9 + np.round(times / 10.0), poses[:, 1:]))
    np.savetxt(folder / "whole.tum", seconds, fmt="%.10g")
    whole = np.linspace(log.prior.time_s, log.end_s, len(times))
    for name, late in {"mine": whole, "ms": 1e3 * whole, "late": whole + 1e3}.items():
        write_trajectory(Trajectory(late, poses[:, 1:4]), folder / f"{name}.csv", "csv")
    (folder / "ekf.trace").mkdir()
    (folder / "ekf.trace" / "filter.trace").touch()
    (folder / "kept.json").write_text("{}")


RIGHT = "slamcheck check a/log --estimate mine"
TAKEN = {
    "check a/log mine.tum": f"{RIGHT}.tum",
    "check a/log mine": RIGHT,
    "check mine a/log": RIGHT,
    "check mine --log a/log": f"is a log, expected a file for warnings; say {RIGHT}",
    "check a/log --estimate mine --log b": "slamcheck: b: is a folder; --log names the file",
    "check --log a/log --estimate mine": RIGHT,
    "check mine.tum --estimate a/log": f"{RIGHT}.tum",
    "check a/log --estimate first.tum": "look like w x y z, expected x y z w",
    "check a/log --estimate ms-1970.tum": "look like milliseconds; in seconds: awk",
    "check a/log --estimate us-1970.tum": "look like microseconds; in seconds: awk",
    "check a/log --estimate ns-1970.tum": "look like nanoseconds; in seconds: awk",
    "check a/log --estimate ns.tum": "look like nanoseconds; in seconds: awk",
    "check a/log --estimate whole.tum": "since 1970 look rounded to seconds, as '%.10g'",
    "audit ekf.trace": "slamcheck audit ekf.trace/filter.trace",
    "audit mine.tum": "slamcheck check LOG --estimate mine.tum",
    "audit mine": "it holds no filter.trace",
    "baseline compare kept.json a/log": "say slamcheck baseline compare a/log kept.json",
    "baseline save new.json a/log": "say slamcheck baseline save a/log new.json",
    "baseline save new.json nieto-loop": "say slamcheck baseline save nieto-loop new.json",
}
"""What stands in another's place, with what is said of it."""


@pytest.mark.parametrize("words", TAKEN)
def test_what_was_taken_for_another_is_named(words: str, taken: Path) -> None:
    """With the command that works, where one follows; nothing is written."""
    before = sorted(taken.rglob("*"))
    assert TAKEN[words] in refused(*words.split(), cwd=taken)
    assert sorted(taken.rglob("*")) == before


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("taken")
    what_it_took(folder)
    return folder


@pytest.mark.slow
def test_two_logs_of_one_name_are_told_apart(taken: Path) -> None:
    """By their paths; a second run of the same has the first one's place."""
    works("solve", "a/log", "-q", cwd=taken)
    works("solve", "a/log", "-q", cwd=taken)
    said = refused("solve", "b/log", "-q", cwd=taken)
    assert f"(log.source {taken}/a/log there, {taken}/b/log here)" in said
    assert said.endswith("; give --replace, or --out slamcheck-solve-log-2")
    works("solve", "b/log", "-q", "--out", "slamcheck-solve-log-2", cwd=taken)
    assert refused("solve", "b/log", "-q", cwd=taken).endswith("--out slamcheck-solve-log-3")
    works("solve", "b/log", "-q", "--out", "other/slamcheck-solve-log", cwd=taken)
    works(
        "compare", "slamcheck-solve-log", "other/slamcheck-solve-log", "--out", "t.csv", cwd=taken
    )
    heads = (taken / "t.csv").read_text().splitlines()[0]
    assert heads == "name,slamcheck-solve-log,other/slamcheck-solve-log"
    works("baseline", "save", "a/log", "k.json", "--runs", "1", cwd=taken)
    said = refused("baseline", "compare", "b/log", "k.json", cwd=taken)
    assert "log: is not the log of the baseline (log, another of this name)" in said
    assert "slamcheck baseline save LOG NEW.json" in said


@pytest.mark.skipif(shutil.which("awk") is None, reason="no awk here")
def test_the_printed_command_turns_quaternions_and_times(taken: Path) -> None:
    """The output of what `check` says is the right estimate."""
    for name in ("first.tum", "ns-1970.tum", "ms-1970.tum", "ms.csv", "late.csv"):
        said = slamcheck("check", "a/log", "--estimate", name, cwd=taken).stderr
        command = shlex.split(said[said.index("awk '") : said.index(" OLD > NEW")])
        done = subprocess.run([*command, name], cwd=taken, capture_output=True, text=True)
        (taken / "NEW").write_text(done.stdout)
        found = read_trajectory_file(taken / "NEW")
        right = read_trajectory_file((taken / "mine").with_suffix(Path(name).suffix))
        time_s = found.time_s - (1.7e9 if "1970" in name else 0.0)
        assert np.abs(time_s - right.time_s).max() < 1e-6
        assert np.abs(found.pose - right.pose).max() < 1e-6
    (taken / "NEW").unlink()


def test_a_command_that_has_moved_says_where(tmp_path: Path) -> None:
    for words in (["reproduce"], ["reproduce", "N3.5", "--drives", "1"], ["reproduce", "--help"]):
        said = refused(*words, cwd=tmp_path)
        assert said.startswith("slamcheck: reproduce: the documents' figures are no part of")
        assert "python -m research.documents FIGURE ... --data FOLDER" in said
    assert "reproduce" not in slamcheck("--help", cwd=tmp_path).stdout
    assert list(tmp_path.iterdir()) == []
