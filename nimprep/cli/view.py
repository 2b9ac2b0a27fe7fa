"""nimprep view."""

from __future__ import annotations

import click

from nimprep.cli.echo import echo
from nimprep.cli.options import progress_bars, quiet_option


@click.command()
@click.argument("store", type=click.Path())
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=8123,
    show_default=True,
    help="On this machine; 0 = any that is free.",
)
@click.option("--browser", is_flag=True, help="Open the page in the browser too.")
@quiet_option
def view(store: str, port: int, browser: bool, quiet: bool) -> None:
    """Show STORE in the browser: the page of `nimprep report`, with every frame.

    Served to this machine only, at 127.0.0.1, from memory; nothing is written. Ctrl-C ends it.
    """
    from nimprep.report.server import make_server
    from nimprep.report.store_page import examine

    seen = examine(store, progress_bars(quiet))
    with make_server(seen, port) as server:
        echo(f"{store}: {len(seen.store)} frames at {server.address} (Ctrl-C ends)")
        if browser:
            click.launch(server.address)
        server.run()
