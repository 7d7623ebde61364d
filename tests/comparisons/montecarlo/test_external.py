"""Filters of the user's in a study: a callable or a command, judged as ours are."""

import html
import json
import re
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from comparisons.config import RunConfig
from comparisons.errors import InputError
from comparisons.estimates.estimate import Estimate
from comparisons.estimates.external import ExternalEstimate
from comparisons.experiments.montecarlo.config import MonteCarloConfig
from comparisons.experiments.montecarlo.external import EstimatorError, ExternalProgram, errors_of
from comparisons.experiments.montecarlo.external import parse_commands as parse
from comparisons.experiments.montecarlo.folder import write_montecarlo
from comparisons.experiments.montecarlo.study import (
    External,
    Study,
    kept_runs,
    montecarlo,
    read_study,
    run_study,
)
from comparisons.experiments.scenarios.scenario import bundled_scenarios
from comparisons.experiments.scenarios.world import log_of_run
from comparisons.jobs.run import run_filter
from comparisons.logs.log import Log, Poses, Truth
from comparisons.logs.log_folder import read_log_folder, write_log_folder
from comparisons.pipeline.prepare import prepare
from tests.commands import refused, works
from tests.comparisons.montecarlo.test_command import ENVIRONMENT, SLAMCHECK
from tests.comparisons.montecarlo.worlds import short, short_world, shortened, study_of
from tests.comparisons.test_beside import gone
from tests.helpers import present

PROGRAM = """
import shutil, sys
from pathlib import Path
log, out = map(Path, sys.argv[1:3])
{body}
"""
COPY = """
import csv
seed = int((log / "log.toml").read_text().split('name = "short-')[1].split('"')[0])
times = [row["time_s"] for row in csv.DictReader((log / "odometry.csv").open())]
out.mkdir()
(out / "trajectory.tum").write_text("".join(f"{t} 0 0 0 0 0 0 1\\n" for t in times))
"""


