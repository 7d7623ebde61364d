"""`import slamcheck`: what it offers is what it says, and importing it loads nothing heavy."""

import ast
import inspect
import json
import re
import shutil
import sys
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import slamcheck
from comparisons.report.html.shell import prose
from tests.comparisons.test_html_report import Reader
from tests.processes import printed, python
from tests.release_check import ROOT, version

SOURCE = Path(slamcheck.__file__)


def test_every_name_exists_and_type_checkers_see_the_same_object() -> None:
    tree = ast.parse(SOURCE.read_text())
    typed: dict[str | None, str] = {}
    for node in tree.body:
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            for one in node.body:
                if isinstance(one, ast.ImportFrom):
                    named = [alias for alias in one.names if alias.asname is not None]
                    typed |= {alias.asname: f"{one.module}:{alias.name}" for alias in named}
    places = {
        name: place if ":" in place else f"{place}:{name}"
        for name, place in slamcheck._PLACES.items()
    }
    own = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert typed == places
    assert set(slamcheck.__all__) == {*places, *(name for name in own if name[0] != "_")}
    for name in slamcheck.__all__:
        assert getattr(slamcheck, name) is not None
    assert dir(slamcheck) == sorted(slamcheck.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = slamcheck.nothing


def test_every_name_has_one_use() -> None:
    """The reference is made by use: a name without one would be missing there."""
    placed = [name for names in slamcheck._USES.values() for name in names]
    assert sorted(placed) == sorted(slamcheck.__all__)


@pytest.mark.parametrize("package", ["slamcheck", "comparisons", "ekf_reference", "graphslam"])
def test_types_reach_a_users_type_checker(package: str) -> None:
    """Without the mark everything that comes from a package is Any to its users (PEP 561)."""
    root = SOURCE.parents[1]
    assert (root / package / "py.typed").exists()
    found = tomllib.loads((root / "pyproject.toml").read_text())
    assert "py.typed" in found["tool"]["setuptools"]["package-data"]["*"]


def test_options_are_typed_as_the_table_has_them() -> None:
    """`make settings` makes the file; a wrong word then fails in a user's type checker."""
    from tools.options_types import source

    text = (SOURCE.parent / "_options.py").read_text()
    assert text == source()
    assert "filter: Literal['full', 'compressed'," in text
    for job, options in (("compare", "Run"), ("check", "Check"), ("solve", "Solve")):
        assert f"Unpack[{options}Options]" in str(inspect.signature(getattr(slamcheck, job)))


def test_names_and_paths_stand_for_logs_and_estimates(tmp_path: Path) -> None:
    log = slamcheck.load_log("simulated-loop", seed=3)
    slamcheck.write_log(log, str(tmp_path / "mine"))
    solved = slamcheck.solve(str(tmp_path / "mine"))
    slamcheck.write_estimate(solved.estimate, str(tmp_path / "out"))
    read = slamcheck.read_estimate(str(tmp_path / "out"))
    assert len(read.time_s) == len(solved.estimate.time_s)
    with pytest.raises(slamcheck.InputError, match="no-such-log"):
        slamcheck.compare("no-such-log")


def test_importing_it_loads_nothing_heavy() -> None:
    code = (
        "import sys, slamcheck; "
        "print([m for m in ('numpy', 'gtsam', 'pydantic', 'comparisons') if m in sys.modules])"
    )
    assert printed(code) == "[]"


@pytest.mark.slow
def test_a_log_is_run_checked_and_solved(tmp_path: Path) -> None:
    log = slamcheck.load_log("simulated-loop", seed=7)
    run = slamcheck.compare(log, filter="compressed")
    assert run.verdict.outcome == "agree"
    estimate = run.ekf.estimate
    folder = tmp_path / "new" / "folder"
    slamcheck.write_estimate(estimate, folder)
    (tmp_path / "file").touch()
    with pytest.raises(slamcheck.InputError, match="cannot be made"):
        slamcheck.write_estimate(estimate, tmp_path / "file")
    for handed_in in (estimate, slamcheck.ExternalEstimate.of(estimate), folder, str(folder)):
        assert slamcheck.check(log, handed_in).outcome == "agree"
    solution = slamcheck.solve(log)
    assert np.isfinite(solution.estimate.pose).all()
    counts = "3,400 odometry, 1,900 measurements, 3,401 truth poses"
    assert repr(log) == f"<Log simulated-loop: {counts}; 85.0 s>"
    assert repr(run) == f"<Comparison of simulated-loop: {run.verdict.summary}>"
    assert repr(estimate) == "<Estimate: 426 filtered poses, 60 landmarks>"
    checked = slamcheck.check(log, estimate)
    assert repr(checked) == "<ExternalCheck of simulated-loop: agree, grade equal>"
    assert repr(solution).endswith(", verified>")


def test_faults_are_input_errors() -> None:
    with pytest.raises(slamcheck.InputError, match="seed"):
        slamcheck.load_log("simulated-loop", seed=-1)
    with pytest.raises(slamcheck.InputError, match="sede"):
        slamcheck.load_log("simulated-loop", sede=1)
    with pytest.raises(slamcheck.InputError, match="no-such-log"):
        slamcheck.load_log("no-such-log")


JOBS: dict[str, Callable[..., object]] = {
    "compare": slamcheck.compare,
    "solve": slamcheck.solve,
    "odometry": slamcheck.odometry,
    "dense_map": slamcheck.dense_map,
}


@pytest.mark.parametrize("job", sorted(JOBS))
def test_a_job_takes_options_or_a_configuration(job: str, log: slamcheck.Log) -> None:
    for name in ("filtr", "seed", "features"):  # the log is read already
        with pytest.raises(slamcheck.InputError, match=f"option {name}: is unknown, expected some"):
            JOBS[job](log, **{name: "trees"})
    with pytest.raises(slamcheck.InputError, match=r"or options \(gps\), not both"):
        JOBS[job](log, slamcheck.RunConfig(), gps="off")


@pytest.mark.parametrize(
    ("fields", "reported"),
    [
        ({"pose": np.zeros((3, 2))}, r"pose has shape \(3, 2\), expected \(3, 3\)"),
        ({"time_s": [0.0, 2.0, 1.0]}, "time_s must hold at least one time, in increasing order"),
        ({"time_s": []}, "time_s must hold at least one time"),
        ({"pose": [[0, 0, 0], [0, np.nan, 0], [0, 0, 0]]}, r"pose\[1\] holds a value that is not"),
        ({"pose": [["a", "b", "c"]] * 3}, "pose must hold numbers"),
        ({"landmark": np.zeros((2, 2))}, "landmark and landmark_id both"),
        ({"landmark": np.zeros((2, 2)), "landmark_id": [1, 1]}, "whole numbers, each once"),
        ({"joint_covariance": np.eye(5)}, r"has shape \(5, 5\), expected \(3, 3\)"),
    ],
)
def test_a_fault_in_own_arrays_is_named(
    fields: dict[str, Any], reported: str, log: slamcheck.Log
) -> None:
    sound = {"time_s": np.arange(3.0), "pose": np.zeros((3, 3))}
    given = slamcheck.ExternalEstimate(**{**sound, **fields})
    with pytest.raises(slamcheck.InputError, match=reported):
        slamcheck.check(log, given)


HOSTILE = "<script>alert('x')</script><img src=x onerror=y>"


@pytest.fixture(scope="module")
def log() -> slamcheck.Log:
    return replace(slamcheck.load_log("simulated-loop", seed=7), name=HOSTILE)


@pytest.fixture(scope="module")
def run(log: slamcheck.Log) -> slamcheck.Comparison:
    return slamcheck.compare(log)


@pytest.fixture(scope="module")
def checked(log: slamcheck.Log, run: slamcheck.Comparison) -> slamcheck.ExternalCheck:
    """Of lists, in another frame."""
    e, shift = run.ekf.estimate, np.array((5.0, -3.0, 0.0))
    return slamcheck.check(
        log,
        slamcheck.ExternalEstimate(
            time_s=e.time_s.tolist(),
            pose=(e.pose + shift).tolist(),
            pose_covariance=e.pose_covariance,
            landmark_id=e.landmark_id,
            landmark=e.landmark + shift[:2],
            joint_covariance=e.joint_covariance,
            estimator="ekf",
        ),
    )


@pytest.fixture(scope="module")
def results(
    log: slamcheck.Log, run: slamcheck.Comparison, checked: slamcheck.ExternalCheck
) -> dict[str, Any]:
    return {
        "Comparison": run,
        "ExternalCheck": checked,
        "Solution": slamcheck.solve(log),
        "MonteCarlo": slamcheck.montecarlo("circle", runs=2),
        "Log": log,
        "Estimate": run.ekf.estimate,
    }


PLACES: dict[str, Callable[[Any, Any], object]] = {
    "load_log source": lambda at, run: slamcheck.load_log(at),
    "compare log": lambda at, run: slamcheck.compare(at),
    "check log": lambda at, run: slamcheck.check(at, run.smoothed),
    "check estimate": lambda at, run: slamcheck.check(run.log, at),
    "check times": lambda at, run: slamcheck.check(run.log, at, times=at),
    "check trace": lambda at, run: slamcheck.check(run.log, at, trace=at),
    "compare_estimates first": lambda at, run: slamcheck.compare_estimates(at, run.smoothed),
    "compare_estimates second": lambda at, run: slamcheck.compare_estimates(run.smoothed, at),
    "solve log": lambda at, run: slamcheck.solve(at),
    "odometry log": lambda at, run: slamcheck.odometry(at),
    "dense_map log": lambda at, run: slamcheck.dense_map(at),
    "audit trace": lambda at, run: slamcheck.audit(at),
    "read_estimate path": lambda at, run: slamcheck.read_estimate(at),
    "read_estimate times": lambda at, run: slamcheck.read_estimate(at, times=at),
    "read_estimate trace": lambda at, run: slamcheck.read_estimate(at, trace=at),
    "write_estimate folder": lambda at, run: slamcheck.write_estimate(run.smoothed, at),
    "write_log folder": lambda at, run: slamcheck.write_log(run.log, at),
    "write_report folder": lambda at, run: slamcheck.write_report(run, at),
    "montecarlo scenario": lambda at, run: slamcheck.montecarlo(at, runs=1),
    "montecarlo folder": lambda at, run: slamcheck.montecarlo(runs=1, folder=at),
    "Recorder path": lambda at, run: slamcheck.Recorder(at),
    "record path": lambda at, run: slamcheck.record((NoTransition(), None), at),
}
"""Function and parameter of every place that is given, called with a file that is none of those."""


class NoTransition:
    """The first of a pair that stands for Stone Soup's filter."""

    transition_model = None


def test_the_table_has_every_place() -> None:
    taking = set()
    for name in slamcheck.__all__:
        one = getattr(slamcheck, name)
        if name in ("Audit", "InputError", "Log"):  # which are returned or raised
            continue
        for parameter in inspect.signature(one).parameters.values():
            if "Path" in str(parameter.annotation):
                taking.add(f"{name} {parameter.name}")
    text = (SOURCE.parent / "_options.py").read_text()
    taking |= {f"check {name}" for name in re.findall(r"(\w+): str \| Path", text)}
    assert set(PLACES) == taking


@pytest.mark.parametrize("name", PLACES)
def test_a_place_is_a_text_or_a_path(name: str, run: slamcheck.Comparison, tmp_path: Path) -> None:
    """Both are refused in the same words, which name the file."""
    file = tmp_path / "taken"
    file.write_text("nothing")
    said = []
    for place in (file, str(file)):
        with pytest.raises(slamcheck.InputError) as caught:
            PLACES[name](place, run)
        said.append(str(caught.value))
    assert said[0] == said[1]
    assert "taken" in said[0]


def test_results_and_what_they_hold_print_in_one_line(
    run: slamcheck.Comparison, checked: slamcheck.ExternalCheck
) -> None:
    """Arrays by their shape: numpy's own text of many numbers has many lines."""
    assert "\n" in repr(run.ekf.estimate.pose)
    held: list[object] = [run, checked, checked.solution, run.log, run.ekf.estimate, checked.given]
    held.append(run.known.gaps)
    held += [slamcheck.compare_estimates(run.ekf.estimate, run.smoothed), slamcheck.RunConfig()]
    for one in tuple(held):
        names = [name for name in dir(one) if name[0] != "_" and not name.startswith("model_")]
        parts = [getattr(one, name) for name in names]
        held += [part for part in parts if type(part).__module__.startswith("comparisons.")]
    assert {"Graded", "EkfRun", "Gaps", "Truth"} <= {type(one).__name__ for one in held}
    for one in held:
        for text in (repr(one), str(one)):
            assert "\n" not in text, type(one)


def test_a_name_taken_for_markup_is_seen() -> None:
    seen = Reader(f"<b>{HOSTILE}</b>")
    assert "script" in seen.tags
    assert "onerror" in seen.names


SHOWN = {"Comparison", "ExternalCheck", "Solution", "MonteCarlo", "Log", "Estimate"}


def framed(result: Any) -> str:
    """The page in the frame that a notebook shows of a result; nothing of it is outside."""
    outer = Reader(result._repr_html_())
    assert outer.tags == ["iframe"]
    assert outer.names == {"sandbox", "srcdoc", "style"}
    given = {name: value for _, name, value in outer.attributes}
    assert given["sandbox"] == "allow-scripts"
    return given["srcdoc"]


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(SHOWN))
def test_a_result_shows_itself_in_a_notebook(name: str, results: dict[str, Any]) -> None:
    page = framed(results[name])
    seen = Reader(page)
    assert "default-src 'none'" in page
    assert "config.toml" not in seen.text.partition("const data")[0], "no folder is beside it"
    assert not {one for one in seen.names if one.startswith("on")}
    assert len(page) < 600_000
    assert len(repr(results[name])) < 300
    if name not in ("MonteCarlo", "Estimate"):
        assert HOSTILE in seen.text
    if name != "MonteCarlo":
        assert "svg" in seen.tags


