"""Everything that decides a job, as data: validated, written to TOML, read back, run again.

A job's configuration has sections (`log`, `ekf`, `smoother`, ...) and, under `extensions`, one
section for each extension that takes part. An extension that is not named is not imported.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from pkgutil import resolve_name
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar, cast, get_args, get_origin

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    SerializeAsAny,
    ValidationError,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from comparisons.documented.row import PRESETS, Preset
from comparisons.errors import InputError, quoted, shorten
from comparisons.extension_names import EXTENSIONS
from comparisons.options import ESTIMATORS, FRONT_END, GRADE, JOB, Option, Where

Filter = Literal["full", "compressed", "compressed-suboptimal", "misono", "misono-full"]
Gps = Literal["off", "on", "half"]
RequiredGrade = Literal["equal", "like", "plausible"]
FailOn = Literal["disagreement", "consistency", "both", "truth", "association", "positions"]
Needs = Mapping[str, Mapping[str, Any]]
"""Extensions that must take part, with the fields that they must have."""


_LARGEST = 2**64 - 1
"""Of whole numbers in a file of settings."""
T = TypeVar("T")


def setting(default: T, about: str, *options: Option, **bounds: Any) -> T:
    """Return a field of a section, for its class.

    about: its meaning. options: of the command line, where it has any. bounds: as pydantic's Field
    takes them.
    """
    field: Any = Field(default, description=about, **bounds)
    field.metadata.extend(options)
    return cast("T", field)


class SettingsGroup(BaseModel):
    """A group of settings. Unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, ser_json_inf_nan="strings")

    @field_validator("*")
    @classmethod
    def _representable(cls, value: Any) -> Any:
        """Refuse whole numbers that no file of settings can hold: Python spells no larger ones."""
        if isinstance(value, int) and abs(value) > _LARGEST:
            raise PydanticCustomError("too_large", "input should be below 2^64")
        return value

    @classmethod
    def of(cls, /, **fields: Any) -> Self:
        """Validate fields, sections given as mappings.

        Raises InputError that names key and choices.
        """
        try:
            return cls.model_validate(fields)
        except ValidationError as error:
            raise InputError(first_fault(error, cls)) from None

    def toml(self) -> str:
        """The whole configuration, defaults written out."""
        import tomli_w

        return tomli_w.dumps(_without_none(self.model_dump(mode="python")))


def _pose(value: Any) -> Any:
    """Three numbers with commas between them, as a command line gives them."""
    parts = value.split(",") if isinstance(value, str) else value
    try:
        found = None if parts is None else tuple(float(part) for part in parts)
    except (TypeError, ValueError):
        found = ()
    if found is not None and not (len(found) == 3 and all(abs(one) <= 1e10 for one in found)):
        raise ValueError(f"prior_pose is {quoted(value)}: expected x,y,heading in m and rad")
    return found


