"""What docs/audit-third-parties.md shows is what its commands print; what its benchmark judges."""

import re
import shlex
from dataclasses import replace
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from comparisons.audit.audit import audit
from comparisons.report.audit import AuditReport
from comparisons.report.terminal import print_summary
from examples.audit import msckf
from examples.audit.__main__ import FILTERS, main
from research.trust.audit_faults import judge, sound
from tests.examples.test_audit_filters import needs
from tests.test_own_project import missing, steps

PAGE = Path(__file__).resolve().parents[2] / "docs" / "audit-third-parties.md"
BLOCKS = re.findall(r"^```console\n(.*?)^```", PAGE.read_text(), re.MULTILINE | re.DOTALL)


def printed(command: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """What a command of the page prints."""
    words = shlex.split(command)
    if words[:3] == ["python", "-m", "examples.audit"]:
        main([words[3], str(folder / words[4]), *words[5:]])
        return capsys.readouterr().out
    assert words[:2] == ["slamcheck", "audit"]
    text = StringIO()
    out = f"slamcheck-audit-{Path(words[2]).stem}"
    summary = AuditReport.of(audit(folder / words[2])).summary()
    print_summary(summary, Console(file=text), out, verbose=False)
    return text.getvalue()


@pytest.mark.slow
@pytest.mark.parametrize(("name", "block"), [*zip(FILTERS, BLOCKS, strict=True)])
def test_commands_print_what_the_page_shows(
    name: str, block: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    needs(name)
    assert f"examples.audit {name} " in block
    for step in steps(block):
        assert missing(step.shown, printed(step.command, tmp_path, capsys)) == [], step.command


def test_a_fault_that_is_unknown_is_an_error_of_usage(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["msckf", str(tmp_path / "trace"), "--fault", "other"])
    assert stopped.value.code == 2
    assert "expected one of lone-clone" in capsys.readouterr().err


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
