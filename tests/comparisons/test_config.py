"""Configurations: from flags, files and single settings, to TOML and back, and what is refused."""

import json
import tomllib
from pathlib import Path

import pytest

from comparisons.config import (
    JOBS,
    CheckConfig,
    Configured,
    EkfConfig,
    JobConfig,
    MapConfig,
    OdometryConfig,
    RunConfig,
    SolveConfig,
    config_class,
    full_path,
    json_schema,
)
from comparisons.errors import InputError
from comparisons.extension_names import EXTENSIONS
from comparisons.logs.log_folder import write_log_folder
from comparisons.options import table
from comparisons.options.table import of_job
from comparisons.pipeline.read import read_for
from comparisons.settings import configure, run_config
from tests.commands import slamcheck
from tests.helpers import simulated
from tools import options_table

RUN, MAP = of_job("run"), of_job("map")


def test_a_path_under_the_home_folder_is_recorded_from_there_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody's name is in a result; the same configuration finds the log again."""
    monkeypatch.setenv("HOME", str(tmp_path))
    write_log_folder(simulated(2, loop_s=10.0), tmp_path / "mine" / "log")
    recorded = full_path(tmp_path / "mine" / "log")
    assert recorded == "~/mine/log"
    assert full_path(Path(recorded)) == recorded
    assert full_path(Path("/usr")) == "/usr"
    config = configure(RunConfig, settings=[f"log.source={recorded}"])
    log, found, _ = read_for(config)
    assert log.records
    assert found.log.source == recorded
    assert found.inputs() == (tmp_path / "mine" / "log",)


def test_the_table_of_options_is_generated_from_the_settings() -> None:
    assert Path(table.__file__).read_text() == options_table.source(), (
        "options are old: make settings"
    )


def test_the_switches_of_extensions_offer_what_their_settings_take() -> None:
    for name in EXTENSIONS:
        kind = config_class(name)
        words = kind.switch.settings if kind.switch else None
        for given in (words or {}).values():
            assert given is None or kind.of(**given)


def everything() -> list[JobConfig]:
    """Configurations that reach every extension and every job."""
    return [
        run_config(),
        run_config(filter="compressed", association="jcbb", gps="half", seed=7, robust="gnc"),
        run_config(motion="both", smoother_association="own", dense=["points"], dynamic=True),
        run_config(landmarks="both", template_extraction="per-segment", attributes="on",
                   smoother_matcher="generalised-icp", association="nn"),
        RunConfig.of(extensions={"high_level": {"cell_m": 0.4}},
                     report={"figures": ["pdf"], "trace": True}),
        MapConfig.of(extensions={"dense_maps": {"layers": ["points"], "known_m": 0.5}}),
        SolveConfig.of(association="own", smoother={"method": "isam2"}),
        CheckConfig.of(estimate="mine"),
    ]  # fmt: skip


@pytest.mark.parametrize("config", everything(), ids=lambda c: c.job)
def test_a_configuration_survives_its_file(config: JobConfig, tmp_path: Path) -> None:
    path = tmp_path / "config.toml"
    path.write_text(config.toml())
    assert configure(type(config), path) == config
    assert type(config).model_validate_json(config.model_dump_json()) == config


def test_defaults_are_written_out() -> None:
    written = tomllib.loads(run_config().toml())
    assert written["smoother"]["lag"] == 100
    core = {"job", "preset", "fail_on", "log", "ekf", "smoother", "report", "extensions"}
    assert set(written) == core


def over_a_file(
    file: RunConfig, folder: Path, option: str, value: object, *settings: str
) -> RunConfig:
    """A configuration of a file, with a flag over it, and settings over that."""
    path = folder / "config.toml"
    path.write_text(file.toml())
    flags = [(flag, value) for flag in RUN if flag.option == option]
    return configure(RunConfig, path, flags, settings)


def test_flags_lie_over_a_file_and_settings_over_flags(tmp_path: Path) -> None:
    file = run_config(filter="compressed", gps="on", dense=["points"])
    settings = ("ekf.gps=half", "dense_maps.resolution_m=0.5")
    found = over_a_file(file, tmp_path, "--filter", "misono", *settings)
    assert (found.ekf.filter, found.ekf.gps) == ("misono", "half")
    assert found.model_dump()["extensions"]["dense_maps"]["resolution_m"] == 0.5
    assert found.model_dump()["extensions"]["dense_maps"]["layers"] == ("points",)


