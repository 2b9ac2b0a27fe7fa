"""nimprep merge."""

from __future__ import annotations

import click

from nimprep.cli.echo import echo
from nimprep.cli.options import progress_bars, quiet_option


@click.command()
@click.argument("stores", nargs=-1, required=True)
@click.argument("out")
@click.option(
    "--prefix",
    metavar="A,B,...",
    help="Put before each store's frame ids and scenes, such as day/,night/; may be empty.",
)
@click.option("--workers", type=click.IntRange(1), help="Threads; default: all cores.")
@click.option("--overwrite", is_flag=True, help="Replace a complete store.")
@quiet_option
def merge(
    stores: tuple[str, ...],
    out: str,
    prefix: str | None,
    workers: int | None,
    overwrite: bool,
    quiet: bool,
) -> None:
    """Join STORES of one kind into the new store OUT.

    Frames keep their order and their split. Images move over as they are compressed; those of
    another codec than the first store's, or of a smaller size than the largest, are compressed
    anew, without loss. STORES are never written to; OUT is complete or not there.
    """
    if len(stores) < 2:
        raise click.UsageError("expected at least two stores to merge and OUT, found one")
    prefixes = None if prefix is None else prefix.split(",")
    if prefixes is not None and len(prefixes) != len(stores):
        raise click.UsageError(
            f"--prefix: expected one for each of {len(stores)} stores, found {len(prefixes)}"
        )
    import nimprep
    from nimprep.store.info import info_text, store_info

    nimprep.merge_stores(
        stores,
        out,
        prefixes=prefixes,
        workers=workers,
        overwrite=overwrite,
        progress=progress_bars(quiet),
    )
    echo(info_text(store_info(out)), lines=True)
