"""The map that the scans make."""

from __future__ import annotations

from matplotlib.figure import Figure

from comparisons.arrays import Array
from comparisons.pipeline.odometry import FrontEnd
from comparisons.report.figures.style import (
    draw_aside,
    draw_cloud,
    draw_reference,
    draw_trajectory,
    entitle,
    plan,
)
from comparisons.report.marks import EKF_COLOUR, SCANS_COLOUR, SMOOTHER_COLOUR


def front_end_figure(front_end: FrontEnd, points: Array) -> Figure:
    """The map that the scans make, with the trajectories of wheels, scan odometry and graph."""
    f = front_end
    figure, axis = plan()
    draw_cloud(axis, points)
    if f.log.truth.poses is not None:
        draw_reference(axis, f.log.truth.poses.pose, ".", "truth")
    elif f.log.positions is not None:
        draw_reference(axis, f.log.positions.position_m, ".", "GPS")
    draw_trajectory(axis, f.odometry, EKF_COLOUR, "scan odometry", "--")
    draw_trajectory(axis, f.estimate.pose, SMOOTHER_COLOUR, "scan graph")
    closed = f.graph.problem.loop_closures
    for first, second in zip(closed.first, closed.second, strict=True):
        ends = f.estimate.pose[[first, second]]
        axis.plot(ends[:, 0], ends[:, 1], color=SCANS_COLOUR, linewidth=0.7, zorder=3)
    if f.wheels is not None:
        draw_aside(axis, f.wheels, "wheels")
    title = (
        f"{f.log.name}: {len(f.motion.row)} scans, {len(f.graph.problem.loop_closures.first)} "
        "loops "
        "closed (yellow)"
    )
    entitle(axis, title)
    return figure
