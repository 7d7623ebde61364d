"""The command line's options as data: each names the field of the configuration that it sets.

Nothing heavy is imported here, for help must be quick. What is given on the command line lies over
a configuration file, and that over the defaults. Only flags that are given count, so that a flag
can also take a file's value back.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from typing import Any, NamedTuple, get_args

from comparisons import choices
from comparisons.errors import InputError, note

ABSENT = None
"""A setting that takes its section away."""
ESTIMATORS, SCANS = "Estimators", "Scans and dense maps"
GRADE, FRONT_END_PANEL, JOB = "Estimate", "Scan front end", "Log, settings and report"
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
    where: where another value than the default has an effect; see check_applies. help: a line for
    `--help`, the default in brackets; empty where no command lists the option. `slamcheck config`
    describes every option by its field. panel: of the help. off: a switch that has a --no- form.
    """

    option: str
    field: str
    help: str = ""
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


@dataclass(frozen=True, kw_only=True)
class Renamed:
    """An earlier spelling, which is read for one release.

    field: of the configuration, as it is now. was_field: empty where it is the same. option,
    was_option: the same of the command line. values: earlier values and what they are now.
    """

    field: str
    option: str
    was_field: str = ""
    was_option: str = ""
    values: Mapping[Any, Any] = dataclass_field(default_factory=dict)


_SCAN_LANDMARKS = "extensions.scan_landmarks"
# fmt: off
RENAMED = (
    Renamed(field="ekf.association", option="--association", values={"agreed": "consensus"}),
    Renamed(
        field=f"{_SCAN_LANDMARKS}.template_extraction", was_field=f"{_SCAN_LANDMARKS}.pieces",
        option="--template-extraction", was_option="--pieces",
        values={"joined": "whole-scan", "single": "per-segment"},
    ),
    Renamed(
        field=f"{_SCAN_LANDMARKS}.merge_landmarks", was_field=f"{_SCAN_LANDMARKS}.fuse",
        option="--merge-landmarks", was_option="--fuse-landmarks",
    ),
    Renamed(
        field="extensions.own_matching", option="--smoother-matcher",
        values={"own": "generalised-icp"},
    ),
)
"""Every earlier spelling, of the command line, of `config.toml` and of Python."""

UNUSED = {
    "extensions.dense_maps.attribute_values": False,
    f"{_SCAN_LANDMARKS}.map_aided_matching": False,
    f"{_SCAN_LANDMARKS}.templates": "bare",
}
"""Settings that there were, with the value of one that was not used, as earlier files have it."""

