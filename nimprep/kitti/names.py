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

FRAME_GRAMMAR = "<um|umm|uu>_<six digits>"

PREDICTED = "predictions.json"
"""What `nimprep predict` puts beside its predictions, which is none of them."""

_NAME = re.compile(r"(um|umm|uu)_(road|lane)_([0-9]{6})")
_FRAME = re.compile(r"(um|umm|uu)_([0-9]{6})")
_NEARLY = re.compile(r"(umm?|uu)_?(?:(road|lane)_?)?([0-9]{1,6})", re.IGNORECASE)


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


def prediction_name(path: Path | str, target: Target | None = None) -> PredictionName:
    """Parse a prediction's or a ground truth's file name.

    Parameters
    ----------
    target : {"road", "lane"}, optional
        What a frame's own name (``um_000000``) predicts; without, it is no name.

    Raises
    ------
    LayoutError
        The name does not follow the benchmark's grammar.
    """
    path = Path(path)
    match, frame = _NAME.fullmatch(path.stem), _FRAME.fullmatch(path.stem)
    if match is not None and match[1] in TARGETS[match[2]]:
        return PredictionName(match[1], match[2], match[3])
    if target is not None and frame is not None and frame[1] in TARGETS[target]:
        return PredictionName(frame[1], target, frame[2])
    grammar = GRAMMAR if target is None else f"{GRAMMAR} or {FRAME_GRAMMAR}"
    nearest = nearest_name(path, target or "road")
    advice = f"; {nearest} may be meant" if nearest else "; rename it or take it away"
    raise LayoutError(f"{path}: expected a name {grammar}, found {path.name!r}{advice}")


def nearest_name(path: Path, target: Target) -> str:
    """Return the benchmark's name that a wrong one comes near to, with its ending; else ""."""
    match = _NEARLY.fullmatch(path.stem)
    if match is None:
        return ""
    category, kind = match[1].lower(), (match[2] or target).lower()
    if category not in TARGETS[kind]:
        return ""
    return PredictionName(category, kind, f"{int(match[3]):06d}").stem + path.suffix.lower()


def frame_category(name: str) -> str | None:
    """Return the category of a frame's name (``um_000000``); None = no KITTI road frame."""
    match = _FRAME.fullmatch(name)
    return match[1] if match else None


def official_names(target: Target) -> Iterator[PredictionName]:
    """Yield every prediction a submission must hold: 290 for road, 96 for lane."""
    for category in TARGETS[target]:
        for number in range(TEST_FRAMES[category]):
            yield PredictionName(category, target, f"{number:06d}")


def truths_by_name(folder: Path) -> dict[PredictionName, Path]:
    """Return a folder's ground truths (.png), sorted by name.

    Hidden files, sub-folders and files with other endings are left alone.

    Raises
    ------
    LayoutError
        The folder is missing or holds none, or a name breaks the grammar.
    """
    if not folder.is_dir():
        raise LayoutError(
            f"{folder}: expected a folder of {GRAMMAR}.png, found none; give gt_image_2"
        )
    found = {prediction_name(path): path for path in plain_files(folder) if path.suffix == ".png"}
    if not found:
        raise LayoutError(f"{folder}: expected files {GRAMMAR}.png, found none; give gt_image_2")
    return dict(sorted(found.items()))


def plain_files(folder: Path) -> list[Path]:
    """Return the files right in a folder that are not hidden, sorted."""
    return [p for p in sorted(folder.iterdir()) if p.is_file() and not p.name.startswith(".")]
