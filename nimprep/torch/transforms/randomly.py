"""Transforms with options, of which chance has a share."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from nimprep.errors import ArrayError
from nimprep.torch.transforms.geometry import Sample, crop, flip, frame_size, resize


def uniform(sample: Sample, low: float, high: float) -> float:
    """Draw a number in [low, high) from the sample's generator."""
    drawn = torch.rand((), generator=sample.get("generator"), dtype=torch.float64)
    return low + (high - low) * drawn.item()


def _check_size(name: str, height: int, width: int) -> None:
    if int(height) != height or int(width) != width or height <= 0 or width <= 0:
        raise ArrayError(f"{name}: expected a positive height and width, found {height}, {width}")


@dataclass(frozen=True)
class RandomCrop:
    """Cut a window of this size out of the frame, anywhere alike; the camera moves along.

    Where the frame is smaller, it is padded at the bottom and the right: 0, and 255 for labels.

    Parameters
    ----------
    height, width : int
        Pixels.
    """

    height: int
    width: int

    def __post_init__(self) -> None:
        _check_size("RandomCrop", self.height, self.width)

    def __call__(self, sample: Sample) -> Sample:
        """Return the window."""
        height, width = frame_size(sample)
        top = int(uniform(sample, 0, max(height - self.height, 0) + 1))
        left = int(uniform(sample, 0, max(width - self.width, 0) + 1))
        return crop(sample, top, left, self.height, self.width)


@dataclass(frozen=True)
class Resize:
    """Scale the frame to this size, outer edges aligned; see `resize`.

    Parameters
    ----------
    height, width : int
        Pixels.
    """

    height: int
    width: int

    def __post_init__(self) -> None:
        _check_size("Resize", self.height, self.width)

    def __call__(self, sample: Sample) -> Sample:
        """Return the scaled sample."""
        return resize(sample, self.height, self.width)


@dataclass(frozen=True)
class RandomScale:
    """Scale the frame by one factor in x and y, up to whole pixels.

    Parameters
    ----------
    range : (float, float)
        The factor's smallest and largest value; its logarithm is drawn uniformly, so that half
        and double are as likely.
    """

    range: tuple[float, float]

    def __post_init__(self) -> None:
        low, high = self.range
        if not 0 < low <= high < float("inf"):
            raise ArrayError(f"RandomScale: expected 0 < low <= high, found {self.range}")

    def __call__(self, sample: Sample) -> Sample:
        """Return the scaled sample."""
        low, high = self.range
        factor = low * (high / low) ** uniform(sample, 0, 1)
        height, width = frame_size(sample)
        return resize(sample, max(round(height * factor), 1), max(round(width * factor), 1))


@dataclass(frozen=True)
class RandomHorizontalFlip:
    """Mirror the frame left to right, with probability p; see `flip`."""

    p: float = 0.5

    def __post_init__(self) -> None:
        if not 0 <= self.p <= 1:
            raise ArrayError(f"RandomHorizontalFlip: expected p in [0, 1], found {self.p}")

    def __call__(self, sample: Sample) -> Sample:
        """Return the sample, mirrored or not."""
        return flip(sample) if uniform(sample, 0, 1) < self.p else sample
