"""The names the KITTI road benchmark gives its frames, predictions and score tables."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from nimprep.errors import LayoutError

Target = Literal["road", "lane"]

DepthFrom = Literal["auto", "lidar", "stereo"]
"""Where depth is taken from: depth_u16, else LiDAR, else stereo; or the one named."""

CATEGORIES = ("um", "umm", "uu")
"""Urban marked, urban multiple marked lanes, urban unmarked."""

TEST_FRAMES = {"um": 96, "umm": 94, "uu": 100}
"""Frames of the official test set per category, numbered from 0."""

TARGETS: dict[str, tuple[str, ...]] = {"road": CATEGORIES, "lane": ("um",)}
"""Which categories have a ground truth of each target."""

GRAMMAR = "<um|umm|uu>_<road|lane>_<six digits> (lane: um only)"

_NAME = re.compile(r"(um|umm|uu)_(road|lane)_([0-9]{6})")
_FRAME = re.compile(r"(um|umm|uu)_([0-9]{6})")


@dataclass(frozen=True, order=True)
class PredictionName:
    """Name one prediction or ground truth.

    Attributes
    ----------
    category : str
        "um", "umm" or "uu".
    target : str
        "road" or "lane".
    number : str
        Six digits.
    """

    category: str
    target: str
    number: str

    @property
    def frame(self) -> str:
        """Name of the image and the calibration: ``um_000000``."""
        return f"{self.category}_{self.number}"

    @property
    def table(self) -> str:
        """Name of the table it is scored in: ``um_road``."""
        return f"{self.category}_{self.target}"

    @property
    def stem(self) -> str:
        """The file's name without its ending: ``um_road_000000``."""
        return f"{self.category}_{self.target}_{self.number}"

    @property
    def png(self) -> str:
        """The file's name: ``um_road_000000.png``."""
        return f"{self.stem}.png"


def prediction_name(path: Path | str) -> PredictionName:
    """Parse a prediction's or a ground truth's file name.

    Raises
    ------
    LayoutError
        The name does not follow the benchmark's grammar.
    """
    match = _NAME.fullmatch(Path(path).stem)
    if match is None or match[1] not in TARGETS[match[2]]:
        raise LayoutError(f"{path}: expected a name {GRAMMAR}.png, found {Path(path).name!r}")
    return PredictionName(match[1], match[2], match[3])


def frame_category(name: str) -> str | None:
    """Return the category of a frame's name (``um_000000``); None = no KITTI road frame."""
    match = _FRAME.fullmatch(name)
    return match[1] if match else None


def official_names(target: Target) -> Iterator[PredictionName]:
    """Yield every prediction a submission must hold: 290 for road, 96 for lane."""
    for category in TARGETS[target]:
        for number in range(TEST_FRAMES[category]):
            yield PredictionName(category, target, f"{number:06d}")


PREDICTION_SUFFIXES = (".png", ".npy")
"""8-bit confidences, and floating probabilities."""


def predictions_by_name(
    folder: Path, suffixes: tuple[str, ...] = (".png",)
) -> dict[PredictionName, Path]:
    """Return a folder's predictions or ground truths, sorted by name.

    Hidden files, sub-folders and files with other endings are left alone.

    Raises
    ------
    LayoutError
        The folder is missing or holds none, a name breaks the grammar, or two files have one name.
    """
    if not folder.is_dir():
        raise LayoutError(f"{folder}: expected a folder of {GRAMMAR}.png, found none")
    found: dict[PredictionName, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or path.suffix not in suffixes or not path.is_file():
            continue
        name = prediction_name(path)
        if name in found:
            raise LayoutError(
                f"{path}: expected one file per prediction, found {found[name].name} too"
            )
        found[name] = path
    if not found:
        endings = " or ".join(suffixes)
        raise LayoutError(f"{folder}: expected files {GRAMMAR} with {endings}, found none")
    return dict(sorted(found.items()))
