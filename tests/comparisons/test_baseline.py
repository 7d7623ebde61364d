"""Baselines, as a gate in continuous integration."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args, get_origin
from xml.etree import ElementTree

import pytest

from comparisons.baseline import (
    Baseline,
    Change,
    Metric,
    build_baseline,
    changes_of,
    compare_with,
    figures,
    read_baseline,
    updated,
    write_baseline,
    write_junit,
)
from comparisons.checks.agreement import LandmarksTogether
from comparisons.checks.check import Check
from comparisons.checks.registry import CHECKS
from comparisons.config import CheckConfig
from comparisons.errors import InputError
from comparisons.estimates.estimate import Estimate
from comparisons.estimates.external import ExternalEstimate
from comparisons.estimates.folder import tum_text, write_estimate
from comparisons.figures import Declared, LeftOut, Less, Number, kept_fields, stored
from comparisons.jobs.check import check
from comparisons.jobs.run import Comparison
from comparisons.logs.log_folder import write_log_folder
from comparisons.report import explain
from comparisons.report.check import CheckReport, CheckResult
from comparisons.report.models import Result
from comparisons.report.run import RunReport
from comparisons.settings import run_config
from tests.commands import refused, slamcheck, works
from tests.helpers import compared, present, simulated


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    return compared(simulated(loop_s=20.0))


@pytest.fixture(scope="module")
def result(comparison: Comparison) -> Result:
    return RunReport.build(comparison)


@pytest.fixture(scope="module")
def estimate(comparison: Comparison) -> Estimate:
    """The reference EKF's, standing in for somebody's filter."""
    return comparison.ekf.estimate


@pytest.fixture(scope="module")
def checked(estimate: Estimate) -> CheckResult:
    return CheckReport.build(check(simulated(loop_s=20.0), ExternalEstimate.of(estimate)))


@pytest.fixture(scope="module")
def bare(estimate: Estimate) -> CheckResult:
    """The same without covariances and landmarks."""
    given = ExternalEstimate(time_s=estimate.time_s, pose=estimate.pose, information="filtered")
    return CheckReport.build(check(simulated(loop_s=20.0), given))


@pytest.fixture
def kept(result: Result) -> Baseline:
    return build_baseline([result, result], run_config())


def with_metrics(kept: Baseline, **others: Metric | None) -> Baseline:
    """The baseline with other figures, of which those that are None are left out."""
    metrics = {name: one for name, one in {**kept.metrics, **others}.items() if one is not None}
    return kept.model_copy(update={"metrics": metrics})


def changed(result: Result, **agreement: Any) -> Result:
    """The result with other figures of agreement."""
    return result.model_copy(update={"agreement": replace(result.agreement, **agreement)})


def test_the_same_run_holds(result: Result, kept: Baseline) -> None:
    changes = compare_with(kept, result)
    assert len(changes) > 40
    assert all(change.holds for change in changes)
    assert {"agreement.optimism", "accuracy.ekf.ate_m", "smoother.error"} <= set(kept.metrics)


def test_rounding_may_be_any_rounding_but_no_more(result: Result, kept: Baseline) -> None:
    assert all(c.holds for c in compare_with(kept, changed(result, algebra_gap_sigma=5e-8)))
    broken = [c for c in compare_with(kept, changed(result, algebra_gap_sigma=5e-5)) if not c.holds]
    assert [c.name for c in broken] == ["agreement.algebra_gap_sigma"]


def test_what_older_baselines_lack_is_not_compared_but_a_count_has_to_be_zero(
    result: Result, kept: Baseline
) -> None:
    older = with_metrics(kept, **{"ekf.deactivated": None, "accuracy.ekf.rpe_10m_m": None})
    assert len(older.metrics) == len(kept.metrics) - 2
    assert all(c.holds for c in compare_with(older, result))
    deactivated = result.model_copy(
        update={"ekf": result.ekf.model_copy(update={"deactivated": 1})}
    )
    assert [c.name for c in compare_with(older, deactivated) if not c.holds] == ["ekf.deactivated"]


def test_repetitions_tell_the_noise_floor(result: Result) -> None:
    other = changed(result, optimism=1.2 * present(result.agreement.optimism))
    noisy = build_baseline([result, other], run_config())
    assert noisy.metrics["agreement.optimism"].tolerance == pytest.approx(
        0.6 * present(result.agreement.optimism)
    )
    assert all(c.holds for c in compare_with(noisy, other))


def test_another_log_is_not_compared(kept: Baseline) -> None:
    other = RunReport.build(compared(simulated(seed=1, loop_s=20.0)))
    with pytest.raises(InputError, match="save a new baseline"):
        compare_with(kept, other)


def test_files_round_trip_and_damage_is_named(tmp_path: Path, kept: Baseline) -> None:
    path = tmp_path / "b.json"
    write_baseline(kept, path)
    assert read_baseline(path) == kept
    data = json.loads(path.read_text())
    for damage in ("", "[]", "{}", json.dumps({**data, "strange": 1}), path.read_text()[:400]):
        path.write_text(damage)
        with pytest.raises(InputError, match="not a baseline"):
            read_baseline(path)
    path.write_text(json.dumps({**data, "version": 5}))
    with pytest.raises(InputError, match="version 5"):
        read_baseline(path)


@pytest.mark.parametrize("version", [1, 2, 3])
def test_a_file_of_an_earlier_version_names_what_reads_it(
    tmp_path: Path, kept: Baseline, version: int
) -> None:
    path = tmp_path / "b.json"
    path.write_text(json.dumps({**kept.model_dump(), "version": version, "settings": {}}))
    assert refused("baseline", "compare", "simulated-loop", str(path), cwd=tmp_path) == (
        f"slamcheck: {path}: is a baseline of version {version}, which slamcheck 0.2 reads and "
        "this release does not; save a new one with slamcheck baseline save"
    )


@pytest.mark.parametrize(
    ("figure", "factor", "kind", "said"),
    [
        ("optimism", 9.0, "failure", ", tolerance "),
        ("linearisation_gap_sigma", 0.5, "system-out", "better: agreement.linearisation_gap_sig"),
    ],
)
def test_a_junit_report_says_what_is_worse_and_what_is_better(
    figure: str, factor: float, kind: str, said: str, kept: Baseline, result: Result, tmp_path: Path
) -> None:
    now = {figure: factor * present(getattr(result.agreement, figure))}
    changes = compare_with(kept, changed(result, **now))
    write_junit(changes, "a <log>", tmp_path / "report.xml")
    suite = ElementTree.parse(tmp_path / "report.xml").getroot()  # noqa: S314
    assert suite.get("failures") == str(int(kind == "failure"))
    assert len(suite) == len(changes) == int(suite.get("tests", "0"))
    (case,) = [case for case in suite if len(case)]
    assert (case.get("name"), case[0].tag) == (f"agreement.{figure}", kind)
    assert said in (case[0].get("message") or str(case[0].text))


def test_names_of_figures_are_those_of_the_result(result: Result) -> None:
    document = result.model_dump()
    found = figures(result)
    assert {name for name in found if name.startswith(("accuracy.dead", "spurious", "truth"))}
    for name, one in found.items():
        place: object = document
        for part in name.split("."):
            assert isinstance(place, dict)
            place = place[part]
            if isinstance(place, list | tuple):
                break
        else:
            assert place == one.value


def test_figures_of_a_file_are_those_of_the_result(result: Result, checked: CheckResult) -> None:
    for found in (result, checked):
        again = type(found).model_validate_json(found.model_dump_json(by_alias=True))
        assert figures(again) == figures(found)


def test_an_entry_of_anything_has_the_figures_that_are_there(result: Result) -> None:
    scans = {"scans": True, "rejected": 10**400, "fused": "many", "dynamic": 2, "rule": [1]}
    rows = ["x", 5, {"difference_m": "far", "agrees": 1}, {"distance_sigma": None, "agrees": True}]
    odd = {
        **result.model_dump(by_alias=True),
        "config": {"extensions": {"scan_landmarks": {}, "nothing": 1}},
        "scan_slam": {**scans, "landmarks": rows},
    }
    found = figures(Result.model_validate(odd))
    kept = {name: one.value for name, one in found.items() if name.startswith("scan_slam")}
    assert kept.pop("scan_slam.rejected") is None
    assert {name: value for name, value in kept.items() if value is not None} == {
        "scan_slam.landmarks.count": 4,
        "scan_slam.landmarks.agreeing": 1,
        "scan_slam.dynamic": 2,
    }


def states(changes: list[Change]) -> dict[str, str]:
    """What does not just hold."""
    return {change.name: change.state for change in changes if change.state != "holds"}


@pytest.mark.parametrize(
    ("name", "factor", "state"),
    [
        ("accuracy.ekf.ate_m", 0.9, "better"),
        ("accuracy.ekf.ate_m", 1.1, "broken"),
        ("accuracy.ekf.coverage", 0.9, "broken"),
        ("accuracy.ekf.landmarks_found", 1.1, "better"),
        ("agreement.optimism", 0.9, "broken"),
        ("agreement.optimism", 1.1, "better"),
        ("agreement.optimism", 1.01, "holds"),
        ("agreement.linearisation_gap_sigma", 0.5, "better"),
        ("agreement.linearisation_gap_sigma", 2.0, "broken"),
        ("ekf.landmarks", 1.1, "broken"),
    ],
)
def test_less_of_an_error_is_better_and_beyond_the_tolerance_other_changes_are_not(
    result: Result, kept: Baseline, name: str, factor: float, state: str
) -> None:
    was = kept.metrics[name]
    assert was.value
    then = with_metrics(kept, **{name: was.model_copy(update={"value": was.value / factor})})
    found = {change.name: change.state for change in compare_with(then, result)}
    assert found.pop(name) == state
    assert set(found.values()) == {"holds"}


@pytest.mark.parametrize(
    ("then", "state"),
    [(0.5, "better"), (2.0, "better"), (1.02, "holds"), (0.97, "holds"), (1.001, "holds")],
)
def test_nearer_to_the_nominal_value_is_better(
    result: Result, kept: Baseline, then: float, state: str
) -> None:
    """From either side, of an average and of a ratio; away from it is worse."""
    for name, nominal in (("consistency.ekf.pose.mean", 3.0), ("agreement.optimism", 1.0)):
        was = Metric(value=then * nominal, tolerance=0.04 * nominal)
        now = Metric(value=nominal, tolerance=0.04 * nominal)
        values = {name: Number(nominal, "nominal", nominal)}
        one = kept.model_copy(update={"metrics": {name: was}})
        (found,) = changes_of(one, {"verdict": kept.verdict}, values)[1:]
        assert found.state == state
        back = kept.model_copy(update={"metrics": {name: now}})
        moved = {name: Number(then * nominal, "nominal", nominal)}
        (found,) = changes_of(back, {"verdict": kept.verdict}, moved)[1:]
        assert found.state == {"better": "broken"}.get(state, state)


@dataclass(frozen=True)
class Start:
    """Where something begins."""

    size_m: Less[float]


@dataclass(frozen=True)
class Drift:
    """What the check of nobody's finds."""

    drift_m: Less[float]
    worst_s: LeftOut[float]
    start: LeftOut[Start]
    steps: int
    curve: tuple[float, ...] = ()


