"""What the page's charts share: a figure with its gist in words, axes, a legend, safe text."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from nimprep.report.page import figure_object

MARGIN = {"l": 48, "r": 12, "t": 8, "b": 40}


@dataclass(frozen=True)
class Chart:
    """Hold a chart: a Plotly figure as JSON holds it, and what it shows in a sentence."""

    figure: dict[str, Any]
    gist: str


def make_chart(traces: list[Any], layout: dict[str, Any], gist: str) -> Chart:
    import plotly.graph_objects as go

    settings = {"template": "none", "margin": MARGIN, "showlegend": False, **layout}
    return Chart(figure_object(go.Figure(traces, settings)), gist)


def axis(title: str, **more: Any) -> dict[str, Any]:
    return {"title": {"text": title}, "fixedrange": True, **more}


LEGEND: dict[str, Any] = {
    "showlegend": True,
    "legend": {"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom", "traceorder": "normal"},
    "margin": {**MARGIN, "t": 36},
}


def plain_text(text: str) -> str:
    """Return text that Plotly shows as it is: it reads some HTML, and % in templates."""
    text = text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return text.replace("%{", "%\u200b{")
