"""The benchmark of planted faults judges as it says, and prints what it promises."""

from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.audit_faults import judge, sound
from examples.audit import msckf


@pytest.mark.slow
def test_a_finding_elsewhere_is_not_right(tmp_path: Path) -> None:
    path, fault = tmp_path / "trace", msckf.FAULTS["block-stale"]
    planted = msckf.record(path, 3, "block-stale")
    assert planted is not None
    assert judge(path, planted, fault)[:3] == (True, True, True)
    later = replace(planted, event=planted.event + 10)
    assert judge(path, later, fault)[:3] == (True, False, True)
    other = replace(planted, blocks=("scale",))
    assert judge(path, other, fault)[:3] == (True, True, False)
    assert msckf.record(tmp_path / "sound", 3) is None
    assert judge(tmp_path / "sound", planted, fault)[:3] == (False, False, False)


@pytest.mark.slow
def test_sound_traces_are_counted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sound(["msckf"], 2, tmp_path)
    assert capsys.readouterr().out == "0 of 2 sound traces flagged, 0.0 to 84.2 %\n"
    assert list(tmp_path.iterdir()) == []
