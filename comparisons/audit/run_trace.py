"""A run of the reference EKF as a file for `slamcheck audit`."""

from __future__ import annotations

from pathlib import Path

from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Array
from comparisons.audit.own_filter import run_events
from comparisons.trace.events import (
    Augment,
    Directions,
    Event,
    Predict,
    Remove,
    Snapshot,
    TracePrior,
    Update,
)
from comparisons.trace.recorder import AugmentationNotes, MeasurementNotes, Recorder


def write_run(run: EkfRun, path: Path) -> None:
    """Write a run's trace for `slamcheck audit`, in a folder that is synced as a whole.

    Args:
        run: As the filter made it.
        path: Of the trace.

    Raises:
        InputError: The file exists already, or cannot be written.
    """
    components = {name: sensor.components for name, sensor in run.sensors.items()}
    with Recorder(path, components=components, synced=False) as record:
        for event in run_events(run):
            if event.time_s is not None:
                record.at(event.time_s)
            write_event(event, record)


def write_event(event: Event, record: Recorder) -> None:
    """Record an event of a run again, at the recorder's time.

    Args:
        event: As `run_events` yields it, or as it was read.
        record: A recorder that has recorded the events before.
    """
    match event:
        case TracePrior():
            blocks = dict(zip(event.blocks, event.dims, strict=True))
            charts = dict(zip(event.blocks, event.charts, strict=False))
            record.prior(blocks, event.covariance, point=event.point, charts=charts)
        case Directions():
            basis = dict(zip(event.names, event.basis.T, strict=True))
            record.directions(basis, event.blind, blocks=event.blocks)
        case Predict():
            points = {"point": event.point, "after": event.after}
            record.predict(event.jacobian, event.noise, event.blocks, **points)
        case Augment():
            notes: AugmentationNotes = {"numbers": _needed(event.numbers), "weight": event.weight}
            notes |= {"point": _needed(event.point), "after": _needed(event.after)}
            g_x, g_z = event.jacobian, event.noise_jacobian
            record.augment(event.name, g_x, g_z, event.noise, event.blocks, **notes)
        case Update():
            more: MeasurementNotes = {"point": _needed(event.point), "weight": event.weight}
            more["numbers"] = _needed(event.numbers)
            if event.correction is not None:
                more["correction"] = event.correction
            h, r = event.jacobian, event.noise
            record.update(event.sensor, event.residual, h, r, event.blocks, **more)
        case Remove():
            record.remove(*event.blocks)
        case Snapshot():
            record.snapshot(event.covariance, event.blocks, mean=event.mean)
        case _:
            raise TypeError(f"a run of the EKF has no {type(event).__name__}")


def _needed(values: Array | None) -> Array:
    """What every event of a run has."""
    if values is None:
        raise TypeError("a run's events have their points")
    return values
