"""What stands where an output is to go stays, whatever it is, unless it is an earlier output."""

import functools
import hashlib
import os
import stat
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from comparisons.atomic import LIST, is_unfinished
from tests.comparisons.audit.toy_filter import Toy
from tests.fuzz.damage import cases, counted
from tests.fuzz.subjects import SUBJECTS, Subject
from tests.fuzz.test_hostile_files import QUIET, everything, outcome, run_main, words_in

MARKS = ("config.toml", "audit.json", "result.json", "claims.json", "montecarlo.json")
NAMES = (*MARKS, LIST, "report.html", "ekf/trajectory.tum", "thesis.txt", "../mine.txt")


def all_inputs(folder: Path) -> None:
    """What the commands below read, and what belongs to nobody's output."""
    everything(folder)
    (folder / "run").mkdir()
    SUBJECTS["result"].write(folder / "run")
    Toy(1, 5).record(folder / "a.trace")
    (folder / "mine.txt").write_text("years of work")


WHOLE = Subject(all_inputs, lambda folder: None)
COMMANDS = (
    "run LOG --out OUT",
    "run LOG --log OUT",
    "check LOG --estimate MINE --out OUT",
    "solve LOG --out OUT",
    "audit A.TRACE --out OUT",
    "convert LOG OUT",
    "export MINE OUT --format tum",
    "export MINE OUT --format kitti",
    "baseline save LOG OUT --replace",
    "baseline compare LOG KEPT.JSON --junit OUT",
    "compare RUN RUN --out OUT",
    "montecarlo SMALL.TOML --runs 1 --filters ekf --out OUT",
)


def _made(make: Callable[[Path], object]) -> Callable[[Path], object]:
    """In a folder that may not be there yet."""

    def within(path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        make(path)

    return within


def _file(content: bytes) -> Callable[[Path], object]:
    return _made(lambda path: path.write_bytes(content))


def _link(target: str) -> Callable[[Path], object]:
    return _made(lambda path: path.symlink_to(target))


THINGS: dict[str, Callable[[Path], object]] = {
    "pipe": _made(os.mkfifo),
    "text": _file(b"years of work"),
    "nothing": _file(b""),
    "json": _file(b'{"files": []}'),
    "toml": _file(b'job = "run"\n'),
    "xml": _file(b"<?xml version='1.0'?><testsuites/>"),
    "csv": _file(b"time,x\n0,1\n"),
    "endless": _link("/dev/zero"),
    "itself": _link("out"),
    "nowhere": _link("nowhere"),
    "a log": _link("log"),
    "a log's file": _link("log/odometry.csv"),
    "an estimate": _link("mine"),
    "all": _link("."),
    "above": _link(".."),
    "folder": lambda path: path.mkdir(parents=True),
    "closed folder": lambda path: path.mkdir(mode=0o500, parents=True),
}


def forge(out: Path, extra: list[str], sound: bool) -> None:
    """Write a list of what a folder holds, with right hashes or others, and of what it does not."""
    names = {p.relative_to(out).as_posix() for p in out.rglob("*") if p.is_file()} | set(extra)
    lines = []
    for name in sorted(names):
        path = out / name
        known = sound and path.is_file() and stat.S_ISREG(path.stat().st_mode)
        digest = hashlib.sha256(path.read_bytes()).hexdigest() if known else "0" * 64
        lines.append(f"{digest}  {name}\n")
    if not os.path.lexists(out / LIST):
        (out / LIST).write_text("".join(lines))


def standing(folder: Path) -> dict[str, tuple[int, str]]:
    """All that a folder holds, by path: its kind, and what is in it."""
    found = {}
    for path in sorted(folder.rglob("*")):
        kind = stat.S_IFMT(path.lstat().st_mode)
        what = ""
        if kind == stat.S_IFREG:
            what = hashlib.sha256(path.read_bytes()).hexdigest()
        elif kind == stat.S_IFLNK:
            what = str(path.readlink())
        found[path.relative_to(folder).as_posix()] = kind, what
    return found


@functools.cache
def thing() -> st.SearchStrategy[str]:
    return st.sampled_from(sorted(THINGS))


@pytest.mark.slow
@settings(max_examples=cases(60, 6000), suppress_health_check=QUIET)
@given(
    command=st.sampled_from(COMMANDS),
    within=st.dictionaries(st.sampled_from(NAMES), thing(), max_size=3),
    bare=thing(),
    listed=st.sampled_from(["no", "forged", "right hashes"]),
    extra=st.lists(st.sampled_from([*NAMES, "/etc/passwd", "../log/log.toml"]), max_size=3),
)
def test_what_stands_stays(
    command: str, within: dict[str, str], bare: str, listed: str, extra: list[str]
) -> None:
    """A folder with strange files, a list of them or none; or what is no folder at all."""
    counted("what stands where an output goes")
    with WHOLE.written() as folder:
        out = folder / "out"
        if within:
            out.mkdir()
            for name, what in within.items():
                if not os.path.lexists(out / name):
                    THINGS[what](out / name)
            if listed != "no":
                forge(out, extra, listed == "right hashes")
        else:
            THINGS[bare](out)
        before = standing(folder)
        code, reported = outcome(lambda: run_main(words_in(folder, command)))
        after = standing(folder)
        assert code in (0, 1, 2, 3), reported[-3000:]
        assert not [name for name in after if is_unfinished(Path(name).name)]
        if code == 2:
            assert reported.count("\n") == 1, reported
            assert after == before, (command, reported)
        else:
            lost = {name for name, what in before.items() if after.get(name) != what}
            assert not lost - may_go(out, before), (command, reported, lost)


def may_go(out: Path, before: dict[str, tuple[int, str]]) -> set[str]:
    """What an output may take the place of: an empty file or folder, or an earlier output.

    An earlier output is a folder of files of a job's kinds, all of them listed with their hashes.
    """
    kind, what = before.get("out", (0, ""))
    if kind == stat.S_IFREG and what == hashlib.sha256(b"").hexdigest():
        return {"out"}
    if kind == stat.S_IFLNK:
        return set()
    held = {name for name in before if name.startswith("out/")}
    files = [name for name in held if before[name][0] != stat.S_IFDIR]
    ours = {".json", ".toml", ".html", ".tum", ".sha256"}
    if all(before[name][0] == stat.S_IFREG and Path(name).suffix in ours for name in files):
        return held
    return set()
