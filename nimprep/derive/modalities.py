"""Which modalities are derived from depth, and by which function: the one place that knows."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy.typing as npt

from nimprep.frame import Frame


@dataclass(frozen=True)
class Recipe:
    """Say how the derived modalities are made.

    Attributes
    ----------
    normals : str
        Method of `estimate_normals`.
    sign_filter : bool
        Its option of that name.
    """

    normals: str = "nim"
    sign_filter: bool = False

    def describe(self, modality: str) -> dict[str, Any]:
        """Return what a store's metadata says of how a modality was made."""
        if modality == "normal":
            return {"method": self.normals, "parameters": {"sign_filter": self.sign_filter}}
        return {"method": "source", "parameters": {}}


DERIVED = ("normal",)
"""The modalities that `derive` makes; the others come from the source."""


def derive(
    frame: Frame, modalities: Collection[str], recipe: Recipe
) -> dict[str, npt.NDArray[Any]]:
    """Make a frame's derived modalities, on the calling thread alone.

    Parameters
    ----------
    frame : Frame
        With depth_m as the store will hold it, so that it can be made again from there.
    modalities : tuple of str
        Those to make; names that are not derived are passed over.
    """
    made: dict[str, npt.NDArray[Any]] = {}
    if "normal" in modalities and frame.depth_m is not None:
        from nimprep.derive.normals import estimate_normals

        made["normal"] = estimate_normals(
            frame.depth_m,
            frame.camera,
            method=recipe.normals,
            sign_filter=recipe.sign_filter,
            num_threads=1,
        )
    return made
