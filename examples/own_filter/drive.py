"""A simulated drive as two CSV files, as a vehicle's recorder may write them; also its truth.

Once round a circle of 5 m among twelve trees. The noise is normal: 0.05 m/s and 0.02 rad/s of the
odometry, 0.05 m and 0.01 rad of range and bearing.

python drive.py
"""

from pathlib import Path

import numpy as np

STEP_S, STEPS, SPEED_MPS, YAW_RATE_RADPS, REACH_M = 0.1, 320, 1.0, 0.2, 8.0


def main(folder: Path) -> None:
    """Write odometry.csv, measurements.csv and truth.csv."""
    random = np.random.default_rng(0)
    trees = random.uniform((-9.0, -4.0), (9.0, 14.0), (12, 2))
    x, y, heading = 0.0, 0.0, 0.0
    odometry, measurements = ["time,v,omega"], ["label,t,bearing [deg],range"]
    truth = ["time,x,y,heading"]
    for step in range(STEPS):
        t = round(step * STEP_S, 3)
        truth.append(f"{t},{x:.4f},{y:.4f},{heading:.5f}")
        if step % 5 == 0:
            for tree, (dx, dy) in enumerate(trees - (x, y)):
                distance, bearing = np.hypot(dx, dy), np.arctan2(dy, dx) - heading
                if 0.5 < distance < REACH_M:
                    bearing = (bearing + random.normal(0.0, 0.01) + np.pi) % (2.0 * np.pi) - np.pi
                    distance += random.normal(0.0, 0.05)
                    measurements.append(f"tree_{tree},{t},{np.degrees(bearing):.3f},{distance:.3f}")
        v = SPEED_MPS + random.normal(0.0, 0.05)
        omega = YAW_RATE_RADPS + random.normal(0.0, 0.02)
        odometry.append(f"{t},{v:.3f},{omega:.4f}")
        middle = heading + 0.5 * STEP_S * YAW_RATE_RADPS
        x += STEP_S * SPEED_MPS * np.cos(middle)
        y += STEP_S * SPEED_MPS * np.sin(middle)
        heading += STEP_S * YAW_RATE_RADPS
    for name, lines in (("odometry", odometry), ("measurements", measurements), ("truth", truth)):
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main(Path())
