"""The estimators are independent: neither imports the other, nor the harness."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ALLOWED = {
    "ekf_reference": {"ekf_reference", "numpy", "scipy"},
    "graphslam": {"graphslam", "numpy", "scipy", "gtsam", "kiss_icp", "open3d", "libusb_package"},
}
STANDARD = {
    "__future__",
    "collections",
    "ctypes",
    "dataclasses",
    "functools",
    "math",
    "pathlib",
    "re",
    "tempfile",
    "types",
    "typing",
}


def imported(source: str) -> set[str]:
    """Top-level names of everything a module imports, anywhere in it."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            names.add((node.module or "").split(".")[0])
    return names


HOUSE = {"comparisons", "ekf_reference", "graphslam"}
MAY_SEE = {
    "variants": {"comparisons.variants"},
    "scenarios": {
        "comparisons.scenarios",
        "comparisons.variants",
        "comparisons.errors",
        "comparisons.logs.simulate",
    },
    "montecarlo": {
        "comparisons.montecarlo",
        "comparisons.scenarios",
        "comparisons.variants",
        "comparisons.errors",
        "comparisons.atomic",
    },
    "reproduction": {
        "comparisons.reproduction",
        "comparisons.logs",
        "comparisons.runs",
        "comparisons.checks",
        "comparisons.report",
        "comparisons.mapping",
        "comparisons.montecarlo.workers",
        "comparisons.atomic",
        "comparisons.errors",
        "ekf_reference",
        "graphslam",
    },
}
TOP = {"reproduction": {"cli_reproduce.py"}}
"""Packages that nothing of comparisons but these files may import."""


@pytest.mark.parametrize("package", sorted(MAY_SEE))
def test_packages_see_no_more_than_they_need(package: str) -> None:
    """The variants know arrays only; none of the Monte Carlo needs a log, estimator or report.

    Reproduced figures stand on all that measures and draws, but on no command.
    """
    modules = list((ROOT / "comparisons" / package).glob("*.py"))
    assert len(modules) > 2
    for module in modules:
        for node in ast.walk(ast.parse(module.read_text())):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [a.name for a in node.names] if isinstance(node, ast.Import) else []
            for name in names:
                if name.split(".")[0] in HOUSE:
                    allowed = any(name == m or name.startswith(f"{m}.") for m in MAY_SEE[package])
                    assert allowed, f"{module.relative_to(ROOT)} imports {name}"


@pytest.mark.parametrize("package", sorted(TOP))
def test_nothing_stands_on_what_is_on_top(package: str) -> None:
    name = f"comparisons.{package}"
    for module in (ROOT / "comparisons").rglob("*.py"):
        if module.parent.name != package and module.name not in TOP[package]:
            assert name not in module.read_text(), f"{module.relative_to(ROOT)} names {name}"


@pytest.mark.parametrize("package", sorted(ALLOWED))
def test_estimators_import_nothing_of_the_house(package: str) -> None:
    modules = list((ROOT / package).rglob("*.py"))
    assert len(modules) > 3
    for module in modules:
        extra = imported(module.read_text()) - ALLOWED[package] - STANDARD
        assert not extra, f"{module.relative_to(ROOT)} imports {sorted(extra)}"


def test_the_check_itself_sees_a_hidden_import() -> None:
    hidden = "def f():\n    if True:\n        from graphslam.smoother import smooth\n"
    assert imported(hidden) == {"graphslam"}


def test_files_stay_readable() -> None:
    for package in ("ekf_reference", "graphslam", "comparisons", "tests"):
        for module in (ROOT / package).rglob("*.py"):
            lines = len(module.read_text().splitlines())
            assert lines <= 400, f"{module.relative_to(ROOT)} has {lines} lines"
