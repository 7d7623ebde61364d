"""`slamcheck audit` as a user calls it."""

import json
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import slamcheck
from comparisons.report.audit import AuditReport, audit_panels
from comparisons.report.html.page import page
from tests.commands import refused
from tests.commands import slamcheck as command
from tests.comparisons.audit.test_audit import once, stays
from tests.comparisons.audit.toy_filter import Toy
from tests.comparisons.browser import noted


def traces(folder: Path) -> tuple[Path, Path]:
    alter, _ = once("gps", 80, stays("position", "bias"))
    sound, faulty = folder / "sound.trace", folder / "faulty.trace"
    Toy(seed=1).record(sound)
    Toy(seed=1, alter=alter).record(faulty)
    return sound, faulty


@pytest.mark.slow
def test_exit_codes_folder_and_json(tmp_path: Path) -> None:
    traces(tmp_path)
    sound = command("audit", "sound.trace", cwd=tmp_path)
    assert (sound.returncode, sound.stdout.splitlines()[0]) == (0, "verdict: sound")
    assert max(map(len, sound.stdout.splitlines())) <= 80
    folder = tmp_path / "slamcheck-audit-sound"
    names = ["audit.json", "curves.png", "files.sha256", "report.html"]
    assert sorted(p.name for p in folder.iterdir()) == names
    faulty = command("audit", "faulty.trace", "--json", "--out", "there", cwd=tmp_path)
    assert faulty.returncode == 1
    found = json.loads(faulty.stdout)
    assert found["verdict"] == "faulty"
    assert found["findings"][0]["blocks"] == ["position", "bias"]
    assert sorted(found["files"]) == names
    assert (tmp_path / "there" / "audit.json").read_text() == faulty.stdout
    again = command("audit", "faulty.trace", "--quiet", "--out", "there", cwd=tmp_path)
    assert (again.returncode, again.stdout) == (1, "")


@pytest.mark.parametrize(
    ("name", "text"),
    [("nothing.trace", "no such file"), (".", "not a regular file"), ("a.csv", "not an SQLite")],
)
def test_what_is_no_trace_is_one_line(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / "a.csv").write_text("time,x\n0,1\n" * 10)
    assert text in refused("audit", name, cwd=tmp_path)
    assert not list(tmp_path.glob("slamcheck-audit*"))


def test_a_trace_of_an_earlier_version_and_a_damaged_one_are_one_line(tmp_path: Path) -> None:
    for name, sql, said in (
        ("old", "PRAGMA user_version = 1", "is a trace of version 1, of a development version"),
        ("damaged", "UPDATE batch SET first = 1", "event 1: stands after event -1, expected 0"),
    ):
        Toy(seed=1, steps=12).record(tmp_path / f"{name}.trace")
        with closing(sqlite3.connect(tmp_path / f"{name}.trace", isolation_level=None)) as file:
            file.execute(sql)
        assert said in refused("audit", f"{name}.trace", cwd=tmp_path)


def test_a_page_shows_what_file_names_say_as_text(tmp_path: Path) -> None:
    path = tmp_path / "<b>x&amp;.trace"
    Toy(seed=1, steps=30).record(path)
    found = slamcheck.audit(path)
    slamcheck.write_report(found, tmp_path / "out")
    text = (tmp_path / "out" / "report.html").read_text()
    assert "&lt;b&gt;x&amp;amp;.trace" in text
    assert "<b>x" not in text


@pytest.mark.slow
@pytest.mark.browser
def test_a_finding_shows_its_time_on_the_curves(tmp_path: Path) -> None:
    """It is a card with a button, and a line across all curves."""
    _, faulty = traces(tmp_path)
    found = slamcheck.audit(faulty)
    first = found.findings[0]
    opened = found.first_open
    assert first.event is not None
    assert first.time_s is not None
    assert opened is not None
    assert (first.event, first.time_s) == (opened.event - 1, opened.time_s)
    (tmp_path / "report.html").write_text(
        page(AuditReport(found, AuditReport.build(found)).page()), encoding="utf-8"
    )
    assert all(panel.moments[0].x == first.time_s for panel in audit_panels(found))
    steps = """
    const card = document.querySelector('.cause'), button = card.querySelector('button');
    noted.card = card.textContent;
    noted.marks = document.querySelectorAll('.moment').length;
    noted.curves = document.querySelectorAll('svg.curve').length;
    button.click();
    noted.now = document.getElementById('now').textContent;
    noted.cursors = document.querySelectorAll('.cursor[visibility=visible]').length;
    """
    shown = noted(tmp_path / "report.html", tmp_path, steps)
    assert first.text.partition(":")[0].lower() in shown["card"].lower()
    assert f"show {first.time_s:g} s" in shown["card"]
    assert shown["now"] == f"at {first.time_s:.1f} s"
    assert shown["marks"] == len(found.findings) * shown["curves"]
    assert shown["cursors"] == shown["curves"]