PRESET = Flag(option="--preset", field="preset", choices=choices.Preset)
LOG = (
    PRESET,
    Flag(
        option="--format", panel=JOB, field="log.format", metavar="NAME",
        help="Format of the log, named as in `slamcheck logs`. [recognised]",
    ),
    Flag(
        option="--robot", panel=JOB, field="log.robot", kind=int, metavar="N",
        help="Robot number in an MR.CLAM folder. [1]",
    ),
    Flag(
        option="--topic", panel=JOB, field="log.topics", metavar="NAME", many=True,
        help="Topic of a ROS bag to read; repeat it for several. [per message type, the topic "
        "with most messages]",
    ),
    Flag(
        option="--start", panel=JOB, field="log.start_s", kind=float, metavar="S",
        help="Skip the first S seconds of the log. [0]",
    ),
    Flag(
        option="--end", panel=JOB, field="log.end_s", kind=float, metavar="S",
        help="Stop S seconds after the log's start. [its end]",
    ),
    Flag(
        option="--seed", panel=JOB, field="log.seed", kind=int, metavar="N",
        help="Random seed of a simulated log. [0]",
    ),
    Flag(
        option="--loops", panel=JOB, field="log.loops", kind=int, metavar="N",
        help="Number of loops of a simulated log. [1]",
    ),
    Flag(
        option="--noise-scale", panel=JOB, field="log.noise_scale", kind=float, metavar="X",
        help="Factor on the noise of a simulated log and on its stated sigmas. [1]",
    ),
)
FEATURES = Flag(option="--features", field="log.features", choices=choices.Features)
_GPS_HELP = "GPS: off, on, or half (hold out every second one). [off]"
GPS = Flag(
    option="--gps", field="gps", choices=choices.Gps, help=_GPS_HELP, panel=ESTIMATORS
)
FRONT_END_GPS = Flag(
    option="--gps", field="front_end.gps", choices=choices.Gps, help=_GPS_HELP,
    panel=FRONT_END_PANEL,
)
EKF = (
    Flag(
        option="--filter", field="ekf.filter", choices=choices.Filter, panel=ESTIMATORS,
        help="EKF variant: full, compressed, compressed-suboptimal, misono (direction cosines) or "
        "misono-full. [full]",
    ),
    Flag(
        option="--association", field="ekf.association", choices=choices.Association,
        panel=ESTIMATORS,
        help="Association: known (labels), nn (nearest neighbour), jcbb (joint compatibility "
        "branch and bound), euclidean, consensus (of all likely hypotheses). [known, else nn]",
    ),
    Flag(
        option="--gps", field="ekf.gps", choices=choices.Gps, help=_GPS_HELP, panel=ESTIMATORS
    ),
    FEATURES,
)
ATTRIBUTES = Flag(option="--attributes", field="ekf.attributes", choices=choices.Attributes)
SOLVER_ASSOCIATION = Flag(
    option="--association", field="association", choices=choices.SolverAssociation,
    panel=ESTIMATORS,
    help="Association: known (labels) or own (found by the smoother). [known, else own]",
)
ROBUST = Flag(
    option="--robust", panel=ESTIMATORS, field="smoother.robust", choices=choices.Robust,
    help="Robust smoother kernel: none, huber, cauchy, gnc. [none]",
)
ACCEPT_MISFIT = Flag(option="--accept-misfit", field="smoother.accept_misfit", kind=bool)
SMOOTHER = (
    Flag(
        option="--smoother", panel=ESTIMATORS, field="smoother.method", choices=choices.Method,
        help="Method: batch, isam2 (incremental) or fixed-lag. [batch]",
    ),
    Flag(
        option="--lag", field="smoother.lag", kind=int,
        where=Where("smoother.method", "fixed-lag", "--smoother fixed-lag"),
    ),
    Flag(
        option="--optimiser", field="smoother.optimiser", choices=choices.Optimiser,
        where=Where("smoother.method", "batch", "--smoother batch"),
    ),
    ROBUST,
    ACCEPT_MISFIT,
)
_LANDMARKS = "--landmarks scans or both"
SCAN_LANDMARKS = (
    Flag(
        option="--landmarks", field=_SCAN_LANDMARKS, choices=choices.Landmarks, panel=SCANS,
        settings={"points": ABSENT, "scans": {"landmarks": "scans"}, "both": {"landmarks": "both"}},
        help="Landmarks: points (of the log), scans (templates of laser scans, Scan-SLAM), or "
        "both. [points]",
    ),
    Flag(
        option="--template-extraction", field=f"{_SCAN_LANDMARKS}.template_extraction",
        choices=choices.TemplateExtraction, within=_LANDMARKS,
    ),
)
RESOLUTION = Flag(
    option="--resolution", panel=SCANS, field="extensions.dense_maps.resolution_m",
    kind=float, metavar="M", help="Cell size of the dense map in metres. [0.2]",
)
DYNAMIC = Flag(
    option="--dynamic", panel=SCANS, field="extensions.dynamic", kind=bool, off=True,
    settings=_SWITCH,
    help="Detect moving objects and exclude them from the filter. [off]",
)
RUN_EXTENSIONS = (
    *SCAN_LANDMARKS,
    Flag(
        option="--merge-landmarks", field=f"{_SCAN_LANDMARKS}.merge_landmarks",
        kind=bool, off=True, within=_LANDMARKS, neutral=False,
    ),
    Flag(
        option="--motion", field="extensions.scan_motion", choices=choices.Motion, panel=SCANS,
        settings={"wheel": ABSENT, "scan": {"motion": "scan"}, "both": {"motion": "both"}},
        help="Motion: wheel (odometry), scan (scan matching), or both (scan matching as a third "
        "estimate). [wheel]",
    ),
    Flag(
        option="--smoother-association", field="extensions.own_association",
        choices=choices.Peer, settings={"ekf": {"when": "never"}, "own": {"when": "always"}},
    ),
    Flag(
        option="--smoother-matcher", field="extensions.own_matching",
        choices=choices.SmootherMatcher, settings={"ekf": ABSENT, "generalised-icp": {}},
    ),
    Flag(
        option="--posterior", field="extensions.posterior",
        choices=choices.Posterior, settings={"none": ABSENT, "samples": {}},
    ),
    Flag(
        option="--dense", field="extensions.dense_maps.layers", choices=choices.Layer, many=True,
        panel=SCANS,
        help="Dense map layer (repeatable): points, occupancy, particles or sog (sum of "
        "Gaussians).",
    ),
    RESOLUTION,
    DYNAMIC,
    Flag(
        option="--high-level", field="extensions.high_level", kind=bool, off=True,
        settings=_SWITCH,
    ),
    Flag(
        option="--third", field="extensions.fastslam", choices=choices.Third, panel=ESTIMATORS,
        settings={"none": ABSENT, "fastslam": {}},
        help="Third estimator: fastslam (clouds of particles beside filter and smoother). [none]",
    ),
)
FAIL_ON = Flag(
    option="--fail-on", panel=JOB, field="fail_on", metavar="WHAT,...",
    help="Exit 1 also on: consistency (filter inconsistent), truth (smoother far off), "
        "association (unchecked).",
)
REPORT = (
    Flag(
        option="--figures", field="report.figures", choices=choices.PictureFormat, many=True,
    ),
    Flag(option="--trace", field="report.trace", kind=bool),
)
REQUIRE = Flag(
    option="--require", field="require", choices=choices.RequiredGrade, panel=GRADE,
    help="Lowest grade that exits with 0: equal, like (within 5 %) or plausible. [like for an "
    "EKF, else plausible]",
)
MIN_COVERAGE = Flag(
    option="--min-coverage", field="min_coverage", kind=float, metavar="SHARE", panel=GRADE,
    help="Least share of the log's duration that the estimate must cover. [0.95]",
)
ESTIMATE = (
    Flag(
        option="--estimate", field="estimate", metavar="PATH", panel=GRADE,
        help="Trajectory (TUM, KITTI, CSV) or estimate folder (docs/formats.md).",
    ),
    Flag(
        option="--times", field="times", metavar="FILE", panel=GRADE,
        help="Time stamps of a KITTI trajectory. [times.txt beside it]",
    ),
    REQUIRE,
    MIN_COVERAGE,
)
TRACE = Flag(
    option="--trace", field="trace", metavar="FILE", panel=GRADE,
    help="What the filter did, recorded. [filter.trace in the estimate's folder]",
)
CLOUD = Flag(
    option="--cloud", field="cloud", choices=choices.CloudFormat, panel=JOB,
    help="Write the map as point cloud: pcd, ply (Open3D).",
)
FRONT_END = (
    Flag(
        option="--guess", field="front_end.guess", choices=choices.Guess, panel=FRONT_END_PANEL,
        help="Initial guess of scan matching: wheels (wheel odometry) or none. [wheels]",
    ),
    Flag(
        option="--loop-closure", field="front_end.loop_closure", kind=bool, off=True,
        panel=FRONT_END_PANEL, help="Detect loop closures and add them to the pose graph. [on]",
    ),
    Flag(
        option="--matcher", field="front_end.matcher", choices=choices.LoopMatcher,
        panel=FRONT_END_PANEL,
        help="Scan matcher of loop closure: surface, kiss, point-to-point, point-to-plane or "
        "generalised. [surface]",
        where=Where("front_end.loop_closure", True, "--loop-closure"),
    ),
    FRONT_END_GPS,
    CLOUD,
)
MAP = (
    Flag(
        option="--layer", field="extensions.dense_maps.layers", choices=choices.Layer, many=True,
        panel=SCANS,
        help="Map layer (repeatable): points, occupancy, particles or sog (sum of Gaussians). "
        "[occupancy]",
    ),
    RESOLUTION,
    DYNAMIC,
    *SCAN_LANDMARKS,
    CLOUD,
)
# fmt: on
RUN = (*EKF, ATTRIBUTES, *RUN_EXTENSIONS, *SMOOTHER, *LOG, FAIL_ON, *REPORT)
CHECK = (*ESTIMATE, TRACE, SOLVER_ASSOCIATION, FEATURES, GPS, ROBUST, ACCEPT_MISFIT, *LOG)
FLAGS = (*RUN, SOLVER_ASSOCIATION, GPS, *ESTIMATE, TRACE, *FRONT_END, *MAP)
"""Every command's."""


