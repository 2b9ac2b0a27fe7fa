"""nimprep append."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from nimprep.cli.echo import echo
from nimprep.cli.options import (
    given_camera,
    progress_bars,
    quiet_option,
    reading_options,
    report_skipped,
)


@click.command()
@click.argument("src", type=click.Path(path_type=Path))
@click.argument("store")
@reading_options
@click.option(
    "--skip-existing", is_flag=True, help="Leave out frames that STORE has; else they are an error."
)
@click.option("--workers", type=click.IntRange(1), help="Threads; default: all cores.")
@click.option("--restart", is_flag=True, help="Begin anew where an earlier append was cut short.")
@click.option(
    "--on-error",
    type=click.Choice(["stop", "skip"]),
    default="stop",
    show_default=True,
    help="What a bad frame does: end it all, or be left out.",
)
@click.option(
    "--allow-skipped",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    help="Frames that may be left out before the exit code is 1.",
)
@quiet_option
def append(src: Path, store: str, quiet: bool, allow_skipped: int, **given: Any) -> None:
    """Add the frames of the raw dataset SRC to STORE.

    What is made of them, the store says: modalities, recipe, codec, crop. How SRC is read is to be
    said again as it was for the store. Frames in the store keep their split; new ones get theirs
    by its rule and seed. At every moment STORE is the old one or the new one, whole; an append
    that was cut short goes on where it stopped when the same command is given again.
    """
    camera = given_camera(given)
    import nimprep
    from nimprep.store.info import info_text, store_info

    options = nimprep.AppendOptions(camera=camera, **given)
    done = nimprep.append_frames(src, store, options, progress=progress_bars(quiet))
    there = f", {done.existing} were there already" if done.existing else ""
    echo(f"added {len(done.ids)} frames{there}")
    echo()
    echo(info_text(store_info(store)), lines=True)
    report_skipped(store, [asdict(frame) for frame in done.skipped], allow_skipped)
