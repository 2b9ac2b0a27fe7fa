"""nimprep convert."""

from __future__ import annotations

from typing import Any

import click

from nimprep.cli.echo import echo
from nimprep.cli.options import options_from, options_given, progress_bars, report_skipped
from nimprep.conversion.options import ConvertOptions


@click.command()
@click.argument("src", type=click.Path())
@click.argument("out", type=click.Path())
@options_from(ConvertOptions)
def convert(src: str, out: str, quiet: bool, allow_skipped: int, **given: Any) -> None:
    """Turn the raw dataset SRC into the store OUT.

    SRC is never written to. OUT is a folder, or with the extra cloud a URL such as
    s3://bucket/out.zarr. It is complete or not there; a conversion that was cut short goes on
    where it stopped when the same command is given again. What the store holds is printed at the
    end: look at the depth's percentiles to see that the unit is right.
    """
    options = options_given(ConvertOptions, given)
    import nimprep
    from nimprep.store.info import info_text, store_info

    store = nimprep.convert(src, out, options, progress=progress_bars(quiet))
    echo(info_text(store_info(store)), lines=True)
    report_skipped(out, store.about.skipped, allow_skipped)
