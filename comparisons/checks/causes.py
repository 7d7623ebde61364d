"""The catalogue of causes: what each kind means, what to check, and what it decides."""

from __future__ import annotations

from comparisons.words import Cause, Decides, Explanation

EXPLANATIONS: dict[str, Explanation] = {
    "invalid": Explanation(
        "A recorded noise is no covariance",
        "A P of the prior, a Q or an R of the trace is asymmetric, has a negative eigenvalue, or "
        "holds a number that is not finite. Nothing that follows from it can be judged, so the "
        "trace's equations are not solved.",
        "Check that every entry of the matrix is set, and that no variance becomes negative.",
        decides="filter",
    ),
    "data": Explanation(
        "Measurements used wrongly",
        "The trace shows that the filter used a measurement twice, at the wrong time, or for the "
        "wrong landmark, or that its gate rejected good measurements. The gaps that follow are a "
        "consequence of this.",
        "Check the order of events and the queue of measurements. Check how a label becomes a "
        "landmark of the map, and the bound of the gate.",
        decides="filter",
    ),
    "algebra": Explanation(
        "The filter's linear algebra is wrong",
        "The filter's own matrices F, Q, H and R define a linear least-squares problem. A Kalman "
        "filter reproduces its solution to rounding, and this filter does not. The smoother's "
        "models play no part in this comparison.",
        "Check the covariance equations of prediction, update and landmark initialisation. Look "
        "for a block that is dropped, outdated or not transposed.",
        decides="filter",
    ),
    "model": Explanation(
        "The filter's models are wrong",
        "The filter's matrices and the smoother's factors are linearised at the same points, and "
        "their solutions differ by more than rounding. So a Jacobian, an innovation or a noise "
        "covariance of the filter differs from the model of the log.",
        "Check the quantity that the evidence names: its sign, its units and the wrapping of "
        "angles. If the hint names a known model error, check that formula first.",
        decides="filter",
    ),
    "breakdown": Explanation(
        "The filter stopped with an error",
        "The filter could not process the rest of the log, for example because an innovation "
        "covariance was not positive definite. All comparisons end at that time.",
        "Check the measurements and their sigmas at the time that the evidence names.",
        decides="filter",
    ),
    "log": Explanation(
        "The log fits with another number, unit or sigma",
        "The smoother's chi-square is too high, and one change of the log takes it into its band, "
        "as of `slamcheck logs LOG`: of a column a unit, a sign, a factor, an offset, a lag, or "
        "another column in its place; of a stream its clock; the place of a sensor; the axes of "
        "poses and positions; or sigmas that are variances or of another unit. What is left is the "
        "stated noise, by sensor, by landmark and over time. Where several changes fit as well, "
        "all are named: scales of speed and range stand for each other where nothing else tells "
        "the size of the map.",
        "Check the calibration, the units and the clock of the named sensor.",
        decides="never",
    ),
    "linearisation": Explanation(
        "The filter linearised at the wrong points",
        "The filter's algebra and models are right, but its result differs from the optimum of the "
        "relinearised smoother. The cause is that the filter evaluated its Jacobians at estimates "
        "that turned out to be wrong. This is a property of the EKF, not a programming error.",
        "Reduce the heading uncertainty. Local maps, an iterated update or relinearisation help.",
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
    "oracle": Explanation(
        "The smoother's optimum is not verified",
        "The smoother is the reference, and one condition for trusting its optimum does not hold. "
        "It may be in a local minimum, or the data may contradict the stated noise. The outcome is "
        "therefore unverified.",
        "Check the stated noise and the association. A longer lag or the batch smoother helps "
        "where the smoother ran incrementally.",
        decides="open",
    ),
    "noise": Explanation(
        "The log fits with another noise of one sensor",
        "The smoother's chi-square is too high, and it falls into its band if the sigma of one "
        "sensor has another size. That sensor's residuals then have about one per degree of "
        "freedom, and all residuals are the stated noise by landmark, over time, in the mean and "
        "from one to the next. This cause explains another one and never appears alone.",
        "Check the sigma of the named sensor.",
        decides="never",
    ),
    "misfit": Explanation(
        "None of the changes tried makes the log fit",
        "The smoother's chi-square is too high, and neither another number, unit or sign, nor "
        "another noise of one sensor leaves the stated noise everywhere. The evidence says where "
        "the residuals first leave it. This cause explains another one and never appears alone.",
        "Check what was recorded there: its association, its clock, its frame. Only one change at "
        "a time is tried, and not every one that there may be.",
        decides="never",
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
    "truth": Explanation(
        "The smoother is far from the truth",
        "The smoother's poses or landmarks err by more than their covariance, or the log's labels, "
        "allow. EKF and smoother share log, noise and association, so they can agree on a wrong "
        "result.",
        "Check the association first, then the stated noise, the model and the start pose.",
        decides="qualifies",
    ),
    "fault": Explanation(
        "A known fault reproduces the estimate",
        "The reference EKF with this fault ends at the same poses, landmarks and covariances, to "
        "rounding. It was run with each change of each slot, of data, events' times, models and "
        "algebra.",
        "Correct the named fault first. Other causes that stand behind it follow from it, or show "
        "where it lies.",
        decides="grade",
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
"""By the name that each has in result.json, in the order of a verdict; a check may add its own."""

FILTER_FAULTS = frozenset(
    kind for kind, explanation in EXPLANATIONS.items() if explanation.decides == "filter"
)
"""Kinds that show in the filter's own records, whatever the smoother found."""


SYMPTOMS = ("estimate", "covariance", "optimum", "grade")
"""Kinds that say that an estimate differs, and not why."""


def decides(kind: str) -> Decides:
    """Return what a kind of cause makes of an outcome; a check's own counts like a gap."""
    known = EXPLANATIONS.get(kind)
    return "verified" if known is None else known.decides


def rank(kind: str) -> int:
    """Return the place of a kind of cause among others; a check's own stands like a gap."""
    return list(EXPLANATIONS).index(kind if kind in EXPLANATIONS else "linearisation")


def invalid(evidence: str) -> Cause:
    """A matrix of the trace that no sound filter has."""
    return Cause(
        "invalid",
        evidence,
        "check that every entry of the matrix is set, and that no variance becomes negative; the "
        "trace's equations are not judged",
    )


def coverage(evidence: str, least: float, hint: str = "") -> Cause:
    """Too little of the log's time in an external estimate. least: share that is required."""
    return Cause(
        "coverage",
        f"{evidence}; at least {100.0 * least:.4g} % is required",
        hint
        or "check whether the filter stopped or lost poses; supply the whole trajectory, or lower "
        "--min-coverage",
    )
