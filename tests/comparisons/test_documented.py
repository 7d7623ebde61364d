"""Every constant of a document has a row: its value, or why runs use another."""

import dataclasses
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import build_association, build_ekf, settle
from comparisons.checks.settings import settings_result
from comparisons.config import LogSection, RunConfig, setting_default
from comparisons.documented.preset import SETTINGS, applies, differing, read
from comparisons.documented.row import Documented, Preset, same
from comparisons.extension_names import EXTENSIONS
from comparisons.logs.bundled import open_log
from comparisons.logs.log import Log
from comparisons.logs.odometry import SteeringOdometry
from comparisons.logs.readers import read_log
from comparisons.logs.transforms.published_sigmas import FORMATS, with_published_sigmas
from comparisons.pipeline.read import load_log
from comparisons.settings import configure, run_config, run_options
from comparisons.words import Row
from ekf_reference.association.nearest_neighbour import NearestNeighbour
from ekf_reference.core.trace import Trace
from research.documents.constants import ROWS
from tests.helpers import first_seconds, simulated
from tools.settings_page import differs, in_code, markdown, undocumented, used

LISTS = ("comparisons.documented", "research.documents.constants")
PAGE = Path(__file__).resolve().parents[2] / "docs" / "settings.md"


def wrong(row: Documented) -> str:
    """What is wrong with a row, empty where nothing is."""
    own = [one for one in (row.at, *row.also) if one.startswith(LISTS)]
    if own:
        return f"{own[0]} is this list's own: {row.place} is compared with itself"
    if differs(row) and not any(map(str.isdigit, row.reason)):
        return f"{row.at} is {used(row)}, {row.place} says {row.value}: no measured reason"
    if row.reason and not differs(row):
        return f"{row.at} is as in {row.place}: the reason is stale"
    if row.is_setting and (used(row) is None) != bool(row.absent):
        return f"{row.at}: it is not said what runs use where it is absent"
    strange = [one for one in row.also if not same(in_code(one), row.value)]
    return f"{strange[0]} is not as in {row.place}" if strange else ""


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row.place}: {row.at}")
def test_runs_use_the_document_s_value_or_a_row_says_why_not(row: Documented) -> None:
    assert wrong(row) == ""


def test_a_value_that_moved_away_is_found() -> None:
    equal = next(row for row in ROWS if not differs(row) and isinstance(row.value, float))
    assert wrong(dataclasses.replace(equal, value=2.0 * float(str(equal.value)) + 1.0))
    assert wrong(dataclasses.replace(equal, reason="measured: 3 % better"))
    open_one = next(row for row in ROWS if row.absent)
    assert wrong(dataclasses.replace(open_one, absent=""))
    other = next(row for row in ROWS if differs(row))
    assert wrong(dataclasses.replace(other, reason="it is better"))
    assert wrong(dataclasses.replace(other, also=(other.at,))) if not other.is_setting else True


def test_a_row_that_is_compared_with_itself_is_found() -> None:
    own = "research.documents.constants:_A_1"
    sound = next(row for row in ROWS if not differs(row) and not row.is_setting)
    assert wrong(sound) == ""
    itself = dataclasses.replace(sound, value=in_code(own), at=own)
    assert not differs(itself)
    assert "compared with itself" in wrong(itself)
    assert "compared with itself" in wrong(dataclasses.replace(sound, also=(own,)))


@pytest.mark.slow
def test_the_page_is_generated_from_the_code() -> None:
    assert PAGE.read_text() == markdown(), "docs/settings.md is old: make settings"


def test_no_two_rows_set_one_setting() -> None:
    paths = [(row.at, str({k: (type(v), v) for k, v in row.when.items()})) for row in SETTINGS]
    assert len(set(paths)) == len(paths)


def test_what_no_document_states_is_listed() -> None:
    listed = dict(undocumented())
    assert listed["ekf_reference.filters.compressed:LocalAreas.half_m"] == 25.0
    assert not {row.at for row in ROWS} & set(listed)


def published_run(**flags: object) -> RunConfig:
    """A run as published, with every extension that goes with points."""
    return run_config(preset="nieto-2005", **flags)


