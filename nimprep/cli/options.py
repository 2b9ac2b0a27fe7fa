"""What several commands share: option types and progress."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from nimprep.cli.echo import echo
from nimprep.text import printable

if TYPE_CHECKING:
    from nimprep.parallel import Progress

Command = TypeVar("Command", bound=Callable[..., Any])


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


_READING = (
    click.option(
        "--reader",
        type=click.Choice(["auto", "gmrp", "kitti-road", "folder"]),
        default="auto",
        help="Layout of SRC; default: by its folders.",
    ),
    click.option(
        "--description",
        type=click.Path(path_type=Path),
        help="JSON description of a folder dataset (schemas/folder.schema.json).",
    ),
    click.option("--camera", type=click.Path(path_type=Path), help="Camera file, JSON."),
    click.option(
        "--intrinsics",
        callback=_intrinsics,
        metavar="FX,FY,CX,CY",
        help="Camera as numbers, pixels.",
    ),
    click.option(
        "--depth-scale", type=click.FloatRange(1e-9, 1000), help="Metres per raw depth unit."
    ),
    click.option(
        "--target",
        type=click.Choice(["road", "lane"]),
        default="road",
        show_default=True,
        help="Which of KITTI road's ground truths.",
    ),
    click.option(
        "--depth-from",
        type=click.Choice(["auto", "lidar", "stereo"]),
        default="auto",
        show_default=True,
        help="Where KITTI road's depth comes from; auto: depth_u16, else LiDAR, else stereo.",
    ),
    click.option("--sparse", is_flag=True, help="Leave KITTI road's depth as measured."),
)


def reading_options(command: Command) -> Command:
    """Add the options that say how a raw dataset is read."""
    for option in reversed(_READING):
        command = option(command)
    return command


def given_camera(given: dict[str, Any]) -> Any:
    """Take --camera and --intrinsics out of the options given; return which was.

    Raises
    ------
    click.UsageError
        Both were.
    """
    camera, intrinsics = given.pop("camera"), given.pop("intrinsics")
    if camera and intrinsics:
        raise click.UsageError("expected --camera or --intrinsics, found both")
    return camera or intrinsics


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


quiet_option = click.option("--quiet", "-q", is_flag=True, help="No progress bar.")
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON.")
