"""What a golden run left, small enough to keep: texts as hashes, numbers as sums with limits.

Another processor rounds otherwise, and what becomes of that depends on the figure: its `Kind`.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np


class Kind(NamedTuple):
    """How far a number may be off, relative to the root mean square of its column plus `least`."""

    relative: float
    least: float

    def size(self, values: np.ndarray) -> float:
        """What a column's numbers are relative to."""
        return float(np.sqrt(np.mean(values**2))) + self.least


EXACT = Kind(1e-9, 1e-7)
"""Logs and filters: sums and products, in which rounding errors stay small."""
OPTIMUM = Kind(1e-6, 50.0)
"""What depends on the optimum: to 5e-5 sigma, metres or radians, and to 1e-6 of large numbers.

The smoother's last step promises less than 1e-6 of error, so that it moves nothing by more than
1.5e-3 sigma; between processors optima differ by up to 1.5e-5.
"""
COVARIANCE = Kind(1e-4, 1e-7)
"""Covariances at the optimum."""
GAP = Kind(1e-6, 1.0)
"""Gaps that are rounding where they are below 1e-6, the limit that the verdict sets them."""
KINDS = (
    (re.compile(r"\.ekf_m"), EXACT),
    (re.compile(r"newton_decrement|(algebra|model)_gap|largest_sigma"), GAP),
    (re.compile(r"(smoother|graph|scans|own-matcher)/covariances\.npz"), COVARIANCE),
    (
        re.compile(
            r"smoother|agreement|truth_gap|own[-_]|three_way|scan_slam|:dense|graph|^scans/"
            r"|check\.json|solution\.json"
        ),
        OPTIMUM,
    ),
    (re.compile(""), EXACT),
)
"""The first whose pattern is in a column's name holds."""
_TIMES = 2.0
"""Two sums are equal within so many times the root sum of squares of their numbers' limits."""
UNSTEADY = frozenset(
    {"seconds", "cpu_s", "versions", "schema", "config", "files", "estimate_sha256"}
)
"""Keys of result files that are not results, or hash files whose last bits a BLAS decides."""
_TIMED = frozenset({"seconds", "cpu_s", "scans_per_second"})
"""Keys of times, at any depth."""
_ROUNDED = re.compile(r"(?<![\w.])-?\d[\d,]*(?:\.\d+(?:e[+-]?\d+)?|e[+-]?\d+)(?!\w)")
"""Numbers of a text that are no counts."""

Fingerprint = dict[str, Any]


class Part:
    """Texts and columns of numbers under one name."""

    def __init__(self, name: str) -> None:
        """Begin with nothing."""
        self.name = name
        self._texts: list[str] = []
        self._columns: dict[str, list[float]] = defaultdict(list)
        self._rounded: list[tuple[float, float]] = []

    def text(self, text: str) -> None:
        """Take a text: its words, and its rounded numbers, which may be off by a last digit."""
        self._texts.append(" ".join(_ROUNDED.sub("#", text).split()))
        self._rounded += [_logarithm(number[0]) for number in _ROUNDED.finditer(text)]

    def number(self, column: str, value: float) -> None:
        """Take a number."""
        self._columns[column].append(value)

    def array(self, array: np.ndarray) -> None:
        """Take an array; a stack of matrices is a column an entry."""
        if array.dtype.kind not in "fiub":
            self._texts.append(f"{array.shape} {array.tolist()}")
            return
        self._texts.append(f"{array.shape}")
        entries = array.shape[1] * array.shape[2] if array.ndim == 3 else 1
        for number, column in enumerate(array.astype(float).reshape(-1, entries).T):
            self._columns[str(number)] = column.tolist()

    @property
    def words(self) -> str:
        """All texts, with a mark for each rounded number."""
        return "\n".join(self._texts)

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """The numbers by column."""
        return {name: np.array(values) for name, values in self._columns.items()}

    def fingerprint(self) -> Fingerprint:
        """Hashes of texts and of numbers; by column the count and a sum with its limit."""
        columns = self.columns
        sums = {name: _sum(values, kind_of(self.name + name)) for name, values in columns.items()}
        if self._rounded:
            columns["rounded"], allowed = np.array(self._rounded).T
            sums["rounded"] = _sum_of(columns["rounded"], allowed)
        numbers = np.concatenate([np.zeros(0), *columns.values()])
        return {
            "text": _hash(self.words.encode()),
            "bits": _hash(numbers.tobytes()),
            "sums": sums,
        }


def of_folder(folder: Path, printed: str) -> dict[str, Fingerprint]:
    """Of everything comparable in a run's folder, by name, and of what the command printed."""
    return {part.name: part.fingerprint() for part in parts(folder, printed)}


def parts(folder: Path, printed: str) -> list[Part]:
    """What is comparable in a run's folder, and what the command printed."""
    found = [Part("printed")]
    found[0].text(_steady(printed))
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        name = path.relative_to(folder).as_posix()
        if path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as arrays:
                for key in sorted(arrays.files):
                    found.append(Part(f"{name}:{key}"))
                    found[-1].array(arrays[key])
        elif path.suffix == ".json":
            found += _of_json(path, name)
        elif path.suffix in (".tum", ".csv", ".g2o", ".toml") and name != "config.toml":
            found.append(Part(name))
            _take_table(found[-1], path.read_text(encoding="utf-8"))
    return found


