"""nimprep synth and nimprep demo."""

from __future__ import annotations

import itertools
from pathlib import Path

import click

from nimprep.cli.demo_training import FRAMES, SIZE, check_extra, train_demo
from nimprep.cli.echo import echo
from nimprep.cli.options import parse_numbers, progress_bars, quiet_option
from nimprep.frame import MAX_PIXELS
from nimprep.text import printable

DEMO_FRAMES = 16


def _size(ctx: click.Context, param: click.Parameter, value: str) -> tuple[int, int]:
    width, height = parse_numbers(value.replace("x", ","), "WIDTH,HEIGHT", int)
    if min(width, height) < 1 or width * height > MAX_PIXELS:
        raise click.BadParameter(f"expected 1 to {MAX_PIXELS} pixels in all, found {value!r}")
    return height, width


@click.command()
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--frames", type=click.IntRange(1), default=16, show_default=True)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option(
    "--size", callback=_size, default="640x480", show_default=True, metavar="WIDTHxHEIGHT"
)
@click.option("--normals", is_flag=True, help="Write exact normals and depth too, as .npy.")
@click.option("--no-noise", is_flag=True, help="Exact depth instead of a stereo camera's.")
@quiet_option
def synth(
    out: Path,
    frames: int,
    seed: int,
    size: tuple[int, int],
    normals: bool,
    no_noise: bool,
    quiet: bool,
) -> None:
    """Make a synthetic dataset of outdoor scenes in the folder OUT, in GMRP's layout."""
    from nimprep.synthetic import write_synthetic

    done = progress_bars(quiet)("ray-casting", frames)
    write_synthetic(
        out,
        frames,
        seed,
        size,
        normals=normals,
        noise=not no_noise,
        progress=lambda _: done(),
    )
    echo(f"{out}: {frames} frames of {size[1]}x{size[0]} pixels")


def _free_name() -> Path:
    """Return nimprep-demo, or where that is taken nimprep-demo-2 and so on."""
    numbered = (Path(f"nimprep-demo-{number}") for number in itertools.count(2))
    names = itertools.chain([Path("nimprep-demo")], numbered)
    return next(path for path in names if not (path.exists() or path.is_symlink()))


@click.command()
@click.argument("out", type=click.Path(path_type=Path), required=False)
@click.option("--train", is_flag=True, help="Train a small MFNet on it, predict and score too.")
@quiet_option
def demo(out: Path | None, train: bool, quiet: bool) -> None:
    """Make a small dataset in the folder OUT, convert it, check it, and say what to do next.

    Needs no data and no network. OUT is a new or empty folder; default: nimprep-demo. With --train
    OUT gets run/, a network that has learned from it, its predictions/ of frames that it has never
    seen, and evaluation.json, what they are worth: in a few minutes, without a GPU.
    """
    from nimprep.folders import check_folder

    if train:
        check_extra()
    out = out or _free_name()
    check_folder(out)
    store = out / "demo.zarr"
    frames, size = (FRAMES, SIZE) if train else (DEMO_FRAMES, (480, 640))
    _make_store(out / "raw", store, frames, size, quiet)
    if train:
        train_demo(store, out, quiet)
    else:
        echo(_NEXT.format(store=printable(str(store))), lines=True)


def _make_store(raw: Path, store: Path, frames: int, size: tuple[int, int], quiet: bool) -> None:
    """Make scenes, convert and check them."""
    import nimprep
    from nimprep.errors import StoreError
    from nimprep.store.info import info_text, store_info
    from nimprep.store.validate import validate_store
    from nimprep.synthetic import write_synthetic

    progress = progress_bars(quiet)
    said = "" if size == (480, 640) else f" --size {size[1]}x{size[0]}"
    _step(f"nimprep synth {raw} --frames {frames}{said}")
    done = progress("ray-casting", frames)
    write_synthetic(raw, frames, size=size, progress=lambda _: done())
    _step(f"nimprep convert {raw} {store}")
    nimprep.convert(raw, store, progress=progress)
    _step(f"nimprep validate --deep {store}")
    report = validate_store(store, deep=True, progress=progress)
    if not report.valid:
        raise StoreError(f"{store}: expected a valid store, found {report.problems[0]}")
    echo(f"{report.frames} frames, every chunk and normal checked: valid")
    echo()
    _step(f"nimprep info {store}")
    echo(info_text(store_info(store)), lines=True)


def _step(command: str) -> None:
    echo(f"$ {command}")


_NEXT = """
What to do next
  your own data:     nimprep convert FOLDER out.zarr   (nimprep convert --help)
  in Python:         import nimprep; frame = nimprep.open_store("{store}")[0]
  in xarray:         xarray.open_zarr("{store}")
  another split:     nimprep split {store} --seed 1
"""