def test_a_finding_without_times_is_at_its_event(tmp_path: Path) -> None:
    path = tmp_path / "run.trace"
    with slamcheck.Recorder(path) as record:
        record.prior({"state": 1}, np.eye(1))
        for _ in range(5):
            record.update("gps", [0.3], np.eye(1), np.eye(1))
            record.snapshot(np.eye(1))
    found = slamcheck.audit(path)
    (finding, *_) = (one for one in found.findings if one.fault)
    assert finding.time_s is None
    text = page(AuditReport(found, AuditReport.build(found)).page())
    assert f'data-time="{finding.event}">show event {finding.event}<' in text


def test_the_states_of_a_trace_are_in_a_table(tmp_path: Path) -> None:
    path = tmp_path / "run.trace"
    with slamcheck.Recorder(path) as record:
        record.prior({"pose": 3, "<b>": 1}, np.eye(4), charts={"pose": "se2"})
        record.at(2.0)
        record.augment("tree", np.ones((2, 1)), np.eye(2), np.eye(2), ["<b>"])
        record.clone("pose", "copy")
        record.remove("tree")
        record.snapshot(np.eye(4), ["pose", "<b>"])
    found = slamcheck.audit(path)
    assert [block._asdict() for block in found.states] == [
        {"name": "pose", "dims": 3, "chart": "se2", "since": 0, "until": None},
        {"name": "<b>", "dims": 1, "chart": "additive", "since": 0, "until": None},
        {"name": "tree", "dims": 2, "chart": "additive", "since": 1, "until": 3},
        {"name": "copy", "dims": 3, "chart": "se2", "since": 2, "until": None},
    ]
    assert found.blocks == {"pose": 3, "<b>": 1, "tree": 2, "copy": 3}
    text = page(AuditReport(found, AuditReport.build(found)).page())
    table = text[text.index('<section id="states">') :]
    assert "4 blocks, of which those that stay have 7 entries." in table
    row = "<td>tree</td><td>2</td><td>additive</td><td>1</td><td>3</td>"
    assert row in table
    assert "<td>&lt;b&gt;</td>" in table


@pytest.mark.slow
def test_in_python(tmp_path: Path) -> None:
    sound, faulty = traces(tmp_path)
    assert slamcheck.audit(sound).sound
    found = slamcheck.audit(faulty)
    assert not found.sound
    assert slamcheck.audit(faulty, tolerance=10.0).first_open is None
    result = AuditReport.build(found)
    assert result.largest_gap is not None
    assert audit_panels(found)[0].title.startswith("log10 of the gap")
    with pytest.raises(slamcheck.InputError, match="no such file"):
        slamcheck.audit(tmp_path / "none")


@pytest.mark.parametrize("times", ["given", "none", "falling", "not of all"])
def test_curves_run_over_time_where_times_are_given(tmp_path: Path, times: str) -> None:
    """Where not every update has a time, or time falls, they run over the events' numbers."""
    path, given = tmp_path / "run.trace", times in ("given", "falling")
    with slamcheck.Recorder(path) as record:
        record.prior({"state": 1}, np.eye(1))
        record.snapshot(np.eye(1))
        for step in range(25):
            if given or (times == "not of all" and step == 3):
                record.at(100.0 + (0.1 * step if times == "given" or step < 20 else 0.0))
            record.update("gps", [0.3], np.eye(1), np.eye(1))
            record.snapshot(np.eye(1) / (step + 2.0))
    found = slamcheck.audit(path)
    text = page(AuditReport(found, AuditReport.build(found)).page())
    gap, nis = audit_panels(found)
    if times == "given":
        assert gap.x_label == nis.x_label == "time [s]"
        assert gap.curves[0].x == pytest.approx([100.0, *(100.0 + 0.1 * np.arange(25))])
        assert nis.curves[0].x[[0, -1]] == pytest.approx([100.6, 101.85], abs=0.2)
    else:
        assert gap.x_label == nis.x_label == "event"
        assert gap.curves[0].x.tolist() == [1.0, *range(3, 52, 2)]
    assert ("over the numbers of events" in text) == (times != "given")
    assert json.loads(data(text))["event"] == (times != "given")


