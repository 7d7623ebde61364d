"""Which filter, association and sensors a run uses, and the filter that this makes."""

from __future__ import annotations

from dataclasses import dataclass, replace

from comparisons.errors import InputError
from comparisons.logs.log import Log, RelativePoses, SteeringOdometry
from ekf_reference.association import (
    Association,
    EuclideanNeighbour,
    KnownAssociation,
    NearestNeighbour,
)
from ekf_reference.compressed_ekf import CompressedEkf, LocalAreas
from ekf_reference.full_ekf import FullEkf, Stabilisation
from ekf_reference.joint_compatibility import JointCompatibility
from ekf_reference.motion import AckermannModel, MotionModel, RelativePoseModel, UnicycleModel
from ekf_reference.trace import Trace
from ekf_reference.track_management import TrackManagement

FILTERS = ("full", "compressed", "compressed-suboptimal")
ASSOCIATIONS = ("known", "nn", "jcbb", "euclidean")
LEAST_GAIN = 1e-4
"""c1 of the suboptimal global update, the example of Guivant 2002, eq. 22."""


@dataclass(frozen=True)
class EkfChoices:
    """What a user may choose. association: None to choose by the log."""

    filter: str = "full"
    association: str | None = None

    @property
    def conservative(self) -> bool:
        """The filter does not claim to be exact, only never to be too sure."""
        return self.filter == "compressed-suboptimal"

    def settle(self, log: Log) -> EkfChoices:
        """The same with nothing left open. Raises InputError for what the log cannot serve."""
        if self.filter not in FILTERS:
            raise InputError(f"filter '{self.filter}' is unknown, expected {_either(FILTERS)}")
        name = self.association
        if name is None:
            return replace(self, association="known" if log.sightings.labelled else "nn")
        if name not in ASSOCIATIONS:
            raise InputError(f"association '{name}' is unknown, expected {_either(ASSOCIATIONS)}")
        if name == "known" and not log.sightings.labelled:
            raise InputError(
                f"{log.name}: its sightings do not all name their landmark; use --association nn"
            )
        return self


def build_ekf(log: Log, choices: EkfChoices, trace: Trace) -> FullEkf:
    """The filter that a log and settled choices call for, standing at its prior."""
    odometry, prior = log.odometry, log.prior
    stabilisation = Stabilisation()
    motion: MotionModel
    if isinstance(odometry, RelativePoses):
        motion = RelativePoseModel()
    else:
        noise = odometry.noise
        stabilisation = Stabilisation(noise.variance_rate_position, noise.variance_rate_heading)
        if isinstance(odometry, SteeringOdometry):
            motion = AckermannModel(**vars(odometry.vehicle))
        else:
            motion = UnicycleModel()
    rule = build_association(log, choices)
    common = (motion, rule, prior.pose, prior.covariance, stabilisation, trace)
    if choices.filter == "full":
        return FullEkf(*common)
    gain = LEAST_GAIN if choices.filter == "compressed-suboptimal" else 0.0
    return CompressedEkf(*common, LocalAreas(least_gain=gain))


def build_association(log: Log, choices: EkfChoices) -> Association:
    """The rule; detections that need confirmation pass as candidates first."""
    if choices.association == "known":
        return KnownAssociation(log.sightings.label_gate)
    rule: Association = {
        "nn": NearestNeighbour,
        "jcbb": JointCompatibility,
        "euclidean": EuclideanNeighbour,
    }[choices.association or "nn"]()
    return TrackManagement(rule) if log.sightings.needs_confirmation else rule


def _either(names: tuple[str, ...]) -> str:
    return f"{', '.join(names[:-1])} or {names[-1]}"