def test_a_run_shows_verdict_gaps_and_causes(results: dict[str, Any]) -> None:
    shown = framed(results["Comparison"]).lower()
    assert results["Comparison"].verdict.headline.lower() in shown
    assert [gap for gap in ("algebra", "model", "linearisation", "truth") if gap not in shown] == []
    checked = results["ExternalCheck"]
    assert checked.outcome == "disagree"
    page = framed(checked)
    facts = [fact for cause in checked.causes for fact in cause.evidence.split("; ")]
    assert [fact for fact in facts if prose(fact) not in page] == []


def test_a_large_map_stays_small() -> None:
    poses, landmarks = 200_000, 5_000
    spread = np.random.default_rng(0).normal(size=(landmarks, 2))
    large = slamcheck.Estimate(
        time_s=np.arange(float(poses)),
        pose=np.random.default_rng(1).normal(size=(poses, 3)),
        pose_covariance=np.broadcast_to(np.eye(3), (poses, 3, 3)),
        landmark_id=np.arange(landmarks),
        landmark=spread,
        joint_covariance=np.eye(3),
        information="filtered",
    )
    assert len(large._repr_html_()) < 1_000_000
    assert len(large.to_pandas("landmarks").columns) == 3  # without covariances


TABLES = {
    "Comparison": ("gaps", "landmarks", "nees", "nis", "causes", "settings"),
    "ExternalCheck": ("causes", "gaps", "poses", "landmarks", "nees", "settings"),
    "Solution": ("poses", "landmarks", "settings"),
    "MonteCarlo": ("filters", "pairs", "nees"),
    "Log": ("odometry", "measurements", "positions", "truth", "truth_landmarks"),
    "Estimate": ("poses", "landmarks"),
}


