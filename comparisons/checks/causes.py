"""Reasons for an outcome, in words: the gap each shows in, the numbers, and what to look at."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Array
from comparisons.audit.spurious import HEADING, Learnt
from comparisons.checks.agreement import (
    EXACT,
    LEAST_VARIANCE_RATIO,
    Agreement,
    Allowed,
    Gap,
)
from comparisons.checks.consistency.consistency import Consistency
from comparisons.words import Cause, Decides, Explanation
from graphslam.optimum import DISTANCE_LIMIT, ChiSquareTest, Optimality

if TYPE_CHECKING:
    from comparisons.checks.diagnosis.dropouts import Dropouts
    from comparisons.checks.diagnosis.linearisation_growth import LinearisationGrowth
    from comparisons.checks.diagnosis.log_fit import LogFit
    from comparisons.checks.diagnosis.model_differences import ModelDifference


FITTED = "check for these model errors, which were fitted to the trace: "
"""Begins a hint that names known model errors; they follow, separated by semicolons."""
ALGEBRA_HINT = (
    "check prediction, update and landmark initialisation for a covariance block that is dropped, "
    "outdated or not transposed"
)
MODEL_HINT = (
    "check the signs of the Jacobians, the wrapping of the innovation, the noise for a sigma that "
    "is squared twice, and the conventions of steering and bearing"
)
_NAMED = 3
"""So many events of the filter's algebra are named."""
_GREW = 3.0
"""A dropout over which the position's sigma grew so many times is named as a cause."""
_MATTERS = 10.0
"""Times the heading's largest sigma: what is learnt less surely than that changes nothing."""


