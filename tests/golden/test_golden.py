"""Golden runs: words, counts and figures of whole commands stay as they were kept."""

from pathlib import Path

import pytest

from comparisons.baseline import Baseline, Metric, read_baseline
from tests.golden.cases import CASES, lacks_data
from tests.golden.run import KEPT, ROUNDING, differences, run_case

KNOWN = "loop-own"


@pytest.fixture(scope="session")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("golden")


@pytest.mark.parametrize("name", CASES)
def test_results_are_as_they_were(name: str, work: Path) -> None:
    if lacks_data(name):
        pytest.skip("the real logs (../shared/data) are not on this machine")
    assert [str(change) for change in differences(read_kept(name), run_case(name, work))] == []


def read_kept(name: str) -> Baseline:
    return read_baseline(KEPT / f"{name}.json")


def test_each_case_is_kept_and_nothing_else() -> None:
    assert {path.stem for path in KEPT.iterdir()} == set(CASES)


def moved(kept: Baseline, times: float) -> Baseline:
    """The same with each figure off by `times` its tolerance."""
    metrics = {
        name: Metric(value=(metric.value or 0.0) + times * metric.tolerance, tolerance=0.0)
        for name, metric in kept.metrics.items()
    }
    return kept.model_copy(update={"metrics": metrics})


@pytest.mark.parametrize("name", CASES)
def test_a_figure_may_move_by_a_part_of_its_tolerance_only(name: str) -> None:
    kept = read_kept(name)
    figures = {name for name, metric in kept.metrics.items() if metric.tolerance}
    for sign in (-1.0, 1.0):
        assert differences(kept, moved(kept, 0.3 * sign)) == []
        assert {change.name for change in differences(kept, moved(kept, 10.0 * sign))} == figures


@pytest.mark.parametrize("name", CASES)
def test_tolerances_are_small_beside_their_figures(name: str) -> None:
    """All but a few, which are near zero."""
    metrics = [m for m in read_kept(name).metrics.values() if m.tolerance > ROUNDING]
    assert metrics
    wide = [m for m in metrics if m.tolerance > 0.05 * abs(m.value or 0.0)]
    assert len(wide) <= 0.05 * len(metrics)


def test_words_counts_and_lost_figures_are_seen() -> None:
    kept = read_kept(KNOWN)
    fewer = {n: m for n, m in kept.metrics.items() if n != "agreement.optimism"}
    lost = kept.model_copy(update={"metrics": fewer})
    count = kept.metrics["ekf.landmarks"]
    more = Metric(value=(count.value or 0.0) + 1.0, tolerance=0.0)
    for now, name in (
        (kept.model_copy(update={"verdict": "unverified"}), "verdict"),
        (kept.model_copy(update={"words": kept.words | {"causes": "algebra"}}), "causes"),
        (kept.model_copy(update={"words": kept.words | {"exit code": "3"}}), "exit code"),
        (kept.model_copy(update={"sha256": "another"}), "log"),
        (
            kept.model_copy(update={"metrics": kept.metrics | {"ekf.landmarks": more}}),
            "ekf.landmarks",
        ),
        (lost, "agreement.optimism"),
    ):
        assert [change.name for change in differences(kept, now)] == [name]
    assert [change.state for change in differences(lost, kept)] == ["new"]
