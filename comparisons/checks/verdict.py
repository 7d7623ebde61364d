"""From gaps to a verdict and its causes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from comparisons.adapters.ekf_run import EkfRun
from comparisons.audit.spurious import Learnt
from comparisons.checks import causes as cause
from comparisons.checks.agreement import EXACT, Agreement, Allowed, Gap
from comparisons.checks.consistency.consistency import Consistency
from comparisons.checks.diagnosis.data_usage import DataFault
from comparisons.config import FailOn
from comparisons.figures import rounded
from comparisons.statistics import ROUNDING
from comparisons.words import Cause, Decides
from graphslam.optimum import ChiSquareTest, Optimality
from graphslam.smoother import SmootherResult

if TYPE_CHECKING:
    from comparisons.checks.diagnosis.dropouts import Dropouts
    from comparisons.checks.diagnosis.linearisation_growth import LinearisationGrowth
    from comparisons.checks.diagnosis.model_differences import ModelDifference

SPARED_SIGMA = 0.05
"""Largest difference of the means that sparing part of the covariance may cause, in sigma."""

_UNTOLD = 0.05
"""Share of sigma from which a difference counts: what rounding hides up to there is no verdict."""
_TOLD = 1e-4
"""Rounding up to which nothing is said of it."""

_SHOWN = 2
"""Figures outside their bands that a summary names."""

Outcome = Literal["agree", "disagree", "unverified"]
RULES: dict[Decides, Outcome] = {"always": "disagree", "open": "unverified", "verified": "disagree"}
"""What decides an outcome, the first one first; without any of these it is `agree`."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The outcome, its causes (worst kind first), and remarks that change nothing.

    qualifiers: what a reader of the outcome must know as well. inconsistent: what of the filter's
    consistency is outside its band, None where nothing shows it. failed_on: those of `--fail-on`
    that the run fails on, whatever the outcome. See checks.qualifiers.
    """

    outcome: Outcome
    causes: tuple[Cause, ...]
    remarks: tuple[str, ...]
    qualifiers: tuple[str, ...] = ()
    inconsistent: tuple[str, ...] | None = None
    failed_on: tuple[FailOn, ...] = ()

    @property
    def headline(self) -> str:
        """The outcome with its qualifiers."""
        return ", ".join((self.outcome, *self.qualifiers))

    @property
    def summary(self) -> str:
        """The outcome with its qualifiers, and whether the filter is consistent, with figures."""
        found = self.inconsistent
        if not found:
            return (
                f"{self.headline}; filter "
                f"{'consistent' if found == () else 'consistency not judged'}"
            )
        *others, last = (self.outcome, *self.qualifiers)
        more = len(found) - _SHOWN
        shown = "; ".join(found[:_SHOWN]) + (f"; {more} more" if more > 0 else "")
        return f"{', '.join(others)}; {last} ({shown})"


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """What explains a gap; each is looked for only where there is one.

    differences: where the models differ. operations: which events make the filter's algebra wrong,
    and how. unnamed: what to check where none is found.
    explanations: known mistakes that reproduce the records. growth: where linearising cost
    something. spurious: what the filter learnt of its heading from what cannot tell it. dropouts:
    stretches without observations. consistency: of the innovations. log: what is wrong with it,
    where chi-square is too high. The last three explain a disagreement, or an optimum that is not
    verified, and never make one.
    single: how the algebra gap grows, if computing in single precision explains it. algebra,
    model: the gaps that rounding explains.
    """

    differences: Callable[[], Sequence[ModelDifference]] = tuple
    operations: Callable[[], Sequence[str]] = tuple
    unnamed: str = cause.ALGEBRA_HINT
    known_model_errors: Callable[[], Sequence[str]] = tuple
    growth: Callable[[], LinearisationGrowth | None] = lambda: None
    spurious: Callable[[], Learnt | None] = lambda: None
    dropouts: Callable[[], Dropouts | None] = lambda: None
    consistency: Consistency | None = None
    log: Callable[[ChiSquareTest], Sequence[Cause]] = lambda test: ()
    single: str = ""
    algebra: Allowed = EXACT
    model: Allowed = EXACT

    @property
    def hidden(self) -> float:
        """What double precision hides of either gap; 0 where that is what storing does."""
        return 0.0 if self.algebra.stored else max(self.algebra.largest, self.model.largest)


def judge(
    agreement: Agreement,
    result: SmootherResult,
    run: EkfRun,
    diagnosis: Diagnosis,
    *,
    data_faults: Sequence[DataFault] = (),
    causes: Sequence[Cause] = (),
    conservative: bool = False,
) -> Verdict:
    """Return the verdict on a run.

    misuses: of the data; they come first, for the gaps follow from them. conservative: the filter
    is meant to leave some covariance too large. A red algebra or model gap is a disagreement
    whatever the smoother found, for it compares the filter with linear algebra. Otherwise an
    optimum that is not verified gives no verdict at all. causes: reasons of extensions to
    disagree, which count like the linearisation gap.
    """
    found = _red(agreement, run, diagnosis, data_faults, conservative=conservative)
    algebra = agreement.algebra
    if not found and diagnosis.hidden > _UNTOLD:
        found = [cause.untold(diagnosis.hidden)]
    elif not found:
        found = _by_optimum(agreement, result.optimality, run, diagnosis, causes)
        if found:
            test = result.optimality.chi_square
            wrong = list(diagnosis.log(test)) if test.reading == "too high" else []
            found = wrong + found
            found += cause.noise(test, diagnosis.consistency) if not wrong else []
            found += cause.dropout(diagnosis.dropouts())
    remarks = _remarks(result.optimality, run) + _on_robust(result.options.robust)
    if _TOLD < diagnosis.hidden <= _UNTOLD:
        remarks.append(cause.rounding(diagnosis.hidden))
    if conservative and not algebra.within(ROUNDING):
        under = algebra.sigma < ROUNDING
        mean = f"less than {ROUNDING:.2g}" if under else f"{algebra.sigma:.2g}"
        remarks.append(
            f"the filter is conservative by design: its covariance exceeds the exact one by up to "
            f"{algebra.covariance:.2g} (relative), its mean differs by {mean} sigma"
        )
    if run.breakdown and found[0].gap != "breakdown":
        remarks.insert(0, f"{run.breakdown}; all comparisons end at that time")
    return Verdict(outcome=decided(found), causes=tuple(found), remarks=tuple(remarks))


def decided(causes: Sequence[Cause]) -> Outcome:
    """Return the outcome by the kinds of the causes (words.DECIDES), the first rule that is met."""
    kinds = {cause.decides(one.gap) for one in causes}
    return next((outcome for kind, outcome in RULES.items() if kind in kinds), "agree")


def _red(
    agreement: Agreement,
    run: EkfRun,
    diagnosis: Diagnosis,
    data_faults: Sequence[DataFault],
    *,
    conservative: bool,
) -> list[Cause]:
    """What is wrong with the filter whatever the smoother found."""
    found = [Cause("data", data_fault.evidence, data_fault.hint) for data_fault in data_faults]
    algebra = agreement.algebra
    allowed = diagnosis.algebra
    if not (_conservative(algebra, allowed) if conservative else algebra.explained_by(allowed)):
        known = diagnosis.operations()
        found.append(cause.algebra(algebra, known, allowed, diagnosis.single or diagnosis.unnamed))
    untold = agreement.model.explained_by(diagnosis.model)
    if not untold or (diagnosis.hidden > _UNTOLD and not agreement.model.within(_UNTOLD)):
        differences, known_faults = diagnosis.differences(), diagnosis.known_model_errors()
        # Else the data's use explains the gap, or rounding, which leaves each record alone right.
        if differences or known_faults or not (untold or data_faults):
            found.append(cause.model(agreement.model, differences, known_faults, diagnosis.model))
    if run.breakdown and not found and diagnosis.hidden <= _UNTOLD:
        found.append(
            Cause(
                "breakdown",
                run.breakdown,
                "check the measurements and their sigmas at that time; the gaps are computed "
                "up to it",
            )
        )
    return found


def _by_optimum(
    agreement: Agreement,
    optimality: Optimality,
    run: EkfRun,
    diagnosis: Diagnosis,
    causes: Sequence[Cause],
) -> list[Cause]:
    """The filter against the smoother's optimum."""
    if not optimality.verified:
        alone = [one for one in causes if cause.decides(one.gap) == "always"]
        return [*alone, cause.unverified(optimality)]
    blocks = (agreement.pose, *agreement.landmarks, *agreement.pose_landmarks, agreement.map)
    found = []
    if not all(block.agrees for block in blocks):
        found.append(cause.linearisation(agreement, run, diagnosis.growth(), diagnosis.spurious()))
    return [*found, *causes]


