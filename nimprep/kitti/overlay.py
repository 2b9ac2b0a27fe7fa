"""The paper's figure: what a prediction got right, missed and made up, over the photograph."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nimprep.arrays import unmasked, without_mask
from nimprep.errors import ArrayError, DecodeError, LayoutError
from nimprep.files import check_file, write_whole
from nimprep.folders import refuse_inside
from nimprep.images import read_rgb
from nimprep.kitti.bev import bring_to_bev
from nimprep.kitti.confidences import find_confidences, listed
from nimprep.kitti.evaluation import Pairs, View
from nimprep.kitti.images import GroundTruth, png_bytes
from nimprep.kitti.names import PredictionName, Target, truths_by_name
from nimprep.parallel import Progress, map_frames

TRUE_POSITIVE = (0, 255, 0)
FALSE_NEGATIVE = (255, 0, 0)
FALSE_POSITIVE = (0, 0, 255)


@dataclass(frozen=True)
class OverlayFolders:
    """Name what a set of overlays is drawn from.

    Attributes
    ----------
    predictions : Path
        Confidence maps, ``um_road_000000`` or ``um_000000``, .png or .npy.
    ground_truth : Path
        The benchmark's ``gt_image_2``.
    images : Path
        Its ``image_2``: ``um_000000.png``.
    calib : Path, optional
        Calibrations; needed for the bird's-eye view.
    target : {"road", "lane"}
        What predictions named by frame id predict.
    """

    predictions: Path
    ground_truth: Path
    images: Path
    calib: Path | None = None
    target: Target = "road"

    @property
    def all(self) -> list[Path]:
        """Every folder that is read."""
        folders = (self.predictions, self.ground_truth, self.images, self.calib)
        return [folder for folder in folders if folder is not None]


def draw_overlay(
    image: npt.NDArray[np.uint8],
    confidence: npt.NDArray[np.uint8],
    truth: GroundTruth,
    threshold: float = 0.5,
) -> npt.NDArray[np.uint8]:
    """Colour the evaluated pixels of a photograph by outcome, half transparent.

    True positives green, false negatives red, false positives blue.

    Parameters
    ----------
    image : (H, W, 3) uint8, R, G, B
    confidence : (H, W) uint8
    truth : GroundTruth, (H, W)
        Masked pixels are not evaluated.
    threshold : float
        Confidence, 0 to 1, at or above which a pixel is called positive.

    Returns
    -------
    (H, W, 3) uint8, R, G, B

    Raises
    ------
    ArrayError
        The sizes differ, or the image or the confidence is not uint8 or has masked pixels.
    """
    image, confidence = without_mask(image, "image"), without_mask(confidence, "confidence")
    if image.ndim != 3 or image.shape[2] != 3:
        raise ArrayError(f"image: expected (H, W, 3), found shape {image.shape}")
    evaluated = unmasked(truth.evaluated, False) & ~np.ma.getmaskarray(truth.positive)
    truth = GroundTruth(positive=np.asarray(truth.positive), evaluated=evaluated)
    for name, array in (("confidence", confidence), ("truth", truth.evaluated)):
        if array.shape != image.shape[:2]:
            raise ArrayError(
                f"{name}: expected the image's size {image.shape[:2]}, found {array.shape}"
            )
    for name, array in (("image", image), ("confidence", confidence)):
        if array.dtype != np.uint8:
            raise ArrayError(f"{name}: expected uint8, found {array.dtype}")
    return draw_outcomes(image, confidence / 255 >= threshold, truth)


def draw_outcomes(
    image: npt.NDArray[np.uint8], called: npt.NDArray[np.bool_], truth: GroundTruth
) -> npt.NDArray[np.uint8]:
    """Colour the evaluated pixels of a photograph by what became of them, half transparent.

    Parameters
    ----------
    image : (H, W, 3) uint8, R, G, B
    called : (H, W) bool
        Predicted as positive.
    truth : GroundTruth, (H, W)

    Returns
    -------
    (H, W, 3) uint8, R, G, B
        True positives green, false negatives red, false positives blue; all else as it was.
    """
    outcomes = (
        (called & truth.positive, TRUE_POSITIVE),
        (~called & truth.positive, FALSE_NEGATIVE),
        (called & ~truth.positive, FALSE_POSITIVE),
    )
    drawn = image.copy()
    for mask, colour in outcomes:
        tint(drawn, mask & truth.evaluated, colour)
    return drawn


def tint(
    image: npt.NDArray[np.uint8], mask: npt.NDArray[np.bool_], colour: tuple[int, int, int]
) -> None:
    """Mix half of a colour into the pixels of a mask, in place."""
    # Halving each first keeps the sum in 8 bits.
    image[mask] = image[mask] // 2 + np.array(colour, np.uint8) // 2


def write_overlays(
    folders: OverlayFolders,
    out: Path | str,
    view: View = "perspective",
    threshold: float = 0.5,
    progress: Progress | None = None,
    *,
    overwrite: bool = False,
) -> tuple[Path, ...]:
    """Draw each prediction's overlay as ``OUT/<cat>_<type>_<number>.png``.

    Parameters
    ----------
    overwrite : bool
        Replace images that are there already; without, they are an error.

    Returns
    -------
    tuple of Path
        What was written.

    Raises
    ------
    LayoutError
        A folder, a ground truth, an image or a calibration is missing, `out` is in a source, or
        a file is there already.
    DecodeError
        A file is bad, or sizes differ.
    """
    out = Path(out)
    refuse_inside(out, *folders.all)
    guesses = find_confidences(folders.predictions, "training", folders.target)
    truths = truths_by_name(folders.ground_truth)
    lacking = [name.png for name in guesses.files if name not in truths]
    if lacking:
        raise LayoutError(
            f"{folders.ground_truth}: expected a ground truth for each prediction, "
            f"found none for {listed(lacking)}"
        )
    for name in guesses.files:
        check_file(out / name.png, *folders.all, overwrite=overwrite)
    pairs = Pairs(guesses, truths, folders.calib, view)

    def draw(name: PredictionName) -> Path:
        written = out / name.png
        image = png_bytes(_drawn(name, pairs, folders.images, threshold))
        write_whole(written, image, *folders.all, overwrite=overwrite)
        return written

    return tuple(map_frames("overlay", draw, list(guesses.files), progress))


def _drawn(
    name: PredictionName, pairs: Pairs, images: Path, threshold: float
) -> npt.NDArray[np.uint8]:
    guess_path = pairs.guesses.files[name]
    confidence, truth = pairs.read(name)
    image_path = images / f"{name.frame}.png"
    if not image_path.is_file():
        raise LayoutError(f"{image_path}: expected the image of {guess_path.name}, found none")
    image = read_rgb(image_path)
    if pairs.view == "bev":
        image = bring_to_bev(image, image_path, pairs.calib, name.frame)
    if image.shape[:2] != confidence.shape:
        (height, width), (high, wide) = image.shape[:2], confidence.shape
        raise DecodeError(
            f"{guess_path}: expected {width}x{height} pixels like {image_path}, found {wide}x{high}"
        )
    return draw_overlay(image, confidence, truth, threshold)
