"""Which filter, association and sensors a run uses, and the filter that this makes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.attributes import check_attributes, no_estimates
from comparisons.arrays import Array
from comparisons.config import EkfConfig
from comparisons.errors import InputError
from comparisons.logs.log import Log, Positions
from comparisons.logs.odometry import RelativePoses, SteeringOdometry, own_integration
from comparisons.logs.transforms.known_landmarks import surveyed
from ekf_reference.association.attributes import NO_ATTRIBUTES, Attributes, RememberedAttributes
from ekf_reference.association.known import KnownAssociation, SurveyedLandmarks
from ekf_reference.association.nearest_neighbour import EuclideanNeighbour, NearestNeighbour
from ekf_reference.core.ekf import Ekf, Stabilisation
from ekf_reference.core.measurement_update import UpdateSplitter
from ekf_reference.core.measurements import Association
from ekf_reference.core.trace import Trace
from ekf_reference.models.motion import (
    AckermannModel,
    IntegratedModel,
    MotionModel,
    RelativePoseModel,
    UnicycleModel,
)
from ekf_reference.models.position import PositionFixes, PositionModel

Common = tuple[MotionModel, Association, Array, Array, Stabilisation, Trace]
"""What every filter is made of: motion, association, prior, its covariance, noise, trace."""
LEAST_GAIN = 1e-4
"""c1 of the suboptimal global update, the example of Guivant 2002, eq. 22."""
SHARE = 0.6
"""Of all states in an area from which on the exact compressed filter takes them all: to keep phi
would cost more than it saves."""
LEAST_BLOCK_S, LEAST_BLOCKS = 60.0, 4
"""Shortest blocks of positions of which every second one is held out; shorter ones where these
would be fewer. A receiver's errors are alike for some ten seconds: a position between two that are
fused shows how well a filter follows the receiver."""
NO_GATE = float("inf")
"""Of labels and positions in Misono's published filter, which rejects nothing."""
WIDER = 2.0
"""Misono 2007, section 3.4: d_min is larger than the way of one sample; so many times, at least."""


def settle(config: EkfConfig, log: Log) -> EkfConfig:
    """Return the settings with nothing left open.

    Raises InputError for what the log cannot serve.
    """
    if config.gps != "off" and (log.positions is None or not len(log.positions.time_s)):
        raise InputError(f"{log.name}: holds no positions to fuse; use --gps off")
    if config.association is None:
        known = log.measurements.labelled and config.attributes == "off"
        return settle(config.model_copy(update={"association": "known" if known else "nn"}), log)
    if config.association == "known" and not log.measurements.labelled:
        raise InputError(
            f"{log.name}: its measurements do not all name their landmark; use --association nn"
        )
    if config.attributes != "off":
        check_attributes(log)
    return config


def build_ekf(log: Log, choices: EkfConfig, trace: Trace) -> Ekf:
    """The filter that a log and settled choices call for, standing at its prior."""
    prior, rule = log.prior, build_association(log, choices)
    added = stabilisation(log)
    common = (motion_model(log), rule, prior.pose, prior.covariance, added, trace)
    antenna = log.positions.antenna_m if log.positions is not None else (0.0, 0.0)
    make = _misono if choices.own_axes else _of_headings
    ekf = make(choices, common, antenna)
    splitter = _bounded(ekf.fixes.splitter, choices)
    ekf.splitter = _bounded(ekf.splitter, choices)
    gate = ekf.fixes.gate if choices.position_gate is None else choices.position_gate
    ekf.fixes = replace(ekf.fixes, gate=gate, splitter=splitter, recovery=choices.gps_recovery)
    return ekf


def _bounded(splitter: UpdateSplitter, choices: EkfConfig) -> UpdateSplitter:
    """A splitter with the bounds that were chosen in place of its own."""
    return replace(
        splitter,
        largest_turn_rad=choices.split_turn_rad or splitter.largest_turn_rad,
        largest_move_m=choices.split_move_m or splitter.largest_move_m,
        largest_shrink=choices.split_shrink or splitter.largest_shrink,
    )


def _of_headings(choices: EkfConfig, common: Common, antenna: tuple[float, float]) -> Ekf:
    """A filter of x, y and heading, with all its covariance or with what is near."""
    ekf: Ekf
    if choices.filter == "full":
        ekf = Ekf(*common)
    else:
        from ekf_reference.filters.compressed import CompressedEkf, LocalAreas

        gain = LEAST_GAIN if choices.least_gain is None else choices.least_gain
        areas = (
            LocalAreas(least_gain=gain) if choices.conservative else LocalAreas(most_share=SHARE)
        )
        ekf = CompressedEkf(*common, areas)
    ekf.fixes = PositionFixes(PositionModel(antenna))
    return ekf


def _misono(choices: EkfConfig, common: Common, antenna: tuple[float, float]) -> Ekf:
    """A filter of direction cosines, as published or with all of its Jacobian."""
    from ekf_reference.filters.misono import (
        DirectionCosineEkf,
        DirectionCosineOptions,
        DirectionCosinePosition,
    )

    ours = choices.filter == "misono-full"
    options = DirectionCosineOptions(full_jacobian=ours, renormalise=ours, stacked=ours)
    ekf = DirectionCosineEkf(*common, options=options)
    gate = PositionFixes.gate if ours else NO_GATE
    ekf.fixes = PositionFixes(DirectionCosinePosition(antenna), gate)
    return ekf


