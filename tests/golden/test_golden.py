"""Golden runs: results, tables and exit codes stay as they were kept.

Texts are compared exactly. Numbers are equal to the bit on the processor that kept them; elsewhere
they are equal as far as rounding leaves them, each by its kind.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.golden.cases import CASES
from tests.golden.fingerprint import differences
from tests.golden.run import SHARED, is_keeper, read_kept, run_case


@pytest.fixture(scope="session")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("golden")


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[] if c.quick else pytest.mark.golden) for n, c in CASES.items()]
)
def test_results_are_as_they_were(name: str, work: Path) -> None:
    case = CASES[name]
    if case.needs_data and not SHARED.is_dir():
        pytest.skip("the real logs (../shared/data) are not on this machine")
    assert differences(read_kept(name), run_case(case, work), bits=is_keeper()) == []
