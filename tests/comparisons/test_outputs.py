"""Every output goes through one door: nothing that stands is lost, nothing that never ends read."""

import hashlib
import os
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest

from comparisons.atomic import (
    LIST,
    NEW,
    check_apart,
    check_file,
    check_replaceable,
    fresh_folder,
    write_whole,
)
from comparisons.baseline import BASELINE, JUNIT, write_junit
from comparisons.errors import InputError
from comparisons.experiments.montecarlo.chunk_files import check_folder
from comparisons.report.side_by_side import check_table, write_table
from tests.fuzz.subjects import SUBJECTS
from tests.fuzz.test_hostile_files import outcome, run_main

MARK = "result.json"


def an_output(folder: Path, mark: str = MARK) -> Path:
    with fresh_folder(folder, mark) as work:
        (work / mark).write_text("{}")
        (work / "ekf").mkdir()
        (work / "ekf" / "trajectory.tum").write_text("0 0 0 0 0 0 0 1\n")
    return folder


def a_pipe(path: Path) -> None:
    os.mkfifo(path)


def a_device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def a_thesis(path: Path) -> None:
    path.write_text("years of work")


STRANGE: dict[str, Callable[[Path], None]] = {
    "pipe": a_pipe,
    "link to a device": a_device,
    "thesis": a_thesis,
}


@pytest.mark.parametrize("kind", STRANGE)
@pytest.mark.parametrize("name", [MARK, LIST, "audit.json", "ekf/map.png", "ekf/thesis.tex"])
@pytest.mark.parametrize("listed", [False, True])
def test_what_is_not_an_earlier_output_stays(
    kind: str, name: str, listed: bool, tmp_path: Path
) -> None:
    """Whatever a forged list says of it, and however long it may be."""
    folder = tmp_path / "out"
    (folder / "ekf").mkdir(parents=True)
    STRANGE[kind](folder / name)
    if listed and name != LIST:
        (folder / LIST).write_text(f"{'0' * 64}  {name}\n{'0' * 64}  {MARK}\n")
    with pytest.raises(InputError, match=f"already holds {name}"):
        check_replaceable(folder, MARK)
    with pytest.raises(InputError, match=f"already holds {name}"):
        an_output(folder)
    assert os.path.lexists(folder / name)


def test_an_earlier_output_is_replaced_by_its_own_kind_alone(tmp_path: Path) -> None:
    folder = an_output(tmp_path / "out")
    assert an_output(folder) == check_replaceable(folder, MARK)
    for mark, words in (("audit.json", "another command"), (None, "already holds")):
        with pytest.raises(InputError, match=words):
            check_replaceable(folder, mark)
    (folder / "ekf" / "trajectory.tum").write_text("by hand")
    with pytest.raises(InputError, match=r"ekf/trajectory\.tum, which is not as it was written"):
        an_output(folder)
    assert (folder / "ekf" / "trajectory.tum").read_text() == "by hand"


