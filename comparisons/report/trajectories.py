"""The page of trajectories that are compared with another: a map, errors over time, a table."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle

import numpy as np

from comparisons.checks.path_errors import PathErrors, error_statistics
from comparisons.estimates.external import ExternalEstimate
from comparisons.report.html.map import MapContent, Track
from comparisons.report.html.page import PageContent, page
from comparisons.report.marks import EKF_COLOUR, SMOOTHER_COLOUR, TIME, Curve, Panel
from comparisons.report.panels import REFERENCE_COLOURS
from comparisons.report.side_by_side import TITLE, Row, html_table
from comparisons.report.track_errors import TrackErrors


def trajectories_page(
    reference: tuple[str, ExternalEstimate],
    errors: Sequence[PathErrors],
    titles: Sequence[str],
    rows: Sequence[Row],
) -> str:
    """Return the page.

    Args:
        reference: Its name, and its poses.
        errors: Of each trajectory against it.
        titles: Names of the trajectories.
        rows: The table of all figures.
    """
    name, true = reference
    if name in titles:
        name += " (reference)"
    paths = list(zip(titles, cycle((EKF_COLOUR, *REFERENCE_COLOURS)), errors, strict=False))
    tracks = [
        Track(name=name, colour=SMOOTHER_COLOUR, time_s=true.time_s, pose=true.pose),
        *(
            Track(name=title, colour=colour, dashes="6 3", time_s=path.time_s, pose=path.pose)
            for title, colour, path in paths
        ),
    ]
    content = PageContent(
        name=TITLE,
        headline=f"against {name}",
        facts=[(title, _in_words(path)) for title, _, path in paths],
        map=MapContent(
            log=None,
            tracks=tracks,
            view=[track.pose[:, :2] for track in tracks],
            errors=[_track_errors(title, path) for title, _, path in paths],
        ),
        panels=[
            Panel(
                title=title,
                x_label=TIME,
                curves=tuple(
                    Curve(name, colour, path.time_s, unit * getattr(path, field))
                    for name, colour, path in paths
                ),
                bands=(),
                level=0.0,
            )
            for title, field, unit in (
                ("distance from the reference [m]", "place_m", 1.0),
                ("turn from the reference [deg]", "heading_rad", np.degrees(1.0)),
            )
        ],
        sections=[f"<h2>Errors</h2>{html_table(titles, rows)}"],
    )
    return page(content)


def _track_errors(name: str, path: PathErrors) -> TrackErrors:
    rms_m = error_statistics(path.place_m)["rms"]
    return TrackErrors(name, "reference", path.time_s, path.place_m, path.heading_rad, rms_m)


def _in_words(path: PathErrors) -> str:
    """The errors that most ask for."""
    figures = path.figures()
    parts = [
        f"{figures['ape_m.rms']:.3g} m (RMS), at most {figures['ape_m.max']:.3g} m",
        f"heading {figures['ape_deg.rms']:.3g} deg",
    ]
    if "rpe_10m_m.rms" in figures:
        parts.append(f"motion over 10 m {figures['rpe_10m_m.rms']:.3g} m")
    if path.nees is not None:
        parts.append(f"NEES {path.nees:.3g} per degree of freedom, expected 1")
    parts.append(f"{len(path.time_s):,} of {path.poses:,} poses")
    return "; ".join(parts)
