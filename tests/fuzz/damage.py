"""Damage to files, as hypothesis strategies: what a disk, an editor or somebody hostile may do."""

import io
import os
import re
import shutil
import zipfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

COUNT: Counter[str] = Counter()
"""Cases of each kind that a test has tried; conftest.py adds them up."""


def counted(kind: str) -> None:
    """One more case of a kind."""
    COUNT[kind] += 1


def cases(each_time: int, at_night: int) -> int:
    """How many hypothesis shall draw."""
    return at_night if os.environ.get("HYPOTHESIS_PROFILE") == "nightly" else each_time


HOSTILE = (
    *("", "nan", "inf", "-inf", "1e400", "-1e400", "1e200", "-1e200", "5e-324", "-0", "-0.0"),
    *("-1", "0", "1", "2", "1e9", "1e11", "9" * 30, "9" * 5000, "0x10", "1_000", "1e", "--1"),
    *("1,5", "1;2", "true", "None", "null", "{}", "[]", "[[[[", "[" * 3000, "{" * 3000),
    *("\u0661\u0662", "\u00bd", "\u2028", "\x00", "\x1b[2J", "\x85", "\u202e", "\U0001f600"),
    *("#", "# 1", '"', "'", "'''", "\\", "\\u0000", "\r", "\t", "1 2", "x" * 100_000),
    *("__proto__", "__class__", "<script>alert(1)</script>", "'; DROP TABLE x;--", "%s%n", "{0}"),
    *("../../etc/passwd", "1970-01-01T00:00:00Z", "2026-02-30", "-9223372036854775809"),
)  # fmt: skip
"""Words to put in a field's place."""
N = 20_000
LINES = (
    "", "#", ",", "strange = 1", "[prior]", "[[prior]]", "[strange]", "__proto__ = {}", "\x00",
    "1,2,3", "nan nan nan", "1e308 " * 8, "-1 0 0 0 0 0 0 1", '"strange": 1,', "\ufeff", "}", "{",
    "," * N, "1 " * N, "1," * N, "\n" * N, "#\n" * N, '"' * N, '"' + "\\" * N + '"', "[[s]]\n" * N,
    "\n".join(f"k{i} = 1" for i in range(N)), "\n".join(f"[s{i}]" for i in range(N)),
    f"a{'.a' * 60} = 1", f"'a'{' . a' * N} = 1", '{"a":' * N, f"[{'[],' * N}[]]",
)  # fmt: skip
"""Lines to put in between."""
ARRAYS: dict[str, np.ndarray] = {
    "object": np.array([{"a": 1}, None], dtype=object),
    "text": np.array(["1", "x"]),
    "bytes": np.array([b"1", b"x"]),
    "complex": np.array([1j, 2.0]),
    "bool": np.array([True, False]),
    "date": np.array(["2026-01-01"], dtype="M8[s]"),
    "record": np.zeros(3, dtype=[("a", "f8"), ("b", "i4")]),
    "scalar": np.array(1.0),
    "empty": np.zeros(0),
    "hollow": np.zeros((0, 3, 3)),
    "flat": np.zeros((5, 0)),
    "deep": np.zeros((1,) * 30),
    "long": np.array([2.0**60, -(2.0**60)]),
    "unsigned": np.array([2**64 - 1, 0], dtype=np.uint64),
    "big-endian": np.arange(4, dtype=">f4"),
}
"""Arrays to put in an array's place."""
_KEYS = b"".join(b'"k%d": 1,' % i for i in range(N))
GROWN: dict[str, Callable[[bytes, bytes], bytes]] = {
    "blanks in a header": lambda first, rest: first + b" [" + b" " * N + rest,
    "brackets in a header": lambda first, rest: first + b"(" * N + rest,
    "header again": lambda first, rest: b",".join([first.strip()] * 2000) + rest,
    "digits": lambda first, rest: first + re.sub(rb"\d+", b"0" * 900 + b"1", rest[:9000]),
    "decimals": lambda first, rest: first + re.sub(rb"\.\d+", b"." + b"3" * 900, rest[:9000]),
    "last line": lambda first, rest: first + rest + rest[-80:].rpartition(b"\n")[2] * N,
    "a line": lambda first, rest: first + rest + (rest.split(b"\n", 2)[1:2] or [b""])[0] * N,
    "keys": lambda first, rest: first.replace(b"{", b"{" + _KEYS, 1) + rest,
    "values": lambda first, rest: first.replace(b"{", b'{"a":[' + b"[]," * N + b"[]],", 1) + rest,
}
"""What makes a text long, given its first line and the rest, which begins with the line's end."""
_LONG = 1_000_000
"""Bytes from which on a text grows no more: twice 2,000 times are gigabytes."""
EDITS = ("nan", "inf", "1e300", "negated", "doubled", "short", "transposed", "tall", "zero")
"""What may happen to an array's own values."""


