"""Settings of FastSLAM as a third estimator."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from pydantic import Field

from comparisons.config import Configured, ExtensionConfig

if TYPE_CHECKING:
    from comparisons.extensions.fastslam.extension import FastSlamExtension


class FastSlamConfig(ExtensionConfig):
    """FastSLAM (Rao-Blackwellised particle filter) as a third estimator."""

    particles: int = Field(100, ge=4, le=100_000, description="Particles of each cloud")
    clouds: int = Field(
        192,
        ge=16,
        le=10_000,
        description="Independent clouds, divided among at most 12 stretches of the log; each gives "
        "one draw of the posterior",
    )
    proposal: Literal["1.0", "2.0"] = Field(
        "2.0",
        description="Distribution from which poses are sampled. 1.0: the motion; 2.0: the motion "
        "conditioned on the measurements",
    )
    association: Literal["likeliest", "sampled"] = Field(
        "likeliest",
        description="How a particle associates measurements without labels. sampled: it draws in "
        "proportion to the likelihood, so that particles hold several hypotheses",
    )
    seed: int = Field(0, ge=0, description="Seed of all random numbers")

    def check_with(self, config: Configured) -> None:
        """Raise ValueError for what FastSLAM does not estimate."""
        if config.ekf.gps != "off":
            raise ValueError("--third fastslam fuses no absolute positions; use --gps off")
        for name, option in (("scan_landmarks", "--landmarks"), ("scan_motion", "--motion")):
            if name in config.extensions:
                raise ValueError(f"--third fastslam does not go with {option}")

    def build(self, config: Configured) -> FastSlamExtension:
        """Return the extension."""
        from comparisons.extensions.fastslam.extension import FastSlamExtension

        return FastSlamExtension(self)
