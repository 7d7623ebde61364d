"""The scan landmarks of a run as the smoother's own matcher sees them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from comparisons.adapters.beam_noise import sensor_of
from comparisons.adapters.ekf_run import EkfRun
from comparisons.adapters.scan_source import CloudsAt, ScanSource
from comparisons.adapters.smoother_input import build_problem
from comparisons.logs.log import Log
from comparisons.logs.odometry import RelativePoses
from comparisons.logs.stamps import resolved
from ekf_reference.scan_landmarks.templates import Template as FiltersTemplate
from graphslam.problem import SlamProblem
from graphslam.scan import planar
from graphslam.scan.open3d_matchers import GeneralisedMatcher
from graphslam.scan.template_matchers import Template, TemplateMatchers
from graphslam.scan.template_measurements import (
    TemplateMeasurements,
    TemplateOptions,
    measure_templates,
)


def own_measurements(
    log: Log,
    run: EkfRun,
    templates: Mapping[int, FiltersTemplate],
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[SlamProblem, TemplateMeasurements]:
    """What the smoother is to solve, its scan landmarks measured by Open3D's generalised ICP.

    Of the filter it takes which returns of which scan a template was made of, and where its axis
    was put; none of its alignments, no pose, and not which landmarks it fused. templates: by
    landmark index, as they were initialised. Raises ValueError for a log without planar scans, and
    graphslam.scan.libraries.MissingLibraryError.
    """
    if log.scans is None:
        raise ValueError("the log has no planar scans")
    source, problem = ScanSource(log), build_problem(log, run)
    settings = source.suited_options()
    scan_of = _scan_of_epoch(log, source, run)
    taken = {}
    for landmark_index, template in templates.items():
        epoch = int(
            problem.pose_landmarks.pose[problem.pose_landmarks.landmark == landmark_index].min()
        )
        place = planar.compose(log.scans.mount.pose, template.pose)
        returns = source.points(scan_of[epoch])
        shape = np.column_stack((template.shape.mean, np.zeros(len(template.shape))))
        row = cKDTree(returns).query(planar.moved(place, shape))[1]
        own = planar.moved(planar.between(place, np.zeros(3)), returns[row])
        taken[landmark_index] = Template(epoch, place, own)
    found = measure_templates(
        problem,
        taken,
        CloudsAt(source, scan_of, settings),
        TemplateMatchers(settings, GeneralisedMatcher),
        TemplateOptions.suited(settings, sensor_of(log.scans).sigma_range_m),
        progress,
    )
    return replace(problem, pose_landmarks=found.factors), found


def _scan_of_epoch(log: Log, source: ScanSource, run: EkfRun) -> dict[int, int]:
    """Numbers of scans by the epochs that they were taken at."""
    epochs = run.timeline.epoch_time_s
    time_s = source.time_s if isinstance(log.odometry, RelativePoses) else resolved(source.time_s)
    at = np.minimum(np.searchsorted(epochs, time_s), len(epochs) - 1)
    scans = np.flatnonzero(epochs[at] == time_s)
    return dict(zip(at[scans].tolist(), scans.tolist(), strict=True))
