"""E, F1, F2 and S of one filter's run, whoever's filter it is, and the gaps between them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.adapters.recorded import recorded_predictions
from comparisons.adapters.smoother_input import (
    build_problem,
    model_steps,
    model_system_at,
    model_system_of,
    recorded_system_of,
    run_smoother,
    smoothed_estimate,
    solve_model,
    solve_recorded,
)
from comparisons.adapters.timeline import Timeline
from comparisons.arrays import Array
from comparisons.checks.agreement import (
    Agreement,
    Gap,
    Gaussian,
    compare,
)
from comparisons.covariances import covariance_gap, units
from comparisons.estimates.estimate import Estimate
from comparisons.logs.log import Log
from comparisons.pipeline.beside import BackgroundCall
from comparisons.pipeline.clock import Clock
from comparisons.rounding import FORMS, ROUNDING, Allowed, lost_of, rounding_of
from comparisons.shown import Brief
from ekf_reference.core.landmark_types import POINT
from ekf_reference.core.trace import TraceArrays
from graphslam.arrays import Marginal
from graphslam.linear_problem import LinearProblem, LinearRelations
from graphslam.problem import SlamProblem
from graphslam.smoother import SmootherEvidence, SmootherOptions

if TYPE_CHECKING:
    from comparisons.checks.diagnosis.linearisation_growth import LinearisationGrowth
    from comparisons.checks.diagnosis.model_differences import Events, ModelDifference

V = TypeVar("V")
Frozen = tuple[LinearProblem, LinearProblem, Marginal, Marginal]
"""The linear systems of F1 and F2, and the estimates that solve them."""
Optimum = tuple[SmootherEvidence, Estimate]
"""S with its evidence, and as an estimate."""
Solver = Callable[[SlamProblem, Array], Optimum]
"""Gives S of a problem whose poses are of times (K,)."""
PAYS_FROM = 120_000
"""Poses and measurements from which F1 and F2 are worth a second process."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Gaps(Brief):
    """The chain of estimates and its gaps.

    recorded: the linear system of F1, from the filter's own matrices. model: that of F2, from the
    smoother's factors linearised where the filter was. result, smoothed: S.
    """

    log: Log
    run: EkfRun
    problem: SlamProblem
    recorded: LinearProblem
    model: LinearProblem
    result: SmootherEvidence
    smoothed: Estimate
    agreement: Agreement

    @cached_property
    def rounding(self) -> Allowed:
        """What double precision explains of the algebra and the model gap."""
        last = Gaussian.of(self.smoothed)
        prior = self.problem.prior_covariance
        return rounding_of(prior, last.mean, last.covariance, last.layout.angles)

    @cached_property
    def algebra_rounding(self) -> Allowed:
        """What double precision explains of the algebra gap.

        Measured where the gap is more than `rounding`: what moving the records in their last places
        changes, and what sound recursions lose. A filter that broke down is not measured: what it
        may lose of what it knew least counts.
        """
        if self.run.breakdown:
            return self.rounding.at_least(self._lost)
        algebra = self.agreement.algebra
        if algebra.explained_by(self.rounding):
            return self.rounding
        unit = units(self.run.estimate.joint_covariance, self._f1.covariance)  # as of the gap
        moved = self._moved(self.solved, self._f1, algebra, unit)
        return moved.at_least_of(self._recursion())

    @cached_property
    def model_rounding(self) -> Allowed:
        """What double precision explains of the model gap, measured where that is more.

        F2 is not moved where the filter's own pose has other entries than the log's.
        """
        model = self.agreement.model
        if model.explained_by(self.rounding):
            return self.rounding
        unit = np.sqrt(np.diag(self.smoothed.joint_covariance))
        moved = self._moved(self.solved, self._f1, model, unit)
        if self.run.trace.departed.shape[1:] != self.run.departed.shape[1:]:
            return moved
        modelled = self.model_solved(self.run.trace)
        return moved.at_least_of(self._moved(self.model_solved, modelled, model, unit))

    @cached_property
    def _f1(self) -> Gaussian:
        return Gaussian(*solve_recorded(self.recorded, self.run), self.run.estimate.layout)

    @property
    def _lost(self) -> float:
        """What a filter may lose that forgets as much as a single step of this run forgets."""
        noise, last = np.einsum("kii->i", self.run.trace.q), self.smoothed.joint_covariance
        return lost_of(noise[:2].max(), noise[2:].max(), last)

    def _moved(
        self, solve: Callable[[TraceArrays], Gaussian], stored: Gaussian, least: Gap, sigma: Array
    ) -> Allowed:
        """What moving the records in their last places changes, at least `rounding`.

        sigma: (n,) units of the means, those of the gap.
        """
        from comparisons.checks.diagnosis.single_precision import rounding_gap

        moved = rounding_gap(solve, stored, self.run.trace, sigma, least)
        return self.rounding.at_least_of(moved)

    def _recursion(self) -> Allowed:
        """Ten times what a sound recursion through the recorded matrices loses, where it counts."""
        if not self._lost > ROUNDING:
            return self.rounding
        from comparisons.audit.own_filter import sound_recursion

        found = sound_recursion(self.run)
        if found is None:
            return self.rounding
        other, errors = found
        exact = self._f1.covariance
        unit = units(other, exact)
        lost = covariance_gap(other, exact, unit).largest
        mean = float(np.max(np.abs(errors) / unit))
        return self.rounding.at_least_of(Allowed(FORMS * mean, FORMS * lost))

    def solved(self, trace: TraceArrays) -> Gaussian:
        """F1 of other records of the same run."""
        other = replace(self.run, trace=trace)
        return Gaussian(*solve_recorded(recorded_system_of(other), other), other.estimate.layout)

    def model_solved(self, trace: TraceArrays) -> Gaussian:
        """F2 where other records of the same run say that it was."""
        run = self.run
        until = run.timeline.steps_until()
        departed, arrived = run.departed.copy(), run.arrived.copy()
        left = until < len(trace.departed)
        departed[left] = trace.departed[until[left]]
        arrived[until > 0] = trace.arrived[until[until > 0] - 1]
        other = replace(run, trace=trace, departed=departed, arrived=arrived)
        system = model_system_of(self.problem, other)
        return Gaussian(*solve_model(system, other), run.estimate.layout)

    @cached_property
    def _model_steps(self) -> LinearRelations | None:
        return model_steps(self.log, self.problem, self.run)

    def by_steps(self, recorded: LinearProblem, trace: TraceArrays) -> LinearProblem:
        """Return a trace's equations with its steps as those of the smoother's model are.

        That is one by one, as they were recorded, where it has single steps to compare: composed
        between two measurements a wrong Jacobian stands in the noise, too.
        """
        single = self._model_steps is not None
        until = np.arange(len(trace.f) + 1) if single else self.run.timeline.steps_until()
        return replace(recorded, motion=recorded_predictions(trace, until))

    def model_differences(
        self, stored: Mapping[tuple[str, str], float] | None = None
    ) -> tuple[ModelDifference, ...]:
        """Return where F1's and F2's equations differ by more than rounding, and storing."""
        from comparisons.checks.diagnosis.model_differences import model_differences
        from comparisons.checks.diagnosis.sensor_records import sensor_pairs

        said, problem = self.by_steps(self.recorded, self.run.trace), self.model
        if self._model_steps is not None:
            problem = replace(problem, motion=self._model_steps)
        return model_differences(
            said,
            problem,
            ROUNDING,
            self.initialised,
            stored or {},
            self._events(),
            sensor_pairs(self.log, self.run, self.model),
        )

    def _events(self) -> dict[str, Events]:
        """Return when each relation of the trace was used."""
        from comparisons.checks.diagnosis.model_differences import (
            INITIALISATIONS,
            POSITIONS,
            PREDICTIONS,
            UPDATES,
            Events,
        )

        times, trace = self.run.timeline, self.run.trace
        epoch_s, new = times.epoch_time_s, trace.initialisations[POINT]
        seen = trace.measurements[POINT].number, new.number[new.weight > 0.0]
        fix = trace.positions.number
        steps = epoch_s[1:] if self._model_steps is None else times.step_end_s
        return {
            PREDICTIONS: Events(steps),
            POSITIONS: Events(epoch_s[times.position_epoch[fix]], fix),
            **{
                kind: Events(epoch_s[times.measurement_epoch[number]], number)
                for kind, number in zip((UPDATES, INITIALISATIONS), seen, strict=True)
            },
        }

    @property
    def initialised(self) -> int:
        """How many measurements initialised a point."""
        return int(np.count_nonzero(self.run.trace.initialisations[POINT].weight > 0.0))

    def linearisation_growth(self) -> LinearisationGrowth:
        """Return where linearising cost something."""
        from comparisons.checks.diagnosis.linearisation_growth import linearisation_growth

        # All pose landmarks by landmark index, merged ones among them.
        whole = replace(self.smoothed, pose_landmarks=self.result.pose_landmarks())
        return linearisation_growth(
            self.model, model_system_at(self.problem, self.run, whole), whole
        )


