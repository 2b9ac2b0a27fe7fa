"""How derived modalities are made: the options, and what their makers take and give."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from nimprep.depth_unit import MILLIMETRE, depth_unit_from
from nimprep.derive.methods import FILLS as FILLS
from nimprep.derive.methods import FIXED_METHODS, ElevationRoad, Fill, Ground, Method, check_method
from nimprep.errors import ArrayError
from nimprep.frame import VIRTUAL_BASELINE_M, Frame
from nimprep.modality import MODALITIES
from nimprep.options import Options, option

DERIVED: tuple[str, ...] = tuple(name for name, m in MODALITIES.items() if m.derived is not None)
"""The modalities that are made from others; those others come from the source."""


@dataclass(frozen=True, kw_only=True)
class RecipeOptions(Options):
    """Say what a user may of how the derived modalities are made; see `estimate_normals`."""

    normals: Method = option(
        "nim",
        "Normals by the paper's method, by the one that keeps depth edges and smooths noise, or by "
        "whichever the noise of a sample of the frames asks for.",
    )
    sign_filter: bool = option(False, "Normals by NIM with its sign filter.")
    noise: float | None = option(
        None,
        "Standard deviation of inverse depth for nim-edge, 1/m; default: by each frame.",
        least=0,
        metavar="PER_METRE",
    )
    hha_ground: Ground | None = option(
        None,
        "Count HHA's heights from the floor, or from the lowest point as the reference; default: "
        "floor, datasets of rooms: lowest.",
    )
    elevation_road: ElevationRoad = option(
        "calibrated",
        "Count elevation from the road of a frame's calibration where it has one, or from the one "
        "fitted to its depth.",
    )
    fill: Fill = option("none", "Fill holes in depth before normals and HHA are made from it.")
    store_filled: bool = option(False, "Store the filled depth, not the raw one.")
    depth_unit: float | str = option(
        "auto",
        "Unit that depth is stored in: mm to 65.535 m, cm to 655.35 m, or so many metres, as a "
        "number or a fraction (1/256); auto: mm, or SRC's own step or what it says of its range.",
        metavar="auto|mm|cm|METRES",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "depth_unit", depth_unit_from(self.depth_unit))
        check_method(self.normals, self.sign_filter, self.noise)
        if self.store_filled and self.fill == "none":
            raise ArrayError("store_filled: expected a way to fill, found 'none'; give fill")


@dataclass(frozen=True, kw_only=True)
class Recipe(RecipeOptions):
    """Say how the derived modalities are made.

    Attributes
    ----------
    virtual_baseline_m : float
        Baseline of the disparity of frames that have none, metres.
    lone_normals : bool
        Whether pixels without a neighbour, where nothing is measured, have normals that face the
        camera: so in stores that earlier versions made.
    whole_cells : bool
        Whether "nim-edge" smooths over whole cells everywhere: so in stores that earlier versions
        made.
    """

    virtual_baseline_m: float = VIRTUAL_BASELINE_M
    lone_normals: bool = False
    whole_cells: bool = False

    @property
    def ground(self) -> Ground:
        """Where HHA's heights are counted from."""
        return self.hha_ground or "floor"

    def describe(self, name: str) -> dict[str, Any]:
        """Return what a store's metadata says of how a modality was made."""
        modality = MODALITIES[name]
        if modality.derived is not None:
            described: dict[str, Any] = resolve_name(modality.derived.describe)(self)
            return described
        filled = modality.fillable and self.store_filled
        return {"method": "source", "parameters": {"fill": self.fill} if filled else {}}


def recipe_from(modalities: Mapping[str, Any]) -> Recipe:
    """Return the recipe that a store's `modalities` attribute, which fits its schema, describes.

    Raises
    ------
    ArrayError
        It is none that this version knows.
    """
    normal = modalities.get("normal", {"method": "nim", "parameters": {}})
    if normal["method"] not in FIXED_METHODS:
        raise ArrayError(
            f"normals: expected one of {', '.join(FIXED_METHODS)}, found {normal['method']!r}"
        )
    noise = normal["parameters"].get("noise", "estimated")
    derived = [modalities[m]["parameters"] for m in DERIVED if m in modalities]
    stored = modalities.get("depth", {"parameters": {}})["parameters"]
    return Recipe(
        normals=normal["method"],
        sign_filter=bool(normal["parameters"].get("sign_filter", False)),
        hha_ground=modalities.get("hha", {}).get("parameters", {}).get("ground", "lowest"),
        elevation_road=modalities.get("elevation", {})
        .get("parameters", {})
        .get("road", "calibrated"),
        fill=derived[0].get("fill", "none") if derived else stored.get("fill", "none"),
        store_filled="fill" in stored,
        depth_unit=modalities.get("depth", {}).get("unit_m", MILLIMETRE),
        virtual_baseline_m=_number(
            "virtual_baseline_m",
            next(
                (p["virtual_baseline_m"] for p in derived if "virtual_baseline_m" in p),
                VIRTUAL_BASELINE_M,
            ),
        ),
        noise=None if noise == "estimated" else _number("noise", noise),
        lone_normals="normal" in modalities and normal["parameters"].get("lone") != "none",
        whole_cells=normal["method"] == "nim-edge"
        and normal["parameters"].get("cells") != "quartered",
    )


def _number(name: str, value: object) -> float:
    # Beyond it whole numbers, which JSON has of any size, are no float.
    if isinstance(value, (int, float)) and abs(value) <= sys.float_info.max:
        return float(value)
    raise ArrayError(f"{name}: expected a finite number, found {value!r:.200}")


@dataclass(frozen=True)
class Given:
    """Hold what a modality is made from.

    Attributes
    ----------
    frame : Frame
        What was measured, and the camera.
    depth_m : (H, W) float32, metres
        The frame's depth, its holes filled where the recipe says so.
    missing : (H, W) bool, optional
        Where it was filled; None = nowhere.
    recipe : Recipe
    """

    frame: Frame
    depth_m: npt.NDArray[np.float32]
    missing: npt.NDArray[np.bool_] | None
    recipe: Recipe


class Made(NamedTuple):
    """What a maker gives.

    Attributes
    ----------
    image : array, optional
        As a `Frame` has it; None = this frame has none anywhere, as one without a road.
    gravity : (3,) float64, optional
        Direction in the camera frame that it was made with.
    signs : mapping of str to float, optional
        What is to be said of the frame's making: see `nimprep.doubts.judge`.
    """

    image: npt.NDArray[Any] | None
    gravity: npt.NDArray[np.float64] | None = None
    signs: Mapping[str, float] | None = None
