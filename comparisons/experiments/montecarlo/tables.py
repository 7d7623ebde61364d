"""The tables of a study: columns by name, for `to_pandas`."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from comparisons.experiments.montecarlo.statistics import ERRORS
from comparisons.report.tables import Columns, Tables, data_frame

if TYPE_CHECKING:
    from pandas import DataFrame

    from comparisons.experiments.montecarlo.study import StudyOutcome


def study_frame(outcome: StudyOutcome, table: str) -> DataFrame:
    """Return what `Outcome.to_pandas` does. Raises InputError."""
    tables: Tables = {
        "filters": lambda: _filters(outcome),
        "pairs": lambda: [asdict(pair) for pair in outcome.pairs],
        "nees": lambda: _nees(outcome),
    }
    return data_frame(tables, table)


def _filters(outcome: StudyOutcome) -> Columns:
    rows = []
    for name, figures in outcome.filters.items():
        row: dict[str, Any] = {"filter": name, "lost": figures.lost}
        for block, nees in figures.consistency.items():
            low, high = nees.band
            row |= {f"nees_{block}": nees.mean, f"nees_{block}_low": low}
            row |= {f"nees_{block}_high": high, f"nees_{block}_place": nees.place}
        row |= {f"rmse_{what}_{ERRORS[what]}": value for what, value in figures.rmse.items()}
        rows.append(row)
    return rows


def _nees(outcome: StudyOutcome) -> Columns:
    return [
        {
            "filter": name,
            "block": block,
            "time_s": time_s,
            "nees": nees,
            "low": block_nees.band[0],
            "high": block_nees.band[1],
        }
        for name, figures in outcome.filters.items()
        for block, block_nees in figures.consistency.items()
        for time_s, nees in zip(
            outcome.time_s.tolist(), figures.nees_curve[block].tolist(), strict=True
        )
    ]