class LogSection(SettingsGroup):
    """The log: which one is read, and how."""

    source: str = setting(
        "victoria-park", "Log: a name in `slamcheck logs`, or a path; the argument LOG"
    )
    format: str | None = setting(
        None,
        "Format of the log, named as in `slamcheck logs`. Default: recognised",
        Option("--format", JOB, metavar="NAME"),
    )
    robot: int = setting(
        1, "Robot number in an MR.CLAM folder", Option("--robot", JOB, metavar="N")
    )
    topics: tuple[str, ...] | None = setting(
        None,
        "Topics of a ROS bag to read. Default: per message type, the only one",
        Option(
            "--topic",
            JOB,
            "Topic of a ROS bag to read; repeat it for several. [per message type, the only one]",
            metavar="NAME",
        ),
    )
    start_s: float | None = setting(
        None,
        "Seconds to skip at the start of the log",
        Option("--start", JOB, "Skip the first S seconds of the log. [0]", metavar="S"),
        ge=0.0,
        allow_inf_nan=False,
    )
    end_s: float | None = setting(
        None,
        "Last time to read, in seconds after the log's start",
        Option("--end", JOB, "Stop S seconds after the log's start. [its end]", metavar="S"),
        gt=0.0,
        allow_inf_nan=False,
    )
    seed: int = setting(
        0, "Random seed of a simulated log", Option("--seed", JOB, metavar="N"), ge=0, lt=2**64
    )
    loops: int = setting(
        1, "Number of loops of a simulated log", Option("--loops", JOB, metavar="N"), ge=1, le=1000
    )
    noise_scale: float = setting(
        1.0,
        "Factor on the noise of a simulated log and on the sigmas that it states",
        Option(
            "--noise-scale",
            JOB,
            "Factor on the noise of a simulated log and on its stated sigmas. [1]",
            metavar="X",
        ),
        gt=0.0,
        le=1e6,
        allow_inf_nan=False,
    )
    features: Literal["log", "trees"] = setting(
        "log",
        "Landmark measurements: log, those of the log; trees, tree trunks detected in its scans",
        Option("--features", jobs=("run", "solve", "check", "map")),
    )
    sigmas: Literal["log", "published"] = setting(
        "log",
        "Measurement sigmas of the real logs of Nieto's vehicle: those with which the log "
        "is read, or published in his Table A.1. Other logs have one set",
    )
    sigma_position_m: float | None = setting(
        None,
        "Sigma of each absolute position (GPS) per axis in metres. Default: as the log has it",
        gt=0.0,
        le=1e6,
        allow_inf_nan=False,
    )
    prior_pose: Annotated[tuple[float, float, float] | None, BeforeValidator(_pose)] = setting(
        None,
        "Pose x [m], y [m], heading [rad] that the log starts from. Default: as the log has it",
        Option("--prior-pose", JOB, "Start pose. [the log's]", metavar="X,Y,RAD", text=True),
    )
    align: bool | None = setting(
        None,
        "Lay truth onto the start of the log by its first pose there, and with check the estimate: "
        "their frame is another",
        Option(
            "--align",
            JOB,
            "Lay truth, and an estimate without trace, onto the log's start pose: their frame is "
            "another.",
            jobs=("run", "check"),
        ),
    )
    sha256: str | None = setting(
        None, "SHA-256 of the log. A log with another hash is refused without --allow-changed-log"
    )

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.end_s is not None and self.end_s <= (self.start_s or 0.0):
            raise ValueError(
                f"log.end_s is {self.end_s:g}: expected above start_s {self.start_s or 0.0:g}"
            )
        return self


_GPS = (
    "Absolute positions (GPS). on: fuse all; half: fuse those of every second block of at "
    "least 60 s and hold the others out as a reference"
)
_GPS_HELP = "GPS: off, on, half (every second minute held out). [off]"


