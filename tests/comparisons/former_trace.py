"""Writes `trace.npz` as slamcheck 0.2 did, which is still read."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.ekf_run import EkfRun
from ekf_reference.core.landmark_types import POINT
from tests.helpers import Array


def write_trace(run: EkfRun, path: Path) -> None:
    trace, ids = run.trace, run.estimate.landmark_id
    arrays: dict[str, Array | NDArray[np.integer]] = {
        "prior_pose": trace.prior_pose,
        "prior_covariance": trace.prior_covariance,
        "step_time_s": run.timeline.step_end_s,
        "step_departed": trace.departed,
        "step_arrived": trace.arrived,
        "step_f": trace.f,
        "step_q": trace.q,
    }
    for part, records, other in (
        ("update", trace.measurements[POINT], "landmark"),
        ("initialise", trace.initialisations[POINT], "measurement"),
    ):
        arrays |= {
            f"{part}_step": records.step,
            f"{part}_measurement": records.number,
            f"{part}_landmark": ids[records.landmark_index],
            f"{part}_pose": records.pose,
            f"{part}_point": records.landmark,
            f"{part}_jacobian_pose": records.jacobian_pose,
            f"{part}_jacobian_{other}": records.jacobian_other,
            f"{part}_noise": records.noise,
            f"{part}_weight": records.weight,
        }
    arrays["update_innovation"] = trace.measurements[POINT].innovation
    for name in ("step", "number", "pose", "innovation", "jacobian_pose", "noise", "weight"):
        arrays[f"position_{name}"] = getattr(trace.positions, name)
    np.savez_compressed(path, **arrays)  # type: ignore[arg-type]
