"""nimprep warm-up."""

from __future__ import annotations

import click

from nimprep.cli.echo import echo


@click.command("warm-up")
def warm_up() -> None:
    """Compile every kernel now, so that no later command has to.

    They are kept in NUMBA_CACHE_DIR where it is set, else beside the package, else in the user's
    cache. For an image: run it while building, as who may write there; who runs the image need not.
    They fit this machine's kind of CPU; on another, they are compiled again.
    """
    import nimprep

    done = nimprep.warm_up()
    folders = ", ".join(str(folder) for folder in done.folders)
    there = done.kernels - done.compiled
    echo(
        f"{folders}: {done.kernels} kernels, {done.compiled} compiled and {there} there already, "
        f"{done.seconds:.1f} s"
    )