EXPLANATIONS: dict[str, Explanation] = {
    "invalid": Explanation(
        "A recorded noise is no covariance",
        "A P of the prior, a Q or an R of the trace is asymmetric, has a negative eigenvalue, or "
        "holds a number that is not finite. Nothing that follows from it can be judged, so the "
        "trace's equations are not solved.",
        "Check that every entry of the matrix is set, and that no variance becomes negative.",
        decides="always",
    ),
    "data": Explanation(
        "Measurements used wrongly",
        "The trace shows that the filter used a measurement twice, at the wrong time, or for the "
        "wrong landmark, or that its gate rejected good measurements. The gaps that follow are a "
        "consequence of this.",
        "Check the order of events and the queue of measurements. Check how a label becomes a "
        "landmark of the map, and the bound of the gate.",
        decides="always",
    ),
    "algebra": Explanation(
        "The filter's linear algebra is wrong",
        "The filter's own matrices F, Q, H and R define a linear least-squares problem. A Kalman "
        "filter reproduces its solution to rounding, and this filter does not. The smoother's "
        "models play no part in this comparison.",
        "Check the covariance equations of prediction, update and landmark initialisation. Look "
        "for a block that is dropped, outdated or not transposed.",
        decides="always",
    ),
    "model": Explanation(
        "The filter's models are wrong",
        "The filter's matrices and the smoother's factors are linearised at the same points, and "
        "their solutions differ by more than rounding. So a Jacobian, an innovation or a noise "
        "covariance of the filter differs from the model of the log.",
        "Check the quantity that the evidence names: its sign, its units and the wrapping of "
        "angles. If the hint names a known model error, check that formula first.",
        decides="always",
    ),
    "breakdown": Explanation(
        "The filter stopped with an error",
        "The filter could not process the rest of the log, for example because an innovation "
        "covariance was not positive definite. All comparisons end at that time.",
        "Check the measurements and their sigmas at the time that the evidence names.",
        decides="always",
    ),
    "oracle": Explanation(
        "The smoother's optimum is not verified",
        "The smoother is the reference, and one condition for trusting its optimum does not hold. "
        "It may be in a local minimum, or the data may contradict the stated noise. The outcome is "
        "therefore unverified.",
        "Check the stated noise and the association. A longer lag or the batch smoother helps "
        "where the smoother ran incrementally.",
        decides="open",
    ),
    "linearisation": Explanation(
        "The filter linearised at the wrong points",
        "The filter's algebra and models are right, but its result differs from the optimum of the "
        "relinearised smoother. The cause is that the filter evaluated its Jacobians at estimates "
        "that turned out to be wrong. This is a property of the EKF, not a programming error.",
        "Reduce the heading uncertainty. Local maps, an iterated update or relinearisation help.",
    ),
    "noise": Explanation(
        "A stated sigma is too small",
        "The smoother's chi-square and the filter's NIS of the named measurements are both too "
        "large. So these measurements scatter more than their stated sigmas allow, or some belong "
        "to other landmarks. This cause explains another one and never appears alone.",
        "Check the sigmas of the named measurements. Check the association.",
        decides="never",
    ),
    "fault": Explanation(
        "A known fault reproduces the estimate",
        "The reference EKF with this fault ends at the same poses, landmarks and covariances, to "
        "rounding where the evidence says that the estimate equals it. It was run with each fault "
        "of a catalogue, with each way to integrate a step.",
        "Correct the named fault first. Other causes that stand behind it follow from it, or show "
        "where it lies.",
        decides="grade",
    ),
    "dropout": Explanation(
        "A long time without measurements",
        "Over a stretch without any usable measurement the position's sigma grew at least "
        "threefold. The filter then linearised at a poor estimate. This cause explains another one "
        "and never appears alone.",
        "Check for a sensor that was silent or blocked, for lost messages, and for a gate that "
        "rejects every measurement.",
        decides="never",
    ),
    "log": Explanation(
        "The log fits with another number, unit or sigma",
        "The smoother's chi-square is too high, and it falls to what the stated noise explains if "
        "one number of one sensor is changed: a scale, an offset, or a delay. The named one "
        "removes at least 80 % of what chi-square is too high by. Scales of speed and range stand "
        "for each other where nothing else tells the size of the map. Where no such number "
        "explains it, the log is examined as by `slamcheck logs LOG`: units, signs, exchanged "
        "columns, and sigmas that are variances.",
        "Check the calibration, the units and the clock of the named sensor.",
        decides="never",
    ),
    "association": Explanation(
        "Measurements are assigned to different landmarks",
        "In a run, the smoother's own association leads to another optimum than the filter's. In "
        "the check of an external estimate, landmarks lie where the reference has other landmarks.",
        "Check the measurements that the evidence names. Look for a wrong loop closure, for "
        "landmarks that lie close together, and for exchanged ids.",
        decides="always",
    ),
    "motion": Explanation(
        "Wheel odometry and scan odometry disagree",
        "The EKF on wheel odometry and the smoother on scan odometry end at different maps. The "
        "evidence compares the chi-square of both and, where the log has them, absolute positions "
        "or truth, to find the inconsistent source.",
        "Check the source that the hint names: its sigmas, its scale and its calibration.",
        decides="always",
    ),
    "truth": Explanation(
        "The smoother is far from the truth",
        "The smoother's poses or landmarks err by more than their covariance, or the log's labels, "
        "allow. EKF and smoother share log, noise and association, so they can agree on a wrong "
        "result.",
        "Check the association first, then the stated noise, the model and the start pose.",
        decides="qualifies",
    ),
    "coverage": Explanation(
        "The estimate covers too little of the log",
        "The external estimate has poses for less of the log's time than required. Whatever the "
        "poses say, the rest of the log is not judged.",
        "Check whether the filter stopped or lost poses, and whether its clock is the log's. "
        "Supply the whole trajectory, or lower --min-coverage.",
        decides="always",
    ),
    "map": Explanation(
        "The map is incomplete or uses other ids",
        "Landmarks of the log are missing in the external estimate, or landmarks have ids that the "
        "log does not know. A filter's map must be complete to be like the reference EKF's.",
        "Check that the estimate contains every landmark, with the ids of the log's measurements.",
        decides="grade",
    ),
    "time": Explanation(
        "The time stamps are shifted",
        "The trajectory fits a reference if its time stamps are shifted, or the poses are those "
        "from before the measurements of their time were used.",
        "Check the clocks of odometry and measurements, and the interval of a prediction. Check "
        "that a pose is written after the update.",
        decides="grade",
    ),
    "information": Explanation(
        "Filtered and smoothed are confused",
        "estimate.toml says that the poses are filtered, but they equal the smoother's, which use "
        "later measurements; or the reverse.",
        'Check the entry "information" in estimate.toml.',
        decides="grade",
    ),
    "frame": Explanation(
        "The trajectory is in another frame",
        "The trajectory fits a reference after a shift or a rotation. It is therefore expressed in "
        "a frame other than the log's.",
        "Check that the filter starts at the log's prior pose, in the log's frame. Check the first "
        "landmarks of the map.",
        decides="grade",
    ),
    "scale": Explanation(
        "The trajectory has another scale",
        "The trajectory fits a reference after scaling.",
        "Check the units (metres), the calibration of the speed and the radius of the wheels.",
        decides="grade",
    ),
    "mirrored": Explanation(
        "The trajectory is mirrored",
        "The trajectory fits the mirror image of a reference.",
        "Check the sign of the steering angle, the yaw rate and the bearing. Check the order of "
        "the axes.",
        decides="grade",
    ),
    "lever": Explanation(
        "The poses are of another point of the vehicle",
        "The trajectory fits a reference if every pose is moved by one constant offset in the "
        "vehicle's frame.",
        "Check which point of the vehicle the poses describe: rear axle, sensor or antenna.",
        decides="grade",
    ),
    "heading": Explanation(
        "The headings are wrong",
        "The headings have a constant offset, the opposite sign or a wrong encoding, while the "
        "positions fit.",
        "Check the zero, the sign and the unit of the heading. A heading h is counter-clockwise "
        "from east; its quaternion is (0, 0, sin(h/2), cos(h/2)).",
        decides="grade",
    ),
    "estimate": Explanation(
        "The estimate differs from the reference EKF",
        "Poses or landmarks differ by more than 5 % of sigma from those of the reference EKF, and "
        "no simple motion explains the difference.",
        "Check the association, the signs and the noise. Supply a trace: it separates errors of "
        "the algebra from errors of the models.",
        decides="grade",
    ),
    "covariance": Explanation(
        "The covariances are wrong",
        "The covariances of the external estimate differ from those of the reference. The evidence "
        "names the known mistake that reproduces them, if there is one.",
        "Check the noise: a sigma used as a variance, a factor on R or Q, a dropped "
        "cross-covariance, a measurement used twice. Check the file: frame, units, order, time.",
        decides="grade",
    ),
    "optimum": Explanation(
        "The estimate is far from the optimum",
        "The last pose, the landmarks or the trajectory are farther from the smoother's optimum "
        "than its uncertainty allows, or their covariances differ by too much.",
        "Check the causes that come before this one. If there are none, check the association, the "
        "signs and the noise.",
        decides="grade",
    ),
    "grade": Explanation(
        "The required grade is missed by rounding",
        "The estimate is close to a reference, no cause is known, and the difference still exceeds "
        "the limit of the required grade.",
        "Check the precision of the numbers in the files.",
        decides="grade",
    ),
}
"""What kinds of cause mean, by the name that each has in result.json; a check may add its own."""