@dataclass(frozen=True)
class Damage:
    """One thing done to one file. at, to: where, as shares of it. what: of the kind's own list."""

    kind: str
    file: str
    at: float = 0.0
    to: float = 0.0
    what: str = ""

    def apply(self, folder: Path) -> None:
        """Do it; a file that an earlier damage took away stays away."""
        path = folder / self.file
        if self.kind in _PLACES:
            _remove(path)
            _PLACES[self.kind](path)
        elif path.is_file() and not path.is_symlink():
            data = path.read_bytes()
            path.write_bytes(_CONTENTS[self.kind](data, self))


_PACKED = (".npz", ".mat", ".mcap", ".bag", ".db3", ".trace", ".events", "-journal")
"""Of files that are no text."""


def damages(files: list[str]) -> st.SearchStrategy[list[Damage]]:
    """One to three damages to any of the files."""
    share = st.floats(0.0, 1.0, exclude_max=True)
    archives = [name for name in files if name.endswith(".npz")]
    texts = [name for name in files if not name.endswith(_PACKED)]

    def of(kinds: list[str], names: list[str], what: st.SearchStrategy[str]) -> list[object]:
        if not names:
            return []
        return [
            st.builds(Damage, st.sampled_from(kinds), st.sampled_from(names), share, share, what)
        ]

    nothing = st.just("")
    choices = [
        *of(["flip", "cut", "splice", "repeat"], files, nothing),
        *of(sorted(_PLACES), files, nothing),
        *of(["word"], texts, st.sampled_from(HOSTILE)) * 4,
        *of(["line"], texts, st.sampled_from(LINES)) * 2,
        *of(["line gone", "line twice", "lines swapped", "crlf", "cr", "bom", "utf-16", "latin-1"],
            texts, nothing),
        *of(["grown"], texts, st.sampled_from(sorted(GROWN))) * 2,
        *of(["array"], archives, st.sampled_from(sorted(ARRAYS))) * 2,
        *of(["values"], archives, st.sampled_from(EDITS)) * 2,
        *of(["no array", "array named", "declared shape", "bomb"], archives, nothing),
    ]  # fmt: skip
    return st.lists(st.one_of(choices), min_size=1, max_size=3)  # type: ignore[arg-type]


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _unreadable(path: Path) -> None:
    path.write_bytes(b"1 2 3\n")
    path.chmod(0)


_PLACES: dict[str, Callable[[Path], object]] = {
    "missing": lambda path: None,
    "empty": lambda path: path.write_bytes(b""),
    "folder": lambda path: path.mkdir(),
    "link to itself": lambda path: path.symlink_to(path.name),
    "link to nothing": lambda path: path.symlink_to("nowhere"),
    "link to a device": lambda path: path.symlink_to("/dev/zero"),
    "pipe": lambda path: os.mkfifo(path),
    "unreadable": _unreadable,
    "zeros": lambda path: path.write_bytes(bytes(1000)),
}


def _flip(data: bytes, damage: Damage) -> bytes:
    if not data:
        return data
    changed = bytearray(data)
    changed[int(damage.at * len(data))] ^= 1 + int(damage.to * 255)
    return bytes(changed)


def _cut(data: bytes, damage: Damage) -> bytes:
    return data[: int(damage.at * len(data))]


def _splice(data: bytes, damage: Damage) -> bytes:
    first, last = sorted((int(damage.at * len(data)), int(damage.to * len(data))))
    return data[:first] + data[last:]