class EkfConfig(SettingsGroup):
    """The EKF."""

    filter: Filter = setting(
        "full",
        "EKF variant. full: textbook EKF-SLAM; compressed: compressed EKF (Guivant "
        "2002), equal to full; compressed-suboptimal: its conservative global update; misono: "
        "direction-cosine EKF as published (Misono 2007); misono-full: with the full Jacobian",
        Option(
            "--filter",
            ESTIMATORS,
            "EKF variant: full, compressed, compressed-suboptimal, misono (direction cosines) or "
            "misono-full. [full]",
        ),
    )
    association: Literal["known", "nn", "jcbb", "euclidean", "consensus"] | None = setting(
        None,
        "Data association. known: the log's labels; nn: nearest neighbour; jcbb: joint "
        "compatibility branch and bound; euclidean: nearest by distance in metres; consensus: only "
        "the pairs that all likely joint hypotheses share. Default: known where the log has "
        "labels, else nn",
        Option(
            "--association",
            ESTIMATORS,
            "Association: known (labels), nn (nearest neighbour), jcbb (joint "
            "compatibility), euclidean, consensus (of hypotheses). [known, else nn]",
        ),
    )
    attributes: Literal["off", "on"] = setting(
        "off",
        "Landmark attributes in association, for nn and jcbb. on: diameter and "
        "intensity of the measurements",
        Option("--attributes", jobs=("run",)),
    )
    gps: Gps = setting("off", _GPS, Option("--gps", ESTIMATORS, _GPS_HELP))
    nn_gate: float = setting(
        13.82, "Gate of nearest neighbour association: chi-square of 2 degrees of freedom", gt=0.0
    )
    position_gate: float | None = setting(
        None,
        "Gate of absolute positions: chi-square of 2 degrees of freedom; inf: none. Default: 13.82 "
        "(99.9 %), misono none",
        gt=0.0,
    )
    least_gain: float | None = setting(
        None,
        "compressed-suboptimal: least share of a state's variance that an update must "
        "remove to be applied to this state. Default: 1e-4",
        ge=0.0,
        lt=1.0,
    )
    stretch_sigma_m: float | None = setting(
        None,
        "Sigma of absolute positions per axis in metres within stretches of at least 5 s in which, "
        "by a first run with all, they keep one distance from SLAM to this sigma, of at most 3 "
        "such sigmas; the others are left out. Default: all are fused, with the log's sigmas",
        gt=0.0,
        le=1e6,
        allow_inf_nan=False,
    )
    gps_recovery: int | None = setting(
        None,
        "Number of successive rejected absolute positions with the same offset from "
        "the vehicle after which the next ones are fused. Default: never",
        ge=2,
    )
    split_turn_rad: float | None = setting(
        None,
        "Greatest turn of the vehicle by one update in radians; a larger update is "
        "split. Default: 0.0175 (1 degree) for absolute positions, none for landmarks",
        gt=0.0,
    )
    split_move_m: float | None = setting(
        None,
        "Greatest move of the vehicle by one update in metres; a larger update is "
        "split. Default: 1 for absolute positions, none for landmarks",
        gt=0.0,
    )
    split_shrink: float | None = setting(
        None,
        "Greatest share of a variance that one update removes; a larger update is "
        "split. Default: none",
        gt=0.0,
        lt=1.0,
    )

    @model_validator(mode="after")
    def _take_attributes(self) -> Self:
        """`known` needs none, `euclidean` has no likelihood, `consensus` sees discs of several."""
        if self.attributes != "off" and self.association not in (None, "nn", "jcbb"):
            raise ValueError(
                f"association '{self.association}' takes no attributes, expected nn or jcbb; "
                "use --attributes off"
            )
        return self

    @property
    def conservative(self) -> bool:
        """The filter does not claim to be exact, only never to be too certain."""
        return self.filter == "compressed-suboptimal"

    @property
    def own_axes(self) -> bool:
        """The filter measures landmarks as points in the vehicle's axes (Misono 2007)."""
        return self.filter.startswith("misono")


class SmootherConfig(SettingsGroup):
    """The smoother."""

    method: Literal["batch", "isam2", "fixed-lag"] = setting(
        "batch",
        "Method. batch: all poses at once; isam2: incremental; fixed-lag: the last "
        "poses alone. The last two are compared with the batch optimum",
        Option(
            "--smoother",
            ESTIMATORS,
            "Method: batch, isam2 (incremental) or fixed-lag. [batch]",
            jobs=("run", "solve"),
        ),
    )
    lag: int = setting(
        100,
        "Number of poses of a fixed-lag smoother",
        Option(
            "--lag",
            jobs=("run", "solve"),
            where=Where("smoother.method", "fixed-lag", "--smoother fixed-lag"),
        ),
        ge=1,
    )
    optimiser: Literal["levenberg-marquardt", "gauss-newton", "dogleg"] = setting(
        "levenberg-marquardt",
        "Optimiser of method batch",
        Option(
            "--optimiser",
            jobs=("run", "solve"),
            where=Where("smoother.method", "batch", "--smoother batch"),
        ),
    )
    robust: Literal["none", "huber", "cauchy", "gnc"] = setting(
        "none",
        "Robust kernel against outliers: none, huber, cauchy, or gnc (graduated "
        "non-convexity). A kernel changes the marginal covariances",
        Option("--robust", ESTIMATORS, "Robust smoother kernel: none, huber, cauchy, gnc. [none]"),
    )
    accept_misfit: bool = setting(
        False,
        "Accept the lowest minimum as verified although its chi-square is high",
        Option("--accept-misfit"),
    )


class ReportConfig(SettingsGroup):
    """The output folder."""

    figures: tuple[Literal["png", "pdf"], ...] = setting(
        (),
        "Write map, consistency and correlations as figures, too, in these formats; "
        "the page has them in any case. pdf: beside a PNG",
        Option("--figures"),
    )
    trace: bool = setting(
        False, "Write what the EKF did to ekf/filter.trace, for check and audit", Option("--trace")
    )


