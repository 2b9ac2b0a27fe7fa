"""Bring a folder of predictions, or of ground truths, to the bird's-eye view."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.images import read_header, read_label
from nimprep.kitti.bev import bring_to_bev
from nimprep.kitti.images import png_bytes, read_confidence, refuse_inside, write_whole
from nimprep.kitti.names import PREDICTION_SUFFIXES, PredictionName, predictions_by_name
from nimprep.kitti.parallel import Progress, map_frames


def transform_folder(
    predictions: Path | str,
    out: Path | str,
    calib: Path | str | None,
    progress: Progress | None = None,
) -> tuple[Path, ...]:
    """Write each image of a folder as bird's-eye view, under its own name.

    Parameters
    ----------
    predictions : folder
        ``<cat>_<type>_<number>``: 8-bit confidences (.png), probabilities (.npy), or ground truths
        in the benchmark's own colours (red = evaluated, blue = road, no green). Images of 400x800
        are there already.
    out : folder
        Made as needed; images of the same names are replaced.
    calib : folder
        Calibrations, ``um_000000.txt``.

    Returns
    -------
    tuple of Path
        What was written.

    Raises
    ------
    LayoutError
        A folder or a calibration is missing, a name is wrong, or `out` is inside a source.
    DecodeError
        An image or a calibration is bad, or their sizes differ.
    """
    predictions, out = Path(predictions), Path(out)
    calib = None if calib is None else Path(calib)
    refuse_inside(out, predictions, *([calib] if calib else []))
    files = list(predictions_by_name(predictions, PREDICTION_SUFFIXES).items())
    transform = partial(_transform_file, out=out, calib=calib)
    return tuple(map_frames("bev", transform, files, progress))


def _transform_file(item: tuple[PredictionName, Path], out: Path, calib: Path | None) -> Path:
    name, path = item
    image = _ground_truth_colours(path)
    if image is None:
        image = read_confidence(path)
    written = out / name.png
    write_whole(written, png_bytes(bring_to_bev(image, path, calib, name.frame)))
    return written


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
