"""Is my EKF-SLAM right? The public interface; everything else is private.

    import slamcheck

    log = slamcheck.load_log("simulated-loop", seed=7)
    run = slamcheck.compare(log, slamcheck.run_config(filter="compressed"))
    print(run.verdict.summary)
    mine = slamcheck.check(log, "my-filter-output")
    print(mine.outcome, *mine.causes, sep="\\n")

A name is imported when it is first used, so `import slamcheck` takes no time.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from comparisons.config import CheckConfig as CheckConfig
    from comparisons.config import MapConfig as MapConfig
    from comparisons.config import OdometryConfig as OdometryConfig
    from comparisons.config import RunConfig as RunConfig
    from comparisons.config import SolveConfig as SolveConfig
    from comparisons.errors import InputError as InputError
    from comparisons.estimates.estimate import Estimate as Estimate
    from comparisons.estimates.external import ExternalEstimate as ExternalEstimate
    from comparisons.estimates.external import read_external as read_estimate
    from comparisons.estimates.folder import write_estimate as write_estimate
    from comparisons.experiments.montecarlo.study import montecarlo as montecarlo
    from comparisons.logs.log import Log as Log
    from comparisons.logs.log_folder import write_log_folder as write_log
    from comparisons.pipeline.check import ExternalCheck as ExternalCheck
    from comparisons.pipeline.compare import Comparison as Comparison
    from comparisons.pipeline.compare import compare as compare
    from comparisons.pipeline.dense_map import DenseMapping as DenseMapping
    from comparisons.pipeline.dense_map import map_log as dense_map
    from comparisons.pipeline.odometry import FrontEnd as FrontEnd
    from comparisons.pipeline.odometry import run_front_end as odometry
    from comparisons.pipeline.solve import Solution as Solution
    from comparisons.pipeline.solve import solve as solve
    from comparisons.settings import run_config as run_config
    from ekf_reference.core.ekf import Ekf as Ekf
    from ekf_reference.filters.compressed import CompressedEkf as CompressedEkf
    from ekf_reference.filters.misono import DirectionCosineEkf as DirectionCosineEkf

_PLACES = {
    "CheckConfig": "comparisons.config",
    "Comparison": "comparisons.pipeline.compare",
    "CompressedEkf": "ekf_reference.filters.compressed",
    "DenseMapping": "comparisons.pipeline.dense_map",
    "DirectionCosineEkf": "ekf_reference.filters.misono",
    "Ekf": "ekf_reference.core.ekf",
    "Estimate": "comparisons.estimates.estimate",
    "FrontEnd": "comparisons.pipeline.odometry",
    "ExternalCheck": "comparisons.pipeline.check",
    "ExternalEstimate": "comparisons.estimates.external",
    "InputError": "comparisons.errors",
    "Log": "comparisons.logs.log",
    "MapConfig": "comparisons.config",
    "OdometryConfig": "comparisons.config",
    "RunConfig": "comparisons.config",
    "Solution": "comparisons.pipeline.solve",
    "SolveConfig": "comparisons.config",
    "compare": "comparisons.pipeline.compare",
    "dense_map": "comparisons.pipeline.dense_map:map_log",
    "montecarlo": "comparisons.experiments.montecarlo.study",
    "odometry": "comparisons.pipeline.odometry:run_front_end",
    "read_estimate": "comparisons.estimates.external:read_external",
    "run_config": "comparisons.settings",
    "solve": "comparisons.pipeline.solve",
    "write_estimate": "comparisons.estimates.folder",
    "write_log": "comparisons.logs.log_folder:write_log_folder",
}
"""Where each name is defined, with its name there if that differs."""

__all__ = [
    "CheckConfig",
    "Comparison",
    "CompressedEkf",
    "DenseMapping",
    "DirectionCosineEkf",
    "Ekf",
    "Estimate",
    "ExternalCheck",
    "ExternalEstimate",
    "FrontEnd",
    "InputError",
    "Log",
    "MapConfig",
    "OdometryConfig",
    "RunConfig",
    "Solution",
    "SolveConfig",
    "check",
    "compare",
    "dense_map",
    "load_log",
    "montecarlo",
    "odometry",
    "read_estimate",
    "run_config",
    "solve",
    "write_estimate",
    "write_log",
]


def load_log(source: str | Path, **settings: Any) -> Log:
    """Return a log by its bundled name or its path.

    Args:
        source: a name of `slamcheck logs`, or a file or folder in any readable format.
        settings: fields of the configuration's `log` section, as `seed`, `robot` or `format`.

    Raises:
        InputError: the log cannot be read, or a setting is unknown or out of range.
    """
    from comparisons.config import LogSection
    from comparisons.pipeline.read import load_log as load

    return load(LogSection.of(source=str(source), **settings))


def check(
    log: Log, estimate: ExternalEstimate | Estimate | str | Path, config: CheckConfig | None = None
) -> ExternalCheck:
    """Grade another system's estimate of a log.

    Args:
        log: what the estimate was made from.
        estimate: a path to a trajectory or an estimate folder, or the estimate itself.
        config: settings; `require` is the least grade that agrees.

    Raises:
        InputError: the estimate cannot be read, or has no pose within the log's time.
        graphslam.marginals.SingularProblemError: the smoother has no unique solution.
    """
    from comparisons.estimates.estimate import Estimate
    from comparisons.estimates.external import ExternalEstimate, read_external
    from comparisons.pipeline.check import check as check_external_estimate

    if isinstance(estimate, Estimate):
        estimate = ExternalEstimate.of(estimate)
    elif not isinstance(estimate, ExternalEstimate):
        estimate = read_external(Path(estimate))
    return check_external_estimate(log, estimate, config)


def __getattr__(name: str) -> Any:
    place = _PLACES.get(name)
    if place is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, attribute = place.partition(":")
    found = globals()[name] = getattr(import_module(module), attribute or name)
    return found


def __dir__() -> list[str]:
    return sorted(__all__)
