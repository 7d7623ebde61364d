"""The command line's options as data: each names the field of the configuration that it sets.

Nothing heavy is imported here, for help must be quick. What is given on the command line lies over
a configuration file, and that over the defaults. Only flags that are given count, so that a flag
can also take a file's value back.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, get_args

from comparisons import choices
from comparisons.errors import InputError

ABSENT = None
"""A setting that takes its section away."""
FILTER_PANEL, SMOOTHER_PANEL, SCAN_PANEL = "Filter", "Smoother", "Scans and dense maps"
LOG_PANEL, REPORT_PANEL = "Log", "Report"
_SWITCH: Mapping[Any, Any] = {True: {}, False: ABSENT}
"""Of an extension that is there or not."""


class Where(NamedTuple):
    """Where a setting has an effect: a field of the configuration has a value, in words."""

    field: str
    value: Any
    words: str


@dataclass(frozen=True, kw_only=True)
class Flag:
    """One option.

    field: dotted path in the configuration. choices: a Literal, in place of a kind. many: may be
    repeated. settings: what each choice stands for, ABSENT to take the field away; without it
    the value itself. within: what must be asked for as well, for a field of a section that the
    flag alone does not add; neutral: the choice that is the default there, and needs nothing.
    where: where another value than the default has an effect; see check_applies. panel: of the
    help that lists it; empty for what people use first. off: a switch that has a --no- form, too.
    """

    option: str
    field: str
    help: str
    kind: type = str
    metavar: str | None = None
    choices: Any = None
    many: bool = False
    settings: Mapping[Any, Any] | None = None
    within: str = ""
    neutral: Any = ""
    where: Where | None = None
    panel: str = ""
    off: bool = False

    @property
    def words(self) -> tuple[str, ...]:
        """Its choices."""
        return get_args(self.choices)

    @property
    def name(self) -> str:
        """As a parameter of the command's function."""
        return self.option.lstrip("-").replace("-", "_") + "_"

    def lay_over(self, config: dict[str, Any], value: Any) -> None:
        """Put a value that was given into nested mappings. Raises InputError."""
        if self.settings is not None and value not in self.settings:
            known = " or ".join(map(str, self.settings))
            raise InputError(f"{self.option} is {value!r}, expected {known}")
        section, _, key = self.field.rpartition(".")
        if self.within and _below(config, section) is None:
            if value == self.neutral:
                return
            given = self.option if value is True else f"{self.option} {value}"
            raise InputError(f"{given} goes with {self.within}")
        into = config
        for part in section.split(".") if section else ():
            into = into.setdefault(part, {})
        found = value if self.settings is None else self.settings[value]
        if self.settings is not None and found is ABSENT:
            into.pop(key, None)
        elif isinstance(found, Mapping) and isinstance(into.get(key), dict):
            into[key].update(found)
        else:
            into[key] = dict(found) if isinstance(found, Mapping) else found

    def read(self, config: Mapping[str, Any]) -> tuple[Any, frozenset[str]]:
        """Return the value that nested mappings have, None for none, and the paths it stands at."""
        found = _below(config, self.field)
        if self.settings is None:
            return found, frozenset({self.field})
        for value, stands_for in self.settings.items():
            if isinstance(found, Mapping) and isinstance(stands_for, Mapping):
                if stands_for.items() <= found.items():
                    below = (f"{self.field}.{key}" for key in stands_for)
                    return value, frozenset({self.field, *below})
            elif stands_for == found is not ABSENT:
                return value, frozenset({self.field})
        return None, frozenset()