def decides(kind: str) -> Decides:
    """Return what a kind of cause makes of an outcome; a check's own counts like a gap."""
    known = EXPLANATIONS.get(kind)
    return "verified" if known is None else known.decides


def _apart(gap: Gap, allowed: Allowed) -> str:
    limit = f"rounding allows {allowed.sigma:.2g} in both"
    if allowed.stored:
        limit = (
            f"storage in single precision allows {allowed.sigma:.2g} sigma and "
            f"{allowed.covariance:.2g}"
        )
    return (
        f"by {gap.sigma:.2g} sigma in the mean and by {gap.covariance:.2g} (relative) in the "
        f"covariance ({limit})"
    )


def invalid(evidence: str) -> Cause:
    """A matrix of the trace that no sound filter has."""
    return Cause(
        "invalid",
        evidence,
        "check that every entry of the matrix is set, and that no variance becomes negative; the "
        "trace's equations are not judged",
    )


def algebra(
    gap: Gap,
    operations: Sequence[str],
    allowed: Allowed = EXACT,
    hint: str = ALGEBRA_HINT,
) -> Cause:
    """E against F1. operations: what is wrong with which, the first first.

    hint: what to check where no event is named.
    """
    named = "".join(f"; {one}" for one in operations[:_NAMED])
    first = operations[0].partition("; ")[0] if operations else ""
    return Cause(
        "algebra",
        f"the filter differs from the solution of its own linear equations {_apart(gap, allowed)}"
        + named,
        f"check {first}" if first else hint,
    )