@pytest.mark.parametrize(
    "flags",
    [
        {},
        {"filter": "misono"},
        {"dynamic": True},
        {"dense": ["points", "occupancy"], "high_level": True, "dynamic": True},
        {"landmarks": "scans"},
        {"landmarks": "both", "dense": ["sog"]},
    ],
    ids=str,
)
def test_as_published_sets_every_setting_that_applies(flags: dict[str, object]) -> None:
    config = published_run(**flags).model_dump(mode="python")
    assert differing(config, setting_default) == []
    named = [
        row
        for row in SETTINGS
        if row.named and _there(row, config) and applies(row, config, setting_default)
    ]
    assert [same(row.value, read(config, row.at)) for row in named] == [True] * len(named)
    recommended = run_config(**flags).model_dump(mode="python")
    moved = [row for row in SETTINGS if differs(row) and not row.named and _there(row, recommended)]
    assert {row.at for row, _ in differing(recommended, setting_default)} >= {
        row.at for row in moved if applies(row, recommended, setting_default)
    }


def test_a_document_s_preset_has_nothing_of_another() -> None:
    log: dict[str, Any] = {"format": "victoria-park"}
    ekf: dict[str, Any] = {"filter": "compressed", "gps": "half"}
    found = {name: RunConfig.of(preset=name, log=log, ekf=ekf) for name in get_args(Preset)}
    ours, guivant, misono, nieto = found.values()
    assert (guivant.ekf.position_gate, guivant.ekf.stretch_sigma_m) == (math.inf, 0.1)
    for one in (ours, misono, nieto):
        assert (one.ekf.position_gate, one.ekf.stretch_sigma_m) == (None, None)
    assert nieto.ekf.nn_gate == pytest.approx(5.991464547)
    assert {one.ekf.nn_gate for one in (ours, guivant, misono)} == {13.82}
    assert nieto.log.sigmas == "published"
    assert {one.log.sigmas for one in (ours, guivant, misono)} == {"log"}
    asked = RunConfig.of(preset="guivant-2002", log=log, ekf=ekf | {"position_gate": 9.21})
    assert asked.ekf.position_gate == 9.21


@pytest.mark.parametrize("name", ["full", "compressed", "misono", "misono-full"])
def test_the_gate_of_positions_reaches_the_filter(name: str) -> None:
    log = open_log("waypoint-run")
    for asked, gate in ((math.inf, math.inf), (4.0, 4.0), (None, 13.82)):
        config = run_config(filter=name, gps="on").ekf.model_copy(update={"position_gate": asked})
        found = build_ekf(log, settle(config, log), Trace()).fixes.gate
        assert found == (math.inf if name == "misono" and asked is None else gate)


def test_positions_have_the_sigma_that_is_asked_for() -> None:
    asked = load_log(LogSection(source="waypoint-run", sigma_position_m=0.4)).positions
    usual = load_log(LogSection(source="waypoint-run")).positions
    assert asked is not None
    assert usual is not None
    assert np.array_equal(asked.covariance, np.tile(0.4**2 * np.eye(2), (len(asked.time_s), 1, 1)))
    assert np.array_equal(asked.position_m, usual.position_m)
    assert not np.array_equal(asked.covariance, usual.covariance)
    without = LogSection(source="simulated-loop", sigma_position_m=0.3)
    assert load_log(without).positions is None


def _there(row: Documented, config: dict[str, object]) -> bool:
    section = row.at.partition(".")[0]
    return section not in EXTENSIONS or section in config["extensions"]  # type: ignore[operator]


def test_the_gate_reaches_the_association() -> None:
    log = open_log("simulated-loop")
    for preset, gate in (("recommended", NearestNeighbour.gate), ("nieto-2005", 5.991464547)):
        config = run_config(preset=preset, association="nn").ekf
        rule = build_association(log, config)
        assert isinstance(rule, NearestNeighbour)
        assert rule.gate == pytest.approx(gate)
    assert setting_default("ekf.nn_gate") == NearestNeighbour.gate


def test_what_is_given_lies_over_the_preset() -> None:
    config = configure(
        RunConfig,
        flags=run_options({"preset": "nieto-2005", "dense": ["points"]}),
        settings=["dense_maps.known_apart_m=0.3"],
    )
    found = config.model_dump(mode="python")
    assert read(found, "dense_maps.known_apart_m") == 0.3
    assert [row.at for row, _ in differing(found, setting_default)] == ["dense_maps.known_apart_m"]


def test_a_recorded_run_can_be_repeated_and_turned(tmp_path: Path) -> None:
    file = tmp_path / "config.toml"
    first = published_run(dense=["points"])
    file.write_text(first.toml())
    assert configure(RunConfig, file) == first
    turned = configure(RunConfig, file, run_options({"preset": "recommended"}))
    assert turned == run_config(dense=["points"])
    file.write_text(turned.toml())
    assert configure(RunConfig, file, run_options({"preset": "nieto-2005"})) == first