# fmt: off
PRESET = Flag(
    option="--preset", field="preset", choices=choices.Preset,
    help="Settings where none is given: ours, or those that a document states at its values "
    "(docs/settings.md); over a file, what was set beside its preset stays. [recommended]",
)
LOG = (
    PRESET,
    Flag(
        option="--format", panel=LOG_PANEL, field="log.format", metavar="F",
        help="The log's format; recognised if left out.",
    ),
    Flag(
        option="--robot", panel=LOG_PANEL, field="log.robot", kind=int,
        help="Robot number, for MR.CLAM folders. [1]",
    ),
    Flag(
        option="--topic", panel=LOG_PANEL, field="log.topics", metavar="NAME", many=True,
        help="Topic of a ROS bag to read; may be repeated. [of each type the one with most "
        "messages]",
    ),
    Flag(
        option="--start", panel=LOG_PANEL, field="log.start_s", kind=float, metavar="S",
        help="Leave out the log's first seconds. [0]",
    ),
    Flag(
        option="--end", panel=LOG_PANEL, field="log.end_s", kind=float, metavar="S",
        help="Leave out what lies so many seconds after the log's start and later. [its end]",
    ),
    Flag(
        option="--seed", panel=LOG_PANEL, field="log.seed", kind=int,
        help="Seed of a simulated log. [0]",
    ),
    Flag(
        option="--loops", panel=LOG_PANEL, field="log.loops", kind=int,
        help="Loops of a simulated log. [1]",
    ),
    Flag(
        option="--noise-scale", panel=LOG_PANEL, field="log.noise_scale", kind=float,
        help="Factor on the noise of a simulated log, added and stated. [1]",
    ),
)
FEATURES = Flag(
    option="--features", panel=FILTER_PANEL, field="log.features", choices=choices.Features,
    help="Measurements: the log's, or trunks found in its scans. [log]",
)
_GPS_HELP = "Fuse absolute positions; half holds every second one back. [off]"
GPS = Flag(option="--gps", field="gps", choices=choices.Gps, help=_GPS_HELP)
FRONT_END_GPS = Flag(option="--gps", field="front_end.gps", choices=choices.Gps, help=_GPS_HELP)
EKF = (
    Flag(option="--filter", field="ekf.filter", choices=choices.Filter, help="Which EKF. [full]"),
    Flag(
        option="--association", field="ekf.association", choices=choices.Association,
        help="The log's labels, nearest neighbour, joint compatibility, distance in metres, or "
        "only what all likely hypotheses agree on. [known where the log has labels, else nn]",
    ),
    Flag(option="--gps", field="ekf.gps", choices=choices.Gps, help=_GPS_HELP),
    FEATURES,
)
ATTRIBUTES = Flag(
    option="--attributes", panel=FILTER_PANEL, field="ekf.attributes", choices=choices.Attributes,
    help="Let diameters and intensities tell landmarks apart, too (nn and jcbb); layer: "
    "intensities of the scans around them, from a dense map. [off]",
)
SOLVER_ASSOCIATION = Flag(
    option="--association", field="association", choices=choices.SolverAssociation,
    help="The log's labels, or the smoother's own association.",
)
ROBUST = Flag(
    option="--robust", panel=SMOOTHER_PANEL, field="smoother.robust", choices=choices.Robust,
    help="Kernel against outliers in the smoother; changes its marginals. [none]",
)
ACCEPT_MISFIT = Flag(
    option="--accept-misfit", panel=SMOOTHER_PANEL, field="smoother.accept_misfit", kind=bool,
    help="Verify the lowest minimum even where its chi-square is too high.",
)
SMOOTHER = (
    Flag(
        option="--smoother", panel=SMOOTHER_PANEL, field="smoother.method", choices=choices.Method,
        help="How the smoother works. [batch]",
    ),
    Flag(
        option="--lag", panel=SMOOTHER_PANEL, field="smoother.lag",
        kind=int, help="Poses that a fixed lag holds. [100]",
        where=Where("smoother.method", "fixed-lag", "--smoother fixed-lag"),
    ),
    Flag(
        option="--optimiser", panel=SMOOTHER_PANEL, field="smoother.optimiser",
        choices=choices.Optimiser,
        help="Of the batch smoother. [levenberg-marquardt]",
        where=Where("smoother.method", "batch", "--smoother batch"),
    ),
    ROBUST,
    ACCEPT_MISFIT,
)
_LANDMARKS = "--landmarks scans or both"
SCAN_LANDMARKS = (
    Flag(
        option="--landmarks", field="extensions.scan_landmarks", choices=choices.Landmarks,
        settings={"points": ABSENT, "scans": {"landmarks": "scans"}, "both": {"landmarks": "both"}},
        help="Landmarks: the log's measurements, templates of its raw scans (Scan-SLAM), or both. "
        "[points]",
    ),
    Flag(
        option="--pieces", panel=SCAN_PANEL, field="extensions.scan_landmarks.pieces",
        choices=choices.Pieces,
        within=_LANDMARKS,
        help="All segments of a scan make one scan landmark, or each its own. [joined, but single "
        "where a dense map is anchored to them]",
    ),
    Flag(
        option="--templates", panel=SCAN_PANEL, field="extensions.scan_landmarks.templates",
        choices=choices.Templates, within=_LANDMARKS, neutral="bare",
        help="Enriched: align scan landmarks with what the dense map holds around, too. [bare]",
    ),
)
RESOLUTION = Flag(
    option="--resolution", panel=SCAN_PANEL, field="extensions.dense_maps.resolution_m",
    kind=float, metavar="M",
    help="Size of the dense map's cells in metres. [0.2]",
)
_DENSE_HELP = "Keep this layer of a dense map and compare it with the smoother's; may be repeated."
RUN_EXTENSIONS = (
    *SCAN_LANDMARKS,
    Flag(
        option="--fuse-landmarks", panel=SCAN_PANEL, field="extensions.scan_landmarks.fuse",
        kind=bool, off=True,
        within=_LANDMARKS, neutral=False,
        help="Fuse scan landmarks that turn out to be one. [off]",
    ),
    Flag(
        option="--motion", field="extensions.scan_motion", choices=choices.Motion,
        settings={"wheel": ABSENT, "scan": {"motion": "scan"}, "both": {"motion": "both"}},
        help="What moves both estimators: the odometry or the scans; both adds a third estimate, "
        "the smoother on scans. [wheel]",
    ),
    Flag(
        option="--smoother-association", panel=SMOOTHER_PANEL, field="extensions.own_association",
        choices=choices.Peer,
        settings={"ekf": {"when": "never"}, "own": {"when": "always"}},
        help="Own: solve for a second time, with the smoother's own association. [own where the "
        "log has neither labels nor truth and this costs less than the run, else ekf]",
    ),
    Flag(
        option="--smoother-matcher", panel=SMOOTHER_PANEL, field="extensions.own_matching",
        choices=choices.Peer,
        settings={"ekf": ABSENT, "own": {}},
        help="Own: solve for a second time, scan landmarks aligned by Open3D's generalised ICP. "
        "[ekf]",
    ),
    Flag(
        option="--dense", field="extensions.dense_maps.layers", choices=choices.Layer, many=True,
        help=_DENSE_HELP,
    ),
    RESOLUTION,
    Flag(
        option="--dynamic", panel=SCAN_PANEL, field="extensions.dynamic",
        kind=bool, off=True, settings=_SWITCH,
        help="Find where things move in the scans, and let the filter ignore these places. [off]",
    ),
    Flag(
        option="--high-level", panel=SCAN_PANEL, field="extensions.high_level",
        kind=bool, off=True, settings=_SWITCH,
        help="Landmarks made of what stands in the filter's dense map. [off]",
    ),
)
FAIL_ON = Flag(
    option="--fail-on", panel=REPORT_PANEL, field="fail_on", metavar="WHAT,...",
    help="Exit with 1 on these: disagreement (always does), consistency (NEES, NIS or filter "
    "against smoother outside their bands), both (of these), truth (the smoother is far from it), "
    "association (nobody has checked it).",
)
REPORT = (
    Flag(
        option="--figures", panel=REPORT_PANEL, field="report.figures",
        choices=choices.PictureFormat, many=True,
        help="Write the pictures as PDF as well, with pdf; PNG is always written.",
    ),
    Flag(
        option="--trace", panel=REPORT_PANEL, field="report.trace", kind=bool,
        help="Write ekf/trace.npz: what the EKF linearised where.",
    ),
)
REQUIRE = Flag(
    option="--require", field="require", choices=choices.RequiredGrade,
    help="Least grade that exits with 0: equal to the reference EKF, like it (5 %), or as near "
    "to the optimum as that is certain. [like where estimate.toml says estimator = \"ekf\", "
    "else plausible]",
)
MIN_COVERAGE = Flag(
    option="--min-coverage", field="min_coverage", kind=float, metavar="SHARE",
    help="Least share of the log's time that the estimate covers; one that covers less disagrees. "
    "[0.95]",
)
ESTIMATE = (
    Flag(
        option="--estimate", field="estimate", metavar="FOLDER|FILE",
        help="A trajectory (TUM, KITTI, CSV), or a folder with trajectory.tum and, if there are "
        "any, landmarks.csv, covariances.npz, estimate.toml, trace.npz.",
    ),
    Flag(
        option="--times", field="times", metavar="FILE",
        help="Times of a KITTI file, else times.txt beside it.",
    ),
    REQUIRE,
    MIN_COVERAGE,
)
CLOUD = Flag(
    option="--cloud", field="cloud", choices=choices.CloudFormat,
    help="Write the map as a cloud as well; needs Open3D.",
)
FRONT_END = (
    Flag(
        option="--guess", field="front_end.guess", choices=choices.Guess,
        help="Where the alignment of a scan starts. [wheels]",
    ),
    Flag(
        option="--loop-closure", field="front_end.loop_closure", kind=bool, off=True,
        help="Look for places seen before. [on]",
    ),
    Flag(
        option="--matcher", field="front_end.matcher", choices=choices.LoopMatcher,
        help="What aligns scans for loop closure; the last three are Open3D's. [surface]",
        where=Where("front_end.loop_closure", True, "--loop-closure"),
    ),
    FRONT_END_GPS,
    CLOUD,
)
MAP = (
    Flag(
        option="--layer", field="extensions.dense_maps.layers", choices=choices.Layer, many=True,
        help="Layer to keep; may be repeated. [occupancy]",
    ),
    RESOLUTION,
    Flag(
        option="--dynamic", panel=SCAN_PANEL, field="extensions.dynamic",
        kind=bool, off=True, settings=_SWITCH,
        help="Find where things move, let the filter ignore these places, and write that layer.",
    ),
    *SCAN_LANDMARKS,
    CLOUD,
)
# fmt: on
RUN = (*EKF, ATTRIBUTES, *RUN_EXTENSIONS, *SMOOTHER, *LOG, FAIL_ON, *REPORT)
CHECK = (*ESTIMATE, SOLVER_ASSOCIATION, FEATURES, GPS, ROBUST, ACCEPT_MISFIT, *LOG)
FLAGS = (*RUN, SOLVER_ASSOCIATION, GPS, *ESTIMATE, *FRONT_END, *MAP)
"""Every command's."""


