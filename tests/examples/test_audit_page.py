"""What docs/audit-third-parties.md shows is what its commands print, here in one process."""

import re
import shlex
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from comparisons.audit.audit import audit
from comparisons.report.audit import AuditReport
from comparisons.report.terminal import print_summary
from examples.audit.__main__ import FILTERS, main
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
