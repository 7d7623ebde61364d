"""Shelves: tests of what a change seldom breaks, and the files that they cover.

A shelf is run at night, and wherever a file that it covers has changed: since the branch `main`, or
on `main` itself since the commit before. BASE in the environment names another commit to start
from, one at which every shelf has passed.
"""

import os
import subprocess
from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]


class Shelf(NamedTuple):
    """tests: beginnings of node ids; of a file or folder, those that are marked slow or browser.

    covers: beginnings of paths, beside the tests' own files.
    """

    tests: tuple[str, ...]
    covers: tuple[str, ...]


def _tests(*names: str) -> tuple[str, ...]:
    return tuple(f"tests/{name}" for name in names)


def _of_comparisons(*names: str) -> tuple[str, ...]:
    return tuple(f"tests/comparisons/{name}" for name in names)


PRODUCT = ("comparisons/", "ekf_reference/", "graphslam/", "slamcheck/")
"""All that is installed."""
EACH_TIME = _of_comparisons(
    "test_main_job.py::test_victoria_park",
    "test_check_external.py::test_the_command",
    "test_cli.py",
    "test_documented.py",
)
"""On no shelf."""
SHELVES = {
    "the documents' figures": Shelf(
        _tests("research/documents/"),
        ("research/documents/", "comparisons/documented/"),
    ),
    "tutorials and examples": Shelf(
        _tests(
            "test_tutorials.py",
            "test_docs.py",
            "test_snippets.py",
            "test_site_browser.py",
            "test_examples.py",
            "examples/",
        ),
        ("docs/", "examples/", "README.md", "mkdocs.yml"),
    ),
    "results' records": Shelf(
        _tests(
            "research/test_results.py::test_the_pages_in_the_repository_are_those_of_the_records",
            "research/test_results.py::test_earlier_results_are_those_without_a_record",
        ),
        ("docs/results", "research/re"),
    ),
    "equations": Shelf(
        _tests("test_equations.py::test_commands_reach_their_equations"),
        ("docs/equations.md", "ekf_reference/"),
    ),
    "release": Shelf(
        _tests("test_fresh_environment.py", "test_own_project.py", "test_packages.py"),
        ("pyproject.toml", "MANIFEST.in", "slamcheck/"),
    ),
    "browser": Shelf(
        _of_comparisons(
            "test_html_sizes.py",
            "test_html_browser.py",
            "test_check_page.py::test_a_browser_shows_it",
            "test_viewer.py",
        ),
        ("comparisons/report/html/", "comparisons/report/viewer.py"),
    ),
    "research": Shelf(_tests("research/"), ("research/",)),
    "studies": Shelf(
        _of_comparisons("montecarlo/", "test_bands.py", "test_repeat.py"),
        (
            "comparisons/experiments/",
            "comparisons/cli/montecarlo.py",
            "comparisons/pipeline/read.py",
        ),
    ),
    "scans": Shelf(
        (
            *_of_comparisons(
                "test_scan_rounding.py",
                "test_scan_motion.py",
                "test_scan_slam_run.py",
                "test_fused_scan_landmarks.py",
                "test_front_end.py",
                "test_front_end_faults.py",
                "test_own_matching.py",
            ),
            *_tests(
                "graphslam/scan/",
                "ekf_reference/scan_matching/test_alignment_covariance.py::"
                "test_nees_over_200_pairs_is_in_the_band",
                "ekf_reference/scan_landmarks/test_shared_noise.py::"
                "test_errors_through_common_returns_are_as_large_as_said",
            ),
        ),
        (
            "ekf_reference/scan_",
            "graphslam/scan/",
            "comparisons/extensions/scan_",
            "comparisons/extensions/own_matching/",
        ),
    ),
    "dense maps and dynamic objects": Shelf(
        (
            *_of_comparisons(
                "test_dense_run.py",
                "test_dense_checks.py",
                "test_dense_claims.py",
                "test_dynamic_regions.py",
                "test_high_level_run.py",
                "test_map_command.py",
                "test_scan_maps.py",
                "test_both_landmarks.py",
                "logs/test_dynamic_worlds.py",
            ),
            *_tests("ekf_reference/dense/"),
        ),
        (
            "ekf_reference/dense/",
            "comparisons/extensions/dense_maps/",
            "comparisons/extensions/dynamic/",
            "comparisons/extensions/high_level/",
        ),
    ),
    "beyond Gaussians": Shelf(
        (
            *_of_comparisons("test_fastslam.py", "test_posterior_calibration.py"),
            *_tests("ekf_reference/fastslam/"),
        ),
        (
            "ekf_reference/fastslam/",
            "graphslam/sampling.py",
            "comparisons/extensions/fastslam/",
            "comparisons/extensions/posterior/",
        ),
    ),
    "real logs": Shelf(
        _of_comparisons(
            "test_positions.py",
            "test_victoria_park.py",
            "test_association_variants.py",
            "test_solve.py::test_own_association_finds_the_labels_of_mrclam",
            "test_solve.py::test_own_association_of_raw_detections_is_as_the_filters",
            "test_solve.py::test_misread_labels_are_left_out",
            "test_filter_and_smoother.py::test_tracking_solves_the_raw_detections",
            "test_features.py",
            "test_main_job.py::test_mrclam",
            "test_ekf_run.py",
        ),
        (
            "graphslam/association",
            "graphslam/search.py",
            "ekf_reference/association/",
            "ekf_reference/features/",
        ),
    ),
    "long golden runs": Shelf(
        (
            *_tests("golden/test_same.py"),
            *(
                f"tests/golden/test_golden.py::test_results_are_as_they_were[{case}]"
                for case in (
                    "scan-maps-dense",
                    "scan-slam-own",
                    "scan-slam-fused",
                    "scan-loop-dense",
                    "solve",
                    "solve-loop",
                    "map",
                    "map-scans",
                    "map-dynamic",
                    "montecarlo",
                    "dynamic-lanes",
                    "mrclam-2-nn",
                    "odometry",
                    "odometry-car-park",
                    "car-park-trees",
                    "car-park-scan",
                    "car-park-both",
                    "high-level-dense",
                    "loop-2-misono-jcbb",
                    "loop-2-compressed-consensus",
                    "loop-0-misono-full-jcbb",
                    "loop-3-misono-known",
                    "loop-gnc",
                    "loop-isam2",
                )
            ),
        ),
        PRODUCT,
    ),
    "planted faults": Shelf(
        _of_comparisons(
            "test_defects.py",
            "test_regression_gates.py",
            "test_external_trace.py::test_a_planted_defect_has_its_cause",
            "audit/test_audit.py::test_sound_filters_are_rarely_called_faulty",
        ),
        (
            "comparisons/faults/",
            "comparisons/fingerprints/",
            "comparisons/checks/diagnosis/",
            "slamcheck/pytest_plugin.py",
        ),
    ),
    "estimates that are handed in": Shelf(
        (
            *_of_comparisons(
                "test_baseline.py",
                "test_check_external.py",
                "test_check_page.py",
                "test_external_trace.py",
                "test_fingerprints.py",
                "test_grades.py",
                "test_known_landmarks.py",
                "test_newcomer.py",
                "test_stamps.py",
                "test_text_labels.py",
                "test_trajectory_files.py",
            ),
            "tests/test_stranger.py",
        ),
        (
            "comparisons/adapters/",
            "comparisons/checks/",
            "comparisons/estimates/",
            "comparisons/faults/",
            "comparisons/fingerprints/",
            "comparisons/pipeline/",
            "comparisons/trace/",
            "ekf_reference/core/",
        ),
    ),
    "audit": Shelf(
        _tests("comparisons/audit/", "comparisons/trace/", "cpp/"),
        ("comparisons/audit/", "comparisons/trace/", "cpp/", "examples/"),
    ),
    "filters": Shelf(_tests("ekf_reference/"), ("ekf_reference/",)),
    "smoother": Shelf(_tests("graphslam/"), ("graphslam/",)),
    "hostile input": Shelf(_tests("fuzz/", "comparisons/test_beside.py"), PRODUCT),
    "jobs": Shelf(_tests("comparisons/", "test_packages.py", "test_public_interface.py"), PRODUCT),
}
"""By name; a test is on the first that names it. Whatever is not here is run each time."""


