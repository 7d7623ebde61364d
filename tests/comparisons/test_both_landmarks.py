"""Points and pieces of scans in one filter, with Scan-SLAM itself in the loop."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import LEAST_GAIN
from comparisons.adapters.ekf_run import EkfRun
from comparisons.config import EkfConfig, Filter
from comparisons.errors import InputError
from comparisons.extensions.scan_landmarks.source import ScanSlamSource
from comparisons.jobs.run import Comparison, Modified, run_filter
from comparisons.logs.log import Log
from comparisons.pipeline.prepare import prepare
from comparisons.settings import run_config
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import Index
from ekf_reference.core.landmark_types import POINT, LandmarkKind
from ekf_reference.filters.compressed import CompressedState, LocalAreas
from tests.helpers import compared, present, simulated, written
from tests.scenarios import scenario

AREAS = 4.0, 10.0
"""Small, so that areas are left and landmarks are passive. Measurements of points go no farther."""
REACH_M = 18.0
"""The scanner's."""


@cache
def log() -> Log:
    """Twenty seconds of a loop, by sensors that do not see far."""
    made = scenario("scan-loop-fine", seed=3, seconds=20.0)
    assert made.scans is not None
    near = np.where(made.scans.range_m < REACH_M, made.scans.range_m, np.nan)
    seen = made.measurements.chosen(made.measurements.range_m < AREAS[1])
    return replace(made, scans=replace(made.scans, range_m=near), measurements=seen)


class Areas:
    """Gives a filter small areas, and remembers its state."""

    def __init__(self, made: type[CompressedState] = CompressedState, gain: float = 0.0) -> None:
        self.made, self.areas = made, LocalAreas(*AREAS, gain)

    def __call__(self, ekf: Ekf) -> None:
        ekf.state = self.state = self.made(log().prior.pose, log().prior.covariance, self.areas)


def nothing(ekf: Ekf) -> None:
    """As it is."""


@cache
def by_filter(name: str) -> Comparison:
    ekf = EkfConfig.model_validate({"filter": name})
    modify: Callable[[Ekf], None] = nothing
    if name.startswith("compressed"):
        modify = Areas(gain=LEAST_GAIN if ekf.conservative else 0.0)
    return compared(log(), Modified(modify), ekf=ekf, landmarks="both")


@pytest.mark.slow
@pytest.mark.parametrize("name", get_args(Filter))
def test_every_filter_agrees_with_both_kinds_of_landmarks(name: str) -> None:
    c = by_filter(name)
    assert len(c.agreement.landmarks) == len(c.ekf.estimate.landmark) > 5
    assert len(c.agreement.pose_landmarks) == len(c.ekf.estimate.pose_landmarks) >= 3
    a = c.agreement.algebra
    if c.prepared.ekf.conservative:  # not exact, and never too sure
        assert a.sigma < 1e-6 < a.covariance < 0.01
        assert a.least > 1.0 - 1e-6
        assert present(c.ekf.compression).global_update_spared > 0.05
    else:
        assert a.within(1e-6)
    if name == "misono":  # as published, it knows only part of its Jacobian
        assert [cause.gap for cause in c.verdict.causes] == ["model"]
        assert not c.agreement.model.within(1e-2)
        return
    assert c.verdict.outcome == "agree"
    assert c.agreement.model.within(1e-6)
    if name.startswith("compressed"):
        assert present(c.ekf.compression).global_updates > 0


def ran(modify: Callable[[Ekf], None]) -> tuple[EkfRun, int]:
    """A run of the filter alone, and how many scans there were."""
    run, setup = run_filter(prepare(log(), run_config(landmarks="both"), also=[Modified(modify)]))
    source = present(setup.find(ScanSlamSource))
    return run, source.found.scans


class AtEveryScan(CompressedState):
    """Broken: asking who is near makes a global update."""

    def within(self, reach_m: float, kind: LandmarkKind = POINT) -> Index:
        self._global_update()
        return super().within(reach_m, kind)


@pytest.mark.slow
def test_scans_cost_no_global_update() -> None:
    """Only to leave an area does, which takes the vehicle so many metres at least."""
    areas, broken = Areas(), Areas(AtEveryScan)
    run, scans = ran(areas)
    way = np.abs(np.diff(run.estimate.pose[:, :2], axis=0)).max(axis=1).sum()
    most = way / AREAS[0] + 2
    assert scans > 2 * most
    assert len(areas.state.updates) <= most
    ran(broken)
    assert len(broken.state.updates) > scans


@pytest.mark.slow
def test_the_run_is_written_with_both_kinds(tmp_path: Path) -> None:
    folder = written(by_filter("compressed"), tmp_path / "out")
    for name in ("landmarks.csv", "scan_landmarks.csv"):
        assert (folder / "ekf" / name).exists()
    assert "EKF scan landmarks, 3 sigma" in (folder / "report.html").read_text()


@pytest.mark.slow
def test_what_goes_beside_both_and_what_does_not() -> None:
    mapped = compared(
        log(),
        Modified(Areas()),
        filter="compressed",
        association="nn",
        landmarks="both",
        dense=["points"],
        dynamic=True,
        smoother_association="own",
        motion="both",
    )
    assert mapped.verdict.outcome == "agree"
    assert mapped.agreement.model.within(1e-6)
    with pytest.raises(InputError, match="has no planar scans"):
        compared(simulated(), landmarks="both")
