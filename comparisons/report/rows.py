"""Rows of figures that several jobs report: one figure a row, in groups."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from comparisons.checks.agreement import LARGEST_DISTANCE, LEAST_VARIANCE_RATIO, BlockAgreement
from comparisons.figures import band, in_sigma, rounded, rows_of, shown
from comparisons.report.ladder import LadderStep
from comparisons.report.models import EkfResult, LogResult, SmootherResult
from comparisons.words import SPENT, Row

AGREEING_RATIOS = f"{LEAST_VARIANCE_RATIO:g} to {1.0 / LEAST_VARIANCE_RATIO:g}"
"""Variances of the EKF over the smoother's within which a block of a run agrees."""
_DISTANCE = f"<= {LARGEST_DISTANCE:g} sigma"
"""Largest difference of the means within which a block agrees."""
_STAGES = {
    "read": "reading the log",
    "ekf": "EKF",
    "frozen": "fixed-linearisation smoothers",
    "marginals": "marginal covariances",
}
"""Of the clock, where their names in a result are short."""


def log_rows(log: LogResult) -> list[Row]:
    """Return what was read."""
    times = log.provenance.get("times")
    return [
        Row("Log", "name", log.name),
        Row("Log", "format", log.format),
        Row("Log", "duration", f"{log.duration_s:.0f} s"),
        *([Row("Log", "time stamps", times)] if times else ()),
        *(Row("Log", name, f"{n:,}") for name, n in log.records.items()),
    ]


def ekf_rows(ekf: EkfResult) -> list[Row]:
    """Return the filter, and which measurements it used."""
    names = ["filter", "association", "landmarks", "rejected", "ambiguous", "candidate"]
    if ekf.attributes != "off":
        names.append("attributes")
    if ekf.dynamic or ekf.deactivated:
        names += ["dynamic", "deactivated"]
    if ekf.updates is not None:
        names += ["updates", "updates_with_passive", "active_share"]
    if ekf.global_updates:
        names += ["global_updates", "global_update_spared"]
    if ekf.gps != "off":
        names += ["fixes_fused", "fixes_rejected"]
        if ekf.fixes_outside_stretches is not None:
            names.append("fixes_outside_stretches")
        if ekf.longest_streak:
            names += ["fixes_in_streaks", "longest_streak", "fixes_rejected_by_smoother"]
    return rows_of("EKF", ekf, names)


def smoother_rows(smoother: SmootherResult) -> list[Row]:
    """Return the smoother, and the evidence for its optimum."""
    optimum = "verified" if smoother.verified else f"NOT verified: {smoother.lacks}"
    rows = [
        Row("Smoother", "optimum", optimum, "verified", smoother.verified),
        *rows_of("Smoother", smoother, ["poses", "error"]),
        _chi_square(smoother),
        *(
            Row("Smoother", f"error reached from the start {start.name}", shown(start.error, ".2f"))
            for start in smoother.starts
            if not start.name.startswith("random")
        ),
    ]
    if smoother.random_starts:
        rows += rows_of("Smoother", smoother, ["random_starts", "chance_missed"])
    if smoother.hops:
        rows += rows_of("Smoother", smoother, ["hops"])
    rows += _second_minimum(smoother)
    if smoother.method != "batch":
        far = f"largest distance of the {smoother.method} estimate from the optimum"
        rows.append(Row("Smoother", far, in_sigma(smoother.distance_sigma)))
    if smoother.robust != "none":
        left_out = ["robust", "rejected_measurements", "rejected_positions"]
        rows += rows_of("Smoother", smoother, left_out)
    return rows


def _chi_square(smoother: SmootherResult) -> Row:
    """Return chi-square with its band; a robust kernel changes it, and leaves no band."""
    chi2 = rounded(smoother.chi2)
    if not smoother.dof:
        return Row("Smoother", "chi-square under the robust kernel (not tested)", chi2)
    low, high = smoother.chi2_band
    return Row(
        "Smoother",
        f"chi-square (expected {smoother.dof})",
        chi2,
        band(rounded(low), rounded(high)),
        low <= smoother.chi2 <= high,
    )