@pytest.mark.parametrize("name", sorted(TABLES))
def test_tables_are_data_frames(name: str, results: dict[str, Any]) -> None:
    pytest.importorskip("pandas")
    one, typed = results[name], get_type_hints_of(results[name].to_pandas)
    assert typed == TABLES[name]
    with pytest.raises(slamcheck.InputError) as reported:
        one.to_pandas("nothing")
    assert str(reported.value).endswith(f"expected one of {', '.join(offered(reported.value))}")
    assert set(offered(reported.value)) == set(TABLES[name])
    empty = {"Log": ("positions",), "Comparison": ("causes",),
             "MonteCarlo": ("pairs",)}  # fmt: skip
    for table in TABLES[name]:
        frame = one.to_pandas(table)
        assert (len(frame) > 0) == (table not in empty.get(name, ())), table
        assert not any(frame[column].map(np.ndim).any() for column in frame if table != "settings")


def get_type_hints_of(method: Callable[..., object]) -> tuple[str, ...]:
    """The names that the type of `table` allows."""
    words = inspect.signature(method).parameters["table"].annotation
    return tuple(re.findall(r"[\"'](\w+)[\"']", words))


def offered(error: Exception) -> list[str]:
    """The names that an error offers."""
    return str(error).rpartition("expected one of ")[2].split(", ")


