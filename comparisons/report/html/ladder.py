"""The ladder of gaps as one picture: a box for each estimate, between them how far apart they are.

Colours are the style sheet's, so that the picture follows light, dark and print.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

from comparisons.report.ladder import LadderStep

_WIDTH, _BOX, _GAP, _AXIS = 360, 26, 62, 42
_RAIL, _TEXT, _SHIFT = 15, 36, 14
"""Of the line between the boxes, and of what is written beside it; how far a branch stands off."""
_LEFT, _RIGHT = 36.0, 348.0
_LOW, _HIGH = -15.0, 3.0
"""Decades of the scale; what is beyond lies on its end."""
_TICKS = {-12: "10⁻¹²", -9: "10⁻⁹", -6: "10⁻⁶", -3: "10⁻³", 0: "1", 3: "10³"}
_LONG = 40
"""Characters of a name from which on it is squeezed into its box."""
_NAMES = {"reference": "Difference from the reference", "optimum": "Distance from the optimum"}
_MARK = {"passes": "M-4,0l3,3.2l5.4,-6.2", "fails": "M-3.4,-3.4l6.8,6.8m0,-6.8l-6.8,6.8",
         "not judged": "M-3.6,0h7.2"}  # fmt: skip


def ladder_picture(steps: Sequence[LadderStep]) -> str:
    """Return the picture as SVG, with the same in words for those who cannot see it."""
    if not steps:
        return ""
    rails, parts, boxes, y = [], [_box(steps[0].above, 0)], {steps[0].above: 0}, _BOX
    for i, step in enumerate(steps):
        aside = _SHIFT if step.above in [one.above for one in steps[i + 1 :]] else 0
        start = boxes[step.above] + _BOX
        rails.append(_rail(step, start, y, aside))
        parts += [_gap(step, y, aside), _box(step.below, y + _GAP, 2 * aside - 6 if aside else 0)]
        boxes[step.below] = y + _GAP
        y += _GAP + _BOX
    words = " ".join(f"{_name(one)}, {one.above} to {one.below}: {_sizes(one)}; {one.state}."
                     for one in steps)  # fmt: skip
    return (
        f'<figure class="ladder"><svg viewBox="0 0 {_WIDTH} {y + _AXIS}" role="img" '
        'aria-labelledby="ladder-title ladder-words"><title id="ladder-title">The estimates and '
        f'the gaps between them</title><desc id="ladder-words">{escape(words)}</desc>'
        f"{''.join(reversed(rails))}{''.join(parts)}{_axis(y)}</svg></figure>"
    )


def _box(name: str, y: int, aside: int = 0) -> str:
    shown = name[0].upper() + name[1:]
    room = _WIDTH - aside - 24
    squeezed = f' textLength="{room}" lengthAdjust="spacingAndGlyphs"' if len(shown) > _LONG else ""
    return (
        f'<rect class="box" x="{aside + 0.5}" y="{y + 0.5}" width="{_WIDTH - aside - 1}" '
        f'height="{_BOX - 1}" rx="5"/><text class="rung" x="{aside + 12}" y="{y + 17.5}"{squeezed}>'
        f"{escape(shown)}</text>"
    )


def _rail(step: LadderStep, start: int, y: int, aside: int) -> str:
    """The line from an estimate's box, which ends at start, down to the box of the next."""
    turn = f"V{y + 17}h{aside}" if aside else ""
    return f'<path class="rail {_kind(step)}" d="M{_RAIL},{start}{turn}V{y + _GAP}"/>'


def _gap(step: LadderStep, y: int, aside: int) -> str:
    """Name, outcome and sizes, and below these where they lie on the scale."""
    kind, track = _kind(step), y + 48
    marks = [f'<path class="track" d="M{_LEFT},{track}H{_RIGHT}"/>']
    if (limit := step.deciding) is not None:
        at = _place(limit)
        marks.append(
            f'<path class="beyond" d="M{at:.1f},{track}H{_RIGHT}"/>'
            f'<path class="limit" d="M{at:.1f},{track - 6}v12"/>'
        )
    if step.covariance is not None:
        x = _place(step.covariance)
        marks.append(f'<circle class="spread {kind}" cx="{x:.1f}" cy="{track}" r="3.6"/>')
    if step.mean != "unknown":
        x = _RIGHT if step.sigma is None else _place(step.sigma)
        marks.append(f'<circle class="mean {kind}" cx="{x:.1f}" cy="{track}" r="4.2"/>')
    return (
        f'<g transform="translate({_RAIL + aside},{y + 17})"><circle class="badge {kind}" r="8.5"/>'
        f'<path class="sign" d="{_MARK[step.state]}"/></g>'
        f'<text class="name" x="{_TEXT + aside}" y="{y + 17}">{escape(_name(step))}</text>'
        f'<text class="state {kind}" x="{_RIGHT}" y="{y + 17}">{step.state}</text>'
        f'<text class="size" x="{_TEXT + aside}" y="{y + 33}">{escape(_sizes(step))}</text>'
        f"{''.join(marks)}"
    )


def _axis(y: int) -> str:
    """Figures of the scale, and what the marks mean."""
    ticks = "".join(
        f'<path class="tick" d="M{_place(10.0**k):.1f},{y + 5}v4"/>'
        f'<text class="figure" x="{_place(10.0**k):.1f}" y="{y + 19}">{name}</text>'
        for k, name in _TICKS.items()
    )
    key = y + 34
    return (
        f'<path class="track" d="M{_LEFT},{y + 5}H{_RIGHT}"/>{ticks}'
        f'<circle class="mean" cx="{_LEFT + 4}" cy="{key}" r="4.2"/>'
        f'<text class="key" x="{_LEFT + 13}" y="{key + 3.5}">mean [sigma]</text>'
        f'<circle class="spread" cx="{_LEFT + 104}" cy="{key}" r="3.6"/>'
        f'<text class="key" x="{_LEFT + 113}" y="{key + 3.5}">covariance, relative</text>'
        f'<path class="limit" d="M{_LEFT + 236},{key - 6}v12"/>'
        f'<text class="key" x="{_LEFT + 243}" y="{key + 3.5}">limit</text>'
    )


def _kind(step: LadderStep) -> str:
    return step.state.replace(" ", "-")


def _name(step: LadderStep) -> str:
    return _NAMES.get(step.gap, f"{step.gap.capitalize()} gap")


def _sizes(step: LadderStep) -> str:
    parts = [step.mean if step.mean != "unknown" else "unknown: needs the joint covariance"]
    if step.covariance is not None:
        parts.append(f"{step.covariance:.2g} in covariance")
    if step.error_m is not None:
        parts.append(f"{step.error_m:.3g} m")
    return ", ".join(parts)


def _place(value: float) -> float:
    """Where a size lies on the scale."""
    decade = math.log10(value) if value > 0.0 else _LOW  # NaN, too, is on the left
    share = (min(max(decade, _LOW), _HIGH) - _LOW) / (_HIGH - _LOW)
    return _LEFT + share * (_RIGHT - _LEFT)