@dataclass(frozen=True)
class Unjudged:
    """A figure that nobody thought of, below one of another side."""

    drift: Less[dict[str, Drift]]
    jerk: float


class CheckDrift(Check):
    """Does it drift?"""

    name = "drift"
    figures = (("drift", Drift),)


def undeclared(kind: Any, above: str, side: str | None = None) -> Iterator[str]:
    """Floats that neither say on which side they are better, nor are below one that says it."""
    if kind is float and side in (None, "count"):
        yield above
    for part in () if kind in (float, int) else get_args(kind):
        yield from undeclared(part, above, side)
    for name, one in kept_fields(kind).items():
        keyed = any(field.mark.key for field in rows_of(one.hint))
        if one.mark.together is None and (keyed or get_origin(one.hint) not in (list, tuple)):
            yield from undeclared(one.hint, f"{above}.{name}", one.mark.side or side)


def rows_of(hint: Any) -> list[Declared]:
    return [field for row in get_args(hint)[:1] for field in kept_fields(row).values()]


def test_every_number_of_every_check_says_on_which_side_it_is_better() -> None:
    kinds = dict(one for check in explain.every_check() for one in check.figures)
    assert len(kinds) > 15
    more = {"run": Result, "check": CheckResult, "landmarks": LandmarksTogether}
    for name, kind in (kinds | more).items():
        assert list(undeclared(kind, name)) == []
    assert list(undeclared(Unjudged, "toy")) == ["toy.jerk"]


