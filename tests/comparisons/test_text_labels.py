"""Landmarks that a log names by text keep their names: estimates, tables, map, causes."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import slamcheck
from comparisons.checks.diagnosis.departure import departure_from
from comparisons.errors import InputError
from comparisons.estimates.external import ExternalEstimate
from comparisons.estimates.folder import read_estimate, read_landmarks
from comparisons.jobs.check import check
from comparisons.jobs.grading import check_external
from comparisons.jobs.run import Comparison
from comparisons.logs.log import Log
from comparisons.pipeline.solve import solve
from comparisons.report.html.page import page
from comparisons.report.run import RunReport
from comparisons.report.solution import SolutionReport
from research.trust.odometry_drives import drive
from tests.comparisons.browser import noted
from tests.helpers import compared, present

NAMES = ["oak, old", "<b>elm</b>", *(f"post {k}" for k in range(40))]


def labelled_drive(steps: int) -> Log:
    """A short drive; its landmarks are numbered by first measurement."""
    found = drive(5, "velocity", steps)
    order = found.measurements.labels_in_order.tolist()
    number = np.array([order.index(one) for one in found.measurements.landmark.tolist()])
    labels = {NAMES[k]: k for k in range(len(order))}
    return replace(
        found,
        measurements=replace(found.measurements, landmark=number),
        provenance={"labels": json.dumps(labels)},
    )


@pytest.fixture(scope="module")
def log() -> Log:
    return labelled_drive(120)


@pytest.fixture(scope="module")
def run(log: Log) -> Comparison:
    return compared(log)


def test_a_report_has_the_names(run: Comparison, tmp_path: Path) -> None:
    RunReport.of(run).write(tmp_path / "out")
    for name in ("ekf", "smoother"):
        lines = (tmp_path / "out" / name / "landmarks.csv").read_text().splitlines()
        assert lines[1].startswith('"oak, old",')
        assert lines[2].startswith("<b>elm</b>,")
    text = (tmp_path / "out" / "report.html").read_text()
    assert "landmark oak, old: " in text
    assert "<td>&lt;b&gt;elm&lt;/b&gt;</td>" in text
    assert "<b>elm" not in text
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert json.loads(result["log"]["provenance"]["labels"])["post 0"] == 2
    assert run.ekf.estimate.to_pandas("landmarks")["label"].tolist()[:2] == NAMES[:2]


@pytest.mark.browser
def test_the_map_of_a_solution_has_the_names(log: Log, tmp_path: Path) -> None:
    """Without a table of landmarks, too, and a link may ask for one by its name."""
    report = tmp_path / "report.html"
    report.write_text(page(SolutionReport.of(solve(log)).page()), encoding="utf-8")
    steps = """
    noted.names = [...document.querySelectorAll('.names text')].map(one => one.textContent);
    location.hash = 'landmark=' + encodeURIComponent('<b>elm</b>');
    await new Promise(done => setTimeout(done, 50));
    noted.chosen = document.getElementById('chosen').textContent;
    """
    shown = noted(report, tmp_path, steps)
    assert set(shown["names"]) <= set(NAMES)
    assert {"oak, old", "<b>elm</b>"} <= set(shown["names"])
    assert shown["chosen"] == "smoother, landmark <b>elm</b>"


@pytest.mark.slow
def test_an_estimate_is_checked_by_names(log: Log, run: Comparison, tmp_path: Path) -> None:
    """In any order; wrong names put it elsewhere."""
    estimate = run.ekf.estimate
    slamcheck.write_estimate(estimate, tmp_path / "mine")
    assert read_estimate(tmp_path / "mine").names == estimate.names
    path = tmp_path / "mine" / "landmarks.csv"
    header, *rows = path.read_text().splitlines()
    path.write_text("\n".join([header, *rows]) + "\n")
    (tmp_path / "mine" / "covariances.npz").unlink()
    path.write_text("\n".join([header, *reversed(rows)]) + "\n")
    given = slamcheck.read_estimate(tmp_path / "mine")
    found = check(log, given)
    assert found.grade.value == "equal"
    assert not found.agreement.unmatched
    moved = present(given.landmark) + np.eye(len(rows))[:, :1] * 3.0
    wrong = check(log, replace(given, landmark=moved))
    assert any(f"landmark {estimate.names[-1]}" in one.evidence for one in wrong.causes)
    with pytest.raises(InputError, match=r"names landmarks by text .*, the log by numbers"):
        check(replace(log, provenance={}), given)


def test_causes_and_departure_say_names(log: Log, run: Comparison) -> None:
    """Also of the worst covariance, which was a row's number; ids where there are no names."""
    estimate = run.ekf.estimate
    given = ExternalEstimate.of(estimate)
    assert given.landmark is not None
    rows = np.arange(len(given.landmark))
    wrong = replace(
        given,
        pose=given.pose + (0.1, 0.0, 0.0) * (given.time_s >= 5.0)[:, None],
        landmark=given.landmark + (rows == 0)[:, None] * 3.0,
        landmark_covariance=present(given.landmark_covariance) * (2.0 + rows)[:, None, None],
    )
    for named, said in ((log, NAMES), (replace(log, provenance={}), [str(k) for k in rows])):
        found = check_external(replace(wrong, labels=named.labels), solve(named))
        timeline = found.solution.prepared.timeline
        left = present(departure_from(wrong, found.peers, named, timeline))
        first = said[left.landmarks[0]]
        assert f"of landmark{'s' * (len(left.landmarks) > 1)} {first}" in left.event
        evidence = "; ".join(one.evidence for one in found.causes)
        assert f"landmark {said[0]} most, by" in evidence
        assert f"landmark {said[len(rows) - 1]} most" in evidence
        assert re.search(r"landmark number|pose number", evidence) is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "id,x_m,y_m\noak,1,2\noak,1,2\n",
            "landmarks.csv:3: id 'oak' appears twice, expected each id once",
        ),
        ("id,x_m,y_m\noak,1,2\n,1,2\n", "landmarks.csv:3: id is empty"),
        ("id,x_m,y_m\noak,1,x\n", "landmarks.csv:2: 'y_m' is 'x', expected a finite number"),
        ("id,x_m,y_m\noak,1,1e300\n", "landmarks.csv:2: expected at most"),
    ],
)
def test_names_refused(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "landmarks.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        read_landmarks(tmp_path / "landmarks.csv")