def optimum_of(
    run: EkfRun, options: SmootherOptions, clock: Clock, progress: Callable[[str, int, int], None]
) -> Solver:
    """Return what solves for S from where a filter was, among other starts."""

    def solved(problem: SlamProblem, time_s: Array) -> Optimum:
        with clock.stage("smoother"):
            result = run_smoother(problem, run, options, lambda stage: progress(stage, 0, 0))
        with clock.stage("marginals"):
            progress("marginals", 0, 0)
            ids, names = run.estimate.landmark_id, run.estimate.labels
            return result, smoothed_estimate(result, time_s, ids, "the EKF's", names)

    return solved


def compute_gaps(
    log: Log,
    run: EkfRun,
    optimum: Solver,
    clock: Clock,
    progress: Callable[[str, int, int], None],
    timeline: Timeline | None = None,
    *,
    covariance_known: bool = True,
) -> Gaps:
    """Solve F1, F2 and S, and compare.

    optimum: gives S. timeline: of the log's own steps, where the run's are others.
    covariance_known: without E's joint covariance F1 takes E's place, and the algebra gap is no
    evidence. Raises numpy.linalg.LinAlgError where a recorded covariance is singular, and
    SingularProblemError where there is no solution.
    """
    own = run.timeline if timeline is None else timeline
    problem = build_problem(log, replace(run, timeline=own))
    size = problem.pose_count, len(problem.z), problem.landmark_count
    with clock.stage("frozen"):  # beside S where they take long, for none needs another
        progress("fixed-linearisation smoothers", 0, 0)
        work = BackgroundCall(solve_frozen, problem, run, size=size, pays_from=PAYS_FROM)
    with work:
        frozen = None if work.elsewhere else _finished(work, clock)
        try:
            result, smoothed = optimum(problem, own.epoch_time_s)
        except Exception:
            if frozen is None:
                work.result()  # its error comes first, wherever it is found
            raise
        recorded, model, first, second = frozen or _finished(work, clock)
    f1 = Gaussian(*first, run.estimate.layout)
    return Gaps(
        log=log,
        run=run,
        problem=problem,
        recorded=recorded,
        model=model,
        result=result,
        smoothed=smoothed,
        agreement=compare(
            Gaussian.of(run.estimate) if covariance_known else f1,
            f1,
            Gaussian(*second, run.estimate.layout),
            Gaussian.of(smoothed),
        ),
    )


def solve_frozen(problem: SlamProblem, run: EkfRun) -> Frozen:
    """Return F1 and F2. Raises as compute_gaps does."""
    recorded, model = recorded_system_of(run), model_system_of(problem, run)
    return recorded, model, solve_recorded(recorded, run), solve_model(model, run)


def _finished(work: BackgroundCall[Frozen], clock: Clock) -> Frozen:
    with clock.stage("frozen"):
        found = work.result()
    clock.add_cpu("frozen", work.cpu_s)
    return found
