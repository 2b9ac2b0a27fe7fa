"""Charts of surfaces: where normals point, and HHA's heights and angles."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from nimprep.report.collect import DIRECTION_BINS, DIRECTION_REACH, Collected, Counts
from nimprep.report.figures import Chart, axis, make_chart
from nimprep.report.page import percent

_ANGLE_OFFSET = 38
_WORDS = 1.4


def directions(facts: Collected) -> Chart:
    """Draw where normals point, on the hemisphere that faces the camera, areas kept."""
    import plotly.graph_objects as go

    counts = facts.sums.directions
    centres = (np.arange(DIRECTION_BINS) + 0.5) * 2 * DIRECTION_REACH / DIRECTION_BINS
    centres = np.round(centres - DIRECTION_REACH, 4)
    # Against an even spread over the hemisphere, whose disc has the area pi.
    cell = (2 * DIRECTION_REACH / DIRECTION_BINS) ** 2
    total = counts.sum() + facts.sums.directions_outside
    density = counts / total * np.pi / cell
    with np.errstate(divide="ignore"):
        shown = np.where(counts > 0, np.log10(density), np.nan)
    top = float(np.nanmax(shown))
    trace = go.Heatmap(
        z=np.round(shown, 2).astype(np.float32),
        x=centres,
        y=centres,
        zmin=min(-2.0, top - 1),
        zmax=top,
        colorscale="Viridis",
        colorbar={
            "title": {"text": "×"},
            "thickness": 12,
            "outlinewidth": 0,
            "tickvals": [-2, -1, 0, 1, 2, 3],
            "ticktext": ["0.01", "0.1", "1", "10", "100", "1000"],
        },
        hovertemplate="10^%{z} times an even spread<extra></extra>",
    )
    angle = np.linspace(0, 2 * np.pi, 121)
    circles = [
        go.Scatter(
            x=np.round(r * np.cos(angle), 4),
            y=np.round(r * np.sin(angle), 4),
            mode="lines",
            line={"color": "var(--muted)", "width": 1, "dash": "dot" if r < 0.99 else "solid"},
            hoverinfo="skip",
        )
        # 30, 60 and 90 degrees off the view: sqrt(1 - cos).
        for r in np.sqrt(1 - np.cos(np.radians([30, 60, 90])))
    ]
    words = [
        {"x": x, "y": y, "text": text, "showarrow": False}
        for x, y, text in (
            (0, -_WORDS, "up"),
            (0, _WORDS, "down"),
            (-_WORDS, 0, "left"),
            (_WORDS, 0, "right"),
        )
    ]
    plain = {"visible": False, "fixedrange": True, "range": [-DIRECTION_REACH, DIRECTION_REACH]}
    layout = {
        "xaxis": {**plain, "constrain": "domain"},
        "yaxis": {**plain, "range": [DIRECTION_REACH, -DIRECTION_REACH], "scaleanchor": "x"},
        "annotations": words,
        "margin": {"l": 8, "r": 8, "t": 8, "b": 8},
    }
    return make_chart([trace, *circles], layout, _directions_gist(counts, total, centres))


def _directions_gist(counts: Counts, total: int, centres: npt.NDArray[np.float64]) -> str:
    x, y = np.meshgrid(centres, centres)
    # n_z = r^2 - 1 and n_x = x sqrt(2 - r^2) undo the projection.
    n_z = x**2 + y**2 - 1
    n_y = y * np.sqrt(np.maximum(1 - n_z, 0))
    near = np.cos(np.radians(30))
    up, toward = (counts[m].sum() / total for m in (n_y < -near, n_z < -near))
    return (
        f"Directions of the normals: {percent(float(up))} within 30° of up (ground), "
        f"{percent(float(toward))} within 30° of the camera."
    )


def _levels(levels: Counts, first: int, title: str, gist: str, color: str) -> Chart:
    import plotly.graph_objects as go

    share = 100 * levels / levels.sum()
    trace = go.Bar(
        x=np.arange(len(levels)) + first,
        y=np.round(share, 4),
        marker={"color": color, "line": {"width": 0}},
        hovertemplate="%{y:.2f} % at %{x}<extra></extra>",
    )
    layout = {"xaxis": axis(title), "yaxis": axis("share of pixels, %"), "bargap": 0}
    return make_chart([trace], layout, gist)


def _median(levels: Counts) -> int:
    return int(np.searchsorted(np.cumsum(levels), levels.sum() / 2))


def hha_heights(levels: Counts) -> Chart:
    """Draw the heights above the lowest point, cm; the last level holds what is higher."""
    gist = (
        f"Height above the ground: median {_median(levels)} cm; "
        f"{percent(float(levels[-1] / levels.sum()))} at 255 cm or more, where the channel ends."
    )
    return _levels(levels, 0, "height above the lowest point, cm", gist, "var(--accent)")


def hha_angles(levels: Counts) -> Chart:
    """Draw the angles between normal and gravity, degrees: floor 0, wall 90, ceiling 180."""
    degrees = np.arange(len(levels)) - _ANGLE_OFFSET
    total = levels.sum()
    floor = levels[np.abs(degrees) <= 15].sum() / total
    wall = levels[np.abs(degrees - 90) <= 15].sum() / total
    gist = (
        f"Angle with gravity: {percent(float(floor))} within 15° of a floor, "
        f"{percent(float(wall))} within 15° of a wall."
    )
    part = levels[(degrees >= 0) & (degrees <= 180)]
    title = "angle with gravity, ° (wall: 90)"
    return _levels(part, 0, title, gist, "var(--accent)")