class FrontEndConfig(SettingsGroup):
    """The scan front end."""

    guess: Literal["wheels", "none"] = setting(
        "wheels",
        "Initial guess of scan matching. wheels: the odometry; none: no motion",
        Option(
            "--guess",
            FRONT_END,
            "Initial guess of scan matching: wheels (wheel odometry) or none. [wheels]",
        ),
    )
    loop_closure: bool = setting(
        True,
        "Detect and close loops",
        Option(
            "--loop-closure",
            FRONT_END,
            "Detect loop closures and add them to the pose graph. [on]",
            off=True,
        ),
    )
    matcher: Literal["surface", "kiss", "point-to-point", "point-to-plane", "generalised"] = (
        setting(
            "surface",
            "Scan matcher of loop closure: surface (ours), kiss (KISS-ICP), or ICP of "
            "Open3D, point-to-point, point-to-plane or generalised",
            Option(
                "--matcher",
                FRONT_END,
                "Scan matcher of loop closure: surface, kiss, point-to-point, point-to-plane or "
                "generalised. [surface]",
                where=Where("front_end.loop_closure", True, "--loop-closure"),
            ),
        )
    )
    gps: Gps = setting("off", _GPS, Option("--gps", FRONT_END, _GPS_HELP))


class ExtensionConfig(SettingsGroup):
    """An extension's settings."""

    extension: ClassVar[str]
    """Whose they are: `module:Class` (see pipeline.extension), loaded where it takes part."""
    switch: ClassVar[Option | None] = None
    """Adds and removes them."""

    def needs(self) -> Needs:
        """Extensions that this one cannot do without."""
        return {}

    def libraries(self) -> dict[str, str]:
        """As of JobConfig."""
        return {}

    def check_with(self, config: Configured) -> None:
        """Raise ValueError where this does not go with the other settings."""

    def build(self, config: Configured) -> Any:
        """Return the extension."""
        return resolve_name(self.extension)(self, config)


def config_class(name: str) -> type[ExtensionConfig]:
    """Return the class of an extension's settings. Raises InputError for an unknown name."""
    if name not in EXTENSIONS:
        known = ", ".join(EXTENSIONS)
        raise InputError(f"extensions.{shorten(name, 80)}: is unknown, expected one of {known}")
    found: type[ExtensionConfig] = resolve_name(EXTENSIONS[name])
    return found


def _with_classes(value: Any) -> Any:
    """Validate each extension's section by the class that the registry names."""
    if not isinstance(value, Mapping):
        return value
    return {name: _validated(str(name), given) for name, given in value.items()}


def _validated(name: str, given: Any) -> ExtensionConfig:
    if isinstance(given, ExtensionConfig):
        return given
    kind = config_class(name)
    try:
        return kind.model_validate(given)
    except ValidationError as error:
        raise ValueError(first_fault(error, kind, f"extensions.{name}")) from None


Extensions = Annotated[dict[str, SerializeAsAny[ExtensionConfig]], BeforeValidator(_with_classes)]


class JobConfig(SettingsGroup):
    """A job's configuration, whichever the job."""

    job: str
    preset: Preset = setting(
        "recommended",
        "Default values of all other settings: recommended, or those of a document, "
        "guivant-2002, misono-2007 or nieto-2005, where it states one for the log "
        "(docs/settings.md). Over a configuration file, settings that differ from the file's "
        "preset stay",
        Option("--preset"),
    )
    log: LogSection = LogSection()

    @model_validator(mode="before")
    @classmethod
    def _published(cls, given: Any) -> Any:
        """Put the document's values where nothing was given."""
        if not isinstance(given, Mapping):
            return given
        preset = given.get("preset", "recommended")
        if preset not in PRESETS.values():
            return given
        from comparisons.documented.preset import published

        return published(preset, given, tuple(cls.model_fields), setting_default)

    def libraries(self) -> dict[str, str]:
        """Return what the job needs of graphslam.scan.libraries, and what asks for each."""
        return {}

    def inputs(self) -> tuple[Path, ...]:
        """Return the paths of what the job reads, of which its output takes no place."""
        source = recorded_path(self.log.source)
        return (source,) if source.is_absolute() else ()  # else a log's name

    def at_log(self, sha256: str, source: str | None = None) -> Self:
        """The same with the log's hash, and its full path where it is a path."""
        named = {"sha256": sha256} | ({} if source is None else {"source": source})
        return self.model_copy(update={"log": self.log.model_copy(update=named)})


