"""nimprep inspect."""

from __future__ import annotations

import json
from pathlib import Path

import click

from nimprep.cli.echo import echo
from nimprep.cli.options import json_option


@click.command()
@click.argument("src", type=click.Path(path_type=Path))
@json_option
def inspect(src: Path, as_json: bool) -> None:
    """Say what SRC is: a folder of images, an archive, a recording or a store.

    Files are grouped by pattern, some of each are decoded, and what they are is told by their
    values first and their names second: colour, labels, depth and what its numbers mean, with the
    evidence.
    """
    from nimprep.inspection.inspection import inspect_source
    from nimprep.inspection.wording import inspection_text

    document = inspect_source(src).to_dict()
    echo(json.dumps(document, indent=2) if as_json else inspection_text(document), lines=True)