def test_a_preset_is_the_same_as_a_flag_and_as_a_setting(tmp_path: Path) -> None:
    file = tmp_path / "config.toml"
    file.write_text(run_config(dense=["points"]).toml())
    turned = configure(RunConfig, file, settings=["preset=nieto-2005"])
    assert turned == published_run(dense=["points"])
    assert differing(turned.model_dump(mode="python"), setting_default) == []


def test_what_was_asked_for_beside_a_preset_stays_under_another(tmp_path: Path) -> None:
    file = tmp_path / "config.toml"
    asked = ["dense_maps.known_apart_m=0.3", "dense_maps.p_free=0.4"]
    for first, then in (("recommended", "nieto-2005"), ("nieto-2005", "recommended")):
        flags = run_options({"preset": first, "dense": ["points"]})
        file.write_text(configure(RunConfig, flags=flags, settings=asked).toml())
        turned = configure(RunConfig, file, run_options({"preset": then}))
        flags = run_options({"preset": then, "dense": ["points"]})
        assert turned == configure(RunConfig, flags=flags, settings=asked)


def test_a_result_says_which_settings_are_not_the_documents() -> None:
    ours = settings_result(run_config(dense=["points"]))
    assert "dense_maps.known_apart_m" in [one.setting for one in ours.differing]
    (row,) = (row for row in ours.rows() if row.quantity == "dense_maps.known_apart_m")
    assert row.value == "0.5 m, 1.5 m on scan landmarks alone"
    assert " in N 3.5" in row.band
    written = json.dumps(ours.model_dump(mode="json"), allow_nan=False)
    assert '"document": "Infinity"' in written  # of the longest edge, which JSON cannot hold
    theirs = settings_result(published_run(dense=["points"]))
    assert theirs.rows() == [Row("Settings", "preset", "nieto-2005")]
    by_labels, by_place = (
        [row.quantity for row in settings_result(run_config(association=rule)).rows()]
        for rule in ("known", "nn")
    )
    assert by_labels == ["preset"]
    assert "ekf.nn_gate" in by_place


def test_what_depends_on_the_format_of_the_log(tmp_path: Path) -> None:
    row = next(row for row in SETTINGS if row.at == "log.sigmas")
    assert row.when == {"log.format": FORMATS}
    (tmp_path / "data_set.mat").write_bytes(b"")
    found = configure(
        RunConfig,
        flags=run_options({"preset": "nieto-2005"}),
        over={"log": {"source": str(tmp_path)}},
    )
    assert (found.log.sigmas, found.log.format) == ("published", None)
    assert published_run().log.sigmas == "log"
    ours = settings_result(run_config(association="known"), "acfr-car-park")
    named = [one.setting for one in ours.differing]
    assert named == ["log.sigmas"]


def has_table_a_1(log: Log) -> bool:
    """Nieto 2005, Table A.1."""
    assert isinstance(log.odometry, SteeringOdometry)
    noise, seen = log.odometry.noise, log.measurements
    wheels = (noise.sigma_speed_mps, np.rad2deg(noise.sigma_turn))
    laser = np.column_stack((seen.sigma_range_m, np.rad2deg(seen.sigma_bearing_rad)))
    return bool(np.allclose(wheels, (0.2, 2.0)) and np.allclose(laser, (0.15, 1.5)))


@pytest.mark.parametrize("name", FORMATS)
def test_a_log_of_the_vehicle_gets_all_of_the_table(name: str) -> None:
    log = replace(first_seconds(simulated(), 5.0), format=name)
    found = with_published_sigmas(log)
    assert has_table_a_1(found)
    assert not has_table_a_1(log)
    assert not has_table_a_1(replace(found, odometry=log.odometry)), "of the measurements alone"
    assert not has_table_a_1(replace(found, measurements=log.measurements)), "of the wheels alone"
    assert np.array_equal(found.measurements.range_m, log.measurements.range_m)
    assert isinstance(found.odometry, SteeringOdometry)
    assert isinstance(log.odometry, SteeringOdometry)
    noise, old = found.odometry.noise, log.odometry.noise
    assert noise.variance_rate_position == old.variance_rate_position
    assert noise.variance_rate_heading == old.variance_rate_heading
    assert found.provenance["sigmas"] == "Nieto 2005, Table A.1"


def test_another_log_keeps_its_own() -> None:
    log = simulated()
    assert with_published_sigmas(log) is log


def test_the_car_park_with_either(shared_data: Path) -> None:
    source = str(shared_data / "acfr_car_park")
    usual = load_log(LogSection(source=source))
    kept = read_log(Path(source))
    assert np.array_equal(usual.measurements.sigma_range_m, kept.measurements.sigma_range_m)
    assert not has_table_a_1(usual)
    assert has_table_a_1(load_log(LogSection(source=source, sigmas="published")))
