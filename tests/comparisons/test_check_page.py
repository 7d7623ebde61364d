"""The page of `slamcheck check`: as a run's, as far as what was handed in goes."""

import hashlib
import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from comparisons.checks.consistency.finding import (
    ConsistencyFinding,
    consistency_result,
    external_consistency_result,
)
from comparisons.config import CheckConfig
from comparisons.estimates.external import ExternalEstimate, read_external
from comparisons.estimates.folder import write_estimate
from comparisons.estimates.trajectory_files import Trajectory, write_trajectory
from comparisons.figures import stored
from comparisons.jobs.check import check
from comparisons.jobs.external_check import ExternalCheck
from comparisons.jobs.readings import FAULT, MOTION, READINGS
from comparisons.jobs.run import Comparison
from comparisons.report.check import EXTERNAL, CheckReport, check_ladder
from comparisons.report.figures.run import map_figure
from comparisons.report.html.page import page
from comparisons.report.ladder import SMOOTHER
from comparisons.report.marks import Panel
from comparisons.report.panels import external_panels
from tests.comparisons.browser import came_up, look
from tests.comparisons.test_html_report import HOSTILE, data_of, read
from tests.helpers import compared, present, simulated


@cache
def run() -> Comparison:
    """The reference EKF, standing in for somebody's filter, beside the smoother."""
    return compared(simulated(loop_s=20.0))


@cache
def filtered() -> ExternalEstimate:
    return ExternalEstimate.of(run().ekf.estimate)


@cache
def sound() -> ExternalCheck:
    return check(run().log, filtered())


def bare(given: ExternalEstimate) -> ExternalEstimate:
    return ExternalEstimate(time_s=given.time_s, pose=given.pose)


def overconfident(given: ExternalEstimate) -> ExternalEstimate:
    """From half of the way on its pose covariances are a hundredth of what they should be."""
    late = given.time_s > given.time_s[len(given.time_s) // 2]
    return replace(
        given,
        pose_covariance=present(given.pose_covariance) * np.where(late, 0.01, 1.0)[:, None, None],
    )


def html(found: ExternalCheck) -> str:
    return page(CheckReport.of(found).page())


def named(panels: tuple[Panel, ...], curve: str) -> list[Panel]:
    return [panel for panel in panels if panel.curves[0].name == curve]


def layers(text: str) -> list[str]:
    return re.findall(r'data-name="([^"]*)"', text)


def test_everything_that_was_handed_in_is_on_the_page() -> None:
    text = html(sound())
    shown = layers(text)
    for name in ("truth", "true landmarks", "smoother trajectory", "smoother landmarks",
                 "estimate trajectory", "estimate landmarks", "estimate landmarks, 3 sigma",
                 "reference EKF trajectory", "differences", "variance ratio, least"):  # fmt: skip
        assert name in shown, name
    assert shown.index("reference EKF trajectory") < shown.index("estimate trajectory")
    order = [text.index(part) for part in ('class="verdict agree"', 'id="map"', "<table", "RPE")]
    assert order == sorted(order)
    assert text.count("<tr data-key=") == len(run().smoothed.landmark)
    assert "off truth [m]" in text
    data = data_of(text)
    assert set(data["tracks"]) == {"smoother", "estimate", "reference EKF"}
    titles = [panel["title"] for panel in data["panels"]]
    assert len(titles) == 9 + 3  # east, north and heading of the paths
    assert {"NEES of the pose (3 dof)", "pose's difference, squared"} < set(titles)


def test_the_ladder_starts_at_the_estimate() -> None:
    """With covariances and map: to the reference that it equals, and to the smoother."""
    result = CheckReport.build(sound())
    reference, optimum = check_ladder(result)
    assert (reference.above, reference.below) == (EXTERNAL, "reference EKF")
    assert present(reference.sigma) < 1e-6
    assert reference.state == "passes"
    assert (optimum.above, optimum.below) == (EXTERNAL, SMOOTHER)
    assert optimum.error_m == result.rms_m
    assert optimum.sigma == max(
        one.distance_sigma for one in (*result.landmarks, result.last_pose) if one is not None
    )
    text = html(sound())
    assert "slamcheck check config.toml" in text
    assert "The estimate equals the reference EKF to rounding." in text


@pytest.mark.slow
def test_a_wrong_estimate_fails_where_it_is_wrong() -> None:
    """Of a path that is five times too long neither the filter nor the optimum is near."""
    stretched = replace(bare(filtered()), pose=filtered().pose * (5.0, 5.0, 1.0))
    result = CheckReport.build(check(run().log, stretched))
    steps = check_ladder(result)
    assert result.grade == "wrong"
    assert [step.state for step in steps] == ["fails", "fails"]
    assert [cause.gap for cause in result.causes] == ["scale"]  # by which it equals the filter
    sound = check_ladder(CheckReport.build(check(run().log, bare(filtered()))))
    assert "fails" not in [step.state for step in sound]


def test_consistency_is_judged_as_the_run_judges_its_own_filter() -> None:
    found, own = sound(), consistency_result(run().consistency)
    given = external_consistency_result(found.consistency)
    assert stored(present(given.truth)) == stored(present(own.ekf))
    theirs, ours = (one.filter_against_smoother for one in (given, own))
    assert theirs is not None
    assert ours is not None
    assert theirs.squared_per_dof == pytest.approx(ours.squared_per_dof, rel=1e-6)
    assert (theirs.epochs, theirs.overconfident_epochs) == (ours.epochs, ours.overconfident_epochs)


def test_the_band_is_what_the_future_took_away() -> None:
    found = sound()
    east = named(external_panels(found)[1], "estimate - smoother")[0]
    gap = run().ekf.estimate.pose_covariance - run().smoothed.pose_covariance
    sure = np.isfinite(east.bands[0].high)
    assert np.count_nonzero(sure) > 90
    expected = 3.0 * np.sqrt(np.maximum(gap[:, 0, 0], 0.0))
    assert east.bands[0].high[sure] == pytest.approx(expected[sure], abs=1e-6)
    assert east.bands[0].high[sure] != pytest.approx(
        3.0 * np.sqrt(run().ekf.estimate.pose_covariance[sure, 0, 0]), rel=0.01
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"information": "smoothed"}, "the test needs filtered poses, and these are smoothed"),
        ({"information": "fixed-lag"}, "these are fixed-lag"),
        ({"information": None}, ""),
        ({"information": None, "pose": 0.5}, "does not say whether its poses are filtered"),
    ],
)
def test_no_band_is_drawn_where_none_is_justified(given: dict[str, Any], reason: str) -> None:
    """One that says nothing is taken for what a reference is that it is like, if any."""
    moved = replace(
        filtered(), information=given["information"], pose=filtered().pose + given.get("pose", 0.0)
    )
    found = check(run().log, moved)
    reported, panels = external_panels(found)
    bands = [panel.bands for panel in named(panels, "estimate - smoother")]
    assert len(bands) == (3 if reason else 4)
    assert not any(bands) if reason else all(bands)
    assert reason in reported
    assert reason in found.consistency.unjudged
    assert all(panel.bands for panel in named(panels, "estimate - truth"))


