"""What a golden run left, small enough to keep: texts as hashes, numbers as a few sums."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

RELATIVE = 1e-9
"""Numbers may differ by so much where the machine's BLAS rounds otherwise."""
_ROUNDING = 1e-7
"""A number nearer to zero than that may be rounding: it counts in the plain sum only."""
UNSTEADY = frozenset(
    {"seconds", "cpu_s", "versions", "schema", "config", "files", "estimate_sha256"}
)
"""Keys of result files that are not results, or hash files whose last bits a BLAS decides."""
_TIMED = frozenset({"seconds", "cpu_s", "scans_per_second"})
"""Keys of times, at any depth."""

Fingerprint = dict[str, Any]


def of_folder(folder: Path, printed: str) -> dict[str, Fingerprint]:
    """Of everything comparable in a run's folder, by name, and of what the command printed."""
    found = {"printed": of_parts(_tokens(_steady(printed)))}
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        name = path.relative_to(folder).as_posix()
        if path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as arrays:
                for key in sorted(arrays.files):
                    found[f"{name}:{key}"] = of_array(arrays[key])
        elif path.suffix == ".json":
            whole = json.loads(path.read_text(encoding="utf-8"))
            for key, value in whole.items():
                # A part of the result that a run does not have may be null or absent.
                if key not in UNSTEADY and value is not None:
                    # Remarks stand in no order that means anything.
                    steady = sorted(value) if key == "remarks" else value
                    found[f"{name}:{key}"] = of_parts(_leaves(steady))
        elif path.suffix in (".tum", ".csv", ".g2o", ".toml") and name != "config.toml":
            found[name] = of_parts(_tokens(path.read_text(encoding="utf-8")))
    return found


def of_array(array: np.ndarray) -> Fingerprint:
    """An array's shape, hash and sums."""
    if array.dtype.kind in "fiub":
        values = array.astype(float).ravel()
        return _fingerprint(f"{array.shape}", array.tobytes(), values)
    return _fingerprint(f"{array.shape} {array.tolist()}", array.tobytes(), np.zeros(0))


def of_parts(parts: Iterable[str | float]) -> Fingerprint:
    """Texts and numbers in their order."""
    texts, numbers = [], []
    for part in parts:
        if isinstance(part, str):
            texts.append(part)
        else:
            numbers.append(part)
    values = np.array(numbers, dtype=float)
    return _fingerprint("\n".join(texts), values.tobytes(), values)


def differences(kept: dict[str, Fingerprint], found: dict[str, Fingerprint]) -> list[str]:
    """What differs beyond rounding, one line each."""
    lines = [f"{name}: is no longer there" for name in kept if name not in found]
    lines += [f"{name}: was not there" for name in found if name not in kept]
    for name in kept:
        if name in found:
            lines += [f"{name}: {line}" for line in _differ(kept[name], found[name])]
    return lines


def _differ(kept: Fingerprint, found: Fingerprint) -> Iterator[str]:
    if kept["text"] != found["text"]:
        yield "its texts differ"
    if kept["bits"] == found["bits"]:
        return
    for key in ("count", "negative"):
        if kept[key] != found[key]:
            yield f"{key} was {kept[key]}, is {found[key]}"
    for key in ("sum", "logs"):
        (old, size), (new, _) = kept[key], found[key]
        if not abs(new - old) <= RELATIVE * size:
            yield f"{key} was {old!r}, is {new!r}"


def _fingerprint(text: str, bits: bytes, values: np.ndarray) -> Fingerprint:
    """Two weighted sums with the sums of their absolute values: of the numbers, of their logs."""
    finite = values[np.isfinite(values)]
    weight = np.cos(1.0 + np.arange(len(finite)))
    large = np.abs(finite) > _ROUNDING
    logs = np.log(np.abs(finite[large])) * weight[large]
    return {
        "text": hashlib.sha256(text.encode()).hexdigest()[:12],
        "bits": hashlib.sha256(bits).hexdigest()[:12],
        "count": len(values),
        "negative": int(np.count_nonzero(finite < -_ROUNDING)),
        "sum": _sum(weight * finite),
        "logs": _sum(logs, float(np.count_nonzero(large))),
    }


def _sum(values: np.ndarray, least: float = 0.0) -> tuple[float, float]:
    return float(f"{values.sum():.13g}"), float(f"{np.abs(values).sum() + least:.3g}")


def _leaves(value: Any, path: str = "") -> Iterator[str | float]:
    if isinstance(value, dict):
        for key, inner in value.items():
            if key not in _TIMED:
                yield from _leaves(inner, f"{path}.{key}")
    elif isinstance(value, list):
        for inner in value:
            yield from _leaves(inner, f"{path}[]")
    elif isinstance(value, float) and math.isfinite(value):
        yield path
        yield value
    else:
        yield f"{path}={value!r}"


def _tokens(text: str) -> Iterator[str | float]:
    for token in re.split(r"[\s,]+", text):
        try:
            yield float(token)
        except ValueError:
            yield token


def _steady(printed: str) -> str:
    """Without the seconds and the folder's place, which differ from run to run; notes sorted."""
    kept = [
        line
        for line in printed.splitlines()
        if not line.startswith(("seconds", "scan odometry", "report:"))
    ]
    notes = sorted(line for line in kept if line.startswith("  note:"))
    return "\n".join([line for line in kept if not line.startswith("  note:")] + notes)
