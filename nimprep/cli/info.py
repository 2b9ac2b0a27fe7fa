"""nimprep info and nimprep validate."""

from __future__ import annotations

import json
import sys

import click

from nimprep.cli.echo import echo
from nimprep.cli.options import json_option, progress_bars, quiet_option

_NAMED = 10
"""So much that is not nimprep's is named; of the rest the number is given."""


@click.command()
@click.argument("store", type=click.Path())
@json_option
def info(store: str, as_json: bool) -> None:
    """Show what STORE holds: frames, modalities, splits, camera, depth."""
    from nimprep.store.info import info_text, store_info

    found = store_info(store)
    echo(json.dumps(found, indent=2) if as_json else info_text(found), lines=True)


@click.command()
@click.argument("store", type=click.Path())
@click.option("--deep", is_flag=True, help="Decode and check every pixel.")
@json_option
@quiet_option
def validate(store: str, deep: bool, as_json: bool, quiet: bool) -> None:
    """Check STORE against the format; exit 1 where something is wrong."""
    from nimprep.store.validate import validate_store

    report = validate_store(store, deep=deep, progress=progress_bars(quiet))
    if as_json:
        echo(json.dumps(report.to_dict(), indent=2), lines=True)
    elif report.valid:
        checks = ", ".join(f"{number} {what}" for what, number in report.checks.items())
        echo(f"{store}: valid, {report.frames} frames ({checks} checked)")
    else:
        for problem in report.problems:
            echo(f"{store}: {problem}")
    if report.extras and not as_json:
        more = len(report.extras) - _NAMED
        named = ", ".join(report.extras[:_NAMED]) + (f" and {more} more" if more > 0 else "")
        echo(f"{store}: not nimprep's, and not checked: {named}")
    if not report.valid:
        echo(
            f"error: {store}: expected a valid store, found it is not "
            f"({len(report.problems)} problems)",
            err=True,
        )
        sys.exit(1)
