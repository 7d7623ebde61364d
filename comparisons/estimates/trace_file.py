"""What a filter linearised where, on disk, so that another's algebra can be judged."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.errors import InputError, outdated_format, quoted
from comparisons.estimates.event_arrays import PlanarEvents, event_arrays
from comparisons.estimates.landmark_names import LandmarkNames
from comparisons.logs.validation import LARGEST
from comparisons.rounding import stored_rounding
from comparisons.trace.reader import TraceReader
from ekf_reference.core.landmark_types import POINT, POSE
from ekf_reference.core.trace import (
    VEHICLE,
    MeasurementRecords,
    TraceArrays,
    removal_records,
    stack_records,
)

TRACE, OUTDATED_TRACE = "filter.trace", "trace.npz"
"""In an estimate folder; the latter is refused."""

_COVARIANCES = (
    *("prior_covariance", "step_q", "update_noise", "initialise_noise", "position_noise"),
)
_MAY_BE_NOTHING = ("prior_covariance", "step_q")
"""A start may be known exactly, and a step may have fewer noises than states."""
_WHOLE = ("step", "measurement", "landmark", "number")


@dataclass(frozen=True, kw_only=True)
class TraceFile:
    """A filter's trace with the time (N,) at which each step ends, and where it was read.

    Landmark indices are those of blocks, the landmarks' names in the file, and once they are
    `placed`, when there are no blocks, places in the estimate's list of landmarks. Headings are
    unwrapped along the trace; `spread` and `whitened` are zero, for no gap needs them. rounding:
    what storing has done to the numbers, relative to them: 2^-24 where all are of single precision,
    else nothing.
    remarks: on the file. unsound: which noise, or prior, is no covariance, in words. removed: which
    blocks the filter has removed; once placed, their landmarks have the places behind the
    estimate's list, and the numbers removed_id.
    """

    path: Path
    step_time_s: Array
    trace: TraceArrays
    remarks: tuple[str, ...]
    unsound: str = ""
    rounding: float = 0.0
    blocks: tuple[str, ...] = ()
    removed: tuple[int, ...] = ()
    removed_id: tuple[int, ...] = ()

    @property
    def measurements_used(self) -> int:
        """How many measurements of the log it used, each counted once."""
        uses = self.trace.measurements[POINT], self.trace.initialisations[POINT]
        number = np.concatenate([use.number for use in uses])
        return len(np.unique(number[number >= 0]))

    def placed(self, names: LandmarkNames) -> TraceFile:
        """Return the trace with the places of its blocks' landmarks in the estimate's list.

        names: of the estimate's landmarks, in their order. Raises InputError unless each of them is
        initialised once.
        """
        if not self.blocks:
            return self
        place_of = {number: place for place, number in enumerate(names.numbers)}
        held = [k for k in range(len(self.blocks)) if k not in set(self.removed)]
        numbers = names.of_blocks([self.blocks[k] for k in held])
        if None in numbers:
            block = quoted(self.blocks[held[numbers.index(None)]])
            raise InputError(
                f"{self.path}: block {block} must end in the number or label of a landmark in "
                "landmarks.csv, or be recorded as removed"
            )
        places = np.empty(len(self.blocks), dtype=np.intp)
        places[held] = [place_of[number] for number in numbers if number is not None]
        places[list(self.removed)] = len(place_of) + np.arange(len(self.removed))
        begun = places[self.trace.initialisations[POINT].landmark_index]
        times = np.bincount(begun, minlength=len(place_of))[: len(place_of)]
        if (wrong := np.flatnonzero(times != 1)).size:
            name = names.called(int(wrong[0]))
            raise InputError(
                f"{self.path}: landmark {name} is initialised {times[wrong[0]]} times, expected "
                "once"
            )
        removed_id = names.of_removed([self.blocks[k] for k in self.removed])
        trace = _at_places(self.trace, places)
        return replace(self, blocks=(), removed=(), removed_id=removed_id, trace=trace)


def _at_places(trace: TraceArrays, places: Index) -> TraceArrays:
    """A trace with places (B,) in the place of blocks' indices."""
    moved = [
        {
            **records,
            POINT: replace(records[POINT], landmark_index=places[records[POINT].landmark_index]),
        }
        for records in (trace.measurements, trace.initialisations)
    ]
    return replace(trace, measurements=moved[0], initialisations=moved[1])


def read_trace(path: Path) -> TraceFile:
    """Read a trace. Raises InputError naming the event."""
    if path.suffix == Path(OUTDATED_TRACE).suffix:
        mend = "record the filter anew with slamcheck.Recorder"
        raise outdated_format(path, "a trace in arrays", mend)
    trace = TraceReader(path)
    planar = event_arrays(trace)
    unsound = ""
    if faults := trace.unsound | trace.singular:  # its equations have an inverse of every R
        event, what = min(faults.items())
        others = len(faults) - 1
        unsound = f"{what} at event {event}" + (f", and so at {others:,} more" if others else "")
    return _checked(path, planar, trace.remarks, unsound)


