"""`claims.json`, for machines. The models are the file's documentation."""

from __future__ import annotations

from typing import Literal

from comparisons.report.model import Model


class ClaimResult(Model):
    """See contract.Claim. measured: null where it is not finite.

    why: what is different here, where the claim does not hold and that is known.
    """

    text: str
    measured: float | None
    relation: Literal["at most", "at least"]
    limit: float
    unit: str
    holds: bool
    why: str | None


class FigureResult(Model):
    """One figure. seconds: of its experiment, which the figures in `shared` have in common.

    cpu_s: of the processor, all threads of the process that ran the experiment.
    """

    name: str
    title: str
    source: str
    says: str
    log: str
    seconds: float
    cpu_s: float | None = None
    shared: list[str]
    holds: bool
    claims: list[ClaimResult]


class SkippedResult(Model):
    """A figure that was asked for and not run."""

    name: str
    title: str
    source: str
    reason: str


class ReproductionResult(Model):
    """The whole file. holds: every claim of every figure that was run. seconds: of it all.

    cpu_s: of the processor, of all experiments, whichever process ran them.
    """

    holds: bool
    drives: int
    seconds: float
    cpu_s: float | None = None
    figures: list[FigureResult]
    skipped: list[SkippedResult]
    versions: dict[str, str]
