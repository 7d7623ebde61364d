"""The main job on gtsam's Victoria Park, and the real logs beside the project."""

from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from comparisons.checks.association import AssociationFinding
from comparisons.jobs.run import Comparison
from comparisons.logs.bundled import open_log
from comparisons.report.run import RunReport
from comparisons.report.terminal import print_summary
from tests.helpers import assert_followed, compared, first_seconds, present
from tests.test_own_project import missing

README = (Path(__file__).resolve().parents[2] / "README.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_victoria_park_disagrees_through_linearisation(victoria_park: Comparison) -> None:
    c = victoria_park
    assert len(c.smoother.poses) == 6969
    assert len(c.ekf.estimate.landmark) == 151
    assert abs(c.smoother.error - 3173.49) < 0.01
    assert c.smoother.optimality.verified
    assert set(c.smoother.optimality.agreeing) == {"ekf", "relaxed"}
    assert_followed(c, 1e-6)
    assert c.agreement.linearisation.sigma > 3.0
    assert c.agreement.optimism < 0.05
    assert c.verdict.outcome == "disagree"
    assert [cause.gap for cause in c.verdict.causes] == ["linearisation"]
    assert any("too low" in remark for remark in c.verdict.remarks)


@pytest.mark.slow
def test_the_readme_shows_what_the_main_job_prints(victoria_park: Comparison) -> None:
    printed = StringIO()
    summary = RunReport.of(victoria_park).summary()
    print_summary(summary, Console(file=printed), "slamcheck-victoria-park", verbose=False)
    shown = README.split("`make run` prints\n\n```\n")[1].split("```")[0]
    assert missing(shown, printed.getvalue()) == []
    assert missing(shown.replace("14.052", "14.053"), printed.getvalue()) != []


def test_car_park(shared_data: Path) -> None:
    c = compared(open_log(str(shared_data / "acfr_car_park")))
    assert c.prepared.ekf.association == "nn"
    assert_followed(c, 1e-6)
    assert c.smoother.optimality.verified
    for accuracy in (c.accuracy.ekf, c.accuracy.smoother):
        assert accuracy is not None
        assert accuracy.landmarks_found == accuracy.landmarks_true == 15
        assert present(accuracy.landmark_rmse_m) < 0.30
        assert present(accuracy.coverage) > 0.99


@pytest.mark.slow
@pytest.mark.parametrize("robot", [1, 2, 3])
def test_mrclam(shared_data: Path, robot: int) -> None:
    log = open_log(str(shared_data / "mrclam" / "MRCLAM_Dataset6"), robot=robot)
    c = compared(log, association="known")
    assert_followed(c, 1e-6)
    assert c.smoother.optimality.verified
    assert c.ekf.unused["rejected"] == (4 if robot == 3 else 0)  # one misread label, four times
    for accuracy in (c.accuracy.ekf, c.accuracy.smoother):
        assert accuracy is not None
        assert accuracy.landmarks_found == 15
        assert present(accuracy.landmark_rmse_aligned_m) < 0.12


@pytest.mark.slow
@pytest.mark.parametrize(("robot", "recall"), [(1, 0.93), (2, 0.97), (3, 0.97)])
def test_mrclam_with_its_labels_hidden(shared_data: Path, robot: int, recall: float) -> None:
    log = open_log(str(shared_data / "mrclam" / "MRCLAM_Dataset6"), robot=robot)
    score = present(compared(log, association="consensus").known.value(AssociationFinding))
    assert present(score.clusters).precision > 0.99
    assert present(score.clusters).recall > recall


def test_victoria_park_detections_read_whole(shared_data: Path) -> None:
    log = open_log(str(shared_data / "victoria_park"))
    assert log.records == {"odometry": 61945, "measurements": 52974, "positions": 4466}
    straight_ahead = np.abs(log.measurements.bearing_rad) <= np.pi / 2 + 1e-9
    assert straight_ahead.all()


@pytest.mark.slow
def test_victoria_park_detections_run(shared_data: Path) -> None:
    """The first minutes, by nearest neighbour: both gaps at rounding."""
    log = first_seconds(open_log(str(shared_data / "victoria_park")), 120.0)
    c = compared(log)
    assert_followed(c, 1e-6)