@pytest.mark.parametrize("name", ["thesis.txt", "thesis.toml"])
def test_a_list_of_right_hashes_removes_only_what_jobs_write(name: str, tmp_path: Path) -> None:
    """As `sha256sum` makes one, of a folder with a stranger's file."""
    folder = an_output(tmp_path / "out")
    (folder / name).write_text("years of work")
    with (folder / LIST).open("a") as file:
        file.write(f"{hashlib.sha256(b'years of work').hexdigest()}  {name}\n")
    refused = name == "thesis.txt"
    with pytest.raises(InputError, match=r"holds thesis\.txt;") if refused else nullcontext():
        an_output(folder)
    assert (folder / name).exists() == refused


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_all_is_on_the_disk_before_it_takes_its_place(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    sync, move = os.fsync, os.replace

    def watched_sync(file: int) -> None:
        sync(file)
        done.append(Path(f"/proc/self/fd/{file}").readlink().name)

    def watched_move(source: Path, target: Path) -> None:
        move(source, target)
        done.append("moved")

    monkeypatch.setattr("comparisons.atomic.os.fsync", watched_sync)
    monkeypatch.setattr("comparisons.atomic.os.replace", watched_move)
    if kind == "folder":
        an_output(tmp_path / "out")
        within = {"trajectory.tum", "ekf", MARK, LIST, "new"}
    else:
        write_whole(tmp_path / "out", lambda part: part.write_text("x"))
        within = {"out", "new"}
    at = done.index("moved")
    assert set(done[:at]) == within
    assert done[at + 1 :] == [tmp_path.name]


NO_SPACE, BROKEN = OSError(28, "No space left on device"), OSError(5, "Input/output error")
FAILURES: dict[str, tuple[str, BaseException]] = {
    "while it is written": ("", NO_SPACE),
    "by an interrupt": ("", KeyboardInterrupt("stopped")),
    "as the disk keeps it": ("fsync", BROKEN),
    "as it takes its place": ("replace", BROKEN),
}
"""What fails, of the module os where it is no error of the writer, and how."""


@pytest.mark.parametrize("name", FAILURES)
@pytest.mark.parametrize("kind", ["file", "folder", "earlier folder"])
def test_what_ends_early_leaves_what_was_there(
    name: str, kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    call, fault = FAILURES[name]
    target = tmp_path / "a" / "out"

    def put(text: str, fault: BaseException | None = None) -> None:
        def write(part: Path) -> None:
            part.write_text(text)
            if fault is not None:
                raise fault

        if kind == "file":
            write_whole(target, write)
        else:
            with fresh_folder(target, MARK) as work:
                write(work / MARK)

    real = getattr(os, call or "replace")

    def fails(*given: Any) -> None:
        if call == "fsync" or (target == Path(given[-1]) and "old" not in Path(given[0]).parts):
            raise fault
        real(*given)

    if kind == "earlier folder":
        put("first")
    with monkeypatch.context() as patched:
        if call:
            patched.setattr(f"comparisons.atomic.os.{call}", fails)
        with pytest.raises((InputError, KeyboardInterrupt), match=fault.args[-1]):
            put("second", None if call else fault)
    kept = {p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*")} - {"a"}
    assert kept == ({"a/out", f"a/out/{MARK}", f"a/out/{LIST}"} if "earlier" in kind else set())
    assert not kept or (target / MARK).read_text() == "first"
    put("third")
    assert (target if kind == "file" else target / MARK).read_text() == "third"


def test_what_came_meanwhile_stays(tmp_path: Path) -> None:
    folder = an_output(tmp_path / "out")

    def write() -> None:
        with fresh_folder(folder, MARK) as work:
            (work / MARK).write_text("{}")
            (folder / "thesis.tex").write_text("years of work")

    with pytest.raises(InputError, match=r"already holds thesis\.tex"):
        write()
    assert (folder / "thesis.tex").read_text() == "years of work"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_an_output_takes_no_inputs_place(tmp_path: Path) -> None:
    folder = an_output(tmp_path / "out")
    (tmp_path / "link").symlink_to(folder)
    for target in (folder, tmp_path / "link", tmp_path):
        with pytest.raises(InputError, match="which this command reads"):
            check_apart(target, [tmp_path / "log", folder / "ekf"])
    check_apart(folder, [tmp_path])


@pytest.mark.parametrize("kind", [NEW, BASELINE, JUNIT], ids=lambda kind: kind.name)
@pytest.mark.parametrize("text", ["years of work", "", '{"a": 1}', "<a>b</a>"])
def test_a_file_of_another_kind_stays(kind: object, text: str, tmp_path: Path) -> None:
    path = tmp_path / "mine"
    path.write_text(text)
    assert isinstance(kind, type(NEW))
    if not text and kind is JUNIT:
        check_file(path, kind)
        return
    with pytest.raises(InputError, match=r"mine: exists"):
        write_whole(path, lambda part: part.write_text("x"), kind)
    assert path.read_text() == text


def test_a_link_to_nothing_stands(tmp_path: Path) -> None:
    """Its place is taken by no output, replaced or not."""
    path = tmp_path / "kept.json"
    path.symlink_to("nowhere")
    with pytest.raises(InputError, match="is a link to nothing, expected a new name"):
        write_whole(path, lambda part: part.write_text("{}"), BASELINE)
    assert path.is_symlink()
    assert not path.exists()


@pytest.mark.parametrize("suffix", [".csv", ".tex", ".html"])
def test_a_table_replaces_a_table(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"table{suffix}"
    for title in ("a", "b, & <c>"):
        write_table(["x", title], [("verdict", ["agree", "disagree"])], path)
    assert title[0] in path.read_text()
    path.write_text("time,x\n0,1\n")
    with pytest.raises(InputError, match="is not an earlier table of compare"):
        check_table(path)


def test_a_report_replaces_a_report(tmp_path: Path) -> None:
    for _ in range(2):
        write_junit([], "a & b", tmp_path / "report.xml")


REFUSED = {
    "audit over a run": "audit A.TRACE --out RUN",
    "pipe in a folder": "run LOG --out PIPES",
    "junit over its baseline": "baseline compare LOG KEPT.JSON --junit KEPT.JSON",
    "junit over a log": "baseline compare LOG KEPT.JSON --junit LOG/odometry.csv",
    "log over a log": "run LOG --log LOG/odometry.csv",
    "table over data": "compare RUN RUN --out DATA.CSV",
    "baseline over a text": "baseline save LOG DATA.CSV --replace",
    "export over a text": "export MINE DATA.CSV",
    "estimate under a check": "check LOG --estimate CHECK/mine --out CHECK --replace",
}


@pytest.mark.parametrize("name", REFUSED)
def test_no_command_destroys_a_file(name: str, tmp_path: Path) -> None:
    SUBJECTS["log folder"].write(tmp_path / "log")
    SUBJECTS["estimate folder"].write(tmp_path / "mine")
    SUBJECTS["baseline"].write(tmp_path)
    SUBJECTS["result"].write(tmp_path / "run")
    with fresh_folder(tmp_path / "check", "config.toml") as work:
        SUBJECTS["estimate folder"].write(work / "mine")
        (work / "config.toml").write_text('job = "check"\n')
    (tmp_path / "data.csv").write_text("time,x\n0,1\n")
    (tmp_path / "pipes").mkdir()
    os.mkfifo(tmp_path / "pipes" / MARK)
    words = [
        str(tmp_path / word.split("/")[0].lower() / "/".join(word.split("/")[1:]))
        if word.split("/")[0].isupper()
        else word
        for word in REFUSED[name].split()
    ]
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    code, reported = outcome(lambda: run_main(words))
    assert code == 2, reported
    assert reported.count("\n") == 1, reported
    assert before == {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}


def test_a_study_takes_no_strangers_report_place(tmp_path: Path) -> None:
    for text in (None, "[server]\nport = 1\n"):
        if text is not None:
            (tmp_path / "config.toml").write_text(text)
        (tmp_path / "report.html").write_text("years of work")
        with pytest.raises(InputError, match="and no study's config"):
            check_folder(tmp_path)