def lay_over(config: dict[str, Any], flags: Sequence[tuple[Flag, Any]]) -> None:
    """Put flags that were given over nested mappings, sections before what lies within them."""
    for flag, value in sorted(flags, key=lambda one: bool(one[0].within)):
        flag.lay_over(config, value)


def check_applies(config: Mapping[str, Any], usual: Mapping[str, Any]) -> None:
    """Raise InputError for a setting that is not the usual one and has no effect beside the rest.

    config, usual: whole configurations of one job as nested mappings, the latter all defaults.
    """
    for flag in FLAGS:
        value = _below(config, flag.field)
        if flag.where is None or value == _below(usual, flag.field):
            continue
        if _below(config, flag.where.field) != flag.where.value:
            raise InputError(f"{flag.option} {value} goes with {flag.where.words}")


def options(table: Iterable[Flag], values: Mapping[str, Any]) -> list[tuple[Flag, Any]]:
    """Return flags with values by their options' names, as `filter` or `smoother_association`.

    Raises InputError for a name that no flag of the table has.
    """
    known = {flag.name.rstrip("_"): flag for flag in table}
    for name in values:
        if name not in known:
            raise InputError(f"option {name}: is unknown, expected some of {', '.join(known)}")
    return [(known[name], value) for name, value in values.items()]


def _below(config: Mapping[str, Any], path: str) -> Any:
    found: Any = config
    for part in path.split("."):
        found = found.get(part) if isinstance(found, Mapping) else None
    return found