class Configured(JobConfig):
    """A job with a filter, to which extensions may be added."""

    ekf: EkfConfig = EkfConfig()
    extensions: Extensions = Field(default_factory=dict)

    @model_validator(mode="after")
    def _complete(self) -> Self:
        """Add what is needed; then let every extension look at the whole."""
        found = dict(self.extensions)
        for extension in self.extensions.values():
            for name, fields in extension.needs().items():
                kept = found.get(name) or self._by_preset(name)
                found[name] = kept.model_copy(update=dict(fields))
        object.__setattr__(self, "extensions", found)
        for extension in found.values():
            extension.check_with(self)
        return self

    def libraries(self) -> dict[str, str]:
        """Those of all extensions."""
        return {
            k: v for extension in self.extensions.values() for k, v in extension.libraries().items()
        }

    def settings_of(self, name: str) -> ExtensionConfig:
        """Return an extension's settings, the preset's where it takes no part."""
        return self.extensions.get(name) or self._by_preset(name)

    def _by_preset(self, name: str) -> ExtensionConfig:
        """Return an extension's settings where nothing of it is given."""
        given: dict[str, Any] = {"extensions": {name: {}}}
        if self.preset != "recommended":
            from comparisons.documented.preset import published

            stated = {"log": self.log.model_dump(), "ekf": self.ekf.model_dump()}
            given = published(self.preset, {**stated, **given}, ("ekf",), setting_default)
        return config_class(name).model_validate(given["extensions"][name])


def _listed(value: Any) -> Any:
    """Words with commas between them, as a command line gives several, `both` spelt out."""
    if isinstance(value, str):
        value = [part.strip() for part in value.split(",") if part.strip()]
    known = get_args(FailOn)
    if isinstance(value, list | tuple):
        if unknown := [one for one in value if one not in known]:
            some = ", ".join(known)
            raise ValueError(f"fail_on is {quoted(unknown[0])}: expected some of {some}")
        both = ("disagreement", "consistency")
        value = [word for one in value for word in (both if one == "both" else (one,))]
    return value


class RunConfig(Configured):
    """`slamcheck run`: both estimators on one log, compared."""

    job: Literal["run"] = "run"
    smoother: SmootherConfig = SmootherConfig()
    report: ReportConfig = ReportConfig()
    fail_on: Annotated[tuple[FailOn, ...], BeforeValidator(_listed)] = setting(
        (),
        "Findings that exit with 1. disagreement: always does; consistency: NEES, "
        "NIS or filter against smoother outside their bands; both: these two; truth: the smoother "
        "is far from the truth; association: no check of the association was possible; positions: "
        "those that nobody has used contradict the optimum, which always does",
        Option(
            "--fail-on",
            JOB,
            "Exit 1 also on: consistency (filter inconsistent), truth (smoother far off), "
            "association (unchecked).",
            metavar="WHAT,...",
            text=True,
        ),
    )

    @model_validator(mode="after")
    def _traceable(self) -> Self:
        own_state = self.ekf.own_axes
        if self.report.trace and (own_state or "scan_landmarks" in self.extensions):
            raise ValueError(
                "--trace is for filters of x, y and heading, and for landmarks that are points"
            )
        return self


Cloud = Literal["pcd", "ply"]
_CLOUD = "Write the map also as a point cloud; needs Open3D"
_CLOUD_OPTION = Option("--cloud", JOB, "Write the map as point cloud: pcd, ply (Open3D).")


class MapConfig(Configured):
    """`slamcheck map`: a dense map beside the filter."""

    job: Literal["map"] = "map"
    cloud: Cloud | None = setting(None, _CLOUD, _CLOUD_OPTION)

    def libraries(self) -> dict[str, str]:
        """Clouds are written by Open3D."""
        return super().libraries() | ({"open3d": "--cloud"} if self.cloud else {})


