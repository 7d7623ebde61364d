"""Every setting of every job and extension has an effect: what runs holds or refuses its value."""

import hashlib
import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from types import FunctionType, MethodType, SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np
import pytest

import slamcheck
from comparisons.adapters.ekf_factory import build_ekf, settle
from comparisons.adapters.time_window import cut_log
from comparisons.config import (
    JOBS,
    CheckConfig,
    EkfConfig,
    ExtensionConfig,
    FrontEndConfig,
    LogSection,
    MapConfig,
    OdometryConfig,
    ReportConfig,
    RunConfig,
    SettingsGroup,
    SmootherConfig,
    SolveConfig,
    choices_of,
    config_class,
    setting,
)
from comparisons.errors import InputError
from comparisons.extension_names import EXTENSIONS
from comparisons.extensions.dense_maps import source as dense_source
from comparisons.extensions.dense_maps.config import DenseMapsConfig
from comparisons.extensions.dense_maps.job import DenseMapping, map_log
from comparisons.extensions.dense_maps.report import _layer_files
from comparisons.extensions.fastslam import extension as fastslam
from comparisons.extensions.fastslam.config import FastSlamConfig
from comparisons.extensions.scan_motion import job as front_end_job
from comparisons.jobs.run import Comparison
from comparisons.logs.log import Log
from comparisons.pipeline import read
from comparisons.pipeline.prepare import prepare
from comparisons.pipeline.solve import prepare_solve, solve
from comparisons.report.run import RunReport
from ekf_reference.core.trace import Trace
from ekf_reference.dense.layers.particles import Particles
from graphslam.scan.loop_closure import loop_closer
from tests.helpers import altered, compared, simulated
from tests.scenarios import scenario

ROOT = Path(__file__).resolve().parents[2]
Observer = Callable[[Any], object]
"""From a section to what runs with it."""
Contexts = Mapping[str, Sequence[Mapping[str, Any]]]
"""Fields of the section beside which a setting must have an effect, each time; "" of all others."""

_POINTS, _OCCUPANCY, _PARTICLES, _SOG = (
    {"layers": [name]} for name in ("points", "occupancy", "particles", "sog")
)
BESIDE: Mapping[str, Contexts] = {
    "ekf": {
        "association": ({"association": "known"},),  # which an open one may come to
        "nn_gate": ({"association": "nn"},),
        "least_gain": ({"filter": "compressed-suboptimal"},),
        "stretch_sigma_m": ({"gps": "on"},),
    },
    "smoother": {"lag": ({"method": "fixed-lag", "lag": 5},)},
    "dense_maps": {
        "": (_POINTS,),
        "resolution_m": (_POINTS, _OCCUPANCY),
        "d_min_m": (_PARTICLES, _SOG),
        "confidence": (_OCCUPANCY, _PARTICLES),
        "thinned": (_PARTICLES, _SOG),
        "p_occupied": (_OCCUPANCY, _PARTICLES),
        "p_free": (_OCCUPANCY, _PARTICLES),
        "least_weight": (_PARTICLES,),
        "coarsening": (_OCCUPANCY,),
    },
    "scan_landmarks": {
        "template_extraction": ({"template_extraction": "whole-scan"},),
        "tried": ({"template_extraction": "per-segment"},),
    },
}
_PRESET = "test_documented.py::test_a_document_s_preset_has_nothing_of_another"
SHOWN = {
    **{f"{job}.preset": _PRESET for job in JOBS},
    "run.fail_on": "test_qualifiers.py::test_a_truth_gap_has_an_exit_code_on_request",
    "odometry.cloud": "test_front_end.py::test_the_map_as_a_cloud",
    "check.estimate": "test_check_external.py::test_the_command",
    "check.require": "test_grades.py::test_the_command_takes_what_is_required",
    "check.min_coverage": "test_check_external.py::test_the_command",
}
"""Settings of what a job writes and of how it ends, and the test that shows the effect of each."""


class _StoppedError(Exception):
    """What a function was called with, in place of the call."""


def held(thing: object) -> str:
    """A hash of all values that a thing holds.

    Configurations that it merely keeps, and logs, are not among them.
    """
    digest = hashlib.sha256()
    for value in _values(thing, set()):
        digest.update(value)
    return digest.hexdigest()


def _values(thing: object, met: set[int]) -> Iterator[bytes]:
    yield type(thing).__qualname__.encode()
    if thing is None or isinstance(thing, bool | int | float | complex | str | bytes | np.generic):
        yield repr(thing).encode()
    elif isinstance(thing, np.ndarray):
        yield repr((thing.shape, thing.dtype)).encode()
        yield repr(thing.tolist()).encode() if thing.dtype == object else thing.tobytes()
    elif isinstance(thing, np.random.Generator):
        yield repr(thing.bit_generator.state).encode()
    elif isinstance(thing, type | Path):
        yield str(thing).encode()
    elif not isinstance(thing, SettingsGroup | Log) and id(thing) not in met:
        met.add(id(thing))
        for name, below in _parts(thing):
            yield name.encode()
            yield from _values(below, met)


