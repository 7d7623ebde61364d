"""All figures that can be reproduced, in the documents' order. A further figure is one row more."""

from __future__ import annotations

from comparisons.errors import InputError, shorten
from research.documents import (
    guivant,
    guivant_cost,
    misono,
    nieto_car_park,
    nieto_car_park_scans,
    nieto_dense,
    nieto_fastslam,
    nieto_high_level,
    nieto_motion,
    nieto_regions,
    nieto_scan_maps,
    nieto_scan_slam,
)
from research.documents.interface import AnyFigure

FIGURES: tuple[AnyFigure, ...] = (
    *guivant_cost.FIGURES,
    *guivant.FIGURES,
    *misono.FIGURES,
    *nieto_fastslam.FIGURES,
    *nieto_regions.FIGURES,
    *nieto_dense.FIGURES,
    *nieto_scan_slam.FIGURES,
    *nieto_car_park_scans.FIGURES,
    *nieto_high_level.FIGURES,
    *nieto_scan_maps.FIGURES,
    *nieto_motion.FIGURES,
    *nieto_car_park.FIGURES,
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
        raise InputError(
            f"figure '{shorten(strange[0])}' is unknown, expected all or some of {there}"
        )
    return tuple(f for f in FIGURES if "all" in wanted or f.name.casefold() in wanted)
