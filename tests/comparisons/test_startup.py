"""What a command loads. Not times: `make bench` compares these."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from scipy.special import bdtrc

from comparisons.statistics import chi2_quantile, chi2_tail, f_quantile
from tests.processes import printed, python

SCIPY = {f"scipy.{name}" for name in ("stats", "optimize", "interpolate", "ndimage", "spatial")}
"""Parts that a plain run does not need; scipy.stats alone loads all of them."""
HEAVY = {"numpy", "scipy", "gtsam", "matplotlib", "pydantic", "rich", "PIL", "open3d"}
NEVER = {
    "--help": HEAVY,
    "--version": HEAVY - {"pydantic"},
    "logs": HEAVY - {"pydantic", "numpy"},
    "config": HEAVY - {"pydantic", "numpy"},
    "run --help": HEAVY - {"rich"},
    "run no-such-log": {"matplotlib", "scipy.linalg", *SCIPY},
    "run simulated-loop --set log.end_s=10": SCIPY
    | {"scipy.cluster", "matplotlib", "markdown_it", "pandas", "joblib", "open3d", "kiss_icp"},
}
"""By command: what it must not load."""


def loaded(words: str, folder: Path, before: str = "") -> set[str]:
    """Return the modules that a command loads. before: code that is run in its process first."""
    code = (
        "import sys\n"
        f"{before}\n"
        f"sys.argv[1:] = {words.split()!r}\n"
        "from slamcheck.__main__ import main\n"
        "try:\n    main()\nexcept SystemExit as stop:\n    assert stop.code in (0, 1, 2), stop\n"
        "open('loaded', 'w').write('\\n'.join(sys.modules))\n"
    )
    done = python("-c", code, cwd=folder)
    assert done.returncode == 0, done.stderr
    return set((folder / "loaded").read_text().splitlines())


@cache
def of_scipy_special() -> set[str]:
    """Parts of scipy that scipy.special loads: linalg, too, from 1.18 on."""
    names = printed("import sys; import scipy.special; print(*sys.modules)").split()
    return {name for name in names if name.startswith("scipy.")}


@pytest.mark.parametrize("words", NEVER)
def test_a_command_loads_only_what_it_needs(words: str, tmp_path: Path) -> None:
    assert not (NEVER[words] - of_scipy_special()) & loaded(words, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "before", "found"),
    [
        ("--help", "import comparisons.config", {"pydantic"}),
        ("run no-such-log", "import comparisons.report.picture", {"matplotlib"}),
        ("run no-such-log", "from scipy.stats import chi2", {"scipy.linalg", *SCIPY}),
    ],
)
def test_the_guard_sees_what_is_loaded_too_much(
    words: str, before: str, found: set[str], tmp_path: Path
) -> None:
    """Broken variants: a module at the head of another that loads what is not needed."""
    assert NEVER[words] & loaded(words, tmp_path, before) >= found


def test_pictures_are_loaded_after_the_estimates(tmp_path: Path) -> None:
    """A run that ends within the comparison has not waited for matplotlib."""
    stop = "import comparisons.jobs.run as stage\ndef end(*given): sys.exit(1)\n"
    run = "run simulated-loop --set log.end_s=10 --figures png"
    assert "matplotlib" not in loaded(run, tmp_path, f"{stop}stage.compare = end")


DOF = (1, 2, 3, 30, 123, 2999, 52974)
SHARES = (0.0, 0.0005, 0.025, 0.5, 0.975, 0.999, 1.0 - 1e-9, 1.0)


def test_quantiles_are_those_of_scipy_stats_to_the_bit() -> None:
    for dof in DOF:
        at = chi2_quantile(np.array(SHARES), dof)
        assert np.array_equal(at, stats.chi2.ppf(SHARES, dof))
        assert not np.array_equal(at, 2.0 * stats.gamma.ppf(SHARES, dof))  # broken: not halved
        for value in (0.0, 0.3 * dof, 1.0 * dof, 2.0 * dof, np.inf):
            assert chi2_tail(value, dof) == stats.chi2.sf(value, dof)
        assert f_quantile(0.999, 3, dof) == stats.f.ppf(0.999, 3, dof)
    assert np.array_equal(chi2_quantile(0.025, np.array(DOF)), stats.chi2.ppf(0.025, DOF))


def test_the_binomial_tail_of_the_data_audit_is_that_of_scipy_stats() -> None:
    for count in range(-1, 40):
        assert bdtrc(count, 60, 0.01) == pytest.approx(stats.binom.sf(count, 60, 0.01), rel=1e-12)