def _parts(thing: object) -> list[tuple[str, object]]:
    """What a thing is made of, by name, in order."""
    if isinstance(thing, Mapping):
        return [(repr(key), value) for key, value in thing.items()]
    if isinstance(thing, list | tuple):
        return [(str(number), value) for number, value in enumerate(thing)]
    if isinstance(thing, set | frozenset):
        return [("", value) for value in sorted(thing, key=repr)]
    if isinstance(thing, partial):
        return [("called", thing.func), ("with", thing.args), ("named", thing.keywords)]
    if isinstance(thing, MethodType):
        return [(thing.__qualname__, thing.__self__)]
    if isinstance(thing, FunctionType):
        cells = thing.__closure__ or ()
        return [(thing.__qualname__, None), *(("cell", cell.cell_contents) for cell in cells)]
    slots = (name for kind in type(thing).__mro__ for name in getattr(kind, "__slots__", ()))
    found = {name: getattr(thing, name) for name in slots if hasattr(thing, name)}
    return [*found.items(), *getattr(thing, "__dict__", {}).items()]


def seen(observe: Observer, section: SettingsGroup) -> str:
    """What runs with a section: a hash of what it holds, or why it is refused."""
    try:
        return held(observe(section))
    except _StoppedError as call:
        return held(call.args)
    except InputError as error:
        return f"refused: {error}"


def another(kind: type[SettingsGroup], name: str, given: Mapping[str, Any]) -> SettingsGroup:
    """A section with another value of one setting, which its class takes."""
    now = getattr(kind.of(**given), name)
    number = isinstance(now, int | float) and not isinstance(now, bool)
    words = choices_of(kind.model_fields[name].annotation)
    values = [True, False, *words, *((word,) for word in words)]
    values += [0.9 * now, now + 1, now - 1] if number else []
    for value in (*values, 0.4, 3, {}, "other", ("other",), (1.0, 2.0, 3.0)):
        try:
            found = kind.of(**{**given, name: value})
        except InputError:
            continue
        if getattr(found, name) != now:
            return found
    raise AssertionError(f"{kind.__name__}.{name}: this test knows no other value than {now!r}")


def silent(kind: type[SettingsGroup], observe: Observer, beside: Contexts) -> list[str]:
    """Settings of a section that nothing which runs holds, with what stood beside them."""
    usual = cache(lambda text: seen(observe, kind.of(**given[text])))
    found, given = [], dict[str, Mapping[str, Any]]()
    for name in kind.model_fields:
        for fields in beside.get(name, beside.get("", ({},))):
            given[text := repr(fields)] = fields
            if seen(observe, another(kind, name, fields)) == usual(text):
                found.append(f"{name} {text}" if fields else name)
    return found


@cache
def with_positions() -> Log:
    """A log of points and positions."""
    return cut_log(scenario("waypoint-run"), end_s=20.0)


@cache
def with_scans() -> Log:
    """A log of points and scans."""
    return cut_log(scenario("occupancy-loop"), end_s=4.0)


@cache
def comparison() -> Comparison:
    return compared(simulated(loop_s=10.0))


def of_log(section: LogSection) -> object:
    """The log as a job reads it; the file is replaced by a log of the thesis' vehicle."""
    log = replace(with_scans(), format="acfr-car-park", positions=with_positions().positions)
    opened = mock.Mock(return_value=log)
    with mock.patch.object(read, "open_log", opened):
        found, *_ = read.read_for(RunConfig(log=section))
    return opened.call_args.args, vars(found)


def of_filter(ekf: EkfConfig) -> object:
    """The filter, and the positions that it is given."""
    settled = settle(ekf, with_positions())
    built = build_ekf(with_positions(), settled, Trace())
    return built, prepare(with_positions(), RunConfig(ekf=ekf)).positions


def of_smoother(smoother: SmootherConfig) -> object:
    """What the smoother finds."""
    return solve(simulated(loop_s=10.0), SolveConfig(smoother=smoother)).result


def of_report(report: ReportConfig) -> object:
    """The names of what a run writes."""
    c = comparison()
    config = c.prepared.config.model_copy(update={"report": report})
    folder = RunReport.of(altered(c, "known.prepared.config", config)).folder()
    return list(folder.files), list(folder.figures)


def of_front_end(front_end: FrontEndConfig) -> object:
    """The graph that the front end solves, and the matchers that close its loops."""
    closers = mock.Mock(wraps=loop_closer)
    with (
        mock.patch.object(front_end_job, "loop_closer", closers),
        mock.patch.object(front_end_job, "smooth", side_effect=_StoppedError) as solved,
        pytest.raises(_StoppedError),
    ):
        front_end_job.run_front_end(with_scans(), OdometryConfig(front_end=front_end))
    matchers = [type(call.args[1]).__name__ for call in closers.call_args_list]
    return matchers, solved.call_args.args


