"""Bring a folder of predictions, or of ground truths, to the bird's-eye view."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.files import check_file, write_whole
from nimprep.folders import refuse_inside
from nimprep.images import read_header, read_label
from nimprep.kitti.bev import bring_to_bev
from nimprep.kitti.confidences import Confidences, find_confidences
from nimprep.kitti.images import png_bytes
from nimprep.kitti.names import PredictionName, Target
from nimprep.parallel import Progress, map_frames


def transform_folder(
    predictions: Path | str,
    out: Path | str,
    calib: Path | str | None,
    progress: Progress | None = None,
    *,
    target: Target = "road",
    overwrite: bool = False,
) -> tuple[Path, ...]:
    """Write each image of a folder as bird's-eye view, under the benchmark's name.

    Parameters
    ----------
    predictions : folder
        ``<cat>_<type>_<number>`` or the frame's id: confidences of 8 or 16 bits (.png; where all
        are 0 and 1, masks), probabilities (.npy), or ground truths in the benchmark's own colours
        (red = evaluated, blue = road, no green). Images of 400x800 are there already.
    out : folder
        Made as needed.
    calib : folder
        Calibrations, ``um_000000.txt``.
    target : {"road", "lane"}
        What images named by frame id show.
    overwrite : bool
        Replace images that are there already; without, they are an error.

    Returns
    -------
    tuple of Path
        What was written.

    Raises
    ------
    LayoutError
        A folder or a calibration is missing, a name is wrong, `out` is inside a source, or a
        file is there already.
    DecodeError
        An image or a calibration is bad, or their sizes differ.
    """
    predictions, out = Path(predictions), Path(out)
    calib = None if calib is None else Path(calib)
    sources = (predictions, *([calib] if calib else []))
    refuse_inside(out, *sources)
    found = find_confidences(predictions, target=target)
    for name in found.files:
        check_file(out / name.png, *sources, overwrite=overwrite)

    def transform(name: PredictionName) -> Path:
        written = out / name.png
        image = png_bytes(_transformed(name, found, calib))
        write_whole(written, image, *sources, overwrite=overwrite)
        return written

    return tuple(map_frames("bev", transform, list(found.files), progress))


def _transformed(name: PredictionName, found: Confidences, calib: Path | None) -> npt.NDArray[Any]:
    path = found.files[name]
    image = _ground_truth_colours(path)
    if image is None:
        image = found.read(name)
    return bring_to_bev(image, path, calib, name.frame)


def _ground_truth_colours(path: Path) -> npt.NDArray[Any] | None:
    """Return a ground truth as (H, W, 3) uint8, R, G, B; None where the image is none.

    A ground truth holds 0 and 255 only, no green, and some red.
    """
    header = read_header(path)
    if (header.bits, header.kind) != (8, "RGB"):
        return None
    image = read_label(path)
    pure = not image[:, :, 1].any() and not np.any((image != 0) & (image != 255))
    return image if pure and image[:, :, 0].any() else None