def _on_robust(robust: str) -> list[str]:
    if robust in ("huber", "cauchy"):
        return [
            f"the smoother's {robust} kernel reduces the weight of measurements that fit "
            "badly: its "
            "covariances are those of the weighted problem, and chi-square is not tested"
        ]
    if robust == "gnc":
        return ["the smoother excluded outliers; the filter did not exclude them"]
    return []


def _conservative(gap: Gap, allowed: Allowed) -> bool:
    least, skew = 1.0 - allowed.covariance, allowed.covariance
    return gap.least >= least and gap.asymmetry <= skew and gap.sigma <= SPARED_SIGMA


def misfit_remarks(optimality: Optimality) -> list[str]:
    """What a chi-square outside its band means, and whether it was accepted."""
    test = optimality.chi_square
    if test.reading == "plausible":
        return []
    meaning = {
        "too high": "the noise is larger than stated, or the models or the association are wrong",
        "too low": "the actual noise is smaller than stated",
    }[test.reading]
    if test.reading == "too high" and optimality.accept_misfit:
        meaning += "; --accept-misfit accepts it"
    chi2, lower, upper = map(rounded, (test.chi2, test.lower, test.upper))
    return [
        f"chi-square {chi2} for {test.dof} degrees of freedom is {test.reading} "
        f"(band {lower} to {upper}): {meaning}"
    ]


def _remarks(optimality: Optimality, run: EkfRun) -> list[str]:
    remarks = misfit_remarks(optimality)
    unused = {reason: count for reason, count in run.unused.items() if count}
    if unused:
        remarks.append(
            f"{sum(unused.values())} of {len(run.landmark_index)} measurements were not used: "
            + ", ".join(f"{count} {reason}" for reason, count in unused.items())
        )
    if run.cut_off:
        from ekf_reference.association.joint_compatibility import JointCompatibility

        remarks.append(
            f"joint compatibility reached its limit of {JointCompatibility.most_nodes:,} nodes in "
            f"{run.cut_off:,} scans and used the best association found until then"
        )
    if len(run.deactivated):
        names = ", ".join(str(i) for i in run.estimate.landmark_id[run.deactivated].tolist())
        if len(run.deactivated) == len(run.estimate.landmark):
            remarks.append(
                "every landmark is deactivated: at the end the filter uses odometry alone"
            )
        remarks.append(
            f"landmarks {names} are deactivated because something moves at their position: their "
            "estimates no longer change, and no measurement is associated with them"
        )
    return remarks