def d_min_exceeds_way() -> bool:
    """Return whether d_min is larger than the way of one sample, whatever the log."""
    return WIDER > 1.0


def longest_sample_m(log: Log) -> float:
    """The longest way that the vehicle goes in one sample of its odometry."""
    odometry = log.odometry
    if isinstance(odometry, RelativePoses):
        way = np.hypot(*odometry.displacement[:, :2].T)
    else:
        way = np.abs(odometry.speed_mps[:-1]) * np.diff(odometry.time_s)
    return float(way.max(initial=0.0))


def motion_model(log: Log) -> MotionModel:
    """How the log's vehicle moves under its odometry."""
    if isinstance(log.odometry, RelativePoses):
        return RelativePoseModel()
    own = own_integration(log.odometry)
    model: MotionModel = UnicycleModel()
    if isinstance(log.odometry, SteeringOdometry):
        model = AckermannModel(**vars(log.odometry.vehicle))
    asked = log.integration or own
    return model if asked == own else IntegratedModel(model, own, asked)


def stabilisation(log: Log) -> Stabilisation:
    """The noise that every step adds; of relative poses the usual one."""
    if isinstance(log.odometry, RelativePoses):
        return Stabilisation()
    noise = log.odometry.noise
    return Stabilisation(noise.variance_rate_position, noise.variance_rate_heading)


def fused_positions(log: Log, choices: EkfConfig) -> Positions | None:
    """The positions that the estimators are given: within the log's time, in order."""
    return None if log.positions is None else _rows(log.positions, _fused(log, choices))


def held_out_positions(log: Log, choices: EkfConfig) -> Positions | None:
    """The positions that accuracy is measured against: none that was given to the estimators.

    Within the log's time, as those are.
    """
    if log.positions is None:
        return None
    return _rows(log.positions, np.setdiff1d(_inside(log, log.positions), _fused(log, choices)))


def _inside(log: Log, positions: Positions) -> NDArray[np.intp]:
    """Positions within the log's time."""
    time = positions.time_s
    return np.flatnonzero((time >= log.prior.time_s) & (time <= log.end_s))


def _fused(log: Log, choices: EkfConfig) -> NDArray[np.intp]:
    if log.positions is None or choices.gps == "off":
        return np.zeros(0, dtype=np.intp)
    inside = _inside(log, log.positions)
    if choices.gps != "half" or not len(inside):
        return inside
    fused: NDArray[np.intp] = inside[hold_out_blocks(log.positions.time_s)[inside] % 2 == 0]
    return fused


def hold_out_blocks(time_s: Array) -> NDArray[np.intp]:
    """Return the block (N,) of each position, equally long ones. time_s: (N,) ascending.

    Of all positions of a log, so that they are the same whatever part of it is used.
    """
    duration_s = float(time_s[-1] - time_s[0])
    count = max(LEAST_BLOCKS, int(duration_s / LEAST_BLOCK_S))
    share = (time_s - time_s[0]) / (duration_s or 1.0)
    blocks: NDArray[np.intp] = np.minimum((share * count).astype(np.intp), count - 1)
    return blocks


def _rows(p: Positions, rows: NDArray[np.intp]) -> Positions | None:
    return p.chosen(rows) if len(rows) else None


def build_association(log: Log, choices: EkfConfig) -> Association:
    """The rule; detections that need confirmation pass as candidates first.

    Measurements of surveyed landmarks go by their labels in any case. Misono's published filter has
    no gate for labels.
    """
    index_of, _, _ = surveyed(log)
    rule: Association
    memory = no_estimates() if choices.attributes != "off" else None
    reported: Attributes = memory or NO_ATTRIBUTES
    if choices.association == "known":
        gate = NO_GATE if choices.filter == "misono" else log.measurements.label_gate
        rule = KnownAssociation(gate, first_index=len(index_of))
    else:
        rule = _rule(choices, reported, log)
        if log.measurements.needs_confirmation:
            from ekf_reference.association.landmark_initiation import LandmarkInitiation

            rule = LandmarkInitiation(rule=rule)
    if index_of:
        gate = NO_GATE if choices.filter == "misono" else SurveyedLandmarks.gate
        rule = SurveyedLandmarks(rule, index_of, gate)
    return rule if memory is None else RememberedAttributes(rule, memory)


def _rule(choices: EkfConfig, attributes: Attributes, log: Log) -> Association:
    """A rule that needs no labels, by name."""
    name = choices.association
    if name == "jcbb":
        from ekf_reference.association.joint_compatibility import JointCompatibility

        return JointCompatibility(attributes=attributes)
    if name == "consensus":
        from ekf_reference.association.consensus import ConsensusAssociation

        return ConsensusAssociation()
    if name == "euclidean":
        return EuclideanNeighbour(max(EuclideanNeighbour.d_min_m, WIDER * longest_sample_m(log)))
    return NearestNeighbour(choices.nn_gate, attributes=attributes)
