"""`claims.json`, for machines. The models are the file's documentation."""

from __future__ import annotations

from typing import Literal

from comparisons.figures import Model


class ClaimResult(Model):
    """A claim of a document and what was measured.

    See contract.Claim.

    Attributes:
        text: the claim.
        measured: the figure; null where it is not finite.
        relation: how the figure must stand to the limit.
        limit: the limit.
        unit: unit of figure and limit.
        holds: whether the claim holds.
        why: what is different here, where the claim does not hold and the reason is known.
    """

    text: str
    measured: float | None
    relation: Literal["at most", "at least"]
    limit: float
    unit: str
    holds: bool
    why: str | None


class FigureResult(Model):
    """A figure of a document.

    Attributes:
        name: name of the figure, as `slamcheck reproduce` takes it.
        title: its title.
        source: where the document has it.
        says: what the document says.
        log: log on which it was run.
        seconds: wall time of its experiment, which the figures in `shared` have in common.
        cpu_s: processor time of it, all threads of its process.
        shared: figures of the same experiment.
        holds: whether all its claims hold.
        claims: its claims.
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
    """A figure that was asked for and not run.

    Attributes:
        name: name of the figure.
        title: its title.
        source: where the document has it.
        reason: why it was not run.
    """

    name: str
    title: str
    source: str
    reason: str


class ReproductionResult(Model):
    """`claims.json`: figures of the documents and their claims.

    Attributes:
        holds: whether every claim of every figure that was run holds.
        drives: simulated drives of a claim on averages.
        seconds: wall time of all.
        cpu_s: processor time of all experiments, whichever process ran them.
        figures: figures that were run.
        skipped: figures that were not run.
        versions: versions of the packages.
    """

    holds: bool
    drives: int
    seconds: float
    cpu_s: float | None = None
    figures: list[FigureResult]
    skipped: list[SkippedResult]
    versions: dict[str, str]
