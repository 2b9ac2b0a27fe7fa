"""What several commands share: option types and progress."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import click

Progress = Callable[[str, int], Callable[[], None]]


def parse_numbers(value: str, names: str, kind: type[int] | type[float]) -> tuple[Any, ...]:
    """Return the numbers of "a,b,c,d", as many as there are names.

    Raises
    ------
    click.BadParameter
        They are not numbers, or not as many.
    """
    try:
        numbers = tuple(kind(part) for part in value.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != len(names.split(",")):
        raise click.BadParameter(f"expected {names}, found {value!r}")
    return numbers


def progress_bars(quiet: bool) -> Progress:
    """Return a progress callable that draws on stderr, or nothing where nobody looks.

    Frames per second and the time left are shown to a person; a file, a pipe or --quiet gets none.
    """

    def start(step: str, frames: int) -> Callable[[], None]:
        if quiet or not sys.stderr.isatty():
            return lambda: None
        from tqdm import tqdm

        bar = tqdm(total=frames, desc=step, unit="frame", file=sys.stderr, dynamic_ncols=True)

        def done() -> None:
            bar.update()
            if bar.n >= frames:
                bar.close()

        return done

    return start


def report_skipped(store: object, skipped: Sequence[Mapping[str, str]], allowed: int) -> None:
    """Name the frames that were left out on stderr; exit 1 where they are more than allowed."""
    for frame in skipped:
        click.echo(f"skipped {frame['id']}: {frame['reason']}", err=True)
    if len(skipped) > allowed:
        click.echo(
            f"error: {store}: expected at most {allowed} bad frames, found {len(skipped)}; the "
            f"store is complete without them, --allow-skipped {len(skipped)} says that is fine",
            err=True,
        )
        sys.exit(1)


quiet_option = click.option("--quiet", "-q", is_flag=True, help="No progress bar.")
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON.")