def model(
    gap: Gap,
    differences: Sequence[ModelDifference],
    known_model_errors: Sequence[str],
    allowed: Allowed = EXACT,
) -> Cause:
    """F1 against F2. explanations: known mistakes that reproduce what was recorded.

    Of each kind of relation the largest difference is named, of its Jacobians and of the rest.
    """
    largest = {one.group: one for one in reversed(differences)}
    named = "; ".join(str(one) for one in differences if largest[one.group] is one)
    hint = MODEL_HINT
    if differences and differences[0].absent:
        hint = (
            f"complete {differences[0].quantity}: its columns are zero in the filter, but the "
            "measurement depends on these states"
        )
    if known_model_errors:
        hint = FITTED + "; ".join(known_model_errors)
    return Cause(
        "model",
        "the filter's models differ from the smoother's, linearised at the same points, "
        f"{_apart(gap, allowed)}" + (f"; {named}" if named else ""),
        hint,
    )


def unverified(optimality: Optimality) -> Cause:
    """The optimum is not verified, and what the check lacks."""
    if optimality.distance_sigma > DISTANCE_LIMIT:
        hint = "use the batch smoother, or a longer lag"
    elif optimality.chi_square.reading == "too high":
        hint = (
            "check the stated noise and the association; --accept-misfit accepts the lowest "
            "minimum "
            "despite its chi-square"
        )
    else:
        hint = "check the stated noise and the association: the smoother may be in a local minimum"
    return Cause("oracle", optimality.lacks, hint)


def rounding(share: float) -> str:
    """How well double precision tells the gaps of a log; share: of sigma, or of a covariance."""
    digits = f"to {share:.1g} (relative) only" if np.isfinite(share) else "not at all"
    return (
        "variances or coordinates of the log lie so many powers of ten apart that double precision "
        f"tells the algebra and the models {digits}"
    )


def untold(share: float) -> Cause:
    """Rounding hides what a verdict would be about."""
    hint = "narrow the prior, end the log before its longest gap, or move the origin nearer"
    return Cause("oracle", rounding(share), hint)


def doubted_association(against: int, variants: int) -> Cause:
    """Neither the smoother's nor the reference filter's association without labels is certain."""
    return Cause(
        "oracle",
        f"the log has no labels, and {against} of {variants} other ways to associate its "
        "measurements contradict the smoother's, so that smoother and reference filter may be the "
        "ones that are wrong",
        "label the measurements, or give the filter's own association in a trace",
    )