def test_figures_of_a_table_are_the_results(results: dict[str, Any]) -> None:
    pytest.importorskip("pandas")
    run, e = results["Comparison"], results["Estimate"]
    gaps = run.to_pandas().set_index("gap")
    assert gaps["sigma"]["linearisation"] == run.agreement.linearisation.sigma
    poses = e.to_pandas()
    assert np.array_equal(poses[["x_m", "y_m", "heading_rad"]].to_numpy(), e.pose)
    assert np.allclose(poses["sigma_x_m"] ** 2, e.pose_covariance[:, 0, 0], rtol=1e-12)
    nees = run.to_pandas("nees").groupby("estimate")["nees"].mean()
    assert nees["ekf"] == pytest.approx(run.consistency.ekf.poses.pose.mean)
    settings = run.to_pandas("settings").set_index("setting")
    assert settings["value"]["ekf.filter"] == "full"


def test_without_pandas_an_error_says_what_to_install(
    run: slamcheck.Comparison, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(slamcheck.InputError, match="pip install pandas"):
        run.to_pandas()


@pytest.mark.slow
def test_a_report_folder_is_written(results: dict[str, Any], tmp_path: Path) -> None:
    files = {"Comparison": "result", "ExternalCheck": "check", "Solution": "solution"}
    for name, file in files.items():
        slamcheck.write_report(results[name], tmp_path / name)
        assert (tmp_path / name / f"{file}.json").exists()
        slamcheck.write_report(results[name], str(tmp_path / name))
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "mine.txt").write_text("mine")
    with pytest.raises(slamcheck.InputError, match="other"):
        slamcheck.write_report(results["Comparison"], tmp_path / "other")
    with pytest.raises(TypeError, match="a Log has no report"):
        slamcheck.write_report(results["Log"], tmp_path / "log")


@pytest.mark.slow
def test_scan_jobs_show_themselves_and_are_written(tmp_path: Path) -> None:
    pytest.importorskip("kiss_icp")
    log = slamcheck.load_log("scan-loop")
    for result in (slamcheck.dense_map(log, layer=["occupancy"]), slamcheck.odometry(log)):
        page = framed(result)
        assert "<svg" in page
        assert len(page) < 300_000
        slamcheck.write_report(result, tmp_path / "out")
        (file,) = (tmp_path / "out").glob("*.json")
        assert "settings" in json.loads(file.read_text())
        shutil.rmtree(tmp_path / "out")


def test_one_version() -> None:
    """That of pyproject.toml; an installation that is older than it has to be made again.

    What refuses a file of the last release must not call itself by its name: after a release the
    version is that of development.
    """
    assert slamcheck.__version__ == version()
    (cited,) = re.findall(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    headings = re.findall(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert cited in headings
    unreleased = headings[0] == "Unreleased"
    assert version().endswith(".dev0") == unreleased
    assert (version() == cited) != unreleased
    assert python("-m", "slamcheck", "--version").stdout == f"slamcheck {version()}\n"
