"""nimprep convert."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from nimprep.cli.echo import echo
from nimprep.cli.options import (
    given_camera,
    parse_numbers,
    progress_bars,
    quiet_option,
    reading_options,
    report_skipped,
)
from nimprep.modality import MODALITIES, modality_name


def _crop(ctx: click.Context, param: click.Parameter, value: str | None) -> Any:
    if value is None or value == "auto":
        return value
    margins = parse_numbers(value, "top,bottom,left,right", int)
    if min(margins) < 0:
        raise click.BadParameter(f"expected pixels to cut off, 0 or more, found {value!r}")
    return margins


def _modalities(
    ctx: click.Context, param: click.Parameter, value: str | None
) -> tuple[str, ...] | None:
    if value is None:
        return None
    names = tuple(modality_name(name) for name in value.split(","))
    for name in names:
        if name not in MODALITIES:
            known = ", ".join(MODALITIES).replace("_", "-")
            raise click.BadParameter(f"expected some of {known}, found {name!r}")
    return names


def _listed(*, on_request: bool) -> str:
    names = (name for name, m in MODALITIES.items() if m.on_request == on_request)
    return ",".join(names).replace("_", "-")


@click.command()
@click.argument("src", type=click.Path())
@click.argument("out", type=click.Path())
@reading_options
@click.option(
    "--crop",
    callback=_crop,
    metavar="auto|T,B,L,R",
    help="Cut sides that have depth in no frame, or so many pixels: top,bottom,left,right.",
)
@click.option("--no-labels", "labels", flag_value=False, default=True, help="Convert without.")
@click.option(
    "--modalities",
    callback=_modalities,
    help=f"Comma-separated; default: {_listed(on_request=False)} as far as there are; by name "
    f"only: {_listed(on_request=True)}.",
)
@click.option(
    "--normals",
    type=click.Choice(["nim", "nim-edge"]),
    default="nim",
    show_default=True,
    help="Normals by the paper's method, or by the one that keeps depth edges and smooths noise.",
)
@click.option("--sign-filter", is_flag=True, help="Normals by NIM with its sign filter.")
@click.option(
    "--noise",
    type=click.FloatRange(0),
    metavar="PER_METRE",
    help="Standard deviation of inverse depth for nim-edge, 1/m; default: by each frame.",
)
@click.option(
    "--fill",
    type=click.Choice(["none", "nearest", "linear", "colorization"]),
    default="none",
    show_default=True,
    help="Fill holes in depth before normals and HHA are made from it.",
)
@click.option("--store-filled", is_flag=True, help="Store the filled depth, not the raw one.")
@click.option(
    "--normal-dtype", type=click.Choice(["int8", "int16"]), default="int8", show_default=True
)
@click.option(
    "--codec",
    type=click.Choice(["fast", "small"]),
    default="fast",
    show_default=True,
    help="fast to read, or small for archives.",
)
@click.option(
    "--split-by",
    type=click.Choice(["frame", "group", "stratified"]),
    help="Split frames, whole scenes, or frames within each scene; default: frame.",
)
@click.option("--split-file", type=click.Path(path_type=Path), help="Split by this JSON file.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the split.")
@click.option(
    "--shard-length",
    type=click.IntRange(1, 4096),
    default=32,
    show_default=True,
    help="Frames per shard.",
)
@click.option("--workers", type=click.IntRange(1), help="Threads; default: all cores.")
@click.option(
    "--scheduler",
    metavar="tcp://HOST:8786",
    help="Encode on this Dask cluster; every worker must reach SRC and OUT under the same paths.",
)
@click.option("--overwrite", is_flag=True, help="Replace a complete store.")
@click.option(
    "--restart", is_flag=True, help="Begin anew where an earlier conversion was cut short."
)
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
def convert(src: str, out: str, quiet: bool, allow_skipped: int, **given: Any) -> None:
    """Turn the raw dataset SRC into the store OUT.

    SRC is never written to. OUT is a folder, or with the extra cloud a URL such as
    s3://bucket/out.zarr. It is complete or not there; a conversion that was cut short goes on
    where it stopped when the same command is given again. What the store holds is printed at the
    end: look at the depth's percentiles to see that the unit is right.
    """
    camera = given_camera(given)
    if given["split_file"] and given["split_by"]:
        raise click.UsageError("expected --split-file or --split-by, found both")
    if given["store_filled"] and given["fill"] == "none":
        raise click.UsageError("expected --fill with --store-filled, found none")
    if given["sign_filter"] and given["normals"] != "nim":
        raise click.UsageError("expected --sign-filter with --normals nim, found nim-edge")
    if given["noise"] is not None and given["normals"] != "nim-edge":
        raise click.UsageError("expected --noise with --normals nim-edge, found nim")
    import nimprep
    from nimprep.store.info import info_text, store_info

    options = nimprep.ConvertOptions(camera=camera, **given)
    store = nimprep.convert(src, out, options, progress=progress_bars(quiet))
    echo(info_text(store_info(store)), lines=True)
    report_skipped(out, store.about.skipped, allow_skipped)