def linearisation(
    agreement: Agreement,
    run: EkfRun,
    growth: LinearisationGrowth | None = None,
    spurious: Learnt | None = None,
) -> Cause:
    """The gap between F2 and S. growth: where it arose, if that was looked for."""
    names = [f"landmark {i}" for i in run.estimate.names]
    names += [f"scan landmark {i}" for i in run.estimate.pose_landmark_id]
    blocks = (*agreement.landmarks, *agreement.pose_landmarks)
    off = [i for i, block in enumerate(blocks) if not block.agrees]
    parts = []
    far = [i for i in off if not blocks[i].near]
    if far:
        worst = max(far, key=lambda i: blocks[i].distance_sigma)
        block = blocks[worst]
        parts.append(
            f"{len(far)} of {len(names)} landmarks are more than {block.limit_sigma:.2g} sigma "
            f"from the optimum; {names[worst]} differs most, by {block.difference_m:.2f} m "
            f"({block.distance_sigma:.1f} sigma)"
        )
    unsure = [i for i in off if i not in far]
    if unsure:
        worst, ratio = max(
            ((i, r) for i in unsure for r in blocks[i].ratios),
            key=lambda pair: max(pair[1], 1.0 / max(pair[1], 1e-300)),
        )
        parts.append(
            f"{len(unsure)} of {len(names)} landmarks have a wrong covariance; the variance of "
            f"{names[worst]} is {ratio:.2g} times the smoother's"
        )
    if not agreement.pose.near:
        parts.append(
            f"the last pose differs by {agreement.pose.difference_m:.2f} m "
            f"({agreement.pose.distance_sigma:.1f} sigma)"
        )
    if not agreement.map.near:
        far_all = agreement.map.distance_sigma
        parts.append(f"map and last pose together differ by {far_all:.1f} sigma")
    if agreement.optimism < LEAST_VARIANCE_RATIO:
        parts.append(
            f"in the most optimistic direction the filter's variance is "
            f"{100 * agreement.optimism:.2g} % of the smoother's"
        )
    if agreement.pessimism > 1.0 / LEAST_VARIANCE_RATIO:
        parts.append(
            f"in the most pessimistic direction the filter's variance is "
            f"{agreement.pessimism:.1f} times the smoother's"
        )
    sigma, reached = np.sqrt(run.estimate.pose_covariance[:, 2, 2]), ""
    if np.isfinite(sigma).any():
        k = int(np.nanargmax(sigma))
        reached = f" (its sigma reached {_degrees(sigma[k])} at {run.estimate.time_s[k]:.1f} s)"
    if growth is not None and growth.total > 0.0:
        parts.append(_grew(growth, run, sigma))
    if spurious is not None:
        parts += _learnt(spurious, sigma)
    return Cause(
        "linearisation",
        "; ".join(parts),
        "algebra and models are right, so the linearisation points are the reason: reduce the "
        f"heading uncertainty{reached}, or use local maps or relinearisation",
    )


def _degrees(angle_rad: float) -> str:
    """One decimal, below a degree two digits: never 0.0 of an angle that is there."""
    angle = float(np.degrees(angle_rad))
    return f"{angle:.1f} degrees" if abs(angle) >= 1.0 else f"{angle:.2g} degrees"


def _learnt(spurious: Learnt, sigma: Array) -> list[str]:
    """How well the filter seems to know what nothing measured, and when it learnt that.

    sigma: (K,) the filter's own of the heading [rad]; what is learnt far less surely than the
    largest of them changes nothing.
    """
    learnt = spurious.of(HEADING)
    known = sigma[np.isfinite(sigma)]
    if learnt.largest is None or learnt.sigma > _MATTERS * np.degrees(known.max(initial=0.0)):
        return []
    begin_s, end_s, _ = spurious.fastest(HEADING)
    return [
        f"the filter has learnt its global heading to {_degrees(np.radians(learnt.sigma))} from "
        f"measurements that cannot tell it, most from {begin_s:.1f} to {end_s:.1f} s and, by a "
        f"single update, with {learnt.largest.seen} at {learnt.largest.time_s:.1f} s"
    ]


