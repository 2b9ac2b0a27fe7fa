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
@click.option(
    "--write",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Write a description to start from, for convert's --description.",
)
@click.option("--overwrite", is_flag=True, help="Replace FILE where it is there already.")
def inspect(src: Path, as_json: bool, write: Path | None, overwrite: bool) -> None:
    """Say what SRC is: a folder of images, an archive, a recording or a store.

    Files are grouped by pattern, some of each are decoded, and what they are is told by their
    values first and their names second: colour, labels, depth and what its numbers mean, with the
    evidence. Nothing is written but what --write names.
    """
    from nimprep.errors import LayoutError
    from nimprep.files import check_file, write_whole
    from nimprep.inspection.document import description_bytes
    from nimprep.inspection.inspection import inspect_source
    from nimprep.inspection.wording import inspection_text

    if write is not None:
        check_file(write, src, overwrite=overwrite)
    found = inspect_source(src)
    if write is not None:
        if found.description is None:
            if found.kind == "reader":
                raise LayoutError(
                    f"{src}: expected a folder that needs a description, found {found.what}; "
                    f"{found.next_steps[0]} reads it as it is"
                )
            raise LayoutError(
                f"{src}: expected colour images to describe, found {found.what}; "
                "leave out --write to see what is there"
            )
        write_whole(write, description_bytes(found.description), src, overwrite=overwrite)
        found.next_steps = [
            f"look through {write}, then: nimprep convert {src} OUT.zarr --description {write}"
        ]
    document = found.to_dict()
    echo(json.dumps(document, indent=2) if as_json else inspection_text(document), lines=True)
