"""`slamcheck compare`: results of several jobs in one table, on a terminal and in files."""

import csv
import io
import json
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from comparisons.errors import InputError
from comparisons.report.models import Result
from comparisons.report.run import RunReport
from comparisons.report.side_by_side import (
    Row,
    print_side_by_side,
    read_results,
    side_by_side,
    write_table,
)
from tests.commands import refused, works
from tests.helpers import compared, simulated

ROWS: list[Row] = [
    ("log", ["a_log & more", "b"]),
    ("agreement.linearisation_gap_covariance", [-1.2345678e-12, 0.1 + 0.2]),
    ("accuracy.ekf.ate_m", [None, -123456.0]),
]


@pytest.fixture(scope="module")
def result() -> Result:
    return RunReport.build(compared(simulated(loop_s=10.0)))


def folder(place: Path, name: str, content: dict[str, Any] | str) -> Path:
    place.mkdir(exist_ok=True)
    text = content if isinstance(content, str) else json.dumps(content)
    (place / f"{name}.json").write_text(text)
    return place


def printed(titles: list[str], rows: list[Row], width: int) -> str:
    file = io.StringIO()
    print_side_by_side(titles, rows, Console(file=file, width=width))
    return file.getvalue()


def test_only_what_differs_is_shown(tmp_path: Path, result: Result) -> None:
    agreement = replace(result.agreement, optimism=0.123)
    other = result.model_copy(update={"agreement": agreement})
    places = [
        folder(tmp_path / name, "result", one.model_dump_json(by_alias=True))
        for name, one in (("a", result), ("b", other))
    ]
    rows = dict(side_by_side(read_results(places)))
    assert rows["agreement.optimism"] == [result.agreement.optimism, 0.123]
    assert "agreement.pessimism" not in rows
    assert "job" not in rows
    assert rows["verdict"] == [result.headline] * 2
    chosen = dict(side_by_side(read_results(places), ["pessim", "smoother.chi*"]))
    assert {name for name in chosen if "." in name} == {"agreement.pessimism", "smoother.chi2"}
    with pytest.raises(InputError, match=r"--only nope: no figure .* of ekf\.\*, smoother"):
        side_by_side(read_results(places), ["nope"])


def test_the_figures_of_every_check_and_extension_are_compared(
    tmp_path: Path, result: Result
) -> None:
    whole = json.loads(result.model_dump_json(by_alias=True))
    learnt = {**whole["spurious_heading"], "sigma_deg": 9.0}
    other = {**whole, "spurious_heading": learnt, "toy": {"drift_m": 2.0, "parts": [1.0]}}
    places = [folder(tmp_path / n, "result", one) for n, one in (("a", whole), ("b", other))]
    rows = dict(side_by_side(read_results(places)))
    assert rows["spurious_heading.sigma_deg"] == [whole["spurious_heading"]["sigma_deg"], 9.0]
    assert rows["toy.drift_m"] == [None, 2.0]
    assert not any(name.startswith(("config", "settings", "seconds", "toy.parts")) for name in rows)


def test_other_jobs_stand_beside_a_run(tmp_path: Path, result: Result) -> None:
    """Under the names that a run has for the same."""
    run = folder(tmp_path / "run", "result", result.model_dump_json(by_alias=True))
    log = {"name": "loop"}
    others = [
        folder(tmp_path / "s", "solution", {
            "log": log, "smoother": {"chi2": 5.0, "rank": 3, "verified": True, "starts": [1]},
            "accuracy": {"ate_m": 1.0}, "verdict": "verified", "config": {"seed": 1},
        }),
        folder(tmp_path / "c", "check", {
            "log": log, "accuracy": {"ate_m": 2.0}, "smoother_accuracy": {"ate_m": 1.0},
            "grade": "like", "verdict": "disagree", "causes": [{"gap": "coverage"}],
        }),
        folder(tmp_path / "o", "odometry", {"log": log, "graph": {"chi2": 7.0}, "wheels": None}),
        folder(tmp_path / "m", "map", {"log": log, "accuracy": {"ate_m": 3.0}, "regions": 4}),
        folder(tmp_path / "mc", "montecarlo", {
            "scenario": "circle", "runs": 50, "filters": {"ekf": {"rmse_position_m": 0.5}},
        }),
    ]  # fmt: skip
    rows = dict(side_by_side(read_results([run, *others])))
    assert rows["job"] == ["run", "solve", "check", "odometry", "map", "montecarlo"]
    assert rows["log"][1:] == ["loop", "loop", "loop", "loop", "circle"]
    assert rows["grade"] == ["", "", "like", "", "", ""]
    assert rows["first cause"][2] == "coverage"
    assert rows["smoother.chi2"][1:] == [5.0, None, 7.0, None, None]
    assert rows["smoother.chi2"][0] == result.smoother.chi2
    assert rows["accuracy.smoother.ate_m"][1:] == [1.0, 1.0, None, None, None]
    assert rows["accuracy.estimate.ate_m"][2] == 2.0
    assert rows["accuracy.ekf.ate_m"][4] == 3.0
    assert rows["filters.ekf.rmse_position_m"][5] == 0.5
    assert not [name for name in rows if "rank" in name or "config" in name or "verified" in name]


