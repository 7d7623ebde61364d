"""The jobs' options from Python, by type; generated from their settings by `make settings`."""

# fmt: off
# ruff: noqa

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, TypedDict


class RunOptions(TypedDict, total=False):
    """Options of `slamcheck run`."""

    filter: Literal['full', 'compressed', 'compressed-suboptimal', 'misono', 'misono-full']
    association: Literal['known', 'nn', 'jcbb', 'euclidean', 'consensus']
    attributes: Literal['off', 'on']
    gps: Literal['off', 'on', 'half']
    landmarks: Literal['points', 'scans', 'both']
    template_extraction: Literal['whole-scan', 'per-segment']
    merge_landmarks: bool
    motion: Literal['wheel', 'scan', 'both']
    smoother_association: Literal['ekf', 'own']
    smoother_matcher: Literal['ekf', 'generalised-icp']
    posterior: Literal['none', 'samples']
    dense: Sequence[Literal['points', 'occupancy', 'particles', 'sog']]
    resolution: float
    dynamic: bool
    high_level: bool
    third: Literal['none', 'fastslam']
    smoother: Literal['batch', 'isam2', 'fixed-lag']
    lag: int
    optimiser: Literal['levenberg-marquardt', 'gauss-newton', 'dogleg']
    robust: Literal['none', 'huber', 'cauchy', 'gnc']
    accept_misfit: bool
    preset: Literal['recommended', 'guivant-2002', 'misono-2007', 'nieto-2005']
    fail_on: str
    figures: Sequence[Literal['png', 'pdf']]
    trace: bool


class CheckOptions(TypedDict, total=False):
    """Options of `slamcheck check`."""

    robust: Literal['none', 'huber', 'cauchy', 'gnc']
    accept_misfit: bool
    preset: Literal['recommended', 'guivant-2002', 'misono-2007', 'nieto-2005']
    association: Literal['known', 'own']
    gps: Literal['off', 'on', 'half']
    times: str | Path
    trace: str | Path
    require: Literal['equal', 'like', 'plausible']
    min_coverage: float


class SolveOptions(TypedDict, total=False):
    """Options of `slamcheck solve`."""

    smoother: Literal['batch', 'isam2', 'fixed-lag']
    lag: int
    optimiser: Literal['levenberg-marquardt', 'gauss-newton', 'dogleg']
    robust: Literal['none', 'huber', 'cauchy', 'gnc']
    accept_misfit: bool
    preset: Literal['recommended', 'guivant-2002', 'misono-2007', 'nieto-2005']
    association: Literal['known', 'own']
    gps: Literal['off', 'on', 'half']


class OdometryOptions(TypedDict, total=False):
    """Options of `slamcheck odometry`."""

    preset: Literal['recommended', 'guivant-2002', 'misono-2007', 'nieto-2005']
    cloud: Literal['pcd', 'ply']
    guess: Literal['wheels', 'none']
    loop_closure: bool
    matcher: Literal['surface', 'kiss', 'point-to-point', 'point-to-plane', 'generalised']
    gps: Literal['off', 'on', 'half']


class MapOptions(TypedDict, total=False):
    """Options of `slamcheck map`."""

    filter: Literal['full', 'compressed', 'compressed-suboptimal', 'misono', 'misono-full']
    association: Literal['known', 'nn', 'jcbb', 'euclidean', 'consensus']
    gps: Literal['off', 'on', 'half']
    landmarks: Literal['points', 'scans', 'both']
    template_extraction: Literal['whole-scan', 'per-segment']
    resolution: float
    dynamic: bool
    layer: Sequence[Literal['points', 'occupancy', 'particles', 'sog']]
    preset: Literal['recommended', 'guivant-2002', 'misono-2007', 'nieto-2005']
    cloud: Literal['pcd', 'ply']