@pytest.fixture
def unsearched(monkeypatch: pytest.MonkeyPatch) -> None:
    """No fault is looked for, which would take minutes and change nothing of what is drawn."""
    kinds = [kind for kind in READINGS if kind not in (FAULT, MOTION)]
    monkeypatch.setattr("comparisons.jobs.check.READINGS", kinds)


@pytest.mark.slow
@pytest.mark.usefixtures("unsearched")
def test_no_band_is_drawn_where_the_filter_is_surer() -> None:
    found = check(run().log, overconfident(filtered()))
    assert "filter inconsistent" in found.qualifiers
    assert "The estimate is inconsistent: NEES of the poses" in html(found)
    reported, panels = external_panels(found)
    high = named(panels, "estimate - smoother")[0].bands[0].high
    half = len(high) // 2
    assert np.isfinite(high[:half]).all()
    assert np.isnan(high[half + 2 : -2]).all()
    assert "but where the estimate's covariance is the smaller one" in reported
    lack = named(panels, "estimate - smoother")[0].bands[0].lack
    assert lack == "the estimate claims less variance than the smoother"
    squared = named(panels, "estimate - smoother")[3]
    clear = present(found.consistency.smoothed).dof > 0
    assert not clear.all()
    assert (np.isfinite(squared.curves[0].y) == clear).all()
    assert (np.isfinite(squared.bands[0].high) == clear).all()


def test_without_labels_there_is_no_band() -> None:
    found = check(run().log, filtered(), CheckConfig(association="own"))
    assert "different associations" in found.consistency.unjudged
    text = html(found)
    assert " in the estimate)" in text
    assert "different associations" in text


