"""Settings of FastSLAM as a third estimator."""

from __future__ import annotations

from typing import Literal

from comparisons.config import Configured, ExtensionConfig, setting
from comparisons.options import ABSENT, ESTIMATORS, Option


class FastSlamConfig(ExtensionConfig):
    """FastSLAM (Rao-Blackwellised particle filter) as a third estimator."""

    extension = "comparisons.extensions.fastslam.extension:FastSlamExtension"
    switch = Option(
        "--third",
        ESTIMATORS,
        "Third estimator: none or fastslam (particles). [none]",
        jobs=("run",),
        settings={"none": ABSENT, "fastslam": {}},
    )
    particles: int = setting(100, "Particles of each cloud", ge=4, le=100_000)
    clouds: int = setting(
        192,
        "Independent clouds, divided among at most 12 stretches of the log; each gives "
        "one draw of the posterior",
        ge=16,
        le=10_000,
    )
    proposal: Literal["1.0", "2.0"] = setting(
        "2.0",
        "Distribution from which poses are sampled. 1.0: the motion; 2.0: the motion "
        "conditioned on the measurements",
    )
    association: Literal["likeliest", "sampled"] = setting(
        "likeliest",
        "How a particle associates measurements without labels. sampled: it draws in "
        "proportion to the likelihood, so that particles hold several hypotheses",
    )
    seed: int = setting(0, "Seed of all random numbers", ge=0)

    def check_with(self, config: Configured) -> None:
        """Raise ValueError for what FastSLAM does not estimate."""
        if config.ekf.gps != "off":
            raise ValueError("--third fastslam fuses no absolute positions; use --gps off")
        for name, option in (("scan_landmarks", "--landmarks"), ("scan_motion", "--motion")):
            if name in config.extensions:
                raise ValueError(f"--third fastslam does not go with {option}")