def test_errors_are_drawn_within_three_sigma_of_the_recorded_covariance(tmp_path: Path) -> None:
    """Of the blocks that the prior has, by component, at each snapshot with a truth."""
    rng, path = np.random.default_rng(4), tmp_path / "run.trace"
    errors, covariances = rng.standard_normal((20, 3)), rng.uniform(0.5, 2.0, (20, 3))
    with slamcheck.Recorder(path) as record:
        record.prior({"pose": 2, "bias": 1}, np.eye(3))
        for k, (error, variance) in enumerate(zip(errors, covariances, strict=True)):
            record.at(float(k))
            record.update("gps", [0.3], np.eye(1), np.eye(1), ["bias"])
            record.snapshot(np.diag(variance), error=error if k != 5 else None)
    panels = [p for p in audit_panels(slamcheck.audit(path)) if p.title.startswith("error of")]
    titles = ["error of pose, component 0", "error of pose, component 1", "error of bias"]
    assert [panel.title for panel in panels] == titles
    known = np.arange(20) != 5
    for panel, error, variance in zip(panels, errors.T, covariances.T, strict=True):
        (curve,), (band,) = panel.curves, panel.bands
        assert curve.x.tolist() == np.flatnonzero(known).tolist()
        assert curve.y == pytest.approx(error[known], rel=1e-12)
        assert band.high == pytest.approx(3.0 * np.sqrt(variance[known]), rel=1e-12)
        assert (band.low == -band.high).all()


def data(text: str) -> str:
    """Return what a page gives its script."""
    return text.split('id="data">')[1].split("</script>")[0]


def test_a_trace_without_snapshots_is_judged_by_its_innovations(tmp_path: Path) -> None:
    path = tmp_path / "bare.trace"
    Toy(seed=1, every=10_000).record(path)
    found = slamcheck.audit(path)
    assert found.sound
    assert found.largest_gap is not None  # the one after the prior
    assert len(found.sensors) == 3


@pytest.mark.parametrize("recorded", ["a prior", "its snapshot", "updates", "a snapshot", "gains"])
def test_where_nothing_can_be_checked_nothing_is_sound(recorded: str, tmp_path: Path) -> None:
    p, h, r = np.eye(2), np.array([[1.0, 0.0]]), np.eye(1)
    with slamcheck.Recorder(tmp_path / "run.trace") as recorder:
        recorder.prior({"state": 2}, p)
        if recorded == "its snapshot":
            recorder.snapshot(p)
        if recorded in ("updates", "a snapshot", "gains"):
            more: dict[str, Any] = {"gain": 0.5 * h.T} if recorded == "gains" else {}
            recorder.update("gps", [0.3], h, r, **more)
        if recorded == "a snapshot":
            recorder.snapshot(np.diag((0.5, 1.0)))
    done = command("audit", "run.trace", cwd=tmp_path)
    found = json.loads((tmp_path / "slamcheck-audit-run" / "audit.json").read_text())
    lacks = {"algebra": recorded not in ("its snapshot", "a snapshot"),
             "gains": recorded != "gains",
             "innovations": recorded in ("a prior", "its snapshot"),
             "smoother": True, "NEES": True, "spurious": True,
             "derivatives": True}  # fmt: skip
    assert found["not_checked"].keys() == {name for name, it_lacks in lacks.items() if it_lacks}
    assert slamcheck.audit(tmp_path / "run.trace").not_checked == found["not_checked"]
    words = " ".join(done.stdout.split())
    assert all(f"{name}: {why}" in words for name, why in found["not_checked"].items())
    if recorded in ("a snapshot", "gains"):
        assert (done.returncode, done.stdout.splitlines()[0]) == (0, "verdict: sound")
        return
    assert done.returncode == 3
    assert done.stdout.startswith("verdict: nothing checked\n  no snapshot, gain or correction")
    page = (tmp_path / "slamcheck-audit-run" / "report.html").read_text()
    assert '<ul class="reasons"><li>no snapshot, gain or correction' in page
