"""A run's replay for rerun, and pictures as PDF."""

import importlib.util
import sys
from pathlib import Path

import pytest

from comparisons.atomic import LIST, listed_files
from comparisons.config import ReportConfig
from comparisons.errors import InputError
from comparisons.jobs.run import Comparison
from comparisons.report import viewer
from comparisons.report.run import RunReport
from tests.commands import files_in
from tests.helpers import altered, compared, first_seconds, simulated

PACKAGE = "rerun"


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    return compared(first_seconds(simulated(seed=2), 10.0))


def without(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if the package were not installed."""
    monkeypatch.setitem(sys.modules, PACKAGE, None)


@pytest.mark.skipif(importlib.util.find_spec(PACKAGE) is None, reason="rerun is not installed")
def test_a_replay_is_written(
    comparison: Comparison, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    viewer.record_run(comparison, tmp_path / "run.rrd")
    assert capfd.readouterr().err == ""  # where rerun tells of names and chunks it cannot use
    said = (tmp_path / "run.rrd").read_bytes()
    assert len(said) > 20_000
    for name in (b"map/ekf/trajectory", b"map/smoother/pose", b"map/ekf/landmarks", b"map/truth"):
        assert name in said
    assert [p.name for p in tmp_path.iterdir()] == ["run.rrd"]


@pytest.mark.skipif(importlib.util.find_spec(PACKAGE) is None, reason="rerun is not installed")
def test_a_replay_that_cannot_be_written_is_one_line(
    comparison: Comparison, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise RuntimeError("Failed to create file\nand more")

    stream = viewer.load_rerun().RecordingStream
    monkeypatch.setattr(stream, "save", refuse)
    with pytest.raises(InputError, match=r"a\.rrd: cannot be written \(Failed to create file\)$"):
        viewer.record_run(comparison, tmp_path / "a.rrd")
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot be written into"):
        viewer.check_viewer(False, tmp_path / "file" / "a.rrd")


def test_without_rerun_one_line_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without(monkeypatch)
    for live, record in ((True, None), (False, tmp_path / "a.rrd")):
        with pytest.raises(InputError, match=r"pip install slamcheck\[rerun\]"):
            viewer.check_viewer(live, record)
    viewer.check_viewer(False, None)


@pytest.mark.slow
def test_pictures_exist_as_pdf_and_the_folder_may_be_replaced(
    comparison: Comparison, tmp_path: Path
) -> None:
    folder, result = tmp_path / "run", RunReport.build(comparison)
    config = comparison.prepared.config
    asked = config.model_copy(update={"report": ReportConfig(figures=("pdf",))})
    drawn = altered(comparison, "known.prepared.config", asked)
    RunReport(drawn, result).write(folder)
    pictures = {p.stem for p in folder.glob("*.png")}
    assert (
        pictures == {p.stem for p in folder.glob("*.pdf")} == {"map", "correlation", "consistency"}
    )
    said = {p.name: p.read_bytes() for p in folder.glob("*.pdf")}
    assert all(text.startswith(b"%PDF-") and b"/Type3" not in text for text in said.values())
    assert files_in(folder) == {*listed_files(folder), LIST}
    RunReport(drawn, result).write(folder)
    assert said == {p.name: p.read_bytes() for p in folder.glob("*.pdf")}
    RunReport(comparison, result).write(folder)
    assert not [*folder.glob("*.pdf"), *folder.glob("*.png")]
