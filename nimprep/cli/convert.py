"""nimprep convert."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from nimprep.cli.options import parse_numbers, progress_bars, quiet_option, report_skipped
from nimprep.frame import MODALITIES


def _crop(ctx: click.Context, param: click.Parameter, value: str | None) -> Any:
    if value is None or value == "auto":
        return value
    return parse_numbers(value, "top,bottom,left,right", int)


def _intrinsics(
    ctx: click.Context, param: click.Parameter, value: str | None
) -> tuple[float, float, float, float] | None:
    if value is None:
        return None
    fx, fy, cx, cy = parse_numbers(value, "fx,fy,cx,cy", float)
    return fx, fy, cx, cy


def _modalities(
    ctx: click.Context, param: click.Parameter, value: str | None
) -> tuple[str, ...] | None:
    if value is None:
        return None
    names = tuple(name.strip() for name in value.split(","))
    for name in names:
        if name not in MODALITIES:
            raise click.BadParameter(f"expected some of {', '.join(MODALITIES)}, found {name!r}")
    return names


@click.command()
@click.argument("src", type=click.Path(path_type=Path))
@click.argument("out", type=click.Path(path_type=Path))
@click.option(
    "--reader",
    type=click.Choice(["auto", "gmrp", "kitti-road", "folder"]),
    default="auto",
    help="Layout of SRC; default: by its folders.",
)
@click.option(
    "--description",
    type=click.Path(path_type=Path),
    help="JSON description of a folder dataset (schemas/folder.schema.json).",
)
@click.option("--camera", type=click.Path(path_type=Path), help="Camera file, JSON.")
@click.option(
    "--intrinsics", callback=_intrinsics, metavar="FX,FY,CX,CY", help="Camera as numbers, pixels."
)
@click.option(
    "--crop",
    callback=_crop,
    metavar="auto|T,B,L,R",
    help="Cut sides that have depth in no frame, or so many pixels: top,bottom,left,right.",
)
@click.option("--no-labels", "labels", flag_value=False, default=True, help="Convert without.")
@click.option("--depth-scale", type=click.FloatRange(1e-9, 1000), help="Metres per raw depth unit.")
@click.option(
    "--target",
    type=click.Choice(["road", "lane"]),
    default="road",
    show_default=True,
    help="Which of KITTI road's ground truths.",
)
@click.option(
    "--depth-from",
    type=click.Choice(["auto", "lidar", "stereo"]),
    default="auto",
    show_default=True,
    help="Where KITTI road's depth comes from; auto: depth_u16, else LiDAR, else stereo.",
)
@click.option("--sparse", is_flag=True, help="Leave KITTI road's depth as measured.")
@click.option(
    "--modalities", callback=_modalities, help="Comma-separated; default: all that can be had."
)
@click.option("--sign-filter", is_flag=True, help="Normals by NIM with its sign filter.")
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
def convert(src: Path, out: Path, quiet: bool, allow_skipped: int, **given: Any) -> None:
    """Turn the raw dataset SRC into the store OUT.

    SRC is never written to. OUT is complete or not there; a conversion that was cut short goes on
    where it stopped when the same command is given again. What the store holds is printed at the
    end: look at the depth's percentiles to see that the unit is right.
    """
    if given["camera"] and given["intrinsics"]:
        raise click.UsageError("expected --camera or --intrinsics, found both")
    if given["split_file"] and given["split_by"]:
        raise click.UsageError("expected --split-file or --split-by, found both")
    if given["store_filled"] and given["fill"] == "none":
        raise click.UsageError("expected --fill with --store-filled, found none")
    import nimprep
    from nimprep.store.info import info_text, store_info

    camera, intrinsics = given.pop("camera"), given.pop("intrinsics")
    options = nimprep.ConvertOptions(camera=camera or intrinsics, **given)
    store = nimprep.convert(src, out, options, progress=progress_bars(quiet))
    click.echo(info_text(store_info(out)))
    report_skipped(out, store.attributes.get("skipped", []), allow_skipped)
