"""Are results of two commits equal to the bit? `python -m tests.golden.same BASE [CASE ...]`.

Golden cases run with the code of BASE and with the tree's, side by side. Every file that they leave
and what they print are compared byte for byte, times apart. Both stay in build/same.
"""

import hashlib
import io
import itertools
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from comparisons.atomic import LIST
from tests.golden.cases import CASES, lacks_data, make_logs, with_before, words

ROOT = Path(__file__).resolve().parents[2]
PLACE = ROOT / "build" / "same"
PRINTED = "printed.txt"
APART = frozenset({"seconds", "cpu_s", "scans_per_second", "versions"})
"""Keys of times and versions, at any depth."""
_WORK = re.compile(re.escape(str(PLACE)) + "/(base|tree)")
_TIMES = re.compile(
    r'(?<=rect width=")[\d.]+%|\d[\d.,]* s\b|(?<=scans per second</td><td>)\d+|(?m:^seconds.*)'
)
"""Times in a page, as bars and as text, and in what is printed."""


def check_out(base: str, folder: Path) -> None:
    """Put the code of a commit into a folder."""
    archive = subprocess.run(["git", "archive", base], cwd=ROOT, check=True, capture_output=True)
    with tarfile.open(fileobj=io.BytesIO(archive.stdout)) as packed:
        packed.extractall(folder, filter="data")


def run_case(name: str, code: Path, work: Path) -> None:
    """Run a case with the code in one folder, in another; what it prints is kept as a file."""
    done = subprocess.run(
        [sys.executable, "-m", "slamcheck", *words(name, Path())],
        cwd=work,
        env={**os.environ, "PYTHONPATH": str(code), "OPENBLAS_NUM_THREADS": "1", "COLUMNS": "200"},
        capture_output=True,
        text=True,
        check=False,
    )
    said = "" if done.returncode in (0, 1, 3) else done.stderr
    (work / name).mkdir(exist_ok=True)
    printed = f"{done.stdout}{said}exit code {done.returncode}\n"
    (work / name / PRINTED).write_text(printed, encoding="utf-8")


def differences(then: Path, now: Path) -> Iterator[str]:
    """Return the first difference of each file of two folders, one line each."""
    names = {p.relative_to(top) for top in (then, now) for p in top.rglob("*") if p.is_file()}
    for name in sorted(names):
        if not (then / name).exists() or not (now / name).exists():
            yield f"{name}: is only in {'tree' if (now / name).exists() else 'base'}"
        elif (then / name).read_bytes() != (now / name).read_bytes():
            pairs = itertools.zip_longest(values(then / name), values(now / name), fillvalue=())
            for one, other in pairs:
                if repr(one) != repr(other):
                    where = " ".join(dict.fromkeys(str(at[0]) for at in (one, other) if at))
                    yield f"{name}: {where}: {_shown(one)} in base, {_shown(other)} in tree"
                    break


def values(path: Path) -> Iterator[tuple[str, Any]]:
    """Return what a file holds, in order, each with its place; times are left out."""
    if path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as arrays:
            for key in arrays.files:
                yield key, (arrays[key].dtype, arrays[key].shape)
                for number, value in enumerate(arrays[key].ravel().tolist()):
                    yield f"{key}.flat[{number}]", value
        return
    try:
        text = _WORK.sub("", path.read_text(encoding="utf-8"))
    except UnicodeDecodeError:
        yield "bytes", hashlib.sha256(path.read_bytes()).hexdigest()
        return
    if path.name == LIST:  # with the hashes of files that hold times
        yield "names", [line[66:] for line in text.splitlines()]
    elif path.suffix == ".json":
        yield from _of_json(json.loads(text))
    else:
        timed = path.suffix == ".html" or path.name == PRINTED
        text = _TIMES.sub("#", text) if timed else text
        for number, line in enumerate(re.split(r"\n|(?<=>)", text), 1):
            yield f"part {number}", line


def _of_json(value: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict | list):
        yield place, type(value).__name__
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            if key not in APART:
                yield from _of_json(inner, f"{place}.{key}")
    else:
        yield place, value


def _shown(found: tuple[Any, ...]) -> str:
    return repr(found[1])[:120] if found else "nothing"


def main(base: str, names: list[str]) -> int:
    """Print a line for each case, or for each file that differs; 1 where one does."""
    shutil.rmtree(PLACE, ignore_errors=True)
    sides = {"base": PLACE / "code", "tree": ROOT}
    check_out(base, sides["base"])
    for side in sides:
        make_logs(PLACE / side)
    different = False
    for name in with_before(names or CASES):
        if lacks_data(name):
            print(f"{name}: left out, the real logs are not on this machine")
            continue
        with ThreadPoolExecutor() as pool:
            list(pool.map(lambda side, n=name: run_case(n, sides[side], PLACE / side), sides))
        found = list(differences(PLACE / "base" / name, PLACE / "tree" / name))
        print(*(f"{name}: {line}" for line in found or ["equal"]), sep="\n", flush=True)
        different = different or bool(found)
    return int(different)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2:]))
