"""nimprep report."""

from __future__ import annotations

import click

from nimprep.cli.echo import echo
from nimprep.cli.options import progress_bars, quiet_option


@click.command()
@click.argument("store", type=click.Path())
@click.argument("out", type=click.Path())
@click.option("--overwrite", is_flag=True, help="Replace OUT where it is there already.")
@click.option(
    "--max-mb",
    type=click.FloatRange(min=0, min_open=True),
    default=20.0,
    show_default=True,
    help="OUT stays below so many megabytes; a large store's gallery is then a sample.",
)
@click.option(
    "--road",
    metavar="CLASS",
    help="The class that the table of what tells holds against the others; default: of the large "
    "ones the lowest in the images.",
)
@quiet_option
def report(
    store: str, out: str, overwrite: bool, max_mb: float, road: str | None, quiet: bool
) -> None:
    """Show what is in STORE on one page: the file OUT, HTML that needs no network.

    Statistics are of every frame; the gallery shows as many as fit, what looks wrong among them.
    Prints what looks wrong, and which modality tells the classes apart.
    """
    from nimprep.report.separation_table import advice
    from nimprep.report.store_page import write_report

    made = write_report(store, out, overwrite, max_mb, progress_bars(quiet), road)
    for finding in made.findings:
        text = f"{finding.severity}: {finding.title}: {finding.text}"
        echo(" ".join(text.split()))
    for sentence in advice(made.separation):
        echo(" ".join(sentence.split()))
    echo(
        f"{made.path}: {made.frames} frames, {made.shown} of them with pictures, "
        f"{made.bytes / 1e6:.1f} MB"
    )
