"""`slamcheck run`, `solve` and `check`: the jobs that end in a verdict."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from comparisons.cli.options import (
    AssociationOption,
    AttributesOption,
    DenseOption,
    DynamicOption,
    EstimateOption,
    FeaturesOption,
    FiguresOption,
    FilterOption,
    FormatOption,
    FuseLandmarksOption,
    GpsOption,
    HighLevelCellOption,
    HighLevelEveryOption,
    HighLevelLeastOption,
    HighLevelOption,
    HighLevelPairOption,
    LagOption,
    LandmarksOption,
    LiveOption,
    LogArgument,
    LoopsOption,
    MethodOption,
    MotionOption,
    NoiseOption,
    OptimiserOption,
    OutOption,
    PiecesOption,
    RecordOption,
    ResolutionOption,
    RobotOption,
    RobustOption,
    SeedOption,
    SmootherAssociationOption,
    SmootherMatcherOption,
    SolveAssociationOption,
    TemplatesOption,
    TimesOption,
    TraceOption,
)
from comparisons.cli.support import (
    AGREE,
    DISAGREE,
    UNPROVEN,
    Extras,
    check_figures,
    guarded,
    print_result,
    progress_bar,
    read_named,
)
from comparisons.errors import InputError

if TYPE_CHECKING:
    from comparisons.adapters.ekf_factory import EkfChoices
    from comparisons.extensions.dense_maps.source import DenseOptions
    from comparisons.extensions.high_level.source import HighLevelOptions
    from comparisons.logs.log import Log
    from ekf_reference.scan_landmarks.scan_slam import ScanSlamOptions
    from graphslam.smoother import SmootherOptions

_VERDICTS = {"agree": AGREE, "disagree": DISAGREE, "unproven": UNPROVEN}


def run(
    log: LogArgument = "victoria-park",
    format_name: FormatOption = None,
    out: OutOption = None,
    filter_name: FilterOption = "full",
    association: AssociationOption = None,
    attributes: AttributesOption = "off",
    features: FeaturesOption = "log",
    landmarks: LandmarksOption = "points",
    fuse_landmarks: FuseLandmarksOption = "off",
    pieces: PiecesOption = None,
    templates: TemplatesOption = "bare",
    motion: MotionOption = "wheel",
    gps: GpsOption = "off",
    smoother: MethodOption = "batch",
    smoother_association: SmootherAssociationOption = "ekf",
    smoother_matcher: SmootherMatcherOption = "ekf",
    lag: LagOption = 100,
    optimiser: OptimiserOption = "levenberg-marquardt",
    robust: RobustOption = "none",
    robot: RobotOption = 1,
    seed: SeedOption = 0,
    loops: LoopsOption = 1,
    noise_scale: NoiseOption = 1.0,
    dense: DenseOption = [],  # noqa: B006
    resolution: ResolutionOption = 0.2,
    high_level: HighLevelOption = "off",
    high_level_cell: HighLevelCellOption = 0.2,
    high_level_pair: HighLevelPairOption = 12.0,
    high_level_least: HighLevelLeastOption = 200,
    high_level_every: HighLevelEveryOption = 20.0,
    figures: FiguresOption = [],  # noqa: B006
    live: LiveOption = False,
    record: RecordOption = None,
    trace: TraceOption = False,
    dynamic: DynamicOption = "off",
) -> None:
    """Run both estimators on a log, check one against the other, write a report folder.

    \b
    Examples:
      slamcheck run                                   the bundled Victoria Park log
      slamcheck run simulated-loop --loops 2 --seed 7
      slamcheck run path/to/MRCLAM_Dataset6 --robot 2
      slamcheck run my-log-folder --association nn --out report
      slamcheck run path/to/acfr_car_park --motion both
      slamcheck run scan-loop --dense points --dense occupancy
      slamcheck run scan-slam --landmarks scans
      slamcheck run scan-slam --landmarks scans --smoother-matcher own
      slamcheck run scan-slam-maps --landmarks scans --dense occupancy
      slamcheck run occupancy-loop --loops 2 --high-level on
      slamcheck run simulated-loop --figures pdf --record run.rrd
      slamcheck run dynamic-lanes --dynamic on
    """
    with guarded():
        check_figures(figures)
        if live or record is not None:
            from comparisons.report.viewer import check_viewer

            check_viewer(live, record)
        from comparisons.adapters.ekf_factory import EkfChoices
        from comparisons.extensions.dense_maps.source import DenseOptions
        from comparisons.extensions.high_level.source import HighLevelOptions
        from comparisons.extensions.scan_landmarks.source import slam_options

        source, read_s = read_named(log, format_name, robot, seed, loops, noise_scale, features)
        choices = EkfChoices(filter_name, association, gps, attributes)
        options = _options(smoother, lag, optimiser, robust)
        if smoother_association not in ("ekf", "own"):
            raise InputError(
                f"smoother association '{smoother_association}' is unknown, expected ekf or own"
            )
        if dynamic not in ("off", "on"):
            raise InputError(f"dynamic '{dynamic}' is unknown, expected off or on")
        if high_level not in ("off", "on"):
            raise InputError(f"--high-level is '{high_level}', expected off or on")
        if fuse_landmarks not in ("off", "on"):
            raise InputError(f"--fuse-landmarks is '{fuse_landmarks}', expected off or on")
        if trace and (filter_name.startswith("misono") or landmarks != "points"):
            raise InputError(
                "--trace is for filters of x, y and heading, and for landmarks that are points"
            )
        searched = HighLevelOptions.of(
            high_level_cell, high_level_pair, high_level_least, high_level_every
        )
        kept = DenseOptions(tuple(dict.fromkeys(dense)) or ("points",), resolution)
        raise SystemExit(
            _run(
                source,
                choices,
                options,
                smoother_association,
                smoother_matcher,
                motion,
                landmarks,
                fuse_landmarks == "on",
                slam_options(pieces, templates, landmarks),
                kept if dense else None,
                dynamic == "on",
                searched if high_level == "on" else None,
                out,
                read_s,
                Extras(tuple(figures), live, record, trace),
            )
        )


def _options(method: str, lag: int, optimiser: str, robust: str) -> SmootherOptions:
    from graphslam.smoother import SmootherOptions

    try:
        return SmootherOptions(method, lag, optimiser, robust)
    except ValueError as error:
        raise InputError(f"smoother: {error}") from None


def _run(
    log: Log,
    choices: EkfChoices,
    options: SmootherOptions,
    smoother_association: str,
    smoother_matcher: str,
    motion: str,
    landmarks: str,
    fuse_landmarks: bool,
    looking: ScanSlamOptions | None,
    dense: DenseOptions | None,
    dynamic: bool,
    high_level: HighLevelOptions | None,
    out: Path | None,
    read_s: float,
    extras: Extras,
) -> int:
    from comparisons.atomic import check_replaceable, folder_name
    from comparisons.pipeline.compare import compare_estimators
    from comparisons.report.result import build_result
    from comparisons.report.run_folder import CONTENTS, write_run_folder
    from comparisons.report.summary import print_summary

    folder = out or Path(f"slamcheck-{folder_name(log.name)}")
    check_replaceable(folder, CONTENTS)
    with progress_bar() as progress:
        comparison = compare_estimators(
            log,
            choices,
            options,
            progress,
            smoother_association=smoother_association,
            motion=motion,
            dense=dense,
            dynamic=dynamic,
            landmarks=landmarks,
            fuse_landmarks=fuse_landmarks,
            slam_options=looking,
            high_level=high_level,
            smoother_matcher=smoother_matcher,
        )
        result = build_result(comparison, read_s)
        progress("report", 0, 0)
        extras.save(comparison)  # first: where that fails, no folder is left
        write_run_folder(comparison, result, folder, extras.figures, trace=extras.trace)
    print_result(lambda console: print_summary(result, console), folder)
    extras.show(comparison)
    return _VERDICTS[result.verdict]


def solve(
    log: LogArgument = "victoria-park",
    format_name: FormatOption = None,
    out: OutOption = None,
    association: SolveAssociationOption = None,
    features: FeaturesOption = "log",
    gps: GpsOption = "off",
    smoother: MethodOption = "batch",
    lag: LagOption = 100,
    optimiser: OptimiserOption = "levenberg-marquardt",
    robust: RobustOption = "none",
    robot: RobotOption = 1,
    seed: SeedOption = 0,
    loops: LoopsOption = 1,
    noise_scale: NoiseOption = 1.0,
) -> None:
    """Run the smoother alone; write its estimate and its graph. Exits with 0 when proven, else 3.

    \b
    Examples:
      slamcheck solve                                 Victoria Park from dead reckoning
      slamcheck solve path/to/MRCLAM_Dataset6 --robot 3 --robust gnc
    """
    with guarded():
        from comparisons.atomic import check_replaceable, folder_name
        from comparisons.pipeline.solve import solve_log
        from comparisons.report.solution_folder import SOLUTION_CONTENTS, write_solution_folder
        from comparisons.report.solution_result import build_solution_result, print_solution

        source, read_s = read_named(log, format_name, robot, seed, loops, noise_scale, features)
        folder = out or Path(f"slamcheck-solve-{folder_name(source.name)}")
        check_replaceable(folder, SOLUTION_CONTENTS)
        options = _options(smoother, lag, optimiser, robust)
        with progress_bar() as progress:
            solution = solve_log(source, association, gps, options, progress)
            result = build_solution_result(solution, read_s)
            progress("report", 0, 0)
            write_solution_folder(solution, result, folder)
        print_result(lambda console: print_solution(result, console), folder)
        raise SystemExit(AGREE if result.verdict == "proven" else UNPROVEN)


def check(
    log: LogArgument,
    estimate: EstimateOption,
    times: TimesOption = None,
    format_name: FormatOption = None,
    out: OutOption = None,
    association: SolveAssociationOption = None,
    features: FeaturesOption = "log",
    gps: GpsOption = "off",
    robust: RobustOption = "none",
    robot: RobotOption = 1,
    seed: SeedOption = 0,
    loops: LoopsOption = 1,
    noise_scale: NoiseOption = 1.0,
) -> None:
    """Check another system's estimate of a log against the smoother's. Exits as run does.

    \b
    Examples:
      slamcheck check simulated-loop --estimate my-filter-output
      slamcheck check my-log --estimate trajectory.tum
    """
    with guarded():
        from comparisons.atomic import check_replaceable, folder_name
        from comparisons.estimates.external import read_given
        from comparisons.pipeline.check import check_given
        from comparisons.report.check_folder import CHECK_CONTENTS, write_check_folder
        from comparisons.report.check_result import build_check_result, print_check

        given = read_given(estimate, times)
        source, read_s = read_named(log, format_name, robot, seed, loops, noise_scale, features)
        folder = out or Path(f"slamcheck-check-{folder_name(source.name)}")
        check_replaceable(folder, CHECK_CONTENTS)
        options = _options("batch", 100, "levenberg-marquardt", robust)
        with progress_bar() as progress:
            checked = check_given(source, given, association, gps, options, progress)
            result = build_check_result(checked, read_s)
            progress("report", 0, 0)
            write_check_folder(checked, result, folder)
        print_result(lambda console: print_check(result, console), folder)
        raise SystemExit(_VERDICTS[checked.outcome])
