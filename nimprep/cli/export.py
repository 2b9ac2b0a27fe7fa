"""nimprep export."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from nimprep.cli.echo import echo
from nimprep.cli.options import parse_numbers, progress_bars, quiet_option


def _size(ctx: click.Context, param: click.Parameter, value: str | None) -> tuple[int, ...] | None:
    return None if value is None else parse_numbers(value, "H,W", int)


def _export_onnx(run: str, out: Path, size: tuple[int, int] | None, overwrite: bool) -> None:
    import nimprep.torch  # noqa: F401  (says which extra it comes with, where it is not there)
    from nimprep.networks.onnx import export_onnx

    made = export_onnx(run, out, size, overwrite=overwrite)
    names = ", ".join(f"{entry.name} ({','.join(map(str, entry.shape))})" for entry in made.inputs)
    height, width = made.size
    echo(f"{out}: opset {made.opset}, {names}; height {height}, width {width}")


@click.command()
@click.argument("store", type=click.Path())
@click.argument("out", type=click.Path(path_type=Path))
@click.option(
    "--format",
    "form",
    type=click.Choice(["png", "rerun", "npz", "rgbx", "roadformer", "voc", "coco"]),
    help="png: GMRP's raw layout; rerun: one .rrd recording; npz: one archive per frame; rgbx: for "
    "CMX, DFormer and Sigma; roadformer: for RoadFormer; voc: "
    "PASCAL VOC's; coco: COCO's JSON.",
)
@click.option(
    "--onnx",
    "as_onnx",
    is_flag=True,
    help="STORE is a run of nimprep train, OUT the ONNX file of its network.",
)
@click.option(
    "--size",
    callback=_size,
    metavar="H,W",
    help="With --onnx: the frames' height and width; default: of those it was trained on.",
)
@click.option(
    "--frames",
    multiple=True,
    metavar="WHICH",
    help="Ids, splits (train, val, test, none) and ranges START:END of frame numbers from 0, END "
    "left out, joined by commas; may be given several times. Default: all.",
)
@click.option(
    "--modalities",
    metavar="LIST",
    help="Comma-separated, not with rerun: what to write. Default: rgb,depth,label of png, all of "
    "npz, what the networks read of the others.",
)
@click.option(
    "--overwrite",
    is_flag=True,
    help="With rerun and --onnx, replace OUT where it is there already.",
)
@quiet_option
def export(
    store: str,
    out: Path,
    form: Any,
    as_onnx: bool,
    size: tuple[int, int] | None,
    frames: tuple[str, ...],
    modalities: str | None,
    overwrite: bool,
    quiet: bool,
) -> None:
    """Write frames of STORE to the new or empty folder OUT; with rerun, to the new file OUT.

    \b
    png    rgb/ depth_u16/ label/ as GMRP ships them, each frame at its own size, with cameras,
           split.json and description.json, so that
             nimprep convert OUT NEW.zarr --description OUT/description.json
                                          --split-file OUT/split.json
           gives the same images, labels, cameras and splits again.
           With --modalities hha,normal: hha/ and normal/ as PNGs, as exact as the store, and
           encodings.json, which says how to read them:
             hha     8-bit R, G, B: horizontal disparity, height, angle; (0, 0, 0) = none.
             normal  R, G, B: x right, y down, z forward; n = (png - 128) / 127 of 8 bits,
                     (png - 32768) / 32767 of 16 (convert --normal-dtype int16);
                     (0, 0, 0) = none.
             others  value = (png - subtract) * scale + offset.
    rerun  camera, points (at most 200,000 a frame), images and labels; "rerun OUT" shows it.
           Needs the extra: pip install 'nimprep[rerun]'.
    npz    every modality, in float units where it has any: rgb, depth_m (metres, 0 = none),
           normal (unit vectors), hha, label ...; K, baseline_m, cam_to_road, gravity (NaN =
           none); id, split, group.
    rgbx   RGB/ Depth/ HHA/ Label/ train.txt val.txt test.txt: for CMX, DFormer, Sigma.
    roadformer
           images/ normal/ annotations/, in each training/ validation/ testing/.
    voc    JPEGImages/ SegmentationClass/ ImageSets/Segmentation/; 255 = void.
    coco   images/ annotations/instances_train.json ...: a mask of each class of each image.

    \b
    Frames without a split are left out of these; what they lose is said.

    \b
    --frames test         the test split
    --frames 0:10,20:     frames 0 to 9, and from 20 on
    --frames 000003       the frame of this id

    \b
    nimprep export RUN OUT.onnx --onnx
        the network of a run of nimprep train, its normals computed inside: rgb, depth and
        intrinsics in, logits out. Needs the extra: pip install 'nimprep[onnx]'.
    """
    if as_onnx:
        if form is not None or frames or modalities is not None:
            raise click.UsageError(
                "expected --onnx of a run alone, found --format, --frames or --modalities with it"
            )
        _export_onnx(store, out, size, overwrite)
        return
    if form is None:
        raise click.UsageError("expected --format of a store, or --onnx of a run, found neither")
    if size is not None:
        raise click.UsageError("expected --onnx with --size, found --format")
    if overwrite and form != "rerun":
        raise click.UsageError(
            f"expected --format rerun with --overwrite, found {form}: a folder must be new or empty"
        )
    if modalities is not None and form == "rerun":
        raise click.UsageError("expected another --format with --modalities, found rerun")
    from nimprep.export import export_frames

    progress = progress_bars(quiet)
    names = None if modalities is None else modalities.split(",")
    ids = export_frames(
        store, out, form, frames or None, progress, modalities=names, overwrite=overwrite
    )
    echo(f"{out}: {len(ids)} frames")
