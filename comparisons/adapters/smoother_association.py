"""The smoother's own association of a log's measurements to landmarks, without the filter's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from comparisons.adapters.smoother_input import PositionRows, assemble
from comparisons.adapters.timeline import Timeline
from comparisons.arrays import Array, Index
from comparisons.logs.log import Log
from comparisons.logs.transforms.known_landmarks import surveyed
from graphslam.association import AssociationResult, associate
from graphslam.association_variants import Variant, associate_by
from graphslam.problem import SlamProblem
from graphslam.smoother import SmootherEvidence


@dataclass(frozen=True)
class SmootherAssociation:
    """landmark_index: (M,) of each measurement, negative where unused; surveyed ones first.

    problem: what is to be smoothed. poses: (K, 3) and landmarks: (L, 2), a start for that.
    """

    landmark_index: Index
    problem: SlamProblem
    poses: Array
    landmarks: Array


class Optimum(NamedTuple):
    """What other associations take from the smoother's optimum with the one found.

    last_pose: (3,). outliers: rows of the log's measurements that a robust method left out, as
    others do, too, and outlier_positions. kernel: of graphslam.graph_builder.KERNELS.
    """

    last_pose: Array
    outliers: Index
    outlier_positions: Index
    kernel: str

    @classmethod
    def of(cls, association: SmootherAssociation, result: SmootherEvidence) -> Optimum:
        """Return that of the result with an association."""
        used, rejected = np.flatnonzero(association.landmark_index >= 0), result.rejected
        kernel = result.options.kernel
        return cls(result.poses[-1], used[rejected.measurements], rejected.positions, kernel)


@dataclass(frozen=True)
class AlternativeAssociation:
    """Another association of the same measurements, and the optimum with it.

    name: of the way it was found. landmark_index: (M,). poses: (K, 3). chi2: at that optimum,
    infinite where there is none.
    """

    name: str
    landmark_index: Index
    poses: Array
    chi2: float


class OwnAssociator:
    """Associates the measurements of one log, by position alone, in one way or in several."""

    def __init__(
        self, log: Log, timeline: Timeline, rows: PositionRows, left_out: Index | None = None
    ) -> None:
        """Measurements of surveyed landmarks go by their ids. left_out: those not to be used.

        epoch_time_s: (K,) of the poses. time_s: (M,) of the measurements. open_rows: of those that
        are not of surveyed landmarks; problem: with these, to be decided.
        """
        self._log, self._timeline, self._rows = log, timeline, rows
        self.epoch_time_s: Array = timeline.epoch_time_s
        self.time_s: Array = timeline.epoch_time_s[timeline.measurement_epoch]
        index_of, self._places, _ = surveyed(log)
        label = log.measurements.landmark[: len(timeline.measurement_epoch)]
        self._fixed = np.array([index_of.get(key, -1) for key in label.tolist()], dtype=np.intp)
        free = self._fixed < 0
        if left_out is not None:
            self._fixed[left_out], free[left_out] = -1, False
        self.open_rows = np.flatnonzero(free)
        nobody = np.full(len(label), -1, dtype=np.intp)
        nobody[self.open_rows] = 0
        nothing = np.zeros((0, 2)), np.zeros((0, 2, 2))
        self.problem = replace(
            assemble(log, timeline, nobody, 1, rows),
            surveyed=nothing[0],
            surveyed_covariance=nothing[1],
        )

    def associate(self) -> SmootherAssociation:
        """Decide for every measurement."""
        return self._completed(associate(self.problem))

    def alternatives(
        self, variants: Sequence[Variant], optimum: Optimum
    ) -> list[AlternativeAssociation]:
        """Decide in other ways, and optimise with each. optimum: with the association found."""
        found = []
        for variant in variants:
            association = self._completed(associate_by(self.problem, variant, optimum.last_pose))
            found.append(self._optimised(variant.name, association, optimum))
        return found

    def _completed(self, result: AssociationResult) -> SmootherAssociation:
        """The same of all measurements, the surveyed landmarks coming first."""
        landmark_index, known = self._fixed.copy(), len(self._places)
        landmark_index[self.open_rows] = np.where(
            result.landmark_index >= 0, result.landmark_index + known, -1
        )
        problem = assemble(
            self._log, self._timeline, landmark_index, known + result.landmark_count, self._rows
        )
        places = np.vstack((self._places, result.landmarks))
        return SmootherAssociation(landmark_index, problem, result.poses, places)

    def _optimised(
        self, name: str, association: SmootherAssociation, optimum: Optimum
    ) -> AlternativeAssociation:
        """The optimum with another association."""
        from graphslam.graph_builder import build_graph, from_values, to_values
        from graphslam.optimisers import levenberg_marquardt

        problem, landmark_index = association.problem, association.landmark_index
        kept = ~np.isin(np.flatnonzero(landmark_index >= 0), optimum.outliers)
        fixes = np.ones(len(problem.position_pose), dtype=bool)
        fixes[optimum.outlier_positions] = False
        problem = problem.keep(kept, fixes)
        seen = np.union1d(problem.measurement_landmark, np.arange(len(self._places)))
        graph = build_graph(problem, optimum.kernel)
        start = to_values(association.poses, association.landmarks, seen, problem.pose_landmarks)
        try:
            end, *_ = levenberg_marquardt(graph, start, 1e-6)
        except RuntimeError:  # gtsam's indeterminate linear system
            return AlternativeAssociation(name, landmark_index, association.poses, float("inf"))
        return AlternativeAssociation(
            name, landmark_index, from_values(end, problem)[0], 2.0 * float(graph.error(end))
        )
