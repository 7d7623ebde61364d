from __future__ import annotations

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.ekf_run import run_ekf
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.timeline import build_timeline
from comparisons.config import EkfConfig
from ekf_reference.core.ekf import Ekf
from ekf_reference.dense.view import FilterView
from tests.ekf_reference.dense.drives import scans
from tests.helpers import simulated


def test_it_shows_pose_landmarks_and_their_joint_covariance() -> None:
    ekf = list(scans(simulated(loop_s=8.0)))[-1][1]
    view = FilterView.of(ekf)
    near = view.near(12.0)
    assert 2 < len(near) < len(view.landmark)
    columns = np.concatenate((np.arange(3), (3 + 2 * near[:, None] + (0, 1)).ravel()))
    assert np.array_equal(view.joint(near), ekf.state.covariance[np.ix_(columns, columns)])
    assert np.array_equal(view.pose, ekf.state.pose)
    with pytest.raises(ValueError, match="read-only"):
        view.landmark[0] = 0.0


@pytest.mark.parametrize("name", ["compressed", "misono"])
def test_every_filter_is_read_as_pose_and_landmarks(name: str) -> None:
    """The last view of a run is what the run's estimate says, pose as x, y, heading."""
    log = simulated(loop_s=40.0)
    kept: list[Ekf] = []
    run = run_ekf(
        log,
        build_timeline(log),
        settle(EkfConfig(filter=name), log),
        setup=FilterSetup(modify=[kept.append]),
    )
    view = FilterView.of(kept[0])
    assert np.allclose(view.pose, run.estimate.pose[-1], atol=1e-12)
    assert np.allclose(view.landmark, run.estimate.landmark, atol=1e-12)
    near = view.near(15.0)
    columns = np.concatenate((np.arange(3), (3 + 2 * near[:, None] + (0, 1)).ravel()))
    whole = run.estimate.joint_covariance
    assert np.allclose(view.joint(near), whole[np.ix_(columns, columns)], atol=1e-15)


def test_glancing_leaves_a_compressed_filter_as_it_is() -> None:
    """Passive landmarks stay as the last global update left them, and no bit changes."""
    log = simulated(loop_s=40.0)
    timeline, choices = build_timeline(log), settle(EkfConfig(filter="compressed"), log)

    def final(*, watched: bool) -> np.ndarray:
        def watch(ekf: Ekf) -> None:
            if not watched:
                return
            predict = ekf.predict

            def glanced(*given: object) -> None:
                predict(*given)  # type: ignore[arg-type]
                FilterView.of(ekf)

            ekf.predict = glanced  # type: ignore[method-assign, assignment]

        estimate = run_ekf(log, timeline, choices, setup=FilterSetup(modify=[watch])).estimate
        return np.concatenate((estimate.landmark.ravel(), estimate.joint_covariance.ravel()))

    assert np.array_equal(final(watched=True), final(watched=False))
