"""Is my EKF-SLAM right? The public interface: these names and their public methods.

    import slamcheck

    log = slamcheck.load_log("simulated-loop", seed=7)
    run = slamcheck.compare(log, filter="compressed")
    print(run.verdict.summary)
    print(run.to_pandas("gaps"))
    mine = slamcheck.check(log, "my-filter-output")
    print(mine.outcome, *mine.causes, sep="\\n")

A job (`compare`, `check`, `solve`, `odometry`, `dense_map`) takes a log, or its name or path, and
options, named as the command's on the command line (`--smoother-association own` is
`smoother_association="own"`) and typed, or a whole configuration in their place. Its result shows
itself in a notebook; `to_pandas()` returns its tables as data frames, where pandas is installed.
What a user can mend raises `InputError`, in one line. The modules `comparisons`, `ekf_reference`
and `graphslam` that these names come from are private: they may change in any release.

A name is imported when it is first used, so `import slamcheck` takes no time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from slamcheck._packages import check_packages

if TYPE_CHECKING:
    from typing import Unpack

    from comparisons.audit.audit import Audit as Audit
    from comparisons.audit.directions import inertial_directions as inertial_directions
    from comparisons.audit.directions import planar_directions as planar_directions
    from comparisons.checks.pair_of_estimates import EstimateComparison as EstimateComparison
    from comparisons.config import CheckConfig as CheckConfig
    from comparisons.config import JobConfig
    from comparisons.config import MapConfig as MapConfig
    from comparisons.config import OdometryConfig as OdometryConfig
    from comparisons.config import RunConfig as RunConfig
    from comparisons.config import SolveConfig as SolveConfig
    from comparisons.errors import InputError as InputError
    from comparisons.estimates.estimate import Estimate as Estimate
    from comparisons.estimates.external import ExternalEstimate as ExternalEstimate
    from comparisons.estimates.external import read_external as read_estimate
    from comparisons.estimates.folder import write_estimate as write_estimate
    from comparisons.experiments.montecarlo.study import StudyOutcome as MonteCarlo
    from comparisons.experiments.montecarlo.study import montecarlo as montecarlo
    from comparisons.extensions.dense_maps.job import DenseMapping as DenseMapping
    from comparisons.extensions.scan_motion.job import FrontEnd as FrontEnd
    from comparisons.jobs.external_check import ExternalCheck as ExternalCheck
    from comparisons.jobs.run import Comparison as Comparison
    from comparisons.logs.log import Log as Log
    from comparisons.logs.log_folder import write_log_folder as write_log
    from comparisons.pipeline.solve import Solution as Solution
    from comparisons.report.figures.plots import plot_errors as plot_errors
    from comparisons.report.figures.plots import plot_ladder as plot_ladder
    from comparisons.report.figures.plots import plot_map as plot_map
    from comparisons.report.figures.plots import plot_nees as plot_nees
    from comparisons.report.figures.style import plot_trajectory as plot_trajectory
    from comparisons.settings import run_config as run_config
    from comparisons.trace.charts import BlockChart as BlockChart
    from comparisons.trace.recorder import Recorder as Recorder
    from comparisons.trace.wrapping import record as record
    from ekf_reference.core.ekf import Ekf as Ekf
    from ekf_reference.filters.compressed import CompressedEkf as CompressedEkf
    from ekf_reference.filters.misono import DirectionCosineEkf as DirectionCosineEkf
    from slamcheck._options import (
        CheckOptions,
        MapOptions,
        OdometryOptions,
        RunOptions,
        SolveOptions,
    )

    C = TypeVar("C", bound=JobConfig)
    Progress = Callable[[str, int, int], None]

_PLACES = {
    "Audit": "comparisons.audit.audit",
    "CheckConfig": "comparisons.config",
    "Comparison": "comparisons.jobs.run",
    "CompressedEkf": "ekf_reference.filters.compressed",
    "DenseMapping": "comparisons.extensions.dense_maps.job",
    "DirectionCosineEkf": "ekf_reference.filters.misono",
    "Ekf": "ekf_reference.core.ekf",
    "Estimate": "comparisons.estimates.estimate",
    "EstimateComparison": "comparisons.checks.pair_of_estimates",
    "FrontEnd": "comparisons.extensions.scan_motion.job",
    "ExternalCheck": "comparisons.jobs.external_check",
    "ExternalEstimate": "comparisons.estimates.external",
    "InputError": "comparisons.errors",
    "Log": "comparisons.logs.log",
    "MapConfig": "comparisons.config",
    "MonteCarlo": "comparisons.experiments.montecarlo.study:StudyOutcome",
    "OdometryConfig": "comparisons.config",
    "BlockChart": "comparisons.trace.charts",
    "Recorder": "comparisons.trace.recorder",
    "RunConfig": "comparisons.config",
    "Solution": "comparisons.pipeline.solve",
    "SolveConfig": "comparisons.config",
    "inertial_directions": "comparisons.audit.directions",
    "montecarlo": "comparisons.experiments.montecarlo.study",
    "planar_directions": "comparisons.audit.directions",
    "plot_errors": "comparisons.report.figures.plots",
    "plot_ladder": "comparisons.report.figures.plots",
    "plot_map": "comparisons.report.figures.plots",
    "plot_nees": "comparisons.report.figures.plots",
    "plot_trajectory": "comparisons.report.figures.style",
    "read_estimate": "comparisons.estimates.external:read_external",
    "record": "comparisons.trace.wrapping",
    "run_config": "comparisons.settings",
    "write_estimate": "comparisons.estimates.folder",
    "write_log": "comparisons.logs.log_folder:write_log_folder",
}
"""Where each name is defined, with its name there if that differs."""

_USES = {
    "Read and write logs and estimates": (
        "load_log",
        "write_log",
        "Log",
        "read_estimate",
        "write_estimate",
        "Estimate",
        "ExternalEstimate",
    ),
    "Run EKF and smoother": ("compare", "Comparison", "RunConfig", "run_config"),
    "Check an estimate": ("check", "ExternalCheck", "CheckConfig"),
    "Compare two estimates": ("compare_estimates", "EstimateComparison"),
    "Record a trace": (
        *("record", "Recorder", "BlockChart", "planar_directions", "inertial_directions"),
    ),
    "Audit a trace": ("audit", "Audit"),
    "Plot": ("plot_map", "plot_trajectory", "plot_errors", "plot_nees", "plot_ladder"),
    "Write a report": ("write_report",),
    "Run the smoother alone": ("solve", "Solution", "SolveConfig"),
    "Map laser scans": (
        "odometry",
        "FrontEnd",
        "OdometryConfig",
        "dense_map",
        "DenseMapping",
        "MapConfig",
    ),
    "Study filters in simulation": ("montecarlo", "MonteCarlo"),
    "Step a filter yourself": ("Ekf", "CompressedEkf", "DirectionCosineEkf"),
    "Catch what a user can mend": ("InputError",),
}
"""What each name is for, in the order of the reference (docs/site.py)."""

__all__ = [
    "Audit",
    "BlockChart",
    "CheckConfig",
    "Comparison",
    "CompressedEkf",
    "DenseMapping",
    "DirectionCosineEkf",
    "Ekf",
    "Estimate",
    "EstimateComparison",
    "ExternalCheck",
    "ExternalEstimate",
    "FrontEnd",
    "InputError",
    "Log",
    "MapConfig",
    "MonteCarlo",
    "OdometryConfig",
    "Recorder",
    "RunConfig",
    "Solution",
    "SolveConfig",
    "audit",
    "check",
    "compare",
    "compare_estimates",
    "dense_map",
    "inertial_directions",
    "load_log",
    "montecarlo",
    "odometry",
    "planar_directions",
    "plot_errors",
    "plot_ladder",
    "plot_map",
    "plot_nees",
    "plot_trajectory",
    "read_estimate",
    "record",
    "run_config",
    "solve",
    "write_estimate",
    "write_log",
    "write_report",
]


def load_log(source: str | Path, **settings: Any) -> Log:
    """Return a log by its bundled name or its path.

    Args:
        source: A name of `slamcheck logs`, or a file or folder in any readable format.
        settings: Fields of the configuration's `log` section, as `seed`, `robot` or `format`.

    Returns:
        The log in SI units: headings counter-clockwise from east, bearings counter-clockwise from
        straight ahead, whatever the file's own convention.

    Raises:
        InputError: The log cannot be read, or a setting is unknown or out of range.
    """
    check_packages()
    from comparisons.config import LogSection
    from comparisons.pipeline.read import load_log as load

    return load(LogSection.of(source=str(source), **settings))


def compare(
    log: Log | str | Path,
    config: RunConfig | None = None,
    *,
    progress: Progress | None = None,
    **options: Unpack[RunOptions],
) -> Comparison:
    """Run EKF and smoother over a log and judge whether they agree.

    Args:
        log: A log, its bundled name or its path. Both estimators read it, with one set of standard
            deviations and one prior.
        config: A whole configuration, in place of options.
        progress: Called with the stage, how much is done, and of how much (0 if unknown).
        options: Options of `slamcheck run` by name: `filter="compressed"`, `association="nn"`.

    Returns:
        Both estimates, the gaps between them, the verdict with its causes, and consistency.

    Raises:
        InputError: The log cannot be used as configured, or an option is unknown.
        graphslam.marginals.SingularProblemError: The smoother has no unique solution.
    """
    from comparisons.config import RunConfig
    from comparisons.jobs.run import compare as run
    from comparisons.pipeline.clock import no_progress

    return run(_read(log), _configured(RunConfig, config, options), progress or no_progress)


def check(
    log: Log | str | Path,
    estimate: ExternalEstimate | Estimate | str | Path,
    config: CheckConfig | None = None,
    *,
    progress: Progress | None = None,
    **options: Unpack[CheckOptions],
) -> ExternalCheck:
    """Grade another system's estimate of a log.

    Args:
        log: The log that the estimate was made from, its bundled name or its path.
        estimate: A trajectory file, an estimate folder, or arrays as an `ExternalEstimate`.
        config: A whole configuration, in place of options.
        progress: Called with the stage, how much is done, and of how much (0 if unknown).
        options: Options of `slamcheck check` by name: `require="like"` is the least grade that
            agrees.

    Returns:
        Grade, outcome and causes; with the filter's trace also its gaps.

    Raises:
        InputError: The estimate cannot be read, has arrays of other shapes than expected, or has
            no pose within the log's time; or an option is unknown.
        graphslam.marginals.SingularProblemError: The smoother has no unique solution.
    """
    check_packages()
    from comparisons.config import CheckConfig
    from comparisons.estimates.estimate import Estimate
    from comparisons.estimates.external import ExternalEstimate, read_external
    from comparisons.jobs.check import check as check_external_estimate
    from comparisons.pipeline.clock import no_progress

    settings = _configured(CheckConfig, config, options)
    if isinstance(estimate, Estimate):
        estimate = ExternalEstimate.of(estimate)
    if not isinstance(estimate, ExternalEstimate):
        estimate = read_external(Path(estimate), settings.times, settings.trace)
    return check_external_estimate(
        _read(log), estimate.validated(), settings, progress or no_progress
    )


def compare_estimates(
    first: ExternalEstimate | Estimate | str | Path,
    second: ExternalEstimate | Estimate | str | Path,
    *,
    relation: Literal["independent", "filter-smoother"] = "independent",
) -> EstimateComparison:
    """Compare two estimates of one drive, without its log.

    Args:
        first: A trajectory file, an estimate folder, or arrays; the filter's, where the two are a
            filter's and a smoother's.
        second: As first, in the same frame and on the same clock.
        relation: What the covariance of their difference is: of `independent` estimates the sum of
            theirs; of a filter's and a smoother's of the same data the first's less the second's.

    Returns:
        Differences and NEES by time and by landmark.

    Raises:
        InputError: An estimate cannot be read, or they share no time.
    """
    from comparisons.checks.pair_of_estimates import compare_pair
    from comparisons.estimates.estimate import Estimate
    from comparisons.estimates.external import ExternalEstimate, read_external

    pair = []
    for one in (first, second):
        given = ExternalEstimate.of(one) if isinstance(one, Estimate) else one
        given = given if isinstance(given, ExternalEstimate) else read_external(given)
        pair.append(given.validated())
    return compare_pair(pair[0], pair[1], relation)


def solve(
    log: Log | str | Path,
    config: SolveConfig | None = None,
    *,
    progress: Progress | None = None,
    **options: Unpack[SolveOptions],
) -> Solution:
    """Run the smoother alone.

    Args:
        log: The log, its bundled name or its path.
        config: A whole configuration, in place of options.
        progress: Called with the stage, how much is done, and of how much (0 if unknown).
        options: Options of `slamcheck solve` by name: `association="own"`, `robust="huber"`.

    Returns:
        The optimum with its covariances, and whether it is verified (a strict local minimum on
        which independent starts agree, and a plausible chi-square; no certificate).

    Raises:
        InputError: The log cannot be used as configured, or an option is unknown.
        graphslam.marginals.SingularProblemError: The smoother has no unique solution.
    """
    from comparisons.config import SolveConfig
    from comparisons.pipeline.clock import no_progress
    from comparisons.pipeline.solve import solve as run

    return run(_read(log), _configured(SolveConfig, config, options), progress or no_progress)


def odometry(
    log: Log | str | Path,
    config: OdometryConfig | None = None,
    *,
    progress: Progress | None = None,
    **options: Unpack[OdometryOptions],
) -> FrontEnd:
    """Run scan odometry, loop closure and the scan pose graph over a log's scans.

    Args:
        log: A log with scans or clouds, its bundled name or its path.
        config: A whole configuration, in place of options.
        progress: Called with the stage, how much is done, and of how much (0 if unknown).
        options: Options of `slamcheck odometry` by name, as `loop_closure=False`.

    Returns:
        The trajectories by wheels, scan odometry and graph, and their errors.

    Raises:
        InputError: The log has no scans, or an option is unknown.
        graphslam.scan.libraries.MissingLibraryError: KISS-ICP or Open3D is not installed.
    """
    from comparisons.config import OdometryConfig
    from comparisons.extensions.scan_motion.job import run_front_end
    from comparisons.pipeline.clock import no_progress

    settings = _configured(OdometryConfig, config, options)
    return run_front_end(_read(log), settings, progress or no_progress)


def dense_map(
    log: Log | str | Path,
    config: MapConfig | None = None,
    *,
    progress: Progress | None = None,
    **options: Unpack[MapOptions],
) -> DenseMapping:
    """Run the EKF with a dense map beside it, anchored to its landmarks.

    Args:
        log: A log with scans, its bundled name or its path.
        config: A whole configuration, in place of options.
        progress: Called with the stage, how much is done, and of how much (0 if unknown).
        options: Options of `slamcheck map` by name: `layer=["occupancy"]`, `resolution=0.1`.

    Returns:
        The layers as the landmarks lie in the end, and their distances from true surfaces.

    Raises:
        InputError: The log cannot be used as configured, or an option is unknown.
        graphslam.scan.libraries.MissingLibraryError: Open3D is needed and not installed.

    Source: Nieto 2005, chapters 4 and 6.2.
    """
    from comparisons.config import MapConfig
    from comparisons.extensions.dense_maps.job import map_log
    from comparisons.pipeline.clock import no_progress

    if config is None:
        options.setdefault("layer", ["points", "occupancy"])
    settings = _configured(MapConfig, config, options)
    return map_log(_read(log), settings, progress or no_progress)


def audit(trace: str | Path, *, tolerance: float = 1e-6, progress: Progress | None = None) -> Audit:
    """Audit a trace of any Kalman filter, recorded by `Recorder`.

    Args:
        trace: The file.
        tolerance: Largest difference of covariances and estimates that counts as rounding, in
            standard deviations.
        progress: Called with the stage, how many events are done, and of how many.

    Returns:
        The findings, faults first; whether the filter is sound; and the figures.

    Raises:
        InputError: The file is no trace, is damaged, or an event cannot be what it says.
    """
    check_packages()
    from comparisons.checks.of_events import audit_trace

    return audit_trace(trace, tolerance, progress)


def write_report(
    result: Comparison | ExternalCheck | Solution | FrontEnd | DenseMapping | Audit,
    folder: str | Path,
) -> None:
    """Write the folder that the command line writes: JSON, estimates, pictures, `report.html`.

    Args:
        result: Of `compare`, `check`, `solve`, `odometry`, `dense_map` or `audit`.
        folder: New or empty, or one that an earlier job has written, which is replaced.

    Raises:
        InputError: The folder holds other files, or cannot be written.
    """
    from comparisons.report.job import report_of

    report_of(result).write(Path(folder))


def _read(log: Log | str | Path) -> Log:
    """Return a log, or the one of a bundled name or path."""
    return load_log(log) if isinstance(log, str | Path) else log


def _configured(job: type[C], config: C | None, options: Mapping[str, Any]) -> C:
    """Return a configuration, or that of options; those of the log are none, for it is given."""
    from comparisons.errors import InputError
    from comparisons.options.table import of_job
    from comparisons.settings import by_name, configure

    if config is None:
        table = of_job(job.model_fields["job"].default)
        table = tuple(one for one in table if not one.field.startswith("log."))
        return configure(job, flags=by_name(table, options))
    if options:
        raise InputError(f"give a configuration or options ({', '.join(options)}), not both")
    return config


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("slamcheck")
    place = _PLACES.get(name)
    if place is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    check_packages()
    module, _, attribute = place.partition(":")
    found = globals()[name] = getattr(import_module(module), attribute or name)
    return found


def __dir__() -> list[str]:
    return sorted(__all__)
