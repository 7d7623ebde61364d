"""A trace is compared as it was recorded: what differs is named, and nothing beside it."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from comparisons.adapters.ekf_run import EkfRun, run_ekf
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.timeline import build_timeline
from comparisons.arrays import Array
from comparisons.checks.diagnosis.model_differences import ModelDifference
from comparisons.config import CheckConfig, EkfConfig
from comparisons.estimates.external import read_external
from comparisons.faults.fault import Plant, observing
from comparisons.faults.models import FAULTS, gx_times, h_times
from comparisons.jobs import external_trace
from comparisons.jobs.external_check import ExternalCheck
from comparisons.jobs.grading import check_external
from comparisons.logs.log import Log
from comparisons.logs.simulate.drive import Drive, simulate
from comparisons.logs.simulate.worlds import nieto_loop
from comparisons.pipeline.clock import Clock, no_progress
from comparisons.pipeline.gaps import Gaps, compute_gaps, optimum_of
from comparisons.pipeline.solve import solve
from ekf_reference.core.landmark_types import POINT
from ekf_reference.core.trace import TraceArrays
from graphslam.smoother import SmootherOptions
from tests.comparisons.kinds_of_logs import velocity
from tests.comparisons.test_external_trace import hand_in
from tests.helpers import present

CHOICES = EkfConfig(filter="full", association="known")


@cache
def all_round() -> Log:
    """A drive past landmarks on its path, which then lie straight behind."""
    world = nieto_loop()
    world = replace(world, landmark=world.path[:: len(world.path) // 60])
    drive = Drive(
        loop_s=20.0,
        sample_s=0.1,
        scan_every=10,
        field_of_view_rad=2.0 * np.pi,
        sigma_steering_rad=np.radians(10.0),
    )
    return simulate(np.random.default_rng(5), drive, world)


def filtered(log: Log, plant: Plant | None = None) -> EkfRun:
    setup = FilterSetup(modify=[] if plant is None else [plant])
    return run_ekf(log, build_timeline(log), CHOICES, None, setup)


def gaps_of(log: Log, run: EkfRun) -> Gaps:
    optimum = optimum_of(run, SmootherOptions(), Clock(), no_progress)
    return compute_gaps(log, run, optimum, Clock(), no_progress)


def named(found: tuple[ModelDifference, ...]) -> set[tuple[str, str]]:
    return {(one.relation, one.quantity) for one in found}


def of_noise(own: Any, z: Array, sigma: Array) -> Any:
    return own(z, 2.0 * sigma)


def of_range(own: Any, z: Array, sigma: Array) -> Any:
    return own(z + np.array((0.1, 0.0)), sigma)


UPDATES, NEW = "measurement updates", "landmark initialisations"
POSITION, HEADING, LANDMARK, BY_Z = (
    f"the Jacobian with respect to {name}"
    for name in ("position", "heading", "the landmark", "the measurement")
)
RESIDUAL, NOISE = "the innovation", "the noise covariance"
RECORDS: dict[str, tuple[Plant, set[tuple[str, str]]]] = {
    "H by the position": (h_times(1.5, pose=np.s_[:, :, :2]), {(UPDATES, POSITION)}),
    "H by the heading": (h_times(-1.0, pose=np.s_[:, 1, 2:]), {(UPDATES, HEADING)}),
    "H by the landmark": (h_times(0.5, landmark=np.s_[:, 1]), {(UPDATES, LANDMARK)}),
    "H by the landmark's range": (h_times(-1.0, landmark=np.s_[:, 0]), {(UPDATES, LANDMARK)}),
    "H by position and landmark": (
        h_times(-1.0, pose=np.s_[:, 1, :2], landmark=np.s_[:, 1]),
        {(UPDATES, POSITION), (UPDATES, LANDMARK)},
    ),
    "R": (observing(measured=of_noise), {(UPDATES, NOISE), (NEW, NOISE)}),
    "range": (observing(measured=of_range), {(UPDATES, RESIDUAL), (NEW, RESIDUAL)}),
    "G_z": (present(FAULTS["R not rotated by G_z"].plant), {(NEW, BY_Z)}),
    "G_x": (gx_times(0.5), {(NEW, HEADING)}),
}


@pytest.mark.parametrize("record", RECORDS)
def test_what_differs_is_named_and_nothing_beside(record: str) -> None:
    plant, expected = RECORDS[record]
    log = velocity()
    found = gaps_of(log, filtered(log, plant))
    assert named(found.model_differences()) == expected


def test_a_place_alone_mixes_records(monkeypatch: pytest.MonkeyPatch) -> None:
    """Broken: without the records a wrong H by the landmark is a wrong residual and R, too."""
    log, (plant, expected) = velocity(), RECORDS["H by the landmark"]
    found = gaps_of(log, filtered(log, plant))
    from comparisons.checks.diagnosis import sensor_records

    monkeypatch.setattr(sensor_records, "sensor_pairs", lambda *_: {})
    mixed = named(found.model_differences())
    assert mixed > {(UPDATES, RESIDUAL), (UPDATES, NOISE)}
    assert mixed.isdisjoint(expected)


def scaled(run: EkfRun) -> EkfRun:
    """The same filter, whose residuals are in other units: multiplied by a matrix each."""
    r = run.trace.measurements[POINT]
    by = np.array([[3.0, 0.5], [-1.0, 20.0]])
    other = replace(
        r,
        innovation=r.innovation @ by.T,
        jacobian_pose=by @ r.jacobian_pose,
        jacobian_other=by @ r.jacobian_other,
        noise=by @ r.noise @ by.T,
    )
    measurements = {**run.trace.measurements, POINT: other}
    return replace(run, trace=replace(run.trace, measurements=measurements))


def test_residuals_in_other_units_are_no_difference() -> None:
    log = velocity()
    assert not gaps_of(log, scaled(filtered(log))).model_differences()
    plant, expected = RECORDS["H by the heading"]
    found = gaps_of(log, scaled(filtered(log, plant)))
    assert named(found.model_differences()) == expected


def checked(log: Log, run: EkfRun, folder: Path) -> ExternalCheck:
    hand_in(run, folder)
    return check_external(read_external(folder), solve(log, CheckConfig()))


def wrapped(trace: TraceArrays) -> TraceArrays:
    """The trace of a filter that wraps its heading after every event."""

    def short(pose: Array) -> Array:
        return np.column_stack((pose[:, :2], np.angle(np.exp(1j * pose[:, 2]))))

    seen, new = trace.measurements[POINT], trace.initialisations[POINT]
    return replace(
        trace,
        departed=short(trace.departed),
        arrived=short(trace.arrived),
        measurements={**trace.measurements, POINT: replace(seen, pose=short(seen.pose))},
        initialisations={**trace.initialisations, POINT: replace(new, pose=short(new.pose))},
    )


def expected_wrapped(own: Any, z: Array, predicted: Array) -> Array:
    """Off by a turn where expected and measured bearing lie on either side of the cut."""
    wrapped = predicted.copy()
    wrapped[..., 1] = np.angle(np.exp(1j * predicted[..., 1]))
    return z - wrapped


NOT_WRAPPED = observing(innovation=expected_wrapped)


@pytest.mark.parametrize("change", [lambda trace: trace, wrapped], ids=["as it is", "wrapped"])
def test_a_residual_that_is_not_wrapped_is_no_algebra(
    tmp_path: Path, change: Callable[[TraceArrays], TraceArrays], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Corrections turn the heading by more than half a turn: by how much, they say themselves."""
    log = all_round()
    run = filtered(log, NOT_WRAPPED)
    corrections = run.trace.departed[1:, 2] - run.trace.arrived[:-1, 2]
    assert np.abs(corrections).max() > np.pi
    run = replace(run, trace=change(run.trace))
    found = present(checked(log, run, tmp_path / "a").trace)
    assert present(found.algebra).within(1e-6)
    assert [one.gap for one in found.verdict.causes] == ["model"]
    assert "innovations are not wrapped" in found.verdict.causes[0].hint
    monkeypatch.setattr(external_trace, "_SURE_TURN_RAD", np.inf)  # broken
    found = present(checked(log, run, tmp_path / "b").trace)
    assert present(found.algebra).sigma > 1.0
