"""All figures that can be reproduced, in the documents' order. A further figure is one row more."""

from __future__ import annotations

from comparisons.errors import InputError
from comparisons.experiments.reproduction import (
    guivant_figures,
    misono,
    nieto_car_park_figures,
    nieto_car_park_scans_figures,
    nieto_dense_figures,
    nieto_fastslam,
    nieto_high_level_figures,
    nieto_motion,
    nieto_regions,
    nieto_scan_maps_figures,
    nieto_scan_slam_figures,
    nieto_scans,
    nieto_slam_figures,
)
from comparisons.experiments.reproduction.interface import AnyFigure

FIGURES: tuple[AnyFigure, ...] = (
    *guivant_figures.FIGURES,
    *misono.FIGURES,
    *nieto_slam_figures.FIGURES,
    *nieto_fastslam.FIGURES,
    *nieto_regions.FIGURES,
    *nieto_dense_figures.FIGURES,
    *nieto_scans.FIGURES,
    *nieto_scan_slam_figures.FIGURES,
    *nieto_car_park_scans_figures.FIGURES,
    *nieto_high_level_figures.FIGURES,
    *nieto_scan_maps_figures.FIGURES,
    *nieto_motion.FIGURES,
    *nieto_car_park_figures.FIGURES,
)


def chosen(names: tuple[str, ...]) -> tuple[AnyFigure, ...]:
    """The figures of these names, each once, in the catalogue's order; `all` stands for all.

    Raises InputError for a name that is not there.
    """
    wanted = {name.casefold() for name in names}
    known = {figure.name.casefold() for figure in FIGURES}
    strange = [name for name in names if name.casefold() not in known | {"all"}]
    if strange:
        there = ", ".join(figure.name for figure in FIGURES)
        raise InputError(f"figure '{strange[0]}' is unknown, expected all or some of {there}")
    return tuple(f for f in FIGURES if "all" in wanted or f.name.casefold() in wanted)