class SolveConfig(JobConfig):
    """`slamcheck solve`: the smoother alone."""

    job: Literal["solve"] = "solve"
    association: Literal["known", "own"] | None = setting(
        None,
        "Data association. known: the log's labels; own: found by the smoother. "
        "Default: known where the log has labels, else own",
        Option(
            "--association",
            ESTIMATORS,
            "Association: known (labels) or own (found by the smoother). [known, else own]",
        ),
    )
    gps: Gps = setting("off", _GPS, Option("--gps", ESTIMATORS, _GPS_HELP))
    smoother: SmootherConfig = SmootherConfig()


MIN_COVERAGE = 0.95
"""Least share of a log's time that an external estimate has to cover."""


class CheckConfig(SolveConfig):
    """`slamcheck check`: an external estimate against the smoother's."""

    job: Literal["check"] = "check"  # type: ignore[assignment]
    estimate: str = setting(
        "",
        "Trajectory file (TUM, KITTI, CSV), or folder of an estimate (docs/formats.md)",
        Option(
            "--estimate",
            GRADE,
            "Trajectory (TUM, KITTI, CSV) or estimate folder (docs/formats.md).",
            metavar="PATH",
        ),
    )
    times: str | None = setting(
        None,
        "Time stamps of a KITTI trajectory. Default: times.txt beside it",
        Option("--times", GRADE, metavar="FILE"),
    )
    trace: str | None = setting(
        None,
        "What the filter did, by slamcheck.Recorder. Default: filter.trace in the "
        "estimate's folder",
        Option(
            "--trace",
            GRADE,
            "What the filter did, recorded. [filter.trace in the estimate's folder]",
            metavar="FILE",
        ),
    )
    require: RequiredGrade | None = setting(
        None,
        "Lowest grade that exits with 0. equal: to the reference EKF; like: within 5 % "
        "of it; plausible: within the optimum's own uncertainty. Default: like where "
        'estimate.toml says estimator = "ekf", else plausible',
        Option(
            "--require",
            GRADE,
            "Lowest grade that exits with 0: equal, like (within 5 %) or plausible. [like for an "
            "EKF, else plausible]",
        ),
    )
    min_coverage: float = setting(
        MIN_COVERAGE,
        "Least share of the log's time that the estimate must cover; one that covers "
        "less disagrees",
        Option(
            "--min-coverage",
            GRADE,
            "Least share of the log's duration that the estimate must cover. [0.95]",
            metavar="SHARE",
        ),
        ge=0.0,
        le=1.0,
    )

    def inputs(self) -> tuple[Path, ...]:
        """Also the estimate's files."""
        return (
            *super().inputs(),
            *map(Path, filter(None, (self.estimate, self.times, self.trace))),
        )


class OdometryConfig(JobConfig):
    """`slamcheck odometry`: the scan front end alone."""

    job: Literal["odometry"] = "odometry"
    front_end: FrontEndConfig = FrontEndConfig()
    cloud: Cloud | None = setting(None, _CLOUD, _CLOUD_OPTION)

    def libraries(self) -> dict[str, str]:
        """Odometry is KISS-ICP's; clouds and all other matchers but `surface` are Open3D's."""
        found = {"kiss_icp": "odometry"}
        if self.front_end.matcher not in ("surface", "kiss"):
            found["open3d"] = f"--matcher {self.front_end.matcher}"
        return found | ({"open3d": "--cloud"} if self.cloud else {})


JOBS: dict[str, type[JobConfig]] = {
    one.model_fields["job"].default: one
    for one in (RunConfig, SolveConfig, CheckConfig, MapConfig, OdometryConfig)
}


def recorded_path(text: str | Path) -> Path:
    """Return a path as full_path records it, its `~` as the home folder."""
    return Path(os.path.expanduser(text))


def full_path(path: Path) -> str:
    """Return a path as a configuration records it: full, or from the home folder on, with `~`.

    Raises InputError for a name that is not text. A file system may hold such names; TOML and JSON
    cannot.
    """
    full, home = recorded_path(path).resolve(), recorded_path("~").resolve()
    found = str(Path("~", full.relative_to(home)) if home in full.parents else full)
    if any("\ud800" <= one <= "\udfff" for one in found):
        raise InputError(f"{found}: its full name is not UTF-8, which no file of settings can hold")
    return found


