"""Which charts a store's page has, and those of classes and of further modalities."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from nimprep.report.collect import Collected
from nimprep.report.depth_charts import depth_histogram, hole_map, holes_per_frame
from nimprep.report.figures import LEGEND, Chart, axis, make_chart, plain_text
from nimprep.report.page import percent
from nimprep.report.pictures import css_color
from nimprep.report.surface_charts import directions, hha_angles, hha_heights
from nimprep.splits import SPLIT_CODES
from nimprep.store.reader import Store

_BINS = 80


def make_charts(store: Store, facts: Collected) -> dict[str, Chart]:
    """Return the charts that this store's modalities allow, by the id of their element."""
    charts: dict[str, Chart] = {}
    if "label" in store.modalities and facts.classes.sum() > 0:
        charts["chart-classes"] = class_balance(store, facts)
    if "depth" in store.modalities:
        if facts.sums.depth[:, 1:].any():
            charts["chart-depth"] = depth_histogram(facts)
        charts["chart-holes"] = holes_per_frame(store, facts)
        charts["chart-hole-map"] = hole_map(facts)
    if facts.sums.directions.any():
        charts["chart-directions"] = directions(facts)
    if facts.sums.hha.any():
        charts["chart-height"] = hha_heights(facts.sums.hha[1])
        charts["chart-angle"] = hha_angles(facts.sums.hha[2])
    for number, (name, values) in enumerate(facts.pooled.items()):
        if np.isfinite(values).any():
            charts[f"chart-other-{number}"] = other_values(store, name, values)
    return charts


def class_shares(store: Store, facts: Collected) -> dict[str, npt.NDArray[np.float64]]:
    """Return each split's (C,) shares of its labelled pixels; splits without any are left out."""
    shares = {}
    for name, code in SPLIT_CODES.items():
        total = facts.classes[store.tables.split == code].sum(axis=0)
        if total.sum():
            shares[name] = total / total.sum()
    return shares


def class_balance(store: Store, facts: Collected) -> Chart:
    """Draw the share of each class among the labelled pixels, a bar per split."""
    import plotly.graph_objects as go

    shares = class_shares(store, facts)
    traces = [
        go.Bar(
            name=plain_text(entry.name),
            y=list(shares),
            x=[100 * share[i] for share in shares.values()],
            orientation="h",
            marker={
                # Black, a background's usual colour, would vanish in the dark.
                "color": css_color(entry.color) if any(entry.color) else "var(--none)",
                "line": {"color": "var(--surface)", "width": 1},
            },
            hovertemplate=f"{plain_text(entry.name)}: %{{x:.2f}} % of %{{y}}<extra></extra>",
        )
        for i, entry in enumerate(store.classes)
    ]
    layout = {
        "barmode": "stack",
        "xaxis": axis("share of labelled pixels, %", range=[0, 100]),
        "yaxis": {"autorange": "reversed", "fixedrange": True},
        **LEGEND,
    }
    parts = [
        f"{split}: " + ", ".join(f"{c.name} {percent(s)}" for c, s in zip(store.classes, share))  # noqa: B905
        for split, share in shares.items()
    ]
    return make_chart(traces, layout, "Class balance. " + "; ".join(parts))


def other_values(store: Store, name: str, values: npt.NDArray[np.float32]) -> Chart:
    """Draw how the sampled values of a modality without a chart of its own are distributed."""
    import plotly.graph_objects as go

    known = values[np.isfinite(values)].astype(np.float64)
    low, median, high = np.percentile(known, [0.5, 50, 99.5])
    if low == high:
        low, high = low - 0.5, high + 0.5
    counts, edges = np.histogram(known, _BINS, (low, high))
    unit = str(store.arrays[name].spec.attributes.get("units", ""))
    unit = "" if unit == "1" else unit
    trace = go.Bar(
        x=(edges[:-1] + edges[1:]) / 2,
        y=100 * counts / known.size,
        marker={"color": "var(--accent)", "line": {"width": 0}},
        hovertemplate="%{y:.2f} % around %{x:.3g}<extra></extra>",
    )
    shown = plain_text(f"{name}, {unit}" if unit else name)
    layout = {"xaxis": axis(shown), "yaxis": axis("share of pixels, %"), "bargap": 0}
    gist = f"{name}: median {median:.3g} {unit}, 99 % between {low:.3g} and {high:.3g} {unit}."
    return make_chart([trace], layout, gist.replace(" ,", ",").replace(" .", "."))
