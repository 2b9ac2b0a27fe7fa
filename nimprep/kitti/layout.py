"""Where the KITTI road benchmark keeps a frame's files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from nimprep.errors import LayoutError

SPLIT_FOLDERS = ("training", "testing")


@dataclass(frozen=True, order=True)
class RoadFiles:
    """Name one frame's files; which of them are there is another question.

    Attributes
    ----------
    folder : Path
        ``data_road/training`` or ``data_road/testing``.
    split : str
        "training" or "testing"; "" where the source is such a folder itself.
    name : str
        ``um_000000``.
    """

    folder: Path
    split: str
    name: str

    @property
    def id(self) -> str:
        """``training/um_000000``; the name alone where there is no split."""
        return f"{self.split}/{self.name}" if self.split else self.name

    @property
    def image(self) -> Path:
        """The left colour image."""
        return self.folder / "image_2" / f"{self.name}.png"

    @property
    def right_image(self) -> Path:
        """The right colour image."""
        return self.folder / "image_3" / f"{self.name}.png"

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
        return self.folder / "depth_u16" / f"{self.name}.png"

    def ground_truth(self, target: str) -> Path:
        """Return where the ground truth of "road" or "lane" stands."""
        category, _, number = self.name.partition("_")
        return self.folder / "gt_image_2" / f"{category}_{target}_{number}.png"


def list_road_files(root: Path, *, calibrated: bool = True) -> tuple[RoadFiles, ...]:
    """List the frames of a road folder: every image in training/image_2 and testing/image_2.

    A folder that holds image_2 itself is taken too.

    Parameters
    ----------
    calibrated : bool
        Whether each must have its calibration.

    Raises
    ------
    LayoutError
        No image is found, or a frame lacks its calibration.
    """
    candidates = {root / split: split for split in SPLIT_FOLDERS} | {root: ""}
    folders = {f: split for f, split in candidates.items() if (f / "image_2").is_dir()}
    frames = [
        RoadFiles(folder, split, path.stem)
        for folder, split in folders.items()
        for path in sorted((folder / "image_2").glob("*.png"))
        if not path.name.startswith(".")
    ]
    if not frames:
        raise LayoutError(
            f"{root}: expected training/image_2 or testing/image_2 with PNG images, found none; "
            "give the folder that data_road.zip unpacks to"
        )
    for frame in frames:
        if calibrated and not frame.calibration.is_file():
            raise LayoutError(
                f"{frame.calibration}: expected the calibration of {frame.image}, found none"
            )
    return tuple(sorted(frames, key=lambda frame: frame.id))
