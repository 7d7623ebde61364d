"""The command line's arguments and options, which several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

LogArgument = Annotated[
    str, typer.Argument(metavar="LOG", help="A bundled name (see `slamcheck logs`) or a path.")
]
FormatOption = Annotated[
    str | None,
    typer.Option("--format", metavar="F", help="The log's format; recognised if left out."),
]
RobotOption = Annotated[int, typer.Option(help="Robot number, for MR.CLAM folders.")]
SeedOption = Annotated[int, typer.Option(help="Seed of a simulated log.")]
LoopsOption = Annotated[int, typer.Option(help="Loops of a simulated log.")]
MethodOption = Annotated[
    str,
    typer.Option(metavar="batch|isam2|fixed-lag", help="How the smoother works."),
]
LagOption = Annotated[int, typer.Option(help="Poses that a fixed lag holds.")]
OptimiserOption = Annotated[
    str,
    typer.Option(metavar="levenberg-marquardt|gauss-newton|dogleg", help="Of the batch smoother."),
]
RobustOption = Annotated[
    str,
    typer.Option(
        metavar="none|huber|cauchy|gnc",
        help="Against wild sightings and positions in the smoother; changes its marginals.",
    ),
]
NoiseOption = Annotated[
    float, typer.Option("--noise-scale", help="Factor on the noise of a simulated log.")
]
OutOption = Annotated[
    Path | None,
    typer.Option(
        "--out",
        metavar="DIR",
        help="Folder to write [default: slamcheck-LOG, or slamcheck-COMMAND-LOG].",
    ),
]
FilterOption = Annotated[
    str,
    typer.Option(
        "--filter",
        metavar="full|compressed|compressed-suboptimal|misono|misono-full",
        help="Which EKF. [default: full]",
        show_default=False,
    ),
]
AssociationOption = Annotated[
    str | None,
    typer.Option(
        metavar="known|nn|jcbb|euclidean|agreed",
        help="The log's labels, nearest neighbour, joint compatibility, distance in metres, or "
        "only what all likely hypotheses agree on.",
    ),
]
SolveAssociationOption = Annotated[
    str | None,
    typer.Option(
        "--association",
        metavar="known|own",
        help="The log's labels, or the smoother's own reasoning.",
    ),
]
SmootherAssociationOption = Annotated[
    str,
    typer.Option(
        metavar="ekf|own",
        help="Own: solve for a second time, with the smoother's own association.",
    ),
]
SmootherMatcherOption = Annotated[
    str,
    typer.Option(
        metavar="ekf|own",
        help="Own: solve for a second time, scan landmarks seen by Open3D's generalised ICP.",
    ),
]
FeaturesOption = Annotated[
    str, typer.Option(metavar="log|trees", help="The log's sightings, or trunks in its scans.")
]
AttributesOption = Annotated[
    str,
    typer.Option(
        metavar="off|on|layer",
        help="On: diameters and intensities tell landmarks apart, too (nn and jcbb); layer: the "
        "intensities of raw scans around them, from the dense map.",
    ),
]
GpsOption = Annotated[
    str, typer.Option(metavar="off|on|half", help="Fuse positions; half holds every second back.")
]
MotionOption = Annotated[
    str,
    typer.Option(
        metavar="wheel|scan|both",
        help="What moves both estimators: the log's odometry or its scans; both adds a third "
        "estimate, the smoother on scans, to the two on wheels.",
    ),
]
GuessOption = Annotated[
    str, typer.Option(metavar="wheels|none", help="Where the alignment of a scan begins.")
]
LoopClosureOption = Annotated[
    str, typer.Option("--loop-closure", metavar="on|off", help="Look for places seen before.")
]
MatcherOption = Annotated[
    str,
    typer.Option(
        metavar="surface|kiss|point-to-point|point-to-plane|generalised",
        help="What lays scans together for loop closure; the last three are Open3D's.",
    ),
]
CloudOption = Annotated[
    str | None,
    typer.Option(metavar="pcd|ply", help="Write the map as a cloud, too; needs Open3D."),
]
LayerOption = Annotated[
    list[str],
    typer.Option(
        "--layer", metavar="points|occupancy|particles|sog|values", help="May be repeated."
    ),
]
ResolutionOption = Annotated[
    float, typer.Option(metavar="M", help="Size of cells in metres, of grids and pictures.")
]
EstimateOption = Annotated[
    Path,
    typer.Option(
        "--estimate",
        metavar="FOLDER|FILE",
        help="A trajectory (TUM, KITTI, CSV), or a folder with trajectory.tum and, if there are "
        "any, landmarks.csv, covariances.npz, estimate.toml, trace.npz.",
    ),
]
TimesOption = Annotated[
    Path | None,
    typer.Option(
        "--times", metavar="FILE", help="Times of a KITTI file, else times.txt beside it."
    ),
]
TraceOption = Annotated[
    bool, typer.Option("--trace", help="Write ekf/trace.npz: what the EKF linearised where.")
]
DynamicOption = Annotated[
    str,
    typer.Option(
        "--dynamic",
        metavar="off|on",
        help="On: find where things move in the scans, and keep the filter from going by these.",
    ),
]
DynamicLayerOption = Annotated[
    bool,
    typer.Option(
        "--dynamic",
        help="Find where things move, keep the filter from going by these, and write that layer.",
    ),
]
DenseOption = Annotated[
    list[str],
    typer.Option(
        "--dense",
        metavar="points|occupancy|particles|sog|values",
        help="Keep this layer of a dense map and hold it against the smoother's; may be repeated.",
    ),
]
FuseLandmarksOption = Annotated[
    str,
    typer.Option(
        "--fuse-landmarks",
        metavar="off|on",
        help="On: scan landmarks that turn out to be one are fused, templates and all.",
    ),
]
HighLevelOption = Annotated[
    str,
    typer.Option(
        "--high-level",
        metavar="off|on",
        help="On: landmarks made of what stands in the filter's dense map, seen in the scans.",
    ),
]
HighLevelCellOption = Annotated[
    float,
    typer.Option(
        "--high-level-cell", metavar="M", help="Cells of its map, which Gaussians are apart by."
    ),
]
HighLevelPairOption = Annotated[
    float,
    typer.Option("--high-level-pair", metavar="M", help="Greatest distance of two corners of one."),
]
HighLevelLeastOption = Annotated[
    int, typer.Option("--high-level-least", metavar="N", help="Gaussians that one must have.")
]
HighLevelEveryOption = Annotated[
    float, typer.Option("--high-level-every", metavar="S", help="Seconds between two searches.")
]
FiguresOption = Annotated[
    list[str],
    typer.Option(
        "--figures",
        metavar="png|pdf",
        help="Write the pictures as PDF, too, with pdf; png, which is always written, alone.",
    ),
]
LiveOption = Annotated[
    bool, typer.Option("--live", help="Then replay the run in rerun's viewer; needs rerun.")
]
RecordOption = Annotated[
    Path | None,
    typer.Option(metavar="FILE.rrd", help="Write that replay to a file for the viewer."),
]
LandmarksOption = Annotated[
    str,
    typer.Option(
        metavar="points|scans|both",
        help="The log's sightings, pieces of its raw scans (Scan-SLAM), or both.",
    ),
]
PiecesOption = Annotated[
    str | None,
    typer.Option(
        metavar="joined|single",
        help="Whether all segments of a scan become one landmark, or each its own; usually joined, "
        "but single where a dense map hangs on them.",
    ),
]
TemplatesOption = Annotated[
    str,
    typer.Option(
        metavar="bare|enriched",
        help="Enriched: what the dense map holds around a scan landmark says where it is sought "
        "while the vehicle is uncertain.",
    ),
]
