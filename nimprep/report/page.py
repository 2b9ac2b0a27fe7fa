"""Pages of HTML that need nothing but themselves: templates, scripts, policy."""

from __future__ import annotations

import base64
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from nimprep.errors import NimprepError

if TYPE_CHECKING:
    from jinja2 import Environment

LIBRARIES = ("jinja2", "plotly")
"""What the extra `report` brings."""


def check_libraries() -> None:
    """Raise `NimprepError` where the extra `report` is not installed."""
    from importlib.util import find_spec

    missing = [name for name in LIBRARIES if find_spec(name) is None]
    if missing:
        raise NimprepError(
            f"report: expected {' and '.join(LIBRARIES)}, found no {' and no '.join(missing)}; "
            "pip install 'nimprep[report]'"
        )


def render_page(
    template: str,
    context: Mapping[str, Any],
    scripts: Sequence[str] = (),
    figures: Mapping[str, Any] | None = None,
    served: bool = False,
) -> str:
    """Return a page as HTML that loads nothing from anywhere.

    Parameters
    ----------
    template : str
        A file of templates/ that extends base.html.j2. Whatever it prints is escaped.
    context : mapping
        What the template names.
    scripts : sequence of str
        Files of assets/ to run, after base.js.
    figures : mapping of str to dict, optional
        Plotly figures by the id of the element, made by the macro ``chart``, that shows each.
        Colours may be "var(--name)", a property of the style sheet. None leaves Plotly out.
    served : bool
        The page may load pictures from where it came from; else not even that.

    Notes
    -----
    The page carries a content security policy: only its own scripts run, known by their hashes, and
    nothing is fetched. A name in a store that got past the escaping would still do nothing.
    """
    check_libraries()
    code = [asset(name) for name in ("base.js", *scripts)]
    if figures is not None:
        code.insert(0, plotly_script())
    allowed = " ".join(f"'sha256-{_digest(text)}'" for text in code)
    pictures = "data: 'self'" if served else "data:"
    policy = (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; "
        f"img-src {pictures}; base-uri 'none'; form-action 'none'"
    )
    page = environment().get_template(template)
    return page.render(
        {
            **context,
            "policy": policy,
            "style": _trusted(asset("style.css")),
            "scripts": [_trusted(text) for text in code],
            "figures": figures or {},
        }
    )


@cache
def environment() -> Environment:
    """Return the templates' environment: everything printed is escaped, every name must exist."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    made = Environment(
        loader=PackageLoader("nimprep.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["share"] = percent
    made.filters["count"] = lambda number: f"{number:,}".replace(",", "\u202f")
    return made


def percent(share: float) -> str:
    """Return a share, 0 to 1, for a person: three digits at most; "–" for NaN."""
    if math.isnan(share):
        return "–"
    value = 100 * share
    if value == 0:
        return "0\u202f%"
    if value < 0.01:
        return "<\u202f0.01\u202f%"
    return f"{value:.2f}\u202f%" if value < 1 else f"{value:.1f}\u202f%"


@cache
def asset(name: str) -> str:
    """Return a file of assets/."""
    return files("nimprep.report").joinpath("assets", name).read_text(encoding="utf-8")


@cache
def plotly_script() -> str:
    """Return Plotly's own minified script, as its Python package ships it."""
    from plotly.offline import get_plotlyjs

    return str(get_plotlyjs())


def figure_object(figure: Any) -> dict[str, Any]:
    """Return a Plotly figure as what JSON can hold, arrays packed."""
    return dict(json.loads(figure.to_json()))


@cache
def _digest(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _trusted(text: str) -> Any:
    """Mark our own files as HTML, after checking that they cannot end their element."""
    from markupsafe import Markup

    if "</script" in text.lower() or "</style" in text.lower() or "<!--" in text:
        raise ValueError("a script or a style sheet holds what would end it")
    return Markup(text)
