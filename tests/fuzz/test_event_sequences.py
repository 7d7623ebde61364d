"""Any sequence of events that the format allows ends in a verdict, and a sound one in `sound`.

`make nightly` draws 5,000, as `python -m tests.fuzz.event_sequences 5000` does.
"""

from pathlib import Path

import numpy as np
import pytest

from tests.fuzz.damage import cases, counted
from tests.fuzz.event_sequences import tried

COUNT = cases(120, 5000)
PARTS = 4


@pytest.mark.parametrize("part", range(PARTS))
def test_any_sequence_is_audited(part: int, tmp_path: Path) -> None:
    """Three in five are sound; of the others something is another than the events say."""
    verdicts = set()
    for seed in range(part, COUNT, PARTS):
        counted("sequences of events")
        outcome = tried(seed, tmp_path)
        assert not outcome.is_accused, (seed, outcome.printed)
        verdicts.add((outcome.planted > 0, outcome.audit.verdict))
    assert {(False, "sound"), (True, "faulty")} <= verdicts or COUNT < 100


def test_a_snapshot_that_is_off_is_a_fault(tmp_path: Path) -> None:
    """Not only does nothing raise: the sequences that are not sound are told from the others."""
    outcomes = [tried(seed, tmp_path) for seed in range(80) if seed % 5 < 2]
    planted = [one for one in outcomes if one.planted]
    named = [one for one in planted if one.audit.verdict == "faulty"]
    assert len(named) > 0.8 * len(planted) > 10
    assert np.all([one.audit.verdict != "faulty" for one in outcomes if not one.planted])
