"""The commands that work on raw scans. Heavy imports stay inside them."""

from __future__ import annotations

from pathlib import Path

from comparisons.cli.options import (
    AssociationOption,
    CloudOption,
    DynamicLayerOption,
    FeaturesOption,
    FilterOption,
    FormatOption,
    GpsOption,
    GuessOption,
    LandmarksOption,
    LayerOption,
    LogArgument,
    LoopClosureOption,
    LoopsOption,
    MatcherOption,
    NoiseOption,
    OutOption,
    PiecesOption,
    ResolutionOption,
    RobotOption,
    SeedOption,
    TemplatesOption,
)
from comparisons.cli.support import (
    AGREE,
    UNPROVEN,
    check_cloud,
    guarded,
    print_result,
    progress_bar,
    read_named,
)
from comparisons.errors import InputError


def odometry(
    log: LogArgument,
    format_name: FormatOption = None,
    out: OutOption = None,
    guess: GuessOption = "wheels",
    loops_closed: LoopClosureOption = "on",
    matcher: MatcherOption = "surface",
    gps: GpsOption = "off",
    cloud: CloudOption = None,
    robot: RobotOption = 1,
    seed: SeedOption = 0,
    loops: LoopsOption = 1,
    noise_scale: NoiseOption = 1.0,
) -> None:
    """Run the scan front end alone: odometry, loop closure, scan pose graph. Exits as solve does.

    \b
    Examples:
      slamcheck odometry scan-loop                    simulated scans, with truth
      slamcheck odometry path/to/acfr_car_park --cloud pcd
    """
    with guarded():
        from comparisons.atomic import check_replaceable, folder_name
        from comparisons.pipeline.odometry import FrontEndChoices, run_front_end
        from comparisons.report.front_end_folder import FRONT_END_CONTENTS, write_front_end_folder
        from comparisons.report.front_end_result import build_front_end_result, print_front_end

        for name, value, known in (
            ("guess", guess, ("wheels", "none")),
            ("loop-closure", loops_closed, ("on", "off")),
        ):
            if value not in known:
                raise InputError(f"{name} '{value}' is unknown, expected {' or '.join(known)}")
        check_cloud(cloud)
        choices = FrontEndChoices(guess == "wheels", loops_closed == "on", gps, matcher)
        source, read_s = read_named(log, format_name, robot, seed, loops, noise_scale, "log")
        folder = out or Path(f"slamcheck-odometry-{folder_name(source.name)}")
        check_replaceable(folder, FRONT_END_CONTENTS)
        with progress_bar() as progress:
            front_end = run_front_end(source, choices, progress)
            result = build_front_end_result(front_end, read_s)
            progress("report", 0, 0)
            write_front_end_folder(front_end, result, folder, cloud)
        print_result(lambda console: print_front_end(result, console), folder)
        raise SystemExit(AGREE if result.verdict == "proven" else UNPROVEN)


def map_command(
    log: LogArgument,
    layer: LayerOption = ["occupancy"],  # noqa: B006
    resolution: ResolutionOption = 0.2,
    dynamic: DynamicLayerOption = False,
    format_name: FormatOption = None,
    out: OutOption = None,
    filter_name: FilterOption = "full",
    association: AssociationOption = None,
    features: FeaturesOption = "log",
    landmarks: LandmarksOption = "points",
    pieces: PiecesOption = None,
    templates: TemplatesOption = "bare",
    gps: GpsOption = "off",
    cloud: CloudOption = None,
    robot: RobotOption = 1,
    seed: SeedOption = 0,
    loops: LoopsOption = 1,
    noise_scale: NoiseOption = 1.0,
) -> None:
    """Map what the scanner saw, between the filter's landmarks (DenseSLAM). Exits with 0.

    \b
    Examples:
      slamcheck map occupancy-loop                    simulated scans, with true surfaces
      slamcheck map path/to/acfr_car_park --layer points --layer occupancy --resolution 0.4
      slamcheck map dynamic-places --dynamic          and where something has changed
      slamcheck map scan-slam --landmarks scans --layer occupancy --layer sog
    """
    with guarded():
        from comparisons.adapters.ekf_factory import EkfChoices
        from comparisons.atomic import check_replaceable, folder_name
        from comparisons.extensions.dense_maps.source import DenseOptions
        from comparisons.extensions.scan_landmarks.source import slam_options
        from comparisons.pipeline.dense_map import map_log
        from comparisons.report.map_folder import MAP_CONTENTS, write_map_folder
        from comparisons.report.map_result import build_map_result, print_map

        check_cloud(cloud)
        slam = slam_options(pieces, templates, landmarks)
        options = DenseOptions(tuple(dict.fromkeys(layer)), resolution, dynamic=dynamic)
        choices = EkfChoices(filter_name, association, gps)
        source, read_s = read_named(log, format_name, robot, seed, loops, noise_scale, features)
        folder = out or Path(f"slamcheck-map-{folder_name(source.name)}")
        check_replaceable(folder, MAP_CONTENTS)
        with progress_bar() as progress:
            mapping = map_log(source, choices, options, progress, landmarks, slam)
            result = build_map_result(mapping, read_s)
            progress("report", 0, 0)
            write_map_folder(mapping, result, folder, cloud)
        print_result(lambda console: print_map(result, console), folder)
        raise SystemExit(AGREE)