def _checked(
    path: Path,
    planar: PlanarEvents,
    remarks: tuple[str, ...],
    unsound: str = "",
) -> TraceFile:
    """Return arrays as a trace, once their contents are checked. unsound: as known so far."""
    found = planar.arrays
    rounding = stored_rounding(*(array for name, array in found.items() if _is_figure(name)))
    _check_contents(path, found)
    unsound = unsound or _unsound(found, rounding)
    _unwrap(found)
    begun, updated = (
        found[f"{part}_landmark"].astype(np.intp) for part in ("initialise", "update")
    )
    count = len(found["position_step"])
    none_of_poses = stack_records([], POSE.width, POSE)
    return TraceFile(
        path=path,
        step_time_s=found["step_time_s"],
        trace=TraceArrays(
            prior_pose=found["prior_pose"],
            prior_covariance=found["prior_covariance"],
            departed=found["step_departed"],
            arrived=found["step_arrived"],
            f=found["step_f"],
            q=found["step_q"],
            measurements={
                POINT: _records(found, "update", updated, "jacobian_landmark"),
                POSE: none_of_poses,
            },
            initialisations={
                POINT: _records(found, "initialise", begun, "jacobian_measurement"),
                POSE: none_of_poses,
            },
            positions=_records(found, "position", np.full(count, -1), None),
            merges=none_of_poses,
            removals=removal_records([]),
        ),
        remarks=remarks,
        unsound=unsound,
        rounding=rounding,
        blocks=planar.blocks,
        removed=planar.removed,
    )


def _is_figure(name: str) -> bool:
    """Of what was computed: no time, weight or number."""
    return name.partition("_")[2] not in (*_WHOLE, "weight", "time_s")


def _number(part: str) -> str:
    """Return the name of the column of the measurements' numbers."""
    return f"{part}_{'number' if part == 'position' else 'measurement'}"


def _records(
    found: dict[str, Array], part: str, landmark_index: Index, jacobian_other: str | None
) -> MeasurementRecords:
    """Return the records of one part of the file; without landmarks where it names none."""
    noise = found[f"{part}_noise"]
    nothing, none = np.zeros(noise.shape[:2]), noise[:, :, :0]
    return MeasurementRecords(
        step=found[f"{part}_step"].astype(np.intp),
        number=found[_number(part)].astype(np.intp),
        landmark_index=landmark_index,
        pose=found[f"{part}_pose"],
        landmark=found.get(f"{part}_point", nothing[:, :0]),
        innovation=found.get(f"{part}_innovation", nothing),
        jacobian_pose=found[f"{part}_jacobian_pose"],
        jacobian_other=none if jacobian_other is None else found[f"{part}_{jacobian_other}"],
        noise=noise,
        spread=np.zeros_like(noise),
        whitened=nothing,
        weight=found[f"{part}_weight"],
        origin=np.full(len(noise), VEHICLE),
    )


def _check_contents(path: Path, found: dict[str, Array]) -> None:
    """Orders, whole numbers and weights."""
    if not len(found["step_time_s"]):
        raise InputError(f"{path}: holds no steps")
    if (np.diff(found["step_time_s"]) <= 0).any():
        raise InputError(f"{path}: step_time_s must increase")
    for part in ("update", "initialise", "position"):
        number, weight = found[_number(part)], found[f"{part}_weight"]
        if (number != np.round(number)).any():
            raise InputError(f"{path}: {_number(part)} holds a value that is not a whole number")
        smallest = 0.0 if part == "initialise" else 1e-9
        if not ((weight >= smallest) & (weight <= 1.0)).all():
            raise InputError(f"{path}: {part}_weight holds a value outside {smallest:g} to 1")


def _unsound(found: dict[str, Array], rounding: float) -> str:
    """Say which is the first that is no covariance; what is all but symmetric is made so."""
    for name in _COVARIANCES:
        matrices = found[name].reshape(-1, *found[name].shape[-2:])
        if not (np.abs(matrices) <= LARGEST**2).all():
            return f"{name} is not finite, or too large"
        least = np.linalg.eigvalsh(matrices)[:, 0] if len(matrices) else np.zeros(0)
        scale = np.abs(matrices).max(axis=(1, 2), initial=0.0)
        close = 1e-9 + 64.0 * rounding
        positive = least >= -close * scale if name in _MAY_BE_NOTHING else least > 0.0
        skew = np.abs(matrices - matrices.transpose(0, 2, 1)).max(axis=(1, 2), initial=0.0)
        bad = np.flatnonzero(~positive | (skew > close * scale))
        if len(bad):
            return f"{name}, row {bad[0]}, is not symmetric and positive definite"
        found[name] = 0.5 * (found[name] + np.swapaxes(found[name], -1, -2))
    return ""


def _unwrap(found: dict[str, Array]) -> None:
    """Headings without jumps along the trace, whatever the filter wraps and when."""
    departed, arrived = found["step_departed"].copy(), found["step_arrived"].copy()
    start = found["prior_pose"][2:]
    steps = np.column_stack((departed[:, 2], arrived[:, 2])).ravel()
    along = np.unwrap(np.concatenate((start, steps)))
    departed[:, 2], arrived[:, 2] = along[1::2], along[2::2]
    found |= {"step_departed": departed, "step_arrived": arrived}
    reached = along[0::2]
    for part in ("update", "initialise", "position"):
        pose = found[f"{part}_pose"].copy()
        apart = reached[found[f"{part}_step"].astype(np.intp)] - pose[:, 2]
        pose[:, 2] += 2.0 * np.pi * np.round(apart / (2.0 * np.pi))
        found[f"{part}_pose"] = pose
