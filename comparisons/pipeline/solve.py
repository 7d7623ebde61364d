"""The smoother alone: one log to its optimum, without a filter."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from comparisons.adapters.smoother_association import Optimum, OwnAssociator, SmootherAssociation
from comparisons.adapters.smoother_input import (
    assemble,
    position_rows,
    smooth_problem,
    smoothed_estimate,
)
from comparisons.arrays import Array, Index
from comparisons.checks.accuracy import Accuracy, AccuracyFinding
from comparisons.checks.association import AssociationFinding, AssociationScore
from comparisons.checks.association_variants import (
    AssociationCheck,
    AssociationVariants,
    check_association,
)
from comparisons.checks.check import Answers, FromJob, Question
from comparisons.checks.optimum import lacking
from comparisons.checks.registry import BASIS, CHECKS, OF_SOLUTION
from comparisons.config import EkfConfig, SolveConfig
from comparisons.errors import InputError
from comparisons.estimates.estimate import Estimate
from comparisons.explain.disagreement import disagreement
from comparisons.explain.edges import EdgeReading, explained, few_misread
from comparisons.figures import rounded
from comparisons.logs.log import Log
from comparisons.logs.transforms.known_landmarks import indices_by_label
from comparisons.pipeline.beside import ASSOCIATION_PAYS_FROM, BackgroundCall
from comparisons.pipeline.clock import Progress, no_progress
from comparisons.pipeline.known import Known
from comparisons.pipeline.prepare import Required, check_memory, prepare
from comparisons.pipeline.prepared import Prepared
from comparisons.shown import Shown, render
from graphslam.association_variants import variants
from graphslam.smoother import SmootherEvidence, SmootherOptions
from graphslam.unclosed import Unclosed, unclosed_passage

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, kw_only=True)
class Solution(Shown):
    """Hold what the smoother found on its own.

    Attributes:
        prepared: The log as the smoother read it, and the configuration.
        landmark_index: (M,) landmark index of each of the log's measurements, negative where
            unused.
        result: The optimum with the evidence for it.
        estimate: Smoothed poses and landmarks.
        association_check: How its own association compares with others made without labels.
        misread: How edges fit that do not as they are read; None where they do, or none is known.
        disagreeing: Which edges do not agree where none fits otherwise; empty where all do.
        few: How the few edges fit whose information is far from that of the others; None where
            there are none, or they do not.
        unclosed: Poses of a graph nearer to each other than its edges tell; None where these do.
    """

    prepared: Prepared[SolveConfig]
    landmark_index: Index
    result: SmootherEvidence
    estimate: Estimate
    association_check: AssociationCheck | None
    misread: EdgeReading | None = None
    disagreeing: str = ""
    few: EdgeReading | None = None
    unclosed: Unclosed | None = None

    def __repr__(self) -> str:
        """Return log, error and whether that is verified, in one line."""
        word = "verified" if self.verified else "not verified"
        return f"<Solution of {self.log.name}: error {self.result.error:.2f}, {word}>"

    def to_pandas(self, table: Literal["poses", "landmarks", "settings"] = "poses") -> DataFrame:
        """Return a table as a pandas data frame.

        Args:
            table: `poses` and `landmarks` of the estimate, as `Estimate.to_pandas` has them;
                `settings`: value and default of each.

        Returns:
            The table, one row for each of what it lists; no rows where there is none.

        Raises:
            InputError: pandas is not installed, or there is no such table.
        """
        found: DataFrame = render("frame", self, table)
        return found

    @cached_property
    def answers(self) -> Answers:
        """Of the checks, when they are asked for."""
        known = Known(
            prepared=self.prepared,
            solved=(self.result, self.estimate),
            landmark_index=self.landmark_index,
            timeline=self.prepared.timeline,
            positions=self.prepared.positions,
        )
        checks: list[Question[Known]] = [*BASIS, *OF_SOLUTION, *CHECKS]
        if self.association_check is not None:
            variants = AssociationVariants(self.association_check)
            checks.append(FromJob("association_check", variants))
        return Answers(known, checks)

    @property
    def known(self) -> Known:
        """What is known of the log, with what the checks find that need no filter."""
        return self.answers.known

    @property
    def dead_reckoned(self) -> Array:
        """(K, 3) poses where the odometry alone leads."""
        return self.answers.before.dead_reckoned

    @property
    def accuracy(self) -> Accuracy | None:
        """Errors of the estimate; None without truth and positions."""
        return (self.known.value(AccuracyFinding) or {}).get("smoother")

    @property
    def association(self) -> AssociationScore | None:
        """How its own association compares with the log's labels; None where it used them."""
        return self.known.value(AssociationFinding)

    @property
    def verified(self) -> bool:
        """Nothing is lacking."""
        return not self.lacks

    @property
    def is_misread(self) -> bool:
        """Whether edges fit that do not as they are read, so that no sigma means what it says."""
        return self.misread is not None and not self.misread.is_note

    @property
    def lacks(self) -> list[str]:
        """What is lacking for `verified`: edges, the optimum, the smoother's own association."""
        optimality = self.result.optimality
        found = [optimality.lacks] if self.is_misread else lacking(optimality)
        return [*self.doubts, *filter(None, found)]

    @property
    def doubts(self) -> list[str]:
        """What is lacking but for the optimum's own evidence: how edges are read, association."""
        found = [self._reading(self.misread)] if self.misread and self.is_misread else []
        found += [self.disagreeing] if self.disagreeing else []
        checked = self.association_check
        return found if checked is None else [*found, *checked.remarks]

    def _reading(self, reading: EdgeReading) -> str:
        """Say how edges fit, and how well."""
        chi2 = self.result.optimality.chi_square.chi2
        return (
            f"{reading.words}: chi-square {rounded(reading.chi_square.chi2)} for "
            f"{reading.chi_square.dof} degrees of freedom in place of {rounded(chi2)}"
        )

    @property
    def notes(self) -> list[str]:
        """What a graph's file says of its vertices' frame, and of edges far from the others."""
        said = self.log.provenance
        extreme = [said["extreme"]] if "extreme" in said else []
        if extreme and self.few is not None:
            extreme = [f"{extreme[0]}; {self._reading(self.few)}"]
        noted = [self._reading(self.misread)] if self.misread and not self.is_misread else []
        return [*([said["vertices"]] if "vertices" in said else []), *extreme, *noted]

    @property
    def open_loops(self) -> list[str]:
        """Where the graph's optimum need not be the map's."""
        one = self.unclosed
        if one is None:
            return []
        return [
            f"this is the optimum of the graph, but places may be in its map twice: poses "
            f"{one.first:,} and {one.second:,} lie {one.apart_m:.2g} m apart without a loop "
            f"closure between them; by the edges, sigma of their relative pose is "
            f"{one.sigma_m:.2g} m and {np.degrees(one.sigma_rad):.2g} degrees"
        ]

    @property
    def log(self) -> Log:
        """The log as the smoother read it."""
        return self.prepared.log

    @property
    def association_by(self) -> str:
        """`known` by the log's labels, or the smoother's `own`."""
        return "known" if self.prepared.labelled else "own"


