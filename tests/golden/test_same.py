"""`make same` names the file and the place that differ by a last bit, and lets times pass."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from tests.golden.same import PRINTED, check_out, differences, run_case

BIT = math.ulp(1.5)
RESULT = {"a": {"b": [0.5, 1.5]}, "seconds": {"read": 1.0}, "verdict": "agree"}
PLANTED = """

def finite(value: float) -> float | None:
    return math.nextafter(value, 0.0) if math.isfinite(value) else None
"""


def folder(at: Path, *, result: object = RESULT, value: float = 1.5, page: str = "") -> Path:
    at.mkdir()
    (at / "result.json").write_text(json.dumps(result))
    np.savez(at / "covariances.npz", pose=np.array([[1.0, math.nan], [0.0, value]]))
    (at / "report.html").write_text(f'<p>1 m</p>{page}<td>0.1 s</td><rect width="10%"/>')
    (at / PRINTED).write_text("verdict: agree\nexit code 0\n")
    return at


def test_times_and_versions_may_differ(tmp_path: Path) -> None:
    later = RESULT | {"seconds": {"read": 2.0}, "versions": {"numpy": "3"}}
    one, other = folder(tmp_path / "one"), folder(tmp_path / "other", result=later)
    page = (other / "report.html").read_text()
    (other / "report.html").write_text(page.replace("0.1 s", "0.2 s").replace("10%", "22.5%"))
    assert list(differences(one, other)) == []


def test_a_last_bit_is_named_with_its_file_and_place(tmp_path: Path) -> None:
    one = folder(tmp_path / "one")
    changed = RESULT | {"a": {"b": [0.5, 1.5 + BIT]}}
    other = folder(tmp_path / "other", result=changed, value=1.5 + BIT, page="<p>more</p>")
    (other / "map.png").write_bytes(b"\xff")
    assert list(differences(one, other)) == [
        "covariances.npz: pose.flat[3]: 1.5 in base, 1.5000000000000002 in tree",
        "map.png: is only in tree",
        "report.html: part 3: '<td>' in base, '<p>' in tree",
        "result.json: .a.b.1: 1.5 in base, 1.5000000000000002 in tree",
    ]


@pytest.mark.parametrize(
    ("changed", "line"),
    [
        (RESULT | {"more": None}, ".more: nothing in base, None in tree"),
        ({"a": {"b": [0.5]}, "verdict": "agree"}, ".a.b.1 .verdict: 1.5 in base, 'agree' in tree"),
        (RESULT | {"verdict": "disagree"}, ".verdict: 'agree' in base, 'disagree' in tree"),
    ],
)
def test_what_comes_and_goes_is_named(changed: object, line: str, tmp_path: Path) -> None:
    one, other = folder(tmp_path / "one"), folder(tmp_path / "other", result=changed)
    assert list(differences(one, other)) == [f"result.json: {line}"]


def test_other_pictures_are_seen(tmp_path: Path) -> None:
    folders = folder(tmp_path / "one"), folder(tmp_path / "other")
    for at, byte in zip(folders, (b"\xfe", b"\xff"), strict=True):
        (at / "map.png").write_bytes(byte)
    (found,) = differences(*folders)
    assert found.startswith("map.png: bytes: ")


@pytest.mark.slow
def test_each_side_runs_its_own_code(tmp_path: Path) -> None:
    """A commit that rounds one function's results otherwise, beside itself."""
    case = "loop-own"
    for side in ("base", "tree"):
        check_out("HEAD", tmp_path / side / "code")
        if side == "tree":
            module = tmp_path / side / "code" / "comparisons" / "figures.py"
            module.write_text(module.read_text() + PLANTED)
        run_case(case, tmp_path / side / "code", tmp_path / side)
    found = list(differences(tmp_path / "base" / case, tmp_path / "tree" / case))
    assert "result.json" in {line.partition(":")[0] for line in found}, found
    assert not any(line.startswith(("ekf/", "smoother/")) for line in found)
