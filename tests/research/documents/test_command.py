"""`python -m research.documents`: the list, the gallery, the folder, and what it says of faults."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure as Canvas
from pydantic import TypeAdapter

from comparisons.errors import InputError, RecordError
from comparisons.figures import stored
from research.documents import registry, runner
from research.documents.__main__ import main
from research.documents.claims import Claims, at_least, at_most, ours, theirs
from research.documents.folder import write_gallery
from research.documents.interface import (
    AnyFigure,
    DocumentFigure,
    Experiment,
    ReproductionResult,
    Sources,
)
from research.documents.runner import reproduce
from tests.commands import called
from tests.comparisons.test_html_report import HOSTILE, read


@dataclass(frozen=True)
class Number:
    """What the made-up experiment leaves."""

    log: str
    value: float


def one(sources: Sources) -> Number:
    return Number(HOSTILE, float(sources.drives))


def fails(sources: Sources) -> Number:
    raise RecordError("gps", 3, "time is NaN")


def draw(canvas: Canvas, number: Number) -> None:
    canvas.add_subplot().plot([0.0, number.value])


def claims(number: Number) -> Claims:
    yield at_most(HOSTILE, number.value, 3.0, HOSTILE, why=ours(HOSTILE))
    yield at_least("never a number", float("nan"), 0.0, why=theirs(HOSTILE))


def run_and_skipped(result: ReproductionResult) -> tuple[list[str], list[str]]:
    return [one.name for one in result.figures], [one.name for one in result.skipped]


def figure(name: str, run: Any = one, needs: str | None = None) -> AnyFigure:
    return DocumentFigure(
        name=name,
        title=HOSTILE,
        place=HOSTILE,
        says=HOSTILE,
        experiment=Experiment(name, run, needs),
        draw=draw,
        claims=claims,
    )


@pytest.fixture
def made_up(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = (figure("G1"), figure("G2", needs="acfr_car_park"), figure("G3", fails))
    monkeypatch.setattr(registry, "FIGURES", rows)


@pytest.mark.usefixtures("made_up")
def test_the_gallery_is_whole_and_safe_whatever_it_is_told(tmp_path: Path) -> None:
    found = reproduce(("G1", "G2"), Sources(drives=2))
    assert run_and_skipped(found) == (["G1"], ["G2"])
    write_gallery(found, tmp_path / "out")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
        "G1.pdf",
        "G1.png",
        "claims.json",
        "files.sha256",
        "gallery.html",
    ]
    text = (tmp_path / "out/gallery.html").read_text(encoding="utf-8")
    found_in = read(tmp_path / "out/gallery.html")
    assert "script" not in found_in.tags
    attributes = [(name, value) for _, name, value in found_in.attributes]
    assert not [name for name, _ in attributes if name.startswith("on")]
    assert all(v.startswith("data:") for name, v in attributes if name in ("src", "href"))
    assert dict(attributes)["content"]
    assert "script-src" not in text
    assert "default-src 'none'" in text
    assert "&lt;script&gt;document.title" in text
    assert "does not hold" in text
    assert "needs --data FOLDER with acfr_car_park/" in text


@pytest.mark.usefixtures("made_up")
def test_claims_come_back_as_they_were_written(tmp_path: Path) -> None:
    found = reproduce(("G1", "G2"), Sources(drives=2))
    write_gallery(found, tmp_path / "out")
    text = (tmp_path / "out/claims.json").read_text(encoding="utf-8")
    again = TypeAdapter(ReproductionResult).validate_json(text)
    assert stored(again) == stored(found) == json.loads(text)
    met, unmet = json.loads(text)["figures"][0]["claims"]
    assert (met["holds"], met["measured"], met["why"]) == (True, 2.0, None)
    assert (unmet["holds"], unmet["measured"], unmet["why"]) == (False, None, HOSTILE)
    assert [one["cause"] for one in (met, unmet)] == [None, "the document's"]
    assert "1 of 2 claims hold (the others: 1 the document's);" in (
        tmp_path / "out/gallery.html"
    ).read_text(encoding="utf-8").replace("&#x27;", "'")
    assert not found.holds
    assert "NaN" not in text


@pytest.mark.usefixtures("made_up")
def test_the_folder_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    found, out = reproduce(("G1",), Sources()), tmp_path / "out"
    write_gallery(found, out)
    before = {p.name: p.read_bytes() for p in out.iterdir()}
    broken = replace(found.figures[0], pdf=None)  # type: ignore[arg-type]
    with pytest.raises(TypeError):
        write_gallery(replace(found, figures=(broken,)), out)
    assert {p.name: p.read_bytes() for p in out.iterdir()} == before
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
    (out / "mine.txt").write_text("keep")
    with pytest.raises(InputError, match=r"mine\.txt"):
        write_gallery(found, out)


@pytest.mark.usefixtures("made_up")
def test_faults_are_told_with_the_figure(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"G3: gps, row 3: time is NaN"):
        reproduce(("G3",), Sources())
    with pytest.raises(InputError, match=r"nothing to run: G2 needs --data FOLDER"):
        reproduce(("G2",), Sources())
    with pytest.raises(InputError, match="--workers is 0"):
        reproduce(("G1",), Sources(), workers=0)
    with pytest.raises(InputError, match="--drives is 0"):
        Sources(drives=0)
    with pytest.raises(InputError, match="none of the real logs"):
        Sources(tmp_path)
    (tmp_path / "acfr_car_park").mkdir()
    assert run_and_skipped(reproduce(("G2",), Sources(tmp_path))) == (["G2"], [])


@pytest.mark.slow
def test_processes_find_the_same() -> None:
    names, sources = ("G9", "N3.5", "N3.12"), Sources(drives=1)
    alone, together = (reproduce(names, sources, workers) for workers in (1, 2))
    for first, second in zip(alone.figures, together.figures, strict=True):
        assert (first.name, first.claims) == (second.name, second.claims)
        assert (first.png, first.pdf) == (second.png, second.pdf)
    assert alone.figures[1].shared == ("N3.12",)


def test_each_experiment_runs_once(monkeypatch: pytest.MonkeyPatch) -> None:
    reported: list[tuple[str, int, int]] = []
    monkeypatch.setattr(registry, "FIGURES", (figure("G1"), figure("M1")))
    runner.reproduce(("all",), Sources(), progress=lambda *step: reported.append(step))
    assert [step[1:] for step in reported] == [(0, 2), (1, 2), (2, 2)]


def test_a_stopped_reproduction_says_that_nothing_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stops(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(runner, "_experiment", stops)
    done = called(main, "N3.5", "--workers", "1", "--out", "out", cwd=tmp_path)
    reported = "stopped: nothing is written to out; give fewer figures for a shorter job"
    assert (done.returncode, done.stderr) == (130, f"slamcheck: {reported}\n")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_the_command_lists_runs_and_refuses(tmp_path: Path) -> None:
    listed = called(main, cwd=tmp_path)
    assert listed.returncode == 0
    names = [line.split()[0] for line in listed.stdout.splitlines()]
    assert names == [row.name for row in registry.FIGURES]
    unknown = called(main, "N3.5", "N9.9", cwd=tmp_path)
    assert (unknown.returncode, unknown.stdout) == (2, "")
    assert all(name in unknown.stderr for name in ("N9.9", *names))
    assert list(tmp_path.iterdir()) == []
    true = called(main, "g9", "--out", "out", cwd=tmp_path)
    assert (true.returncode, "4 of 4 claims hold" in true.stdout) == (0, True)
    assert (tmp_path / "out/G9.pdf").read_bytes().startswith(b"%PDF")
    false = called(main, "M5", "--drives", "1", "--out", "out", cwd=tmp_path)
    assert false.returncode == 1, false.stderr
    assert "does not hold: and tells exactly where the robot is" in false.stdout
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
        "M5.pdf",
        "M5.png",
        "claims.json",
        "files.sha256",
        "gallery.html",
    ]
