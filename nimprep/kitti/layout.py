"""Where the KITTI road benchmark keeps a frame's files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from nimprep.errors import LayoutError

SPLIT_FOLDERS = ("training", "validation", "validating", "testing")
"""The benchmark's two, and what people call the part of training that they hold out."""

_LOSSLESS = (".png", ".bmp", ".tif", ".tiff")

IMAGE_ENDINGS = (*_LOSSLESS, ".jpg", ".jpeg", ".webp", ".ppm")
"""Of colour images; values that count are never taken from those that change them."""


@dataclass(frozen=True, order=True)
class RoadFiles:
    """Name one frame's files; which of them are there is another question.

    Attributes
    ----------
    folder : Path
        ``data_road/training`` or ``data_road/testing``.
    split : str
        One of `SPLIT_FOLDERS`; "" where the source is such a folder itself.
    name : str
        ``um_000000``.
    suffix : str
        The left colour image's ending.
    """

    folder: Path
    split: str
    name: str
    suffix: str = ".png"

    @property
    def id(self) -> str:
        """``training/um_000000``; the name alone where there is no split."""
        return f"{self.split}/{self.name}" if self.split else self.name

    @property
    def image(self) -> Path:
        """The left colour image."""
        return self.folder / "image_2" / f"{self.name}{self.suffix}"

    @property
    def right_image(self) -> Path:
        """The right colour image."""
        return image_of(self.folder / "image_3", self.name)

    @property
    def calibration(self) -> Path:
        """The calibration's text."""
        return self.folder / "calib" / f"{self.name}.txt"

    @property
    def scan(self) -> Path:
        """The laser scan."""
        return self.folder / "velodyne" / f"{self.name}.bin"

    @property
    def depth(self) -> Path:
        """Dense depth in millimetres."""
        return image_of(self.folder / "depth_u16", self.name, _LOSSLESS)

    def ground_truth(self, target: str) -> Path:
        """Return where the ground truth of "road" or "lane" stands."""
        category, _, number = self.name.partition("_")
        return image_of(self.folder / "gt_image_2", f"{category}_{target}_{number}", _LOSSLESS)


def image_of(folder: Path, name: str, endings: tuple[str, ...] = IMAGE_ENDINGS) -> Path:
    """Return an image of any of these endings; that of the first, .png, where there is none."""
    for ending in (e for each in endings for e in (each, each.upper())):
        path = folder / f"{name}{ending}"
        if path.is_file():
            return path
    return folder / f"{name}{endings[0]}"


def list_road_files(root: Path, *, calibrated: bool = True) -> tuple[RoadFiles, ...]:
    """List the frames of a road folder: every image in image_2 of each of `SPLIT_FOLDERS`.

    A folder that holds image_2 itself is taken too. Images are of any of `IMAGE_ENDINGS`.

    Parameters
    ----------
    calibrated : bool
        Whether each must have its calibration.

    Raises
    ------
    LayoutError
        No image is found, two are one frame, or a frame lacks its calibration.
    """
    candidates = {root / split: split for split in SPLIT_FOLDERS} | {root: ""}
    folders = {f: split for f, split in candidates.items() if (f / "image_2").is_dir()}
    frames = [
        RoadFiles(folder, split, path.stem, path.suffix)
        for folder, split in folders.items()
        for path in sorted((folder / "image_2").iterdir())
        if path.suffix.lower() in IMAGE_ENDINGS and not path.name.startswith(".")
    ]
    if not frames:
        raise LayoutError(
            f"{root}: expected training/image_2 or testing/image_2 with images, found none; "
            "give the folder that data_road.zip unpacks to"
        )
    by_id: dict[str, RoadFiles] = {}
    for frame in frames:
        if (other := by_id.setdefault(frame.id, frame)) != frame:
            raise LayoutError(
                f"{frame.image}: expected one image of frame {frame.id}, found {other.image.name} "
                "too; take one away"
            )
    for frame in frames:
        if calibrated and not frame.calibration.is_file():
            raise LayoutError(
                f"{frame.calibration}: expected the calibration of {frame.image}, found none"
            )
    return tuple(sorted(frames, key=lambda frame: frame.id))