@pytest.mark.parametrize("content", ["", "[1]", "{", "[" * 100_000, "null"])
@pytest.mark.parametrize("name", ["result", "solution", "montecarlo"])
def test_what_is_no_result_is_named(tmp_path: Path, name: str, content: str) -> None:
    with pytest.raises(InputError, match=rf"{name}\.json: not a"):
        read_results([folder(tmp_path / "a", name, content)])
    with pytest.raises(InputError, match="nowhere: holds no result of slamcheck, expected one of"):
        read_results([tmp_path / "nowhere"])


@pytest.mark.parametrize("width", [20, 60, 80, 200])
@pytest.mark.parametrize("several", [1, 3, 12])
def test_no_figure_is_ever_broken(width: int, several: int) -> None:
    values = [-1.2345678e-101 * (i + 1) for i in range(several)]
    rows: list[Row] = [("agreement.linearisation_gap_covariance", list(values))]
    rows.append(("verdict", ["disagree, but with quite a few words"] * several))
    text = printed([f"slamcheck-simulated-loop-seed-{i}" for i in range(several)], rows, width)
    for value in values:
        assert f"{value:.5g} " in text
    if width >= 60:
        assert max(map(len, text.splitlines())) <= width
    assert len(text.split("linearisation_gap_covariance")) > 1 + (several > 3)


def test_a_table_that_folds_figures_would_be_found() -> None:
    """What the test above rejects: rich's own folding at 80 columns."""
    from rich.table import Table

    table = Table(box=None)
    table.add_column("", no_wrap=True)
    for i in range(6):
        table.add_column(str(i), overflow="fold")
    figure = f"{-1.2345678e-101:.5g}"
    table.add_row("agreement.linearisation_gap_covariance", *[figure] * 6)
    file = io.StringIO()
    Console(file=file, width=80, soft_wrap=True).print(table)
    assert figure not in file.getvalue()


def test_csv_holds_every_digit(tmp_path: Path) -> None:
    write_table(["x", "y"], ROWS, tmp_path / "t.csv")
    read = list(csv.reader((tmp_path / "t.csv").read_text().splitlines()))
    assert read[0] == ["name", "x", "y"]
    assert read[1] == ["log", "a_log & more", "b"]
    assert [float(cell) for cell in read[2][1:]] == ROWS[1][1]
    assert read[3] == ["accuracy.ekf.ate_m", "", "-123456.0"]


def test_latex_is_escaped(tmp_path: Path) -> None:
    write_table(["x_1", "50 %"], ROWS, tmp_path / "t.tex")
    assert (tmp_path / "t.tex").read_text().splitlines() == [
        r"\begin{tabular}{lrr}",
        r" & x\_1 & 50 \% \\ \hline",
        r"log & a\_log \& more & b \\",
        r"agreement.linearisation\_gap\_covariance & $-1.2346 \times 10^{-12}$ & $0.3$ \\",
        r"accuracy.ekf.ate\_m &  & $-1.2346 \times 10^{5}$ \\",
        r"\end{tabular}",
    ]


def test_html_is_escaped(tmp_path: Path) -> None:
    cells: list[str] = []

    class Reader(HTMLParser):
        def handle_data(self, data: str) -> None:
            cells.append(data.strip())

    write_table(["<b>", "y"], ROWS, tmp_path / "t.html")
    text = (tmp_path / "t.html").read_text()
    assert "accuracy.<wbr>ekf.<wbr>ate_<wbr>m" in text
    Reader().feed(text.replace("<wbr>", ""))
    assert "Content-Security-Policy" in text  # the shell of all pages
    found = [cell for cell in cells if cell]
    assert found[2] == "Results side by side"
    assert found[3:8] == ["<b>", "y", "log", "a_log & more", "b"]
    assert found[-2:] == ["accuracy.ekf.ate_m", "-1.2346e+05"]


@pytest.mark.slow
def test_the_command(tmp_path: Path, result: Result) -> None:
    for name in "ab":
        folder(tmp_path / name, "result", result.model_dump_json(by_alias=True))
    printed = works("compare", "a", "b", "--only", "ate", "--out", "t.csv", cwd=tmp_path)
    assert "accuracy.ekf.ate_m" in printed
    assert "accuracy.ekf.ate_m," in (tmp_path / "t.csv").read_text()
    for arguments, words in (
        (("a", "nowhere"), "nowhere: holds no result"),
        (("a", "b", "--out", "t.pdf"), "t.pdf: its suffix names no kind of table"),
        (("a", "b", "--only", "x_y"), "--only x_y: no figure is called so"),
    ):
        assert words in refused("compare", *arguments, cwd=tmp_path)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("solution", {"versions": {"slamcheck": "0.1.0"}}),
        ("odometry", {"versions": {"slamcheck": "0.2.0"}, "scan_graph": {}}),
        ("result", {"versions": {"slamcheck": "0.2.0"}, "schema": 3}),
    ],
)
def test_an_earlier_result_is_refused_with_what_reads_it(
    tmp_path: Path, name: str, content: dict[str, object]
) -> None:
    path = folder(tmp_path / "old", name, content) / f"{name}.json"
    job = {"solution": "solve", "result": "run"}.get(name, name)
    assert refused("compare", "old", "old", cwd=tmp_path) == (
        f"slamcheck: old/{path.name}: is a result with earlier names of figures, which slamcheck "
        f"0.2 reads and this release does not; write it anew with slamcheck {job}"
    )