def ekf(log: Log) -> Estimate:
    """The project's filter for logs, which is not the one that runs many at once."""
    return run_filter(prepare(log, RunConfig()))[0].estimate


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short circle in a file."""
    return shortened(tmp_path_factory.mktemp("scenario"), 40, "circle-range-bearing")


@pytest.fixture
def program(tmp_path: Path) -> Callable[[str], str]:
    """A command whose program has a body."""

    def write(body: str) -> str:
        path = tmp_path / "filter.py"
        path.write_text(PROGRAM.format(body=body))
        return f"{sys.executable} {path} {{log}} {{out}}"

    return write


def study(scenario: Path, out: Path, *more: str) -> tuple[str, ...]:
    words = ("montecarlo", str(scenario), "--runs", "3", "--filters", "ekf", "--out", str(out))
    return (*words, *more)


@pytest.mark.parametrize("name", ["circle-range-bearing", "nieto-loop"])
def test_our_filter_handed_in_has_our_figures(name: str) -> None:
    """The oracle: two programs of the same filter over the same runs, paired by seed.

    What is left is the log's stabilisation noise at the first steps, whose covariance is tiny.
    """
    scenario = short(name, 100)
    external = External({"mine": ekf, "sure": lambda log: overconfident(ekf(log))})
    with tempfile.TemporaryDirectory() as folder:
        outcome = run_study(study_of(scenario, 4, "ekf"), Path(folder), external=external)
    ours, mine, sure = outcome.filters.values()
    for block, found in mine.consistency.items():
        assert found.mean == pytest.approx(ours.consistency[block].mean, rel=1e-2)
        assert found.band == ours.consistency[block].band
    assert mine.rmse == pytest.approx(ours.rmse, rel=1e-3)
    pair = outcome.pairs[0]
    assert (pair.first, pair.second, pair.what, pair.runs) == ("ekf", "mine", "pose_nees", 4)
    assert sure.consistency["pose"].mean == pytest.approx(9 * mine.consistency["pose"].mean)
    assert sure.consistency["pose"].place == "above"


def overconfident(estimate: Estimate) -> Estimate:
    """A broken variant: a third of the sigmas."""
    return replace(
        estimate,
        pose_covariance=estimate.pose_covariance / 9,
        joint_covariance=estimate.joint_covariance / 9,
    )


@pytest.mark.parametrize("name", bundled_scenarios())
def test_a_run_is_a_log_that_a_filter_takes(name: str) -> None:
    log = log_of_run(short_world(name, 60), 3, "x")
    assert log.end_s == pytest.approx(log.odometry.time_s[-1])
    assert len(ekf(log).pose) > 1


def truths(folder: Path) -> list[str]:
    """Files of a log that hold truth."""
    return sorted(p.name for p in folder.iterdir() if "truth" in p.name)


@pytest.mark.slow
def test_the_log_handed_out_holds_no_truth(tmp_path: Path) -> None:
    seen: list[Log] = []

    def spy(log: Log) -> Estimate:
        seen.append(log)
        return ekf(log)

    montecarlo("nieto-loop", 1, estimators={"spy": spy})
    assert seen[0].truth == Truth()
    write_log_folder(seen[0], tmp_path / "given")
    files = {p.name for p in (tmp_path / "given").iterdir()}
    assert files == {"log.toml", "odometry.csv", "measurements.csv"}
    assert truths(tmp_path / "given") == []
    reported = replace(seen[0], truth=Truth(Poses(np.array([0.0]), np.zeros((1, 3)))))
    write_log_folder(reported, tmp_path / "told")
    assert truths(tmp_path / "told") == ["truth_poses.csv"]


def test_a_command_sees_a_folder_without_truth(
    scenario: Path, program: Callable[[str], str], tmp_path: Path
) -> None:
    body = f"shutil.copytree(log.parent, {str(tmp_path / 'seen')!r})" + COPY
    asked = study(scenario, tmp_path / "out", "--runs", "1", "--command", program(body))
    printed = works(*asked, cwd=tmp_path)
    found = {p.relative_to(tmp_path / "seen").as_posix() for p in (tmp_path / "seen").rglob("*")}
    assert found == {"log", "log/log.toml", "log/odometry.csv", "log/measurements.csv", "stderr"}
    assert "mine: no covariances, so no NEES, of pose, position, heading, landmarks" in printed
    result = json.loads((tmp_path / "out" / "montecarlo.json").read_text())
    assert result["filters"]["mine"]["consistency"]["pose"]["place"] == "not given"
    assert result["filters"]["mine"]["rmse_position_m"] > 1.0


@pytest.mark.slow
def test_a_failure_is_named_and_its_log_is_kept(
    scenario: Path, program: Callable[[str], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    places = tmp_path / "places"
    places.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(places))
    body = COPY + "\nif seed == 1: sys.exit('first line\\nno such landmark: 7')"
    asked = study(scenario, tmp_path / "out", "--command", f"own={program(body)}")
    printed = works(*asked, cwd=tmp_path)
    kept = tmp_path / "out" / "logs" / "000001"
    assert "own: 1 of 3 runs failed" in printed
    assert "seed 1: exit code 1: no such landmark: 7; its log is logs/000001" in printed
    assert len(read_log_folder(kept).odometry.time_s) == 41
    assert "first line" in (kept.parent / "own-000001.stderr").read_text()
    result = json.loads((tmp_path / "out" / "montecarlo.json").read_text())
    assert result["failures"] == {
        "own": [{"seed": 1, "reason": "exit code 1: no such landmark: 7"}]
    }
    assert result["filters"]["own"]["lost"] == 1
    assert all(pair["runs"] in (0, 2) for pair in result["pairs"])
    assert list(places.iterdir()) == []
    program(COPY)
    assert "failed" not in works(*asked, cwd=tmp_path)
    assert not (kept.parent / "own-000001.stderr").exists()


def test_all_failing_ends_with_exit_code_2(
    scenario: Path, program: Callable[[str], str], tmp_path: Path
) -> None:
    asked = study(scenario, tmp_path / "out", "--command", program("import nowhere"))
    said = refused(*asked, cwd=tmp_path)
    assert "mine: all 3 runs failed; seed 0: exit code 1: ModuleNotFoundError: " in said
    assert (tmp_path / "out" / "logs" / "000000" / "log.toml").exists()


@pytest.mark.slow
def test_a_command_that_hangs_is_ended_with_its_children(tmp_path: Path) -> None:
    mark = tmp_path / "alive"
    child = f"import time, pathlib; time.sleep(3); pathlib.Path({str(mark)!r}).touch()"
    body = f"import subprocess; subprocess.run([{sys.executable!r}, '-c', {child!r}])"
    words = (sys.executable, "-c", body, "{log}", "{out}")
    begin = time.monotonic()
    with pytest.raises(EstimatorError, match="took longer than 1 s"):
        ExternalProgram(words, 1.0)(log_of_run(short_world("circle", 5), 0, "x"))
    assert time.monotonic() - begin < 3.0
    time.sleep(3.0)
    assert not mark.exists()


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("python f.py {log}", r"holds no \{out\}, expected for example python my_ekf.py"),
        ("python 'f.py {log} {out}", "no closing quotation"),
        ("ekf=python f.py {log} {out}", "estimator 'ekf': expected up to 20 of a-z"),
    ],
)
def test_commands_that_are_none(text: str, reported: str) -> None:
    with pytest.raises(InputError, match=reported):
        parse([text])


def test_two_commands_need_two_names() -> None:
    one = "python f.py {log} {out}"
    assert list(parse([one, f"b={one}"])) == ["mine", "b"]
    with pytest.raises(InputError, match="two are called mine"):
        parse([one, one])
    for wrong in (0.0, float("nan"), float("inf")):
        with pytest.raises(InputError, match="--timeout"):
            parse([one], wrong)


def test_no_shell_reads_the_command(tmp_path: Path) -> None:
    (command,) = parse([f"true;touch {tmp_path}/b {{log}} {{out}}"]).values()
    with pytest.raises(EstimatorError, match="true;touch: cannot be started"):
        command(log_of_run(short_world("circle", 5), 0, "x"))
    assert not (tmp_path / "b").exists()


def test_a_changed_filter_is_not_taken_for_the_old_one(
    scenario: Path, program: Callable[[str], str], tmp_path: Path
) -> None:
    asked = read_study(MonteCarloConfig.of(scenario=str(scenario), filters=("ekf",), runs=3))
    out, counted = tmp_path / "out", tmp_path / "counted"
    count = f"\nwith open({str(counted)!r}, 'a') as file: file.write('x')\n"

    def runs(body: str, study: Study = asked, *, reuse: bool = False) -> int:
        counted.write_text("")
        commands = External(parse([program(body)]), reuse)
        outcome = run_study(study, out, external=commands)
        assert outcome.reused == study.config.runs - len(counted.read_text())
        assert kept_runs(study, out, parse([program(body)])) == 2 * study.config.runs
        assert kept_runs(study, out, parse([program(body + "# other")])) == study.config.runs
        return len(counted.read_text())

    more = Study(asked.config.model_copy(update={"runs": 5}), asked.scenario)
    assert runs(COPY + count) == 3
    assert runs(COPY + count) == 3, "never reused unasked"
    assert runs(COPY + count, reuse=True) == 0
    assert runs(COPY + count + "# changed", reuse=True) == 3, "the program's file is another"
    assert runs(COPY + count + "# changed", more, reuse=True) == 2


@pytest.mark.slow
def test_a_configuration_runs_no_command(
    scenario: Path, program: Callable[[str], str], tmp_path: Path
) -> None:
    mark, out = tmp_path / "ran", tmp_path / "out"
    command = program(COPY + f"\nPath({str(mark)!r}).touch()")
    works(*study(scenario, out, "--command", command), cwd=tmp_path)
    mark.unlink()
    read = [path for path in out.glob("*.*") if path.suffix not in (".png", ".html")]
    texts = [path.read_text() for path in read]
    assert len(texts) == 3
    assert not any(str(mark) in text or command in text for text in texts)
    again = ("montecarlo", "out/config.toml", "--out", "again")
    said = refused(*again, cwd=tmp_path)
    assert "names the command 'mine', which is never run from a file; give --command" in said
    assert not mark.exists()
    works(*again, "--command", command, cwd=tmp_path)
    for name in ("montecarlo.json", "runs.csv", "config.toml"):
        assert (out / name).read_bytes() == (tmp_path / "again" / name).read_bytes()


def again(page: Path) -> list[str]:
    """The command that a page says runs it again."""
    shown = re.search(r'<code tabindex="0">(.*?)</code>', page.read_text())
    return shlex.split(html.unescape(present(shown)[1]))


@pytest.mark.slow
def test_the_page_has_a_verdict_and_a_command_that_runs(
    scenario: Path, program: Callable[[str], str], tmp_path: Path
) -> None:
    """In the folder in which it was started; without its commands it is refused."""
    command = program(COPY)
    given = (f"it={command}", "--timeout", "99")
    works(*study(scenario, tmp_path / "it's out", "--command", *given), cwd=tmp_path)
    page = tmp_path / "it's out" / "report.html"
    assert re.search(r'<span class="verdict (agree|disagree|unverified)">NEES: ', page.read_text())
    name, *words = again(page)
    assert name == "slamcheck"
    assert words[-4:] == ["--command", *given]
    kept = (tmp_path / "it's out" / "montecarlo.json").read_bytes()
    works(*words, "--out", "again", cwd=tmp_path)
    assert (tmp_path / "again" / "montecarlo.json").read_bytes() == kept
    assert "give --command" in refused(*words[:-4], cwd=tmp_path)


def rows(estimate: Estimate, which: slice) -> Estimate:
    """Some of its poses."""
    time_s, pose, covariance = estimate.time_s, estimate.pose, estimate.pose_covariance
    return replace(
        estimate, time_s=time_s[which], pose=pose[which], pose_covariance=covariance[which]
    )


BROKEN: dict[str, tuple[Callable[[Estimate], object], str]] = {
    "stops half way": (
        lambda e: rows(e, slice(20)),
        "no pose at 40 s, where the log ends; its last is at 19 s",
    ),
    "few poses": (
        lambda e: rows(e, slice(0, None, 4)),
        "poses at 10 of the 40 instants with measurements, expected at 95 %",
    ),
    "not positive": (
        lambda e: replace(e, pose_covariance=-e.pose_covariance),
        "pose covariance of 1 s is not positive definite",
    ),
    "other ids": (
        lambda e: replace(e, landmark_id=e.landmark_id + 1000),
        "landmarks: none has an id of the log's",
    ),
    "no number": (
        lambda e: replace(e, pose=np.where(e.time_s[:, None] == 7.0, np.nan, e.pose)),
        "pose holds a value that is not a finite number",
    ),
    "backwards": (
        lambda e: rows(e, slice(None, None, -1)),
        "times: expected some, each after the one before",
    ),
    "nothing": (lambda e: None, "returned NoneType, expected an Estimate or a ExternalEstimate"),
    "an exception": (lambda e: 1 / 0, "ZeroDivisionError: division by zero"),
}  # fmt: skip


@pytest.mark.parametrize("how", BROKEN)
def test_an_estimate_that_is_no_whole_one_fails(how: str, scenario: Path) -> None:
    broken, reported = BROKEN[how]

    def mine(log: Log) -> Estimate:
        found = ekf(log)
        return broken(found) if log.name == "short-1" else found  # type: ignore[return-value]

    outcome = montecarlo(str(scenario), 2, estimators={"mine": mine})
    assert [(one.seed, one.reason) for one in outcome.failures["mine"]] == [(1, reported)]
    with pytest.raises(InputError, match="mine: all 2 runs failed; seed 0: "):
        montecarlo(str(scenario), 2, estimators={"mine": lambda log: broken(ekf(log))})  # type: ignore[dict-item, return-value]


def test_pairs_are_told_with_a_correction_for_their_number(scenario: Path) -> None:
    def shifted(log: Log) -> Estimate:
        found = ekf(log)
        return replace(found, pose=found.pose + (1.0, 0.0, 0.0))

    outcome = montecarlo(str(scenario), 12, ["ekf", "fej"], estimators={"mine": shifted})
    assert len(outcome.pairs) == 12
    pair = next(p for p in outcome.pairs if (p.first, p.what) == ("fej", "position_rmse"))
    assert (pair.lower, pair.higher) == (12, 0)
    assert pair.sign_p == pytest.approx(24 * 2 * 0.5**12)
    ratio = stats.t.ppf(1 - 0.025 / 24, 11) / stats.t.ppf(0.975, 11)
    wide, narrow = (np.ptp(one) for one in (pair.family_interval, pair.interval))
    assert wide == pytest.approx(ratio * narrow)
    assert pair.family_interval[1] < 0


def test_poses_are_found_by_their_times() -> None:
    world = short_world("circle-range-bearing", 40)
    given = ExternalEstimate.of(ekf(log_of_run(world, 0, "x")))
    exact = errors_of(given, world)
    late = errors_of(replace(given, time_s=given.time_s + 4e-4), world)
    assert np.array_equal(exact.position_square, late.position_square)
    between = rows_twice(given)
    assert len(between.time_s) == 2 * len(given.time_s) - 1
    assert np.array_equal(errors_of(between, world).position_square, exact.position_square)


def rows_twice(given: ExternalEstimate) -> ExternalEstimate:
    """With a wrong pose between every two."""
    order = np.arange(2 * len(given.time_s) - 1) / 2
    low = order.astype(int)
    off = (order % 1.0)[:, None] * 100.0
    return replace(
        given,
        time_s=given.time_s[low] + order % 1.0 * (given.time_s[1] - given.time_s[0]),
        pose=given.pose[low] + off,
        pose_covariance=present(given.pose_covariance)[low],
    )


def test_the_page_shows_every_filter_and_every_two(scenario: Path, tmp_path: Path) -> None:
    study = read_study(MonteCarloConfig.of(scenario=str(scenario), filters=("ekf",), runs=8))

    def mine(log: Log) -> Estimate:
        if log.name == "short-2":
            raise RuntimeError("<b>no</b>")
        return overconfident(ekf(log))

    outcome = run_study(study, tmp_path, external=External({"mine": mine}))
    write_montecarlo(outcome, tmp_path)
    page = (tmp_path / "report.html").read_text()
    order = ('class="verdict', "mine: 1 of 8 runs failed", "<table", 'id="curves"', 'id="pairs"',
             "<h2>Scenario</h2>", "runs this again")  # fmt: skip
    places = [page.index(part) for part in order]
    assert places == sorted(places)
    assert "seed 2: RuntimeError: &lt;b&gt;no&lt;/b&gt;" in page
    assert "above: too certain" in page
    for cells in (("ekf", "mine", "NEES of the pose"), ("ekf", "mine", "ATE [m]")):
        assert "".join(f"<td>{cell}</td>" for cell in cells) in page
    assert page.count(" of 7</td><td>") == 4, "pairs are over the runs that both have"
    assert "both tests of all 4 rows corrected together (Bonferroni, 95 % " in page
    data = json.loads(page.split('id="data">')[1].split("</script>")[0])
    names = {panel["title"]: {c["name"] for c in panel["curves"]} for panel in data["panels"]}
    assert names["mean NEES of pose (3 dof)"] == {"ekf", "mine"}
    assert names["mean NEES of landmarks (2 dof)"] == {"ekf"}, "an estimate has one map"
    rows = (tmp_path / "runs.csv").read_text().splitlines()
    assert len(rows) == 1 + 2 * 8
    assert "2,mine,,,,," in rows


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_study_that_is_ended_ends_the_command(
    number: signal.Signals, scenario: Path, program: Callable[[str], str], tmp_path: Path
) -> None:
    """With what the command has started, however the study is ended."""
    places, began = tmp_path / "places", tmp_path / "began"
    places.mkdir()
    body = (
        "import os, subprocess, time; child = subprocess.Popen(['sleep', '600']); "
        f"part = Path({str(began)!r} + '.part'); part.write_text(f'{{os.getpid()}} {{child.pid}}')"
        f"; part.rename({str(began)!r}); time.sleep(600)"
    )
    asked = study(scenario, tmp_path / "out", "--runs", "1", "--command", program(body))
    job = subprocess.Popen(
        (*SLAMCHECK, *asked), env={**ENVIRONMENT, "TMPDIR": str(places)}, stderr=subprocess.DEVNULL
    )
    while not began.exists() and job.poll() is None:
        time.sleep(0.02)
    started = [int(one) for one in began.read_text().split()]
    assert not any(gone(one, 0.0) for one in started)
    job.send_signal(number)
    assert job.wait(30) == (143 if number == signal.SIGTERM else -number)
    assert all(gone(one) for one in started)
    assert number == signal.SIGKILL or not list(places.iterdir())
