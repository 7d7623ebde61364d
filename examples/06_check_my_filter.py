"""Is my own EKF right? A textbook EKF, its trace, and what the check says of two planted bugs.

The filter's algebra is its own; the vehicle model and the log are the project's. It records what it
linearised where. The check replays that with a smoother and names the gap: algebra, model or
linearisation.

python examples/06_check_my_filter.py
"""

import math
import tempfile
from pathlib import Path

import numpy as np

from comparisons.adapters.timeline import Timeline, build_timeline
from comparisons.arrays import Array
from comparisons.estimates.estimate import Estimate
from comparisons.estimates.external import read_external
from comparisons.estimates.folder import write_estimate
from comparisons.jobs.check import check
from comparisons.jobs.external_check import ExternalCheck
from comparisons.logs.bundled import open_log
from comparisons.logs.log import Log
from comparisons.logs.odometry import SteeringOdometry
from ekf_reference.models.motion import AckermannModel
from slamcheck import Recorder

BUGS = ("none", "the prediction leaves P_vm as it was", "R holds sigma in place of its square")


class MyEkf:
    """A textbook EKF that is recorded, as docs/formats.md says."""

    def __init__(self, log: Log, bug: str, record: Recorder) -> None:
        """Bug: one of BUGS."""
        if not isinstance(log.odometry, SteeringOdometry):
            raise TypeError("expected a log with steering odometry")
        self.bug, self.motion = bug, AckermannModel(**vars(log.odometry.vehicle))
        self.noise = log.odometry.noise
        self.x, self.p = log.prior.pose.copy(), log.prior.covariance.copy()
        self.landmark_index: dict[int, int] = {}
        self.record = record
        record.prior({"pose": 3}, self.p, point=self.x)

    def predict(self, control: Array, covariance: Array, duration_s: float) -> None:
        """Move the vehicle; record F and Q."""
        step = self.motion.step(self.x[:3], control, duration_s)
        f, b = step.jacobian_pose, step.jacobian_control
        rates = self.noise.variance_rate_position, self.noise.variance_rate_heading
        q = b @ covariance @ b.T + duration_s * np.diag((rates[0], *rates))
        self.record.predict(f, q, ["pose"], point=self.x[:3], after=step.pose)
        self.x[:3] = step.pose
        self.p[:3, :3] = f @ self.p[:3, :3] @ f.T + q
        if self.bug != BUGS[1]:
            self.p[:3, 3:] = f @ self.p[:3, 3:]
            self.p[3:, :3] = self.p[:3, 3:].T

    def observe(self, row: int, label: int, z: Array, sigma: Array) -> None:
        """Fuse one range and bearing, or start a landmark with it."""
        r = np.diag(sigma if self.bug == BUGS[2] else sigma**2)
        pose, name = self.x[:3].copy(), f"landmark {label}"
        if label not in self.landmark_index:
            c, s = math.cos(pose[2] + z[1]), math.sin(pose[2] + z[1])
            point = pose[:2] + z[0] * np.array((c, s))
            g_z = np.array(((c, -z[0] * s), (s, z[0] * c)))
            g_x = np.column_stack((np.eye(2), g_z[:, 1]))
            new = np.vstack((self.p, g_x @ self.p[:3]))
            own = g_x @ self.p[:3, :3] @ g_x.T + g_z @ r @ g_z.T
            self.landmark_index[label], self.x = len(self.x), np.append(self.x, point)
            self.p = np.hstack((new, np.vstack((self.p[:, :3] @ g_x.T, own))))
            self.record.augment(name, g_x, g_z, r, ["pose"], point=pose, after=point, numbers=row)
            return
        i = self.landmark_index[label]
        point = self.x[i : i + 2].copy()
        dx, dy = point - pose[:2]
        q, d = dx * dx + dy * dy, math.hypot(dx, dy)
        h_l = np.array(((dx / d, dy / d), (-dy / q, dx / q)))
        h_v = np.column_stack((-h_l, (0.0, -1.0)))
        nu = z - (d, math.atan2(dy, dx) - pose[2])
        nu[1] = math.remainder(nu[1], 2.0 * math.pi)
        h = np.zeros((2, len(self.x)))
        h[:, :3], h[:, i : i + 2] = h_v, h_l
        gain = self.p @ h.T @ np.linalg.inv(h @ self.p @ h.T + r)
        self.x = self.x + gain @ nu
        self.p = (np.eye(len(self.x)) - gain @ h) @ self.p
        self.p = 0.5 * (self.p + self.p.T)
        at, blocks = np.append(pose, point), ["pose", name]
        self.record.update("landmarks", nu, np.hstack((h_v, h_l)), r, blocks, point=at, numbers=row)


def run(log: Log, timeline: Timeline, bug: str, folder: Path) -> None:
    """Drive the filter through a log; write its estimate and its trace."""
    record = Recorder(folder / "filter.trace")
    ekf, seen, poses, spreads = MyEkf(log, bug, record), log.measurements, [], []
    step_end_s = timeline.step_begin_s + timeline.step_duration_s
    steps, rows = timeline.steps_until(), timeline.measurements_until()
    done = 0
    for k in range(len(timeline.epoch_time_s)):
        for i in range(done, steps[k]):
            noise, duration = timeline.control_covariance[i], timeline.step_duration_s[i]
            record.at(float(step_end_s[i]))
            ekf.predict(timeline.control[i], noise, duration)
        done = steps[k]
        for row in range(rows[k], rows[k + 1]):
            z = np.array((seen.range_m[row], seen.bearing_rad[row]))
            sigma = np.array((seen.sigma_range_m[row], seen.sigma_bearing_rad[row]))
            ekf.observe(row, int(seen.landmark[row]), z, sigma)
        poses.append(ekf.x[:3].copy())
        spreads.append(ekf.p[:3, :3].copy())
    estimate = Estimate(
        time_s=timeline.epoch_time_s,
        pose=np.array(poses),
        pose_covariance=np.array(spreads),
        landmark_id=np.array(list(ekf.landmark_index)),
        landmark=ekf.x[3:].reshape(-1, 2),
        joint_covariance=ekf.p,
        information="filtered",
    )
    record.close()
    write_estimate(estimate, folder)


def main() -> dict[str, ExternalCheck]:
    """Return what the check finds, by bug."""
    log, found = open_log("simulated-loop"), {}
    for bug in BUGS:
        with tempfile.TemporaryDirectory() as folder:
            run(log, build_timeline(log, None), bug, Path(folder))
            found[bug] = check(log, read_external(Path(folder)))
        print(f"bug: {bug}\n  {found[bug].outcome}")
        for cause in found[bug].causes:
            print(f"  {cause.gap}: {cause.evidence}")
    return found


if __name__ == "__main__":
    main()