def prepare_solve(
    log: Log, config: SolveConfig, progress: Progress = no_progress
) -> Prepared[SolveConfig]:
    """Return a log as `solve` reads it. Raises InputError for what the log cannot serve."""
    labelled = log.measurements.labelled
    known = labelled if config.association is None else config.association == "known"
    if log.loop_closures is not None and not known:
        raise InputError(f"{log.name}: holds closures, expected measurements associated by labels")
    gps = config.gps
    if gps == "off" and log.positions is not None and log.prior.open:
        gps = "on"
    ekf = EkfConfig(association="known" if known else "nn", gps=gps)
    other = "use slamcheck odometry for its scans"
    required = Required(None if log.loop_closures is not None else other, other, loop_closures=True)
    return prepare(log, config, ekf, progress, required)


def solve(
    log: Log, config: SolveConfig | None = None, progress: Progress = no_progress
) -> Solution:
    """Associate, solve and assess.

    Raises InputError for what the log cannot serve, and graphslam.marginals.SingularProblemError
    when there is no solution.
    """
    config = config or SolveConfig()
    prepared = prepare_solve(log, config, progress)
    known = prepared.labelled
    check_memory(prepared)
    log, clock, timeline = prepared.log, prepared.clock, prepared.timeline
    guesses, association, associator = {}, None, None
    with clock.stage("association"):
        rows = position_rows(timeline, prepared.positions)
        if known:
            landmark_index, ids = indices_by_label(log)
            problem = assemble(log, timeline, landmark_index, len(ids), rows)
        else:
            progress("association", 0, 0)
            associator = OwnAssociator(log, timeline, rows)
            association = associator.associate()
            landmark_index, problem = association.landmark_index, association.problem
            ids = np.arange(problem.landmark_count)
            guesses["association"] = (association.poses, association.landmarks)
    if not len(ids) and log.loop_closures is None:
        raise InputError(
            f"{log.name}: no measurement could be used, so there is no map to solve for"
        )
    with clock.stage("smoother"):
        options = SmootherOptions(**config.smoother.model_dump())
        result = smooth_problem(problem, guesses, lambda stage: progress(stage, 0, 0), options)
    with clock.stage("marginals"):
        progress("marginals", 0, 0)
        name, labels = ("known", log.labels) if known else ("own", {})
        estimate = smoothed_estimate(result, timeline.epoch_time_s, ids, name, labels)
    with clock.stage("edges"):
        is_graph = log.format == "g2o" or log.loop_closures is not None
        misread = explained(result) if is_graph else None
        disagreeing = disagreement(result) if is_graph and misread is None else ""
        few = few_misread(result.problem) if "extreme" in log.provenance else None
        told = misread is None or misread.is_note  # else no sigma means what it says
        unclosed = unclosed_passage(result, estimate.pose_covariance) if told else None
    checked = None
    if association is not None and associator is not None:
        with clock.stage("association check"):
            progress("association check", 0, 0)
            checked = _check(prepared, associator, association, result, estimate)
    return Solution(
        prepared=prepared,
        landmark_index=landmark_index,
        result=result,
        estimate=estimate,
        association_check=checked,
        misread=misread,
        disagreeing=disagreeing,
        few=few,
        unclosed=unclosed,
    )


def _check(
    prepared: Prepared[SolveConfig],
    associator: OwnAssociator,
    association: SmootherAssociation,
    result: SmootherEvidence,
    estimate: Estimate,
) -> AssociationCheck:
    """Compare the association with others of the same measurements, two at a time."""
    problem, clock, ways = result.problem, prepared.clock, variants()
    given = Optimum.of(association, result)
    size = problem.pose_count, len(associator.time_s), problem.landmark_count
    second = BackgroundCall(
        associator.alternatives, ways[1::2], given, size=size, pays_from=ASSOCIATION_PAYS_FROM
    )
    with second:
        associations = [*associator.alternatives(ways[::2], given), *second.result()]
    clock.add_cpu("association check", second.cpu_s)
    order = [way.name for way in ways]
    associations.sort(key=lambda association: order.index(association.name))
    dof = problem.residual_dimension - problem.state_dimension
    optimum = (result.poses, estimate.pose_covariance, 2.0 * result.error, dof)
    return check_association(association.landmark_index, associator.time_s, optimum, associations)