def test_flags_leave_what_they_lie_over_as_it_is() -> None:
    """Settings under them may be a constant of a command."""
    base = {"extensions": {"dense_maps": {"layers": ["occupancy"]}}}
    flags = [(flag, ["sog"]) for flag in MAP if flag.option == "--layer"]
    found = configure(MapConfig, flags=flags, over=base)
    assert found.model_dump()["extensions"]["dense_maps"]["layers"] == ("sog",)
    assert base == {"extensions": {"dense_maps": {"layers": ["occupancy"]}}}


def test_a_flag_takes_an_extension_of_the_file_away(tmp_path: Path) -> None:
    """As a switch does."""
    file = run_config(motion="both", smoother_association="own")
    found = over_a_file(file, tmp_path, "--motion", "wheel")
    assert set(found.extensions) == {"own_association"}
    file = run_config(high_level=True, landmarks="points")
    assert over_a_file(file, tmp_path, "--high-level", False).extensions == {}


def test_another_log_than_the_files_drops_its_hash(tmp_path: Path) -> None:
    file = run_config(seed=1).at_log("0" * 64)
    assert over_a_file(file, tmp_path, "--filter", "full").log.sha256 == "0" * 64
    assert over_a_file(file, tmp_path, "--seed", 2).log.sha256 is None


WRONG_SETTINGS = {
    "ekf.filter=ukf": "ekf.filter is 'ukf': input should be 'full', 'compressed'",
    "ekf.filtre=full": "ekf.filtre: is unknown, expected one of filter, association",
    "kalman.filter=full": "kalman is unknown, expected one of preset, log, ekf, smoother",
    "log.noise_scale=1e300": "log.noise_scale is ",
    "log.noise_scale=inf": "log.noise_scale is inf: input should be a finite number",
    "log.noise_scale=0": "log.noise_scale is 0: input should be greater than 0",
    "log.seed=-1": "log.seed is -1: input should be greater than or equal to 0",
    "log=1": "log is 1: input should be",
    "dense_maps.layers=[]": "dense_maps.layers: empty, expected some of points, occupancy",
    'dense_maps.layers=["points", "walls"]': "layers.1 is 'walls': input should be 'points', 'occu",
    "dense_maps.size=1": "extensions.dense_maps.size: is unknown, expected one of layers",
    "dense_maps.resolution_m=0": "extensions.dense_maps.resolution_m is 0: input should be",
    "dense_maps.resolution_m=11.0": "extensions.dense_maps.resolution_m is 11.0: input should be",
    "high_level.cell_m=0": "extensions.high_level.cell_m is 0: input should be",
    "high_level.least=0": "extensions.high_level.least is 0: input should be",
    "high_level.every_s=-1": "extensions.high_level.every_s is -1: input should be",
    "own_association=5": "extensions.own_association is 5: input should be",
    "smoother.lag": "--set smoother.lag: expected SECTION.KEY=VALUE",
    "ekf.split_turn_rad=0": "ekf.split_turn_rad is 0: input should be greater than 0",
    "ekf.split_move_m=-1": "ekf.split_move_m is -1: input should be greater than 0",
    "ekf.split_shrink=1": "ekf.split_shrink is 1: input should be less than 1",
}


@pytest.mark.parametrize("setting", WRONG_SETTINGS)
def test_what_is_wrong_is_named_in_one_line(setting: str) -> None:
    with pytest.raises(InputError) as error:
        configure(RunConfig, settings=[setting])
    assert WRONG_SETTINGS[setting] in str(error.value)
    assert "\n" not in str(error.value)