def differences(
    kept: dict[str, Fingerprint], found: dict[str, Fingerprint], *, bits: bool = False
) -> list[str]:
    """What differs beyond a figure's limit, one line each; with bits, what differs at all."""
    lines = [f"{name}: is no longer there" for name in kept if name not in found]
    lines += [f"{name}: was not there" for name in found if name not in kept]
    for name in kept:
        if name in found:
            lines += [f"{name}: {line}" for line in _differ(kept[name], found[name], bits)]
    return lines


def _differ(kept: Fingerprint, found: Fingerprint, bits: bool) -> Iterator[str]:
    if kept["text"] != found["text"]:
        yield "its texts differ"
    if kept["bits"] == found["bits"]:
        return
    if list(kept["sums"]) != list(found["sums"]):
        yield f"columns were {list(kept['sums'])}, are {list(found['sums'])}"
        return
    within = True
    for name, (count, old, limit) in kept["sums"].items():
        number, new, _ = found["sums"][name]
        if number != count or not abs(new - old) <= limit:
            within = False
            yield f"{name} was {old:g} ({count} numbers), is {new - old:g} more ({number}), " + (
                f"may differ by {limit:g}"
            )
    if bits and within:
        yield "its last bits differ"


def _sum(values: np.ndarray, kind: Kind) -> tuple[int, float, float]:
    """The count of finite numbers, a weighted sum, and how far that may be off.

    What is summed is each number, their mean and the logarithm of their size, the latter two with
    the weight of all, so that a change of all numbers shows as well as one of a few.
    """
    finite = values[np.isfinite(values)]
    if not len(finite):
        return 0, 0.0, 0.0
    size = kind.size(finite)
    of_all = math.sqrt(len(finite)) * np.array([np.mean(finite) / size, math.log(size)])
    allowed = kind.relative * np.append(np.ones(len(finite)), [math.sqrt(2 * len(finite))])
    _, value, limit = _sum_of(np.append(finite / size, of_all.sum()), allowed)
    return len(finite), value, limit


def _sum_of(values: np.ndarray, allowed: np.ndarray) -> tuple[int, float, float]:
    """The count, a weighted sum, the last with weight 1, and its limit by those of all (N,)."""
    count = np.arange(1.0, len(values))
    signs = np.where(np.cos(count) < 0.0, -1.0, 1.0)
    weight = np.append(signs * (1.0 + 0.5 * np.abs(np.cos(1.4 * count))), 1.0)
    limit = _TIMES * float(np.linalg.norm(weight * allowed))
    digits = 2 - math.floor(math.log10(limit))
    return len(values), round(float(weight @ values), digits), float(f"{limit:.2g}")


def kind_of(column: str) -> Kind:
    """The kind of a column's numbers, by the names of part and column."""
    return next(kind for pattern, kind in KINDS if pattern.search(column))


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:12]


def _logarithm(number: str) -> tuple[float, float]:
    """Of a text's number over the limit of gaps, with its sign, and what a last digit makes of it.

    Of 1 + number, so that numbers below the limit, which are rounding, hardly count.
    """
    digits, _, power = number.replace(",", "").partition("e")
    value, limit = float(f"{digits}e{power or 0}"), GAP.relative
    unit = 10.0 ** (int(power or 0) - len(digits.partition(".")[2]))
    allowed = (unit + 0.01 * limit) / (abs(value) + limit)
    return math.copysign(math.log1p(abs(value) / limit), value), allowed


def _of_json(path: Path, name: str) -> Iterator[Part]:
    for key, value in json.loads(path.read_text(encoding="utf-8")).items():
        # A part of the result that a run does not have may be null or absent.
        if key not in UNSTEADY and value is not None:
            part = Part(f"{name}:{key}")
            # Remarks stand in no order that means anything.
            _take_json(part, sorted(value) if key == "remarks" else value)
            yield part


def _take_json(part: Part, value: Any, path: str = "") -> None:
    if isinstance(value, dict):
        for key, inner in value.items():
            if key not in _TIMED:
                _take_json(part, inner, f"{path}.{key}")
    elif isinstance(value, list):
        for inner in value:
            _take_json(part, inner, f"{path}[]")
    elif isinstance(value, float) and math.isfinite(value):
        part.text(path)
        part.number(path, value)
    else:
        part.text(f"{path}={value!r}")


def _take_table(part: Part, text: str) -> None:
    for line in text.splitlines():
        for column, token in enumerate(re.split(r"[\s,]+", line.strip())):
            try:
                part.number(f" {column}", float(token))
            except ValueError:
                part.text(token)


def _steady(printed: str) -> str:
    """Without the seconds and the folder's place, which differ from run to run; notes sorted."""
    kept = [
        line
        for line in printed.splitlines()
        if not line.startswith(("seconds", "scan odometry", "report:"))
    ]
    notes = sorted(line for line in kept if line.startswith("  note:"))
    return "\n".join([line for line in kept if not line.startswith("  note:")] + notes)