def shelf_of(test: str, marks: Collection[str]) -> str | None:
    """Return the shelf of a test by its node id and its marks; None where it is on none."""
    if test.startswith(EACH_TIME):
        return None
    slow = not {"slow", "browser"}.isdisjoint(marks)
    for name, shelf in SHELVES.items():
        if any(test.startswith(one) and (slow or "::" in one) for one in shelf.tests):
            return name
    return None


def due(changed: Collection[str]) -> set[str]:
    """Return the shelves that cover one of the changed files."""
    return {
        name
        for name, shelf in SHELVES.items()
        if any(path.startswith(shelf.covers + _files(shelf)) for path in changed)
    }


def changed_files() -> set[str]:
    """Return the paths that differ from the base, uncommitted ones too; none without git."""
    for base in (os.environ.get("BASE", "origin/main"), "main", "HEAD^"):
        fork = _git("merge-base", "HEAD", base)
        if fork and fork != _git("rev-parse", "HEAD"):
            tracked = _git("diff", "--name-only", fork[0])
            return {*tracked, *_git("ls-files", "--others", "--exclude-standard")}
    return set()


def _files(shelf: Shelf) -> tuple[str, ...]:
    return tuple(test.split("::")[0] for test in shelf.tests)


def _git(*words: str) -> list[str]:
    try:
        found = subprocess.run(
            ["git", *words], cwd=ROOT, capture_output=True, text=True, check=False
        )
    except FileNotFoundError:
        return []
    return found.stdout.splitlines() if found.returncode == 0 else []
