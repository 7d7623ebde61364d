"""Which filter, association and sensors a run uses, and the filter that this makes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.attributes import BRIGHTNESS, check_attributes, no_estimates
from comparisons.errors import InputError
from comparisons.logs.log import Log, Positions
from comparisons.logs.odometry import RelativePoses, SteeringOdometry
from comparisons.logs.transforms.known_landmarks import surveyed
from ekf_reference.absolute_updates import PositionFixes, PositionModel
from ekf_reference.agreed_association import AgreedAssociation
from ekf_reference.association import (
    Association,
    EuclideanNeighbour,
    KnownAssociation,
    NearestNeighbour,
    RememberedAttributes,
    SurveyedLandmarks,
)
from ekf_reference.attributes import NO_ATTRIBUTES, Attributes, LayerAttributes, LayerValues
from ekf_reference.compressed_ekf import CompressedEkf, LocalAreas
from ekf_reference.direction_cosine import DirectionCosinePosition
from ekf_reference.direction_cosine_ekf import DirectionCosineEkf, DirectionCosineOptions
from ekf_reference.full_ekf import FullEkf, Stabilisation
from ekf_reference.joint_compatibility import JointCompatibility
from ekf_reference.motion import AckermannModel, MotionModel, RelativePoseModel, UnicycleModel
from ekf_reference.trace import Trace
from ekf_reference.track_management import TrackManagement

FILTERS = ("full", "compressed", "compressed-suboptimal", "misono", "misono-full")
ASSOCIATIONS = ("known", "nn", "jcbb", "euclidean", "agreed")
GPS = ("off", "on", "half")
LEAST_GAIN = 1e-4
"""c1 of the suboptimal global update, the example of Guivant 2002, eq. 22."""


@dataclass(frozen=True)
class EkfChoices:
    """What a user may choose.

    association: None to choose by the log. gps: whether absolute positions are fused: `off`, `on`,
    or `half` for every second one, the others being held back to judge by. attributes: `on` when
    diameters and intensities tell landmarks apart, besides their places; `layer` when intensities
    are those of the dense map's layer.
    """

    filter: str = "full"
    association: str | None = None
    gps: str = "off"
    attributes: str = "off"

    @property
    def conservative(self) -> bool:
        """The filter does not claim to be exact, only never to be too sure."""
        return self.filter == "compressed-suboptimal"

    def settle(self, log: Log) -> EkfChoices:
        """The same with nothing left open. Raises InputError for what the log cannot serve."""
        if self.filter not in FILTERS:
            raise InputError(f"filter '{self.filter}' is unknown, expected {_either(FILTERS)}")
        if self.gps not in GPS:
            raise InputError(f"gps '{self.gps}' is unknown, expected {_either(GPS)}")
        if self.gps != "off" and (log.positions is None or not len(log.positions.time_s)):
            raise InputError(f"{log.name}: holds no positions to fuse; use --gps off")
        name = self.association
        if name is None:
            known = log.sightings.labelled and self.attributes == "off"
            return replace(self, association="known" if known else "nn").settle(log)
        if name not in ASSOCIATIONS:
            raise InputError(f"association '{name}' is unknown, expected {_either(ASSOCIATIONS)}")
        if name == "known" and not log.sightings.labelled:
            raise InputError(
                f"{log.name}: its sightings do not all name their landmark; use --association nn"
            )
        check_attributes(log, self.attributes, name)
        return self


def build_ekf(
    log: Log, choices: EkfChoices, trace: Trace, layer: LayerValues | None = None
) -> FullEkf:
    """The filter that a log and settled choices call for, standing at its prior.

    layer: see build_association.
    """
    odometry, prior = log.odometry, log.prior
    stabilisation = Stabilisation()
    if not isinstance(odometry, RelativePoses):
        noise = odometry.noise
        stabilisation = Stabilisation(noise.variance_rate_position, noise.variance_rate_heading)
    rule = build_association(log, choices, layer)
    common = (motion_model(log), rule, prior.pose, prior.covariance, stabilisation, trace)
    ekf: FullEkf
    antenna = log.positions.antenna_m if log.positions is not None else (0.0, 0.0)
    if choices.filter.startswith("misono"):
        complete = choices.filter == "misono-full"
        options = DirectionCosineOptions(full_jacobian=complete, renormalise=complete)
        ekf = DirectionCosineEkf(*common, options=options)
        ekf.fixes = PositionFixes(DirectionCosinePosition(antenna))
        return ekf
    if choices.filter == "full":
        ekf = FullEkf(*common)
    else:
        gain = LEAST_GAIN if choices.conservative else 0.0
        ekf = CompressedEkf(*common, LocalAreas(least_gain=gain))
    ekf.fixes = PositionFixes(PositionModel(antenna))
    return ekf


def motion_model(log: Log) -> MotionModel:
    """How the log's vehicle moves under its odometry."""
    if isinstance(log.odometry, RelativePoses):
        return RelativePoseModel()
    if isinstance(log.odometry, SteeringOdometry):
        return AckermannModel(**vars(log.odometry.vehicle))
    return UnicycleModel()


def fused_positions(log: Log, choices: EkfChoices) -> Positions | None:
    """The positions that the estimators are given: within the log's time, in order."""
    return None if log.positions is None else _rows(log.positions, _fused(log, choices))


def judging_positions(log: Log, choices: EkfChoices) -> Positions | None:
    """The positions that accuracy is measured against: none that was given to the estimators."""
    if log.positions is None:
        return None
    count = len(log.positions.time_s)
    return _rows(log.positions, np.setdiff1d(np.arange(count), _fused(log, choices)))


def _fused(log: Log, choices: EkfChoices) -> NDArray[np.intp]:
    if log.positions is None or choices.gps == "off":
        return np.zeros(0, dtype=np.intp)
    time = log.positions.time_s
    inside = np.flatnonzero((time >= log.prior.time_s) & (time <= log.end_s))
    return inside[::2] if choices.gps == "half" else inside


def _rows(p: Positions, rows: NDArray[np.intp]) -> Positions | None:
    return p.chosen(rows) if len(rows) else None


def build_association(
    log: Log, choices: EkfChoices, layer: LayerValues | None = None
) -> Association:
    """The rule; detections that need confirmation pass as candidates first.

    Sightings of surveyed landmarks go by their labels in any case. layer: of the map that is kept
    beside the filter. Raises ValueError where attributes are to come from one and there is none.
    """
    slot_of, _, _ = surveyed(log)
    rule: Association
    memory = no_estimates() if choices.attributes != "off" else None
    told: Attributes = memory or NO_ATTRIBUTES
    if choices.attributes == "layer" and memory is not None:
        if layer is None:
            raise ValueError("attributes of a layer need the map that keeps it")
        told = LayerAttributes(memory, layer, BRIGHTNESS)
    if choices.association == "known":
        rule = KnownAssociation(log.sightings.label_gate, first_slot=len(slot_of))
    else:
        rules: dict[str, Association] = {
            "nn": NearestNeighbour(attributes=told),
            "jcbb": JointCompatibility(attributes=told),
            "euclidean": EuclideanNeighbour(),
            "agreed": AgreedAssociation(),
        }
        rule = rules[choices.association or "nn"]
        if log.sightings.needs_confirmation:
            rule = TrackManagement(rule=rule)
    rule = SurveyedLandmarks(rule, slot_of) if slot_of else rule
    return rule if memory is None else RememberedAttributes(rule, memory)


def _either(names: tuple[str, ...]) -> str:
    return f"{', '.join(names[:-1])} or {names[-1]}"
