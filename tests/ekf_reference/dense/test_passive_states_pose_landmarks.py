"""Dense maps and passive states beside a filter that has pose landmarks, too."""

import numpy as np

from ekf_reference.core.geometry import Array
from ekf_reference.core.landmark_types import POINT, POSE
from ekf_reference.core.trace import VEHICLE, MeasurementRecord, RemovalRecord
from tests.ekf_reference.both_kinds import Script, build, drive
from tests.ekf_reference.dense.passive_states import PassiveStates, points
from tests.ekf_reference.numerics import relative_error

Z = np.array([[4.0, 0.5], [6.0, -1.0]])
NOISE = np.tile(np.diag((0.01, 0.004)) ** 2, (2, 1, 1))
SCRIPT = Script(steps=100, order="in turn", fuse_at=60, remove_at=75)


def outcome(passive: type[PassiveStates] | None) -> tuple[Array, Array, Array]:
    """Place, own covariance and covariance with the filter's, of two points from the start.

    passive: who carries them; None for the filter itself, as points that are never seen again.
    """
    ekf = build()
    if passive is not None:
        beside = passive(ekf)
        beside.watch(points(ekf.models[POINT], ekf.state.pose, Z, NOISE))
        drive(ekf, 4, SCRIPT)
        return beside.value, beside.own, beside.cross
    ekf.observe(Z, np.sqrt(NOISE[:, (0, 1), (0, 1)]), np.array([100, 101]))
    dense = np.arange(2)
    drive(ekf, 4, SCRIPT)
    layout = ekf.state.layout
    rows = layout.columns(dense)[3:]
    kept = np.setdiff1d(np.arange(layout.size), rows)
    p = ekf.state.covariance
    own = np.array([p[np.ix_(r, r)] for r in rows.reshape(-1, 2)])
    return ekf.state.landmarks[dense], own, p[np.ix_(rows, kept)]


class Forgetful(PassiveStates):
    """Broken: measurements of pose landmarks tell it nothing."""

    def measurement(self, used: MeasurementRecord) -> None:
        if used.kind == POSE and used.origin == VEHICLE:
            self._next.measurement(used)
        else:
            super().measurement(used)


class WrongColumns(PassiveStates):
    """Broken: it drops the last columns in place of those of what was removed."""

    def removal(self, gone: RemovalRecord) -> None:
        last = self.cross.shape[1] - len(gone.entries)
        super().removal(gone._replace(entries=last + np.arange(len(gone.entries))))


def gaps(passive: type[PassiveStates]) -> float:
    pairs = zip(outcome(passive), outcome(None), strict=True)
    return max(relative_error(ours, theirs) for ours, theirs in pairs)


def test_equal_to_a_filter_that_has_them_in_its_state() -> None:
    assert gaps(PassiveStates) < 1e-8


def test_the_equality_rejects_broken_variants() -> None:
    assert gaps(Forgetful) > 1e-4
    assert gaps(WrongColumns) > 1e-4