def _second_minimum(smoother: SmootherResult) -> list[Row]:
    if len(smoother.minima) < 2:
        return []
    second = smoother.minima[1]
    place, far = f"the pose at {second.time_s:.1f} s", second.pose_m
    if second.landmark is not None and second.landmark_m > second.pose_m:
        place, far = f"landmark {second.landmark}", second.landmark_m
    return [
        Row("Smoother", "distinct minima found", f"{len(smoother.minima)}"),
        Row("Smoother", "error at the second lowest minimum", f"{second.error:.2f}"),
        Row("Smoother", f"shift of {place} to the second lowest minimum", f"{far:.3g} m"),
    ]


def seconds_rows(seconds: Mapping[str, float], cpu_s: Mapping[str, float] | None) -> list[Row]:
    """Return the time of each stage on the wall, which a busy machine stretches, and of the CPU."""
    return [
        Row(group, _STAGES.get(stage, stage), f"{s:.2f} s")
        for group, each in zip(SPENT, (seconds, cpu_s or {}), strict=True)
        for stage, s in each.items()
    ]


def gap_rows(steps: Sequence[LadderStep]) -> list[Row]:
    """Return the gaps of the chain of estimates; what exceeds its limit is marked.

    A gap that fails although its means are within the limit fails by covariance or error.
    """
    found = []
    for step in steps:
        group = f"{step.gap.capitalize()} gap: {step.above} to {step.below}"
        limit = "" if step.limit is None else f"<= {step.limit:.2g} sigma"
        within = step.sigma is not None and step.limit is not None and step.sigma <= step.limit
        inside = None if not step.judged else True if within else False if step.fails else None
        rest = False if step.fails and within else None
        mean = "not judged" if step.sigma is None and not step.judged else in_sigma(step.sigma)
        found.append(Row(group, "difference of the means (largest)", mean, limit, inside))
        if step.error_m is not None:
            found.append(Row(group, "distance", f"{step.error_m:.3g} m", "", rest))
        elif step.covariance is not None:
            far = f"{step.covariance:.2g}"
            found.append(Row(group, "relative difference of covariances", far, "", rest))
    return found


def block_rows(part: str, whose: str, block: BlockAgreement, limits: str = "") -> list[Row]:
    """Return how an estimate agrees with the smoother's.

    part: of the state. whose: as `EKF`. limits: of the variance ratios, empty where they depend on
    the estimate.
    """
    group, agrees = f"{part}, {whose} and smoother", "yes" if block.agrees else "no"
    rows = [
        Row(group, "agrees", agrees, "yes", block.agrees),
        Row(group, "difference of the positions", f"{block.difference_m:.3f} m"),
        Row(group, "difference of the means", in_sigma(block.distance_sigma), _DISTANCE),
    ]
    if block.variance_ratio_least is not None:
        ends = (block.variance_ratio_least, block.variance_ratio_largest)
        ratios = band(*(shown(end, ".3g") for end in ends))
        rows.append(Row(group, f"variances, {whose} over smoother", ratios, limits))
    return rows


def agreeing(blocks: Sequence[BlockAgreement], whose: str) -> list[Row]:
    """Return how many landmarks agree, if there are any. whose: as `EKF`."""
    if not blocks:
        return []
    count = sum(block.agrees for block in blocks)
    value = f"{count} of {len(blocks)}"
    group, name = f"Map, {whose} and smoother", "landmarks that agree"
    return [Row(group, name, value, "all", count == len(blocks))]


def pose_words(pose: BlockAgreement) -> str:
    """Return in words how two estimates agree in the last pose."""
    return f"last pose {'agrees' if pose.agrees else 'disagrees'} ({in_sigma(pose.distance_sigma)})"