def test_what_was_not_handed_in_is_left_out_with_a_word(tmp_path: Path) -> None:
    found = check(run().log, bare(filtered()))
    result = CheckReport.build(found)
    CheckReport(found, result).write(tmp_path / "out")
    written = json.loads((tmp_path / "out" / "check.json").read_text())
    assert {"map.png", "report.html"} < set(written["files"])
    assert written["consistency"]["truth"] is None
    text = (tmp_path / "out" / "report.html").read_text()
    read(tmp_path / "out" / "report.html")
    assert "The estimate has no pose covariances: no bands, and no NEES." in text
    assert "The estimate has no landmarks" in text
    assert "estimate landmarks" not in layers(text)
    assert "variance ratio, least" not in layers(text)
    panels = data_of(text)["panels"]
    errors, paths = panels[:6], [panel for panel in panels if "truth" in names_of(panel)]
    assert len(panels) == 7 + len(paths)
    assert len(paths) == 3
    assert not any(panel["bands"] for panel in panels if panel not in paths)
    lacks = [present(re.fullmatch("no 3 sigma: (.*)", *panel["lacks"]))[1] for panel in errors]
    assert lacks == ["there are no covariances of poses"] * 3 + [found.consistency.unjudged] * 3
    for panel in paths:
        assert [band["name"] for band in panel["bands"]] == ["smoother, 3 sigma"]
        assert panel["lacks"] == ["no 3 sigma of estimate: no covariances of poses"]


def names_of(panel: dict[str, Any]) -> list[str]:
    """Of a panel's curves."""
    return [curve["name"] for curve in panel["curves"]]


def test_without_truth_there_are_no_errors_against_it() -> None:
    from comparisons.logs.log import Truth

    text = html(check(replace(run().log, truth=Truth()), filtered()))
    assert "The log has no true poses in the estimate&#x27;s time" in text
    assert "off truth" not in text
    assert "truth" not in layers(text)
    panels = data_of(text)["panels"]
    assert len(panels) == 5 + 3
    assert not any("truth" in names_of(panel) for panel in panels)


def test_landmarks_without_covariances_or_counterparts_are_drawn() -> None:
    own = replace(
        bare(filtered()),
        landmark_id=np.append(present(filtered().landmark_id)[:5], 999),
        landmark=np.vstack((present(filtered().landmark)[:5], (3.0, 4.0))),
    )
    found = check(run().log, own)
    text = html(found)
    assert text.count("<tr data-key=") == 5
    assert present(found.accuracy).landmarks_found == 5
    assert present(found.accuracy).landmark_rmse_m is not None
    assert "The estimate has none, so there are no ratios." in text
    assert "estimate landmarks without a counterpart" in layers(text)
    assert "estimate landmarks, 3 sigma" not in layers(text)
    assert "not in the estimate" in text


@pytest.mark.slow
def test_one_far_away_does_not_hide_the_map() -> None:
    found = check(run().log, bare(filtered()))
    far = check(run().log, replace(bare(filtered()), pose=filtered().pose + (5e5, 4e6, 0.0)))
    metres = [re.search(r'data-metres="([^"]*)"', html(one)) for one in (found, far)]
    assert float(present(metres[1])[1]) == pytest.approx(float(present(metres[0])[1]), rel=0.1)
    assert "The estimate trajectory leaves the map." in html(far)
    assert "leaves the map" not in html(found)


def test_what_log_and_estimate_are_called_is_text() -> None:
    result = CheckReport.build(sound())
    hostile = result.model_copy(
        update={
            "config": {"estimate": HOSTILE},
            "log": result.log.model_copy(update={"name": HOSTILE}),
            "remarks": [HOSTILE],
        }
    )
    text = page(CheckReport(sound(), hostile).page())
    assert text.count("<script") == 2
    assert "<img" not in text


def test_a_long_estimate_leaves_a_page_of_less_than_5_mb() -> None:
    """Of 60,000 poses, which the curves and the map thin out."""
    found, poses = sound(), 60_000
    row = np.arange(poses) % len(found.consistency.time_s)
    time_s = np.arange(float(poses))
    c = found.consistency
    assert c.smoothed is not None
    part = np.arange(poses) % len(c.smoothed.time_s)
    smoothed = replace(
        c.smoothed,
        time_s=time_s,
        **{n: getattr(c.smoothed, n)[part] for n in ("error", "sigma", "squared", "dof", "ratio")},
    )
    optimum, peers = (
        [
            replace(r, time_s=time_s, pose=r.pose[row], pose_covariance=r.pose_covariance[row])
            for r in some
        ]
        for some in ((found.optimum,), found.peers)
    )
    long = replace(
        found,
        given=replace(
            filtered(),
            time_s=time_s,
            pose=filtered().pose[row],
            pose_covariance=present(filtered().pose_covariance)[row],
        ),
        optimum=optimum[0],
        peers=tuple(peers),
    )
    wide = replace(c, time_s=time_s, difference=c.difference[row], smoothed=smoothed)
    findings = {**found.known.findings, "consistency": ConsistencyFinding(wide, "estimate")}
    long = replace(long, before=replace(found.known, findings=findings))
    assert len(page(CheckReport(long, CheckReport.build(found)).page())) < 2_500_000


