"""Charts of depth: its distribution, and where there is none."""

from __future__ import annotations

import numpy as np

from nimprep.report.collect import Collected, Counts
from nimprep.report.figures import LEGEND, Chart, axis, make_chart, plain_text
from nimprep.splits import SPLIT_CODES
from nimprep.store.reader import Store

_BINS = 80
_HEAT_SIDE = 96


def depth_quantiles(facts: Collected, shares: tuple[float, ...]) -> list[float]:
    """Return the depths, metres, that these shares of the sampled pixels do not exceed."""
    counts = facts.sums.depth.sum(axis=0)
    counts[0] = 0
    cumulated = np.cumsum(counts)
    if cumulated[-1] == 0:
        return [float("nan")] * len(shares)
    ranks = (float(np.searchsorted(cumulated, s * cumulated[-1])) for s in shares)
    return [facts.depth.number_of(rank) for rank in ranks]


def depth_histogram(facts: Collected) -> Chart:
    """Draw how depth is distributed in each split."""
    import plotly.graph_objects as go

    low, median, high, last = depth_quantiles(facts, (0.05, 0.5, 0.95, 0.995))
    # At least one of the store's steps a bin, as depth has no finer ones.
    steps = facts.depth.steps
    width = max(1, int(np.ceil(steps * last / _BINS)))
    edges = np.arange(0, steps * last + width, width)
    traces = []
    for split, counts in zip(SPLIT_CODES, facts.sums.depth, strict=True):
        valid = counts[1:].sum()
        if valid:
            binned, _ = np.histogram(np.arange(1, len(counts)), edges, weights=counts[1:])
            traces.append(
                go.Scatter(
                    name=split,
                    x=(edges[:-1] + width / 2) / steps,
                    y=100 * binned / valid,
                    mode="lines",
                    line={"shape": "hvh", "color": f"var(--{split})", "width": 2},
                    hovertemplate=f"{split}: %{{y:.2f}} % around %{{x:.2f}} m<extra></extra>",
                )
            )
    layout = {
        "xaxis": axis("depth, m", rangemode="tozero"),
        "yaxis": axis("share of pixels, %", rangemode="tozero"),
        **LEGEND,
    }
    gist = (
        f"Depth: 5 % below {low:.2f} m, median {median:.2f} m, 95 % below {high:.2f} m; "
        f"drawn to {last:.2f} m, beyond which lie 0.5 %."
    )
    return make_chart(traces, layout, gist)


def holes_per_frame(store: Store, facts: Collected) -> Chart:
    """Draw each frame's share of pixels without depth; a click on a point opens the frame."""
    import plotly.graph_objects as go

    share = 100 * facts.hole_share
    traces = []
    for name, code in SPLIT_CODES.items():
        frames = np.flatnonzero(store.tables.split == code)
        if frames.size:
            traces.append(
                go.Scatter(
                    name=name,
                    x=frames,
                    y=np.round(share[frames], 2),
                    customdata=frames,
                    text=[plain_text(store.ids[i]) for i in frames],
                    mode="markers",
                    cliponaxis=False,
                    marker={"color": f"var(--{name})", "size": 5, "opacity": 0.75},
                    hovertemplate="%{text}: %{y:.1f} % holes<extra></extra>",
                )
            )
    layout = {
        "xaxis": axis("frame", rangemode="nonnegative"),
        "yaxis": axis("pixels without depth, %", rangemode="tozero"),
        "hovermode": "closest",
        **LEGEND,
    }
    gist = (
        f"Share of pixels without depth, per frame: {share.min():.1f} to {share.max():.1f} %, "
        f"median {np.median(share):.1f} %."
    )
    return make_chart(traces, layout, gist)


def hole_map(facts: Collected) -> Chart:
    """Draw how often each place of the image is without depth, as a heat map."""
    import plotly.graph_objects as go

    holes, seen = (_coarse(a) for a in (facts.sums.holes, facts.sums.seen))
    with np.errstate(invalid="ignore", divide="ignore"):
        share = 100 * holes / seen
    factor = facts.step * -(-max(facts.sums.holes.shape) // _HEAT_SIDE)
    rows, columns = share.shape
    # A constant map would else be drawn from a range of no width.
    top = max(float(np.nanmax(share)), 1.0)
    trace = go.Heatmap(
        z=np.round(share, 1).astype(np.float32),
        x=np.arange(columns) * factor,
        y=np.arange(rows) * factor,
        zmin=0,
        zmax=top,
        colorscale="Viridis",
        colorbar={"title": {"text": "%"}, "thickness": 12, "outlinewidth": 0},
        hovertemplate="%{z:.1f} % of frames without depth near (%{x}, %{y})<extra></extra>",
    )
    layout = {
        "xaxis": axis("", showgrid=False, constrain="domain"),
        "yaxis": axis(
            "", showgrid=False, autorange="reversed", scaleanchor="x", constrain="domain"
        ),
    }
    thirds = np.array_split(np.arange(rows), 3)
    parts = [
        f"{name} third {100 * holes[r].sum() / max(seen[r].sum(), 1):.1f} %"
        for name, r in zip(("upper", "middle", "lower"), thirds, strict=True)
    ]
    gist = f"Where depth is missing, in % of the frames: {', '.join(parts)} of the image."
    return make_chart([trace], layout, gist)


def _coarse(counts: Counts) -> Counts:
    """Add up blocks of cells until no side is longer than the drawn map's."""
    block = -(-max(counts.shape) // _HEAT_SIDE)
    starts = (np.arange(0, n, block) for n in counts.shape)
    rows, columns = starts
    return np.add.reduceat(np.add.reduceat(counts, rows, axis=0), columns, axis=1)