SCANS: dict[str, object] = {"landmarks": "scans"}
BOTH: dict[str, object] = {"landmarks": "both"}
MERGED = BOTH | {"merge_landmarks": True}
DRAWN: dict[str, object] = {"posterior": "samples"}


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (
            {"smoother_matcher": "generalised-icp"},
            "--smoother-matcher generalised-icp goes with --landmarks scans or both",
        ),
        (
            {"template_extraction": "per-segment"},
            "--template-extraction per-segment goes with --landmarks scans or both",
        ),
        ({"merge_landmarks": True}, "--merge-landmarks goes with --landmarks scans or both"),
        ({"landmarks": "walls"}, "--landmarks is 'walls', expected points or scans or both"),
        (SCANS | {"smoother_matcher": "kiss"}, "is 'kiss', expected ekf or generalised-icp"),
        (SCANS | {"template_extraction": "all"}, "is 'all': .*'whole-scan' or 'per-segment'"),
        (SCANS | {"motion": "both"}, "--motion both compares landmarks that are"),
        (
            SCANS | {"smoother_association": "own"},
            "--smoother-association own compares landmarks that are points.* use --landmarks both",
        ),
        (SCANS | {"attributes": "on"}, "--attributes on tells points apart"),
        (BOTH | {"high_level": True}, "--high-level goes with --landmarks points only"),
        (
            MERGED | {"dense": ["sog"]},
            "goes without --dense and .*anchored to scan landmarks for good",
        ),
        (MERGED | {"dynamic": True}, "regions of a map are anchored to scan landmarks for good"),
        (BOTH | {"trace": True}, "--trace is for"),
        ({"filter": "misono", "trace": True}, "--trace is for"),
        (DRAWN | SCANS, "goes with landmarks that are points"),
        (DRAWN | {"robust": "huber"}, "goes with the batch smoother"),
        (DRAWN | {"smoother": "isam2"}, "goes with the batch smoother"),
        ({"attributes": "on", "association": "euclidean"}, "takes no attributes"),
        ({"resolution": 0.4}, "dense_maps.layers: empty, .*; --resolution alone asks for no map"),
        ({"lag": 5}, "--lag 5 goes with --smoother fixed-lag"),
        ({"smoother": "isam2", "optimiser": "dogleg"}, "--optimiser dogleg goes with --smoother"),
        ({"dynamic": "on"}, "--dynamic is 'on', expected True or False"),
        ({"fail_on": "truth,time"}, "fail_on is 'time': expected some of disagreement, consis"),
        ({"kalman": "on"}, "option kalman: is unknown"),
    ],
)
def test_what_does_not_go_together_is_refused(options: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        run_config(**options)


@pytest.mark.parametrize(
    "options",
    [
        {"landmarks": "scans", "motion": "scan"},
        {"landmarks": "both", "motion": "both", "smoother_association": "own"},
        {"lag": 100},
        {"smoother": "fixed-lag", "lag": 5},
        {"merge_landmarks": False},
        {"dynamic": True, "resolution": 0.4},
    ],
)
def test_what_goes_together_is_not(options: dict[str, object]) -> None:
    run_config(**options)


def test_what_has_no_effect_is_refused_in_a_file_too(tmp_path: Path) -> None:
    """Where it differs from the default: a file holds every setting."""
    path = tmp_path / "config.toml"
    path.write_text(SolveConfig.of().toml())
    configure(SolveConfig, path)
    path.write_text(path.read_text().replace("lag = 100", "lag = 5"))
    with pytest.raises(InputError, match=r"config\.toml: --lag 5 goes with --smoother fixed-lag"):
        configure(SolveConfig, path)
    matcher = ["front_end.matcher=kiss"]
    assert configure(OdometryConfig, settings=matcher).front_end.matcher == "kiss"
    with pytest.raises(InputError, match="--matcher kiss goes with --loop-closure"):
        configure(OdometryConfig, settings=[*matcher, "front_end.loop_closure=false"])


def test_an_extension_brings_what_it_needs() -> None:
    """What looks for motion needs a dense map, and a map that is there serves it."""
    alone = run_config(dynamic=True).model_dump()["extensions"]["dense_maps"]
    assert (alone["layers"], alone["detect_motion"]) == ((), True)
    beside = run_config(dynamic=True, dense=["sog"]).model_dump()["extensions"]["dense_maps"]
    assert (beside["layers"], beside["detect_motion"]) == (("sog",), True)


def test_a_settled_filter_keeps_its_settings() -> None:
    assert EkfConfig(filter="compressed-suboptimal").conservative
    assert not EkfConfig(filter="compressed").conservative


def test_the_schema_names_every_field() -> None:
    for name, kind in JOBS.items():
        schema = json_schema(kind)
        assert schema["properties"]["job"]["const"] == name
        if issubclass(kind, Configured):
            found = schema["properties"]["extensions"]["properties"]
            assert set(found) == set(EXTENSIONS)
            assert "resolution_m" in found["dense_maps"]["properties"]


@pytest.mark.slow
def test_the_command_prints_settings_that_can_be_used(tmp_path: Path) -> None:
    printed = slamcheck("config", cwd=tmp_path)
    assert "# --filter full|compressed|" in printed.stdout
    assert '\nfilter = "full"\n' in printed.stdout
    assert "\n#resolution_m = 0.2\n" in printed.stdout
    schema = slamcheck("config", "--schema", cwd=tmp_path)
    assert json.loads(schema.stdout)["title"] == "RunConfig"
