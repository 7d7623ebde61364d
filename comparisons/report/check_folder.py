"""The folder that a check leaves: check.json, a picture, the smoother's estimate."""

from __future__ import annotations

from pathlib import Path

from comparisons.atomic import fresh_folder
from comparisons.estimates.folder import FILES as ESTIMATE_FILES
from comparisons.estimates.folder import write_estimate
from comparisons.pipeline.check import GivenCheck
from comparisons.report.check_models import CheckResult
from comparisons.report.picture import save
from comparisons.report.plots import check_figure

CHECK_CONTENTS = frozenset(
    {"check.json", "map.png"} | {f"smoother/{name}" for name in ESTIMATE_FILES}
)
"""What the folder holds; a folder with nothing else may be replaced by the next."""


def write_check_folder(check: GivenCheck, result: CheckResult, folder: Path) -> None:
    """Write everything; the folder appears whole or not at all. Raises InputError."""
    with fresh_folder(folder, CHECK_CONTENTS) as work:
        (work / "smoother").mkdir()
        write_estimate(check.solution.estimate, work / "smoother")
        save(check_figure(check), work / "map.png")
        (work / "check.json").write_text(result.model_dump_json(indent=2) + "\n", encoding="utf-8")