def check_unchanged(source: str, found: str, recorded: str | None, option: str) -> None:
    """Raise InputError where an input's hash is not the one that a configuration recorded.

    option: what allows that.
    """
    if recorded not in (None, found):
        raise InputError(
            f"{source}: has changed since the configuration was written: its hash is "
            f"{found[:12]}..., expected {str(recorded)[:12]}...; give {option} to "
            "use it all the same"
        )


def first_fault(error: ValidationError, kind: type[BaseModel], within: str = "") -> str:
    """One line on the first thing wrong: key, value and what was expected.

    kind: of what was validated. within: where that stands.
    """
    faults = error.errors()
    # What is misspelt may also be missing under its own name; the former says more.
    fault = next((one for one in faults if one["type"] == "extra_forbidden"), faults[0])
    path, message, context = fault["loc"], fault["msg"], fault.get("ctx", {})
    keys, _ = _follow(kind, path)
    where = ".".join(filter(None, [within, *keys]))[:100]
    tag_key = str(context.get("discriminator", "")).strip("'")
    match fault["type"]:
        case "extra_forbidden":
            _, section = _follow(kind, path[:-1])
            known = f"one of {', '.join(section.model_fields)}" if section else "nothing there"
            return f"{where}: is unknown, expected {known}"
        case "value_error":  # ours; it names what it is about
            return message.removeprefix("Value error, ")
        case "missing":
            return f"{where}: is missing"
        case "union_tag_not_found":
            return f"{where}.{tag_key}: is missing"
        case "union_tag_invalid":
            known = context["expected_tags"].replace("'", "")
            return f"{where}.{tag_key} is {quoted(context['tag'])}: expected one of {known}"
    return f"{where} is {quoted(fault.get('input'))}: {message[:1].lower()}{message[1:]}"


def _follow(
    kind: type[BaseModel], path: Sequence[str | int]
) -> tuple[list[str], type[BaseModel] | None]:
    """Keys on the way to a fault, as the file has them, and the section it leads to, if any.

    Pydantic's path also holds the tag of each section that may be of several kinds.
    """
    keys: list[str] = []
    section: type[BaseModel] | None = kind
    parts = iter(path)
    for part in parts:
        keys.append(str(part))
        field = section.model_fields.get(str(part)) if section else None
        found = () if field is None else get_args(field.annotation) or (field.annotation,)
        models = [one for one in found if isinstance(one, type) and issubclass(one, BaseModel)]
        if field is not None and isinstance(field.discriminator, str):
            tag, key = str(next(parts, "")), field.discriminator
            models = [
                model for model in models if tag in choices_of(model.model_fields[key].annotation)
            ]
        section = models[0] if len(models) == 1 else None
    return keys, section


def choices_of(annotation: Any) -> tuple[str, ...]:
    """The words that a field may be, in whatever they are wrapped."""
    if get_origin(annotation) is Literal:
        return tuple(str(choice) for choice in get_args(annotation))
    return next((found for choice in get_args(annotation) if (found := choices_of(choice))), ())


def json_schema(kind: type[SettingsGroup]) -> dict[str, Any]:
    """The JSON schema of a job's configuration, all extensions included."""
    schema = kind.model_json_schema()
    if issubclass(kind, Configured):
        found = {name: config_class(name).model_json_schema() for name in EXTENSIONS}
        schema["properties"]["extensions"] = {
            "type": "object", "properties": found, "additionalProperties": False
        }  # fmt: skip
    return schema


def setting_default(path: str) -> Any:
    """Return the default of a run's setting `section.key`. Raises KeyError for an unknown one."""
    section, _, key = path.partition(".")
    if section in EXTENSIONS:
        kind: Any = config_class(section)
    else:
        kind = RunConfig.model_fields[section].annotation
    return kind.model_fields[key].get_default(call_default_factory=True)


def _without_none(value: Any) -> Any:
    """TOML has no null: an absent key stands for it."""
    if isinstance(value, Mapping):
        return {k: _without_none(v) for k, v in value.items() if v is not None}
    if isinstance(value, Iterable) and not isinstance(value, str):
        return [_without_none(one) for one in value]
    return value