def of_solve(config: SolveConfig) -> object:
    """What is settled before the smoother runs."""
    prepared = prepare_solve(with_positions(), config)
    return prepared.labelled, prepared.positions


def of_check(config: CheckConfig) -> object:
    """How the estimate is read."""
    name = "comparisons.estimates.external.read_external"
    with mock.patch(name, side_effect=_StoppedError) as called, pytest.raises(_StoppedError):
        slamcheck.check("simulated-loop", "one.tum", config)
    return called.call_args.args


@cache
def mapping() -> DenseMapping:
    layers = DenseMapsConfig(layers=("points",), resolution_m=1.0)
    return map_log(with_scans(), MapConfig(extensions={"dense_maps": layers}))


def of_map(config: MapConfig) -> object:
    """The names of a map's files."""
    prepared = replace(mapping().prepared, config=config)
    return list(_layer_files(replace(mapping(), prepared=prepared)))


def of_extension(name: str) -> Observer:
    """The extension, and what it puts beside a filter."""

    def beside(section: ExtensionConfig) -> object:
        config = RunConfig(extensions={name: section})
        if name == "scan_motion":  # scan odometry would run
            return section.build(config)
        prepared = prepare(with_scans(), config)
        return prepared.extensions, prepared.beside_filter()

    return beside


def of_fastslam(section: FastSlamConfig) -> object:
    """The extension, and how many clouds it asks for."""
    config = RunConfig(extensions={"fastslam": section})
    extension, stretches = section.build(config), mock.Mock()
    stretches.return_value.run.side_effect = lambda clouds, _: _stop(clouds, extension)
    known: Any = SimpleNamespace(
        prepared=prepare(with_scans(), config), ekf=comparison().ekf, gaps=comparison().known.gaps
    )
    with (
        mock.patch.object(fastslam, "StretchComparison", stretches),
        mock.patch.object(fastslam.FastSlamExtension, "cloud"),
    ):
        return extension.find(known)


def _stop(*found: object) -> None:
    raise _StoppedError(*found)


OBSERVERS: Mapping[str, tuple[type[SettingsGroup], Observer]] = {
    "log": (LogSection, of_log),
    "ekf": (EkfConfig, of_filter),
    "smoother": (SmootherConfig, of_smoother),
    "report": (ReportConfig, of_report),
    "front_end": (FrontEndConfig, of_front_end),
    **{name: (config_class(name), of_extension(name)) for name in EXTENSIONS},
    "fastslam": (FastSlamConfig, of_fastslam),
}
SINGLE: Mapping[str, tuple[Observer, Mapping[str, Any]]] = {
    "solve.association": (of_solve, {"association": "known"}),
    "solve.gps": (of_solve, {}),
    "check.association": (of_solve, {"association": "known"}),
    "check.gps": (of_solve, {}),
    "check.times": (of_check, {}),
    "check.trace": (of_check, {}),
    "map.cloud": (of_map, {}),
}
"""Settings of a job itself, with the fields beside which they must have an effect."""


@pytest.mark.parametrize("name", OBSERVERS)
def test_every_setting_of_a_section_has_an_effect(name: str) -> None:
    assert silent(*OBSERVERS[name], BESIDE.get(name, {})) == []


@pytest.mark.parametrize("path", SINGLE)
def test_every_setting_of_a_job_has_an_effect(path: str) -> None:
    job, _, name = path.partition(".")
    observe, given = SINGLE[path]
    kind = JOBS[job]
    assert seen(observe, another(kind, name, given)) != seen(observe, kind.of(**given))


def test_every_section_and_setting_of_every_job_is_among_them() -> None:
    missing = []
    for job, kind in JOBS.items():
        for name, field in kind.model_fields.items():
            section = inspect.isclass(field.annotation) and issubclass(
                field.annotation, SettingsGroup
            )
            known = name in OBSERVERS if section else {f"{job}.{name}"} & {*SINGLE, *SHOWN}
            if not known and name not in ("job", "extensions"):
                missing.append(f"{job}.{name}")
    assert missing == []
    for test in SHOWN.values():
        file, _, function = test.partition("::")
        assert f"def {function}(" in (ROOT / "tests/comparisons" / file).read_text(), test


class WithUnused(DenseMapsConfig):
    """A setting more, which nobody uses."""

    unused: float = setting(0.5, "Nothing")


def test_a_setting_that_nobody_uses_is_found() -> None:
    observe = of_extension("dense_maps")
    assert silent(WithUnused, observe, BESIDE["dense_maps"]) == [f"unused {_POINTS}"]


def test_a_layer_that_a_setting_does_not_reach_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """As particles were, which had the thesis' probabilities whatever config.toml said."""

    def without_model(rng: np.random.Generator, model: object, **others: Any) -> Particles:
        return Particles(rng, **others)

    monkeypatch.setattr(dense_source, "Particles", without_model)
    found = silent(DenseMapsConfig, of_extension("dense_maps"), BESIDE["dense_maps"])
    assert found == [f"{name} {_PARTICLES}" for name in ("p_occupied", "p_free")]