def _repeat(data: bytes, damage: Damage) -> bytes:
    first, last = sorted((int(damage.at * len(data)), int(damage.to * len(data))))
    return data[:last] + data[first:]


def _word(data: bytes, damage: Damage) -> bytes:
    spans = [m.span() for m in re.finditer(rb'[^\s,=\[\]{}":]+', data)]
    if not spans:
        return damage.what.encode("utf-8", "surrogatepass")
    first, last = spans[int(damage.at * len(spans))]
    return data[:first] + damage.what.encode("utf-8", "surrogatepass") + data[last:]


def _grown(data: bytes, damage: Damage) -> bytes:
    if len(data) > _LONG:
        return data
    end = data.find(b"\n") % (len(data) + 1)
    return GROWN[damage.what](data[:end], data[end:])


def _lines(data: bytes, damage: Damage) -> bytes:
    lines = data.split(b"\n")
    i, j = (int(share * len(lines)) for share in (damage.at, damage.to))
    if damage.kind == "line gone":
        del lines[i]
    elif damage.kind == "line twice":
        lines.insert(j, lines[i])
    elif damage.kind == "lines swapped":
        lines[i], lines[j] = lines[j], lines[i]
    else:
        lines.insert(i, damage.what.encode("utf-8", "surrogatepass"))
    return b"\n".join(lines)


def _archive(data: bytes, damage: Damage) -> bytes:
    """The same `.npz` with one array changed, renamed or left out."""
    try:
        with np.load(io.BytesIO(data)) as kept:
            arrays = dict(kept)
    except Exception:  # an earlier damage broke it already
        return data
    if not arrays:
        return data
    name = sorted(arrays)[int(damage.at * len(arrays))]
    if damage.kind == "array":
        arrays[name] = ARRAYS[damage.what]
    elif damage.kind == "values":
        arrays[name] = _edited(arrays[name], damage)
    elif damage.kind == "declared shape":
        return _with_member(arrays, name, _header("(1000000000000,)"))
    elif damage.kind == "bomb":
        return _with_member(arrays, name, _header("(2500000,)") + bytes(20_000_000))
    else:
        value = arrays.pop(name)
        if damage.kind == "array named":
            arrays["../strange"] = value
    target = io.BytesIO()
    np.savez(target, **arrays)
    return target.getvalue()


def _edited(array: np.ndarray, damage: Damage) -> np.ndarray:
    if array.dtype.kind not in "fiub":
        return array
    array = array.astype(float)
    what = damage.what
    if what == "doubled":
        return np.concatenate((array, array))
    if what == "short":
        return array[:-1]
    if what == "transposed":
        return array.T
    if what == "tall":
        return array[..., None]
    value = {"nan": np.nan, "inf": np.inf, "1e300": 1e300, "zero": 0.0}.get(what)
    changed = array.copy()
    if changed.size:
        at = int(damage.to * changed.size)
        changed.flat[at] = -changed.flat[at] if value is None else value
    return changed


def _header(shape: str) -> bytes:
    text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode()


def _with_member(arrays: dict[str, np.ndarray], name: str, content: bytes) -> bytes:
    target = io.BytesIO()
    rest = {key: value for key, value in arrays.items() if key != name}
    np.savez(target, **rest)  # type: ignore[arg-type]
    with zipfile.ZipFile(target, "a", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr(f"{name}.npy", content)
    return target.getvalue()


_CONTENTS: dict[str, Callable[[bytes, Damage], bytes]] = {
    "flip": _flip,
    "cut": _cut,
    "splice": _splice,
    "repeat": _repeat,
    "word": _word,
    "grown": _grown,
    **dict.fromkeys(("line", "line gone", "line twice", "lines swapped"), _lines),
    "crlf": lambda data, damage: data.replace(b"\n", b"\r\n"),
    "cr": lambda data, damage: data.replace(b"\n", b"\r"),
    "bom": lambda data, damage: b"\xef\xbb\xbf" + data,
    "utf-16": lambda data, damage: data.decode("utf-8", "replace").encode("utf-16"),
    "latin-1": lambda data, damage: data + b"\xe9\xff\n",
    **dict.fromkeys(
        ("array", "values", "no array", "array named", "declared shape", "bomb"), _archive
    ),
}