def shifted(given: ExternalEstimate, since: int) -> ExternalEstimate:
    """From a pose on it is 1 m too far east."""
    pose = given.pose.copy()
    pose[since:, 0] += 1.0
    return replace(given, pose=pose)


@pytest.mark.slow
@pytest.mark.usefixtures("unsearched")
def test_the_first_departure_is_said_and_marked(tmp_path: Path) -> None:
    """In the text, on the page's and the picture's map, and on every curve."""
    since = 60
    found = check(run().log, shifted(filtered(), since))
    left, result = present(found.departure), CheckReport.build(found)
    assert left.time_s == filtered().time_s[since]
    assert left.place == tuple(found.given.pose[since, :2])
    said = f"first difference from the reference EKF at {left.time_s:.9g} s"
    summary = CheckReport(found, result).summary()
    assert [*summary.reasons, *summary.remarks][0].startswith(said)
    assert "first difference" in [row.quantity for row in summary.rows]
    text = html(found)
    layer = re.search(r'data-name="first difference".*?</g>', text)
    assert said in present(layer)[0]
    panels, start_s = external_panels(found)[1], data_of(text)["start"]
    assert {moment.x for panel in panels for moment in panel.moments} == {left.time_s}
    marks = [panel["moments"] for panel in data_of(text)["panels"]]
    assert len(marks) == len(panels) + 3
    assert all(start_s + one[0]["x"] == pytest.approx(left.time_s) for one in marks)
    axis = map_figure(found).axes[0]
    drawn = [line for line in axis.lines if line.get_label() == "first difference"]
    assert drawn[0].get_xydata() == pytest.approx(np.array([left.place]))
    CheckReport(found, result).write(tmp_path / "out")
    written = json.loads((tmp_path / "out" / "check.json").read_text())
    assert written["departure"]["time_s"] == left.time_s


def test_what_is_equal_departs_nowhere() -> None:
    assert sound().departure is None
    assert "first difference" not in html(sound())
    assert not any(panel.moments for panel in external_panels(sound())[1])


def test_the_files_that_were_judged_are_named_by_their_hashes(tmp_path: Path) -> None:
    folder = tmp_path / "ekf"
    folder.mkdir()
    write_estimate(run().ekf.estimate, folder)
    (folder / "notes.txt").write_text("not read")
    given = read_external(folder)
    assert sorted(given.sha256) == [
        "covariances.npz", "estimate.toml", "landmarks.csv", "trajectory.tum",
    ]  # fmt: skip
    for name, found in given.sha256.items():
        assert found == hashlib.sha256((folder / name).read_bytes()).hexdigest()
    assert CheckReport.build(check(run().log, given)).estimate_sha256 == given.sha256
    assert CheckReport.build(sound()).estimate_sha256 == {}
    write_trajectory(Trajectory(given.time_s, given.pose), tmp_path / "a.txt", "kitti")
    assert sorted(read_external(tmp_path / "a.txt").sha256) == ["a.txt", "times.txt"]


@pytest.mark.slow
@pytest.mark.browser
@pytest.mark.usefixtures("unsearched")
@pytest.mark.parametrize(("made", "figures"), [(bare, 10), (overconfident, 12)])
def test_a_browser_shows_it(tmp_path: Path, made: Any, figures: int) -> None:
    """Where a band has a gap it is drawn in pieces, none of which spans the gap."""
    path = tmp_path / "report.html"
    path.write_text(html(check(run().log, made(filtered()))), encoding="utf-8")
    dom = look(f"{path.as_uri()}#time=15", tmp_path / "profile")
    assert came_up(dom)
    said = r"no 3 sigma at \d+ of \d+ instants: the estimate claims less variance than the smoother"
    assert bool(re.search(said, dom)) == (made is overconfident)
    assert "none to none" not in dom
    assert dom.count("<figure>") == figures
    assert len(re.findall(r'<circle class="now"[^>]* visibility="visible"', dom)) == 3
    bands = re.findall(r'<path d="([^"]*)"[^>]* class="band"', dom)
    assert (len(bands) == 3) == (made is bare)  # the smoother's alone
    if made is overconfident:
        widths = [
            max(x) - min(x)
            for x in ([float(v) for v in re.findall(r"[ML]([\d.]+),", band)] for band in bands[4:7])
        ]
        whole = [float(v) for v in re.findall(r"[ML]([\d.]+),", bands[0])]
        assert max(widths) < 0.7 * (max(whole) - min(whole))
