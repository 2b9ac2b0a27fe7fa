"""What commands print: the one way to the terminal."""

from __future__ import annotations

import re

import click

from nimprep.text import printable

_BOLD = re.compile("(\x1b\\[[01]m)")
"""Begins bold text, or ends it."""


def echo(text: str = "", *, lines: bool = False, bold: bool = False, err: bool = False) -> None:
    """Print a text; what could steer a terminal is written out.

    Parameters
    ----------
    text : str
    lines : bool
        It is of several lines; whoever put names into them has seen to those of the names.
    bold : bool
        The same of bold letters, which a terminal then shows.
    err : bool
        To stderr.
    """
    parts = _BOLD.split(text) if bold else [text]
    # What was split at stands at the odd places.
    parts[::2] = (printable(part, lines=lines) for part in parts[::2])
    click.echo("".join(parts), err=err)
