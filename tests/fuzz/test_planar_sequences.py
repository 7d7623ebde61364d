"""Any events of a planar filter end `check` in a verdict or a refusal; sound ones are accepted.

`make nightly` draws 1,500.
"""

from pathlib import Path

import numpy as np
import pytest

from comparisons.checks.diagnosis import model_differences
from tests.fuzz.damage import cases, counted
from tests.fuzz.planar_sequences import Planar

COUNT = cases(36, 1500)


@pytest.fixture(scope="module")
def planar() -> Planar:
    return Planar()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_any_sequence_is_checked(planar: Planar, tmp_path: Path) -> None:
    """One in three is sound."""
    for seed in range(COUNT):
        counted("planar sequences of events")
        sound, done, said = planar.tried(seed, tmp_path)
        assert not sound or said.startswith("agree"), (seed, done, said)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_search_that_raises_would_be_noticed(
    planar: Planar, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a point so far away that a covariance is singular there."""
    monkeypatch.setattr(model_differences, "_root", np.linalg.cholesky)
    with pytest.raises(np.linalg.LinAlgError):
        planar.tried(154, tmp_path)
