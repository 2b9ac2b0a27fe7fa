"""What several commands share: option types and progress."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from nimprep.cli.echo import echo
from nimprep.errors import ArrayError
from nimprep.options import Option, options_of
from nimprep.text import printable

if TYPE_CHECKING:
    from nimprep.parallel import Progress

Command = TypeVar("Command", bound=Callable[..., Any])
Made = TypeVar("Made")


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


def _intrinsics(
    ctx: click.Context, param: click.Parameter, value: str | None
) -> tuple[float, float, float, float] | None:
    if value is None:
        return None
    from nimprep.camera import Camera
    from nimprep.errors import CameraError

    fx, fy, cx, cy = parse_numbers(value, "fx,fy,cx,cy", float)
    try:
        Camera(fx, fy, cx, cy, width=1, height=1)
    except CameraError as error:
        raise click.BadParameter(str(error)) from error
    return fx, fy, cx, cy


def _crop(ctx: click.Context, param: click.Parameter, value: str | None) -> Any:
    if value is None or value == "auto":
        return value
    margins = parse_numbers(value, "top,bottom,left,right", int)
    if min(margins) < 0:
        raise click.BadParameter(f"expected pixels to cut off, 0 or more, found {value!r}")
    return margins


def _window(ctx: click.Context, param: click.Parameter, value: str | None) -> Any:
    return value if value in (None, "none") else parse_numbers(value, "H,W", int)


def _range(ctx: click.Context, param: click.Parameter, value: str | None) -> Any:
    return None if value is None else parse_numbers(value, "low,high", float)


def _parts(ctx: click.Context, param: click.Parameter, value: str | None) -> Any:
    return tuple(value.split(",")) if value is not None and "," in value else value


def _gravity(
    ctx: click.Context, param: click.Parameter, value: str | None
) -> tuple[float, float, float] | None:
    if value is None:
        return None
    x, y, z = parse_numbers(value, "x,y,z", float)
    return x, y, z


_PARSED: dict[str, Callable[..., Any]] = {
    "auto|T,B,L,R": _crop,
    "H,W|none": _window,
    "LOW,HIGH": _range,
    "SETUP": _parts,
    "X,Y,Z": _gravity,
    "modalities": lambda ctx, param, value: None if value is None else value.split(","),
}
"""What is read in a way of its own, by how it is written, or by its name."""

quiet_option = click.option("--quiet", "-q", is_flag=True, help="No progress bar.")

_intrinsics_option = click.option(
    "--intrinsics",
    callback=_intrinsics,
    metavar="FX,FY,CX,CY",
    help="Camera as numbers, pixels.",
)

_allow_skipped = click.option(
    "--allow-skipped",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    help="Frames that may be left out before the exit code is 1.",
)


def options_from(made: Any) -> Callable[[Command], Command]:
    """Add the options of a dataclass, and those that go with them, to a command."""
    said = _in_order(made)
    every = [_option(each) for each in said]
    every.insert([each.name for each in said].index("camera") + 1, _intrinsics_option)
    return _all_of([*every, _allow_skipped, quiet_option])


def options_alone(made: Any) -> Callable[[Command], Command]:
    """Add the options of a dataclass, and --quiet, to a command."""
    return _all_of([*map(_option, _in_order(made)), quiet_option])


def _in_order(made: Any) -> list[Option]:
    """Return options; how the work is done comes last."""
    return sorted(options_of(made).values(), key=lambda each: not each.counts)


def _all_of(every: Sequence[Callable[[Any], Any]]) -> Callable[[Command], Command]:
    def add(command: Command) -> Command:
        for each in reversed(every):
            command = each(command)
        return command

    return add


def said_by(ctx: click.Context, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return what was said on the command line, without what are defaults."""
    line = click.core.ParameterSource.COMMANDLINE
    return {n: value for n, value in given.items() if ctx.get_parameter_source(n) == line}


class _Number(click.FloatRange):
    """A number in bounds; what is beyond them is told what to do."""

    def __init__(self, least: float | None, most: float | None, *, said: Option) -> None:
        super().__init__(least, most)
        self._said = said

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        try:
            return float(super().convert(value, param, ctx))
        except click.BadParameter as error:
            number = click.FLOAT.convert(value, param, ctx)
            if self.max is None or not self.max < number < math.inf:
                raise
            said = error.message.rstrip(".") + self._said.step_beyond(number)
            raise click.BadParameter(said, ctx, param) from error


def _option(said: Option) -> Callable[[Command], Command]:
    """Return the option of a command that a field says."""
    name = said.name.replace("_", "-")
    if bool in said.types:
        flag = f"--no-{name}" if said.default else f"--{name}"
        return click.option(
            flag, said.name, flag_value=not said.default, default=said.default, help=said.help
        )
    bounds: Any = (said.least, said.most)
    kinds: dict[Any, Any] = {
        Path: click.Path(path_type=Path),
        float: _Number(*bounds, said=said),
        int: click.INT if said.least is None else click.IntRange(*bounds),
    }
    kind = click.Choice(said.choices) if said.choices else None
    if float in said.types and str in said.types:
        # Numbers or words: whose option it is says which.
        kinds = {}
    return click.option(
        f"--{said.flag or name}",
        said.name,
        type=kind or next((kinds[t] for t in kinds if t in said.types), None),
        callback=_PARSED.get(said.metavar or said.name),
        default=said.default,
        show_default=said.default is not None and "default:" not in said.help,
        metavar=said.metavar,
        help=said.help or None,
    )


def options_given(made: Callable[..., Made], given: dict[str, Any]) -> Made:
    """Return the options that were given to a command.

    Raises
    ------
    click.UsageError
        They do not go together.
    """
    intrinsics = given.pop("intrinsics")
    if given["camera"] and intrinsics:
        raise click.UsageError("expected --camera or --intrinsics, found both")
    try:
        return made(**{**given, "camera": given["camera"] or intrinsics})
    except ArrayError as error:
        raise usage_error(error, made) from error


def usage_error(error: ArrayError, made: Any) -> click.UsageError:
    """Return what is said of a call with an option of a dataclass that is wrong."""
    name, _, rest = str(error).partition(": ")
    said = options_of(made).get(name)
    flag = (said and said.flag) or name.replace("_", "-")
    return click.UsageError(f"--{flag}: {rest}")


def progress_bars(quiet: bool) -> Progress:
    """Return a progress callable that draws on stderr, or nothing where nobody looks.

    Frames per second and the time left are shown to a person; a file, a pipe or --quiet gets none.
    """

    def start(step: str, frames: int) -> Callable[[], None]:
        if quiet or not sys.stderr.isatty():
            return lambda: None
        from tqdm import tqdm

        name = printable(step)
        bar = tqdm(total=frames, desc=name, unit="frame", file=sys.stderr, dynamic_ncols=True)

        def done() -> None:
            bar.update()
            if bar.n >= frames:
                bar.close()

        return done

    return start


def report_skipped(store: object, skipped: Sequence[Mapping[str, str]], allowed: int) -> None:
    """Name the frames that were left out on stderr; exit 1 where they are more than allowed."""
    for frame in skipped:
        echo(f"skipped {frame['id']}: {frame['reason']}", err=True)
    if len(skipped) > allowed:
        echo(
            f"error: {store}: expected at most {allowed} bad frames, found {len(skipped)}; the "
            f"store is complete without them, --allow-skipped {len(skipped)} says that is fine",
            err=True,
        )
        sys.exit(1)


json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON.")