def _grew(growth: LinearisationGrowth, run: EkfRun, sigma: Array) -> str:
    """When, by which relation, at which uncertainty of the heading (K,)."""
    time_s, at = run.estimate.time_s, growth.epoch
    seen = ""
    if growth.landmark_index >= 0:
        template = "template" in growth.kind  # whose landmark's id is its landmark index
        index = growth.landmark_index
        seen = f" of landmark {index if template else run.estimate.names[index]}"
    around = _degrees(sigma[max(at - 1, 0) : at + 1].max())
    return (
        f"the largest linearisation error is that of {growth.kind}{seen} at {time_s[at]:.1f} s "
        f"({growth.sigma:.1f} sigma of its noise; the heading's sigma was {around}), and half of "
        f"the total linearisation error arose before {time_s[growth.reached(0.5)]:.1f} s"
    )


def log_number(fits: Sequence[LogFit], test: ChiSquareTest) -> Cause:
    """Numbers that would make the log fit, of which there is one at least."""
    named = ", or ".join(f"to {one.chi2:.0f} with {one.what}" for one in fits)
    return Cause(
        "log",
        f"the smoother's chi-square falls from {test.chi2:.0f} (for {test.dof} degrees of "
        f"freedom) {named}",
        "check the calibration, units and clock of this sensor; correct the log and run again",
    )


def log_fault(words: str) -> Cause:
    """What the log looks like, with what mends it."""
    return Cause("log", words, "make the log again with this changed (slamcheck new-log)")


def noise(test: ChiSquareTest, consistency: Consistency | None) -> list[Cause]:
    """The sensors whose innovations are too large, where the smoother's residuals are, too."""
    if test.reading != "too high" or consistency is None:
        return []
    off = [
        (nis, sensor.sensor)
        for sensor in consistency.sensors
        for nis in sensor.nis[1:]
        if nis.worded(consistency.outside)[0] == "too high"
    ]
    if not off:
        return []
    worst, of = max(off, key=lambda pair: pair[0].mean)
    return [
        Cause(
            "noise",
            f"the smoother's chi-square is too high, {test.chi2:.0f} for {test.dof} degrees of "
            "freedom; these mean NIS are too high as well: "
            + ", ".join(
                f"{name}' {nis.name} {nis.mean:.3g} (expected {nis.dof})" for nis, name in off
            ),
            f"check the sigma of the {of}' {worst.name}: if nothing else is wrong, it is about "
            f"{worst.mean**0.5:.2g} times too small; also check the association",
        )
    ]


def dropout(dropouts: Dropouts | None) -> list[Cause]:
    """The stretch without observations that made the vehicle uncertain, if one did."""
    worst = None if dropouts is None else dropouts.worst
    if dropouts is None or worst is None or worst.growth < _GREW:
        return []
    refused = f", {worst.refused} measurements rejected" if worst.refused else ""
    before, after = worst.sigma_heading_rad
    return [
        Cause(
            "dropout",
            f"the filter used no measurement from {worst.begin_s:.1f} to {worst.end_s:.1f} s "
            f"({worst.way_m:.1f} m driven{refused}): the position's sigma grew from "
            f"{worst.sigma_m[0]:.2g} to {worst.sigma_m[1]:.2g} m, the heading's from "
            f"{_degrees(before)} to {_degrees(after)}, and at the end of it the filter was "
            f"{worst.error_m:.2f} m from the smoother; such stretches are "
            f"{100.0 * (1.0 - dropouts.coverage):.0f} % of the time, and outside them the RMS "
            f"difference is {dropouts.error_outside_m:.2f} m",
            "check for a silent or blocked sensor, for lost messages, and for a gate that rejects "
            "every measurement",
        )
    ]


def coverage(evidence: str, least: float, hint: str = "") -> Cause:
    """Too little of the log's time in an external estimate. least: share that is required."""
    return Cause(
        "coverage",
        f"{evidence}; at least {100.0 * least:.4g} % is required",
        hint
        or "check whether the filter stopped or lost poses; supply the whole trajectory, or lower "
        "--min-coverage",
    )
