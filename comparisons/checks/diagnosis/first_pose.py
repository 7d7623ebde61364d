"""The prior of a log beside what truth or the measurements say of its first pose."""

from __future__ import annotations

import numpy as np

from comparisons.arrays import Array
from comparisons.faults.catalogue import EXCHANGED_ROWS
from comparisons.logs.log import Poses, Prior
from comparisons.plane import pose_difference
from comparisons.statistics import likelier_orders


def rows_by_truth(prior: Prior, true: Poses | None) -> str:
    """Return which rows of the prior's covariance the true first pose exchanges, in words."""
    if true is None or not true.time_s[0] <= prior.time_s <= true.time_s[-1]:
        return ""
    return exchanged_rows(prior, true.at(np.array([prior.time_s]))[0], np.zeros((3, 3)))


def exchanged_rows(prior: Prior, pose: Array, left: Array) -> str:
    """Return which rows of the prior's covariance a first pose (3,) exchanges, in words.

    Empty where the pose is probable, or no exchange makes it so. left: (3, 3) covariance of the
    pose; zero of the truth.
    """
    (error,) = pose_difference(prior.pose[None], pose)
    orders = {names: np.array(order) for names, order in EXCHANGED_ROWS.items()}
    row_orders = likelier_orders(error, prior.covariance, left, orders.values())
    if not row_orders:
        return ""
    named = {id(order): names for names, order in orders.items()}
    listed = ", or ".join(
        f"{named[id(order.order)]} (p = {order.p_value:.2g})" for order in row_orders
    )
    x, y, heading = (f"{one:.3g}" for one in error)
    sigma = ", ".join(f"{one:.3g}" for one in np.sqrt(np.diag(prior.covariance)))
    return (
        f"the prior is off by {x} m, {y} m and {heading} rad, with sigmas of {sigma}: these are "
        f"too small, or rows of its covariance are exchanged; then it is probable: {listed}"
    )