def renamed_settings(config: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Return nested mappings with earlier keys and values as they are now, and notes of it.

    A key that stands beside its earlier spelling is kept, one that is gone and was not used is not.
    """
    found, notes = dict(config), list[str]()
    for one in RENAMED:
        section, _, key = one.field.rpartition(".")
        was = (one.was_field or one.field).rpartition(".")[2]
        old = _below(config, section)
        if not isinstance(old, Mapping) or was not in old:
            continue
        value = old[was]
        new = one.values.get(value, value) if isinstance(value, str) else value
        if was == key and new == value:
            continue
        into = _copied(found, section)
        del into[was]
        into.setdefault(key, new)
        place = section.removeprefix("extensions.")
        notes.append(f"{place}.{was} = {_toml(value)} is now {place}.{key} = {_toml(new)}")
    for path, unused in UNUSED.items():
        section, _, key = path.rpartition(".")
        if _below(found, path) == unused:
            del _copied(found, section)[key]
    return found, notes


def renamed_words(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return a command line's words with earlier options and values as they are now, and notes."""
    found, notes, rest = list[str](), list[str](), list(words)
    while rest:
        word = rest.pop(0)
        if word == "--":
            return [*found, word, *rest], notes
        option, equals, value = word.partition("=")
        one = next((r for r in RENAMED if option in _earlier(r)), None)
        if one is None:
            found.append(word)
            continue
        given = [option]
        if one.values and (equals or rest):
            given.append(value if equals else rest.pop(0))
        now = [f"--no-{one.option[2:]}" if option.startswith("--no-") else one.option]
        if len(given) > 1:
            now.append(one.values.get(given[1], given[1]))
        if now != given:
            notes.append(f"{' '.join(given)} is now {' '.join(now)}")
        found += now
    return found, notes


def _earlier(one: Renamed) -> tuple[str, ...]:
    """Return the options that may be spelt as they were."""
    was = one.was_option
    return (was, f"--no-{was[2:]}") if was else (one.option,)


def _copied(config: dict[str, Any], section: str) -> dict[str, Any]:
    """Return a section of nested mappings, copied there and on the way to it."""
    for name in section.split("."):
        config[name] = dict(config[name])
        config = config[name]
    return config


def _toml(value: Any) -> str:
    return f'"{value}"' if isinstance(value, str) else str(value).lower()


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

    Earlier names and values are read, with a note. Raises InputError for a name that no flag of
    the table has.
    """
    known = {flag.name.rstrip("_"): flag for flag in table}
    found = []
    for name, value in values.items():
        option = f"--{name.replace('_', '-')}"
        now, new = option, value
        for one in RENAMED:
            if option == (one.was_option or one.option):
                now = one.option
                new = one.values.get(value, value) if isinstance(value, str) else value
        flag = known.get(now[2:].replace("-", "_"))
        if flag is None:
            raise InputError(f"option {name}: is unknown, expected some of {', '.join(known)}")
        if (now, new) != (option, value):
            note(f"{name}={value!r} is now {flag.name.rstrip('_')}={new!r}")
        found.append((flag, new))
    return found


def _below(config: Mapping[str, Any], path: str) -> Any:
    found: Any = config
    for part in path.split("."):
        found = found.get(part) if isinstance(found, Mapping) else None
    return found