def test_figures_of_a_new_check_are_kept_and_are_new_beside_an_older_baseline(
    result: Result, kept: Baseline, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With nothing but the check itself."""
    monkeypatch.setattr(explain, "CHECKS", (*CHECKS, CheckDrift()))
    with_drift = [
        Result.model_validate({**result.model_dump(by_alias=True), "drift": stored(drift)})
        for drift in (Drift(1.0, 3.0, Start(1.0), 7), Drift(1.2, 9.0, Start(2.0), 7))
    ]
    assert figures(with_drift[0])["drift.drift_m"] == Number(1.0, "less")
    assert states(compare_with(kept, with_drift[0])) == {
        "drift.drift_m": "new",
        "drift.steps": "new",
    }
    newer = build_baseline(with_drift[:1], run_config())
    assert states(compare_with(newer, with_drift[1])) == {"drift.drift_m": "broken"}


def test_a_figure_of_no_side_is_two_sided(result: Result, kept: Baseline) -> None:
    then = with_metrics(kept, **{"ekf.unheard_of": Metric(value=1.0, tolerance=0.0)})
    assert states(compare_with(then, result)) == {"ekf.unheard_of": "broken"}


def test_a_check_holds_beside_itself(checked: CheckResult) -> None:
    kept = build_baseline([checked], CheckConfig(estimate="mine", times="times.txt"))
    changes = compare_with(kept, checked)
    assert states(changes) == {}
    assert [change.name for change in changes[:2]] == ["verdict", "grade"]
    assert {"rms_m", "accuracy.ate_m", "landmarks.agreeing", "outside"} <= set(kept.metrics)
    assert not {"estimate", "times"} & set(kept.config)
    assert not {"source", "sha256"} & set(kept.config["log"])
    assert kept.of_estimate
    assert read_again(kept) == kept


def read_again(kept: Baseline) -> Baseline:
    return Baseline.model_validate_json(json.dumps(kept.model_dump()))


def test_a_worse_and_a_better_estimate(checked: CheckResult) -> None:
    kept = build_baseline([checked], CheckConfig())
    worse = checked.model_copy(
        update={"rms_m": 2.0 * checked.rms_m, "grade": "like", "verdict": "disagree"}
    )
    broken = dict.fromkeys(("verdict", "grade", "rms_m"), "broken")
    assert states(compare_with(kept, worse)) == broken
    from_worse = states(compare_with(build_baseline([worse], CheckConfig()), checked))
    assert from_worse == dict.fromkeys(("verdict", "grade", "rms_m"), "better")


def test_what_is_no_longer_handed_in_is_broken_and_what_is_more_is_new(
    checked: CheckResult, bare: CheckResult
) -> None:
    less = states(compare_with(build_baseline([checked], CheckConfig()), bare))
    assert less["outside"] == less["landmarks.agreeing"] == "broken"
    more = compare_with(build_baseline([bare], CheckConfig()), checked)
    found = {n: state for n, state in states(more).items() if not n.startswith("landmarks.")}
    assert found["outside"] == "new"
    assert "broken" not in found.values()


def test_a_run_and_an_estimate_are_not_compared(
    result: Result, checked: CheckResult, kept: Baseline
) -> None:
    with pytest.raises(InputError, match="is of an estimate, expected slamcheck run"):
        compare_with(kept, checked)
    with pytest.raises(InputError, match="is of slamcheck run, expected an estimate"):
        compare_with(build_baseline([checked], CheckConfig()), result)


def test_an_update_keeps_tolerances_made_by_hand(checked: CheckResult) -> None:
    kept = build_baseline([checked], CheckConfig())
    kept = with_metrics(kept, rms_m=Metric(value=checked.rms_m, tolerance=0.5))
    accuracy = replace(present(checked.accuracy), ate_m=10.0)
    worse = checked.model_copy(update={"rms_m": checked.rms_m + 0.4, "accuracy": accuracy})
    assert states(compare_with(kept, worse)) == {"accuracy.ate_m": "broken"}
    new = updated(kept, worse, CheckConfig())
    assert new.metrics["rms_m"] == Metric(value=checked.rms_m + 0.4, tolerance=0.5)
    assert new.metrics["accuracy.ate_m"] == Metric(value=10.0, tolerance=0.2)
    assert states(compare_with(new, worse)) == {}


def test_a_file_without_some_figures_is_updated(
    tmp_path: Path, result: Result, kept: Baseline
) -> None:
    metrics = {name: m for name, m in kept.metrics.items() if "consistency" not in name}
    fewer = kept.model_copy(update={"metrics": metrics})
    assert set(states(compare_with(fewer, result)).values()) == {"new"}
    write_baseline(updated(fewer, result, run_config()), tmp_path / "b.json")
    assert states(compare_with(read_baseline(tmp_path / "b.json"), result)) == {}


@pytest.mark.slow
def test_the_commands_on_an_estimate(tmp_path: Path, estimate: Estimate) -> None:
    write_log_folder(simulated(loop_s=20.0), tmp_path / "log")
    (tmp_path / "mine").mkdir()
    write_estimate(estimate, tmp_path / "mine")
    mine = ("--estimate", "mine")
    printed = works("baseline", "save", "log", "b.json", *mine, cwd=tmp_path)
    assert "verdict agree, grade equal" in printed
    works("baseline", "compare", "log", "b.json", *mine, cwd=tmp_path)
    late = replace(estimate, time_s=estimate.time_s + 0.2)
    (tmp_path / "late.tum").write_text(tum_text(late.time_s, late.pose))
    compare = ("baseline", "compare", "log", "b.json", "--estimate", "late.tum")
    broken = slamcheck(*compare, "--junit", "j.xml", cwd=tmp_path)
    assert broken.returncode == 1
    assert "broken: grade: equal then, wrong now" in broken.stdout
    verdict, cause = broken.stdout.splitlines()[:2]
    assert verdict.startswith("verdict: worse than the baseline; ")
    assert cause.startswith("  time: the time stamps are 0.200 s too late")
    assert "if that is meant, keep it in b.json: --update" in broken.stdout
    cases = ElementTree.parse(tmp_path / "j.xml").getroot()  # noqa: S314
    (grade,) = [case[0] for case in cases if case.get("name") == "grade"]
    assert str(grade.get("message")).startswith("grade: equal then, wrong now")
    assert "time: the time stamps are 0.200 s too late" in str(grade.text)
    before = (tmp_path / "b.json").read_text()
    kept = works(*compare, "--update", cwd=tmp_path)
    assert "broken: grade" in kept
    assert (tmp_path / "b.json").read_text() != before
    assert slamcheck(*compare, cwd=tmp_path).returncode == 0


@pytest.mark.slow
def test_a_baseline_of_the_other_job_is_refused(
    tmp_path: Path, estimate: Estimate, checked: CheckResult, kept: Baseline
) -> None:
    write_log_folder(simulated(loop_s=20.0), tmp_path / "log")
    (tmp_path / "mine").mkdir()
    write_estimate(estimate, tmp_path / "mine")
    write_baseline(kept, tmp_path / "run.json")
    write_baseline(build_baseline([checked], CheckConfig()), tmp_path / "mine.json")
    mine = ("--estimate", "mine")
    for words, message in (
        (("compare", "log", "run.json", *mine), "run.json: is of slamcheck run"),
        (("compare", "log", "mine.json"), "mine.json: is of an estimate; give one with --estimate"),
        (("save", "log", "b.json", *mine, "--runs", "3"), "--runs repeats a run"),
        (("save", "log", "b.json", *mine, "--filter", "full"), "--filter is of a run"),
        (("save", "log", "b.json", "--require", "like"), "--require goes with --estimate"),
        (("save", "log", "b.json", "--estimate", "nowhere", "--replace"), "nowhere: no such file"),
        (("save", "log", "run.json", *mine), "run.json: holds a baseline"),
        (("save", "log", "c.json", *mine, "--out", "d"), "--out d: baseline save writes c.json"),
    ):
        assert message in refused("baseline", *words, cwd=tmp_path), words
    assert not (tmp_path / "b.json").exists()


@pytest.mark.slow
def test_a_gate_of_a_run_with_extensions(tmp_path: Path) -> None:
    """Any option of `run` may be a baseline's; the comparison runs with all of them again."""
    options = ("--filter", "compressed", "--smoother-association", "own", "--robust", "huber")
    log = ("simulated-loop", "--seed", "2")
    works("baseline", "save", *log, "b.json", *options, "--runs", "1", cwd=tmp_path)
    config = json.loads((tmp_path / "b.json").read_text())["config"]
    assert config["extensions"] == {"own_association": {"when": "always"}}
    works("baseline", "compare", "simulated-loop", "b.json", cwd=tmp_path)


def test_a_negative_tolerance_is_refused(tmp_path: Path, checked: CheckResult) -> None:
    """With it no figure would hold, not even the same."""
    path = tmp_path / "kept.json"
    write_baseline(build_baseline([checked], CheckConfig()), path)
    path.write_text(path.read_text().replace('"tolerance": 0.0}', '"tolerance": -1.0}'))
    with pytest.raises(InputError, match="tolerance: input should be greater than"):
        read_baseline(path)
