"""Which modalities are derived from depth, and by which function: the one place that knows."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import ArrayError
from nimprep.frame import ON_REQUEST, PLANES, VIRTUAL_BASELINE_M, Frame

DERIVED = ("normal", "hha", "disparity", "transformed_disparity", "elevation")
"""The modalities that `derive` makes; the others come from the source."""

FILLS = ("none", "nearest", "linear", "colorization")
"""How holes in depth can be filled before anything is derived from it."""


@dataclass(frozen=True)
class Recipe:
    """Say how the derived modalities are made.

    Attributes
    ----------
    normals : str
        Method of `estimate_normals`.
    sign_filter : bool
        Its option of that name.
    fill : {"none", "nearest", "linear", "colorization"}
        Method of `fill_depth` for what normals and HHA are made from.
    store_filled : bool
        Whether the store holds the filled depth in place of the raw one.
    virtual_baseline_m : float
        Baseline of the disparity of frames that have none, metres.
    noise : float, optional
        What `estimate_normals` takes by that name, 1/m.
    """

    normals: str = "nim"
    sign_filter: bool = False
    fill: str = "none"
    store_filled: bool = False
    virtual_baseline_m: float = VIRTUAL_BASELINE_M
    noise: float | None = None

    def __post_init__(self) -> None:
        from nimprep.derive.normals import METHODS, check_method

        if self.normals not in METHODS:
            raise ArrayError(
                f"normals: expected one of {', '.join(METHODS)}, found {self.normals!r}"
            )
        check_method(self.normals, self.sign_filter, self.noise)
        if self.fill not in FILLS:
            raise ArrayError(f"fill: expected one of {', '.join(FILLS)}, found {self.fill!r}")
        if self.store_filled and self.fill == "none":
            raise ArrayError("store_filled: expected a way to fill, found 'none'; give fill")

    def describe(self, modality: str) -> dict[str, Any]:
        """Return what a store's metadata says of how a modality was made."""
        if modality == "normal":
            options: dict[str, Any] = {"sign_filter": self.sign_filter}
            if self.normals == "nim-edge":
                options = {"noise": "estimated" if self.noise is None else self.noise}
            return {"method": self.normals, "parameters": {**options, "fill": self.fill}}
        if modality == "hha":
            return {
                "method": "hha",
                "parameters": {
                    "fill": self.fill,
                    "gravity": "from cam_to_road where a frame has it, else estimated",
                    "horizontal_disparity": "31000 / max(depth, 100), depth in cm",
                    "height": "cm above the frame's lowest point, or above a ground 130 cm below "
                    "the camera where no point lies 90 cm below it",
                    "angle": "degrees between normal and gravity, plus 38: floor 38, wall 128",
                },
            }
        if modality in ON_REQUEST:
            return _describe_plane(modality, self)
        fill = self.fill if modality == "depth" and self.store_filled else None
        return {"method": "source", "parameters": {} if fill is None else {"fill": fill}}


def _describe_plane(modality: str, recipe: Recipe) -> dict[str, Any]:
    baseline = {
        "baseline": "the frame's own where it has one, else the virtual one",
        "virtual_baseline_m": recipe.virtual_baseline_m,
    }
    if modality == "disparity":
        method, more = "disparity", {**baseline, "disparity": "fx * baseline / depth"}
    elif modality == "transformed_disparity":
        meaning = "disparity less that of the road's fitted profile; 0 = on the road"
        method, more = "road-profile", {**baseline, "transformed_disparity": meaning}
    else:
        plane = "the road frame's y = 0 where a frame has cam_to_road, else fitted to the depth"
        method, more = "road-plane", {"plane": plane}
    return {"method": method, "parameters": {"fill": recipe.fill, **more}}


def recipe_from(modalities: Mapping[str, Any]) -> Recipe:
    """Return the recipe that a store's `modalities` attribute describes."""
    normal = modalities.get("normal", {"method": "nim", "parameters": {}})
    noise = normal["parameters"].get("noise", "estimated")
    derived = [modalities[m]["parameters"] for m in DERIVED if m in modalities]
    stored = modalities.get("depth", {"parameters": {}})["parameters"]
    return Recipe(
        normals=normal["method"],
        sign_filter=bool(normal["parameters"].get("sign_filter", False)),
        fill=derived[0].get("fill", "none") if derived else stored.get("fill", "none"),
        store_filled="fill" in stored,
        virtual_baseline_m=float(
            next(
                (p["virtual_baseline_m"] for p in derived if "virtual_baseline_m" in p),
                VIRTUAL_BASELINE_M,
            )
        ),
        noise=None if noise == "estimated" else float(noise),
    )


@dataclass(frozen=True)
class Derived:
    """Hold what was derived from one frame's depth.

    Attributes
    ----------
    images : dict of modality to array
        Normals as float32 vectors, HHA as bytes, the others as the integers of `PLANES`, which is
        how a store holds them.
    gravity : (3,) float64
        Direction in the camera frame that HHA was made with; NaN without HHA.
    """

    images: dict[str, npt.NDArray[Any]]
    gravity: npt.NDArray[np.float64]


def fill_frame(frame: Frame, recipe: Recipe) -> tuple[Frame, npt.NDArray[np.bool_] | None]:
    """Return the frame with its holes filled by the recipe, and the mask of what was filled.

    The mask is None where the recipe fills nothing.
    """
    if recipe.fill == "none" or frame.depth_m is None:
        return frame, None
    from nimprep.derive.completion import fill_depth

    filled, mask = fill_depth(frame.depth_m, recipe.fill, frame.rgb, num_threads=1)  # type: ignore[arg-type]
    return replace(frame, depth_m=filled), mask


def derive(
    frame: Frame,
    missing: npt.NDArray[np.bool_] | None,
    modalities: Collection[str],
    recipe: Recipe,
) -> Derived:
    """Make a frame's derived modalities, on the calling thread alone.

    Parameters
    ----------
    frame : Frame
        With depth_m filled already, where the recipe says so (see `fill_frame`).
    missing : (H, W) bool, optional
        Where depth_m was filled in.
    modalities : collection of str
        Those to make; names that are not derived are passed over.
    """
    images: dict[str, npt.NDArray[Any]] = {}
    gravity = np.full(3, np.nan)
    if frame.depth_m is None:
        return Derived(images, gravity)
    if "normal" in modalities:
        from nimprep.derive.normals import estimate_normals

        images["normal"] = estimate_normals(
            frame.depth_m,
            frame.camera,
            method=recipe.normals,
            sign_filter=recipe.sign_filter,
            num_threads=1,
            noise=recipe.noise,
        )
    if "hha" in modalities:
        from nimprep.derive.hha import encode_hha, encode_hha_and_gravity

        depth, camera = frame.depth_m, frame.camera
        if frame.cam_to_road is not None:
            # The road frame's y axis points down, as the camera's does.
            gravity = frame.cam_to_road[:, :3].T @ (0.0, 1.0, 0.0)
            images["hha"] = encode_hha(depth, camera, missing, gravity, num_threads=1)
        else:
            images["hha"], gravity = encode_hha_and_gravity(depth, camera, missing, num_threads=1)
    images |= {name: _plane(name, frame, recipe) for name in ON_REQUEST if name in modalities}
    return Derived(images, gravity)


def _plane(name: str, frame: Frame, recipe: Recipe) -> npt.NDArray[Any]:
    """Return disparity, transformed disparity or elevation as integers; no road in it = none."""
    from nimprep.kernels.planes import positives_to_integers, signed_to_integers

    numbers = _numbers(name, frame, recipe)
    plane = PLANES[name]
    if numbers is None:
        return np.full(frame.camera.shape, plane.none, plane.dtype)
    out = np.empty(numbers.shape, plane.dtype)
    if plane.dtype == "uint16":
        positives_to_integers(numbers, plane.steps, out)
    else:
        signed_to_integers(numbers, plane.steps, out)
    return out


def _numbers(name: str, frame: Frame, recipe: Recipe) -> npt.NDArray[np.float32] | None:
    """Return an image of one number per pixel; None = there is no road in the frame."""
    from nimprep.derive.depth import checked_depth
    from nimprep.derive.disparity import disparity_from_depth
    from nimprep.derive.elevation import estimate_elevation, find_road_plane, road_plane
    from nimprep.derive.road_profile import find_road_profile, transform_disparity

    depth, camera = checked_depth(frame.depth_m, frame.camera), frame.camera
    if name == "elevation":
        if frame.cam_to_road is not None:
            plane: npt.NDArray[np.float64] | None = road_plane(frame.cam_to_road)
        else:
            plane = find_road_plane(depth, camera)
        return None if plane is None else estimate_elevation(depth, camera, plane, num_threads=1)
    own = np.isfinite(frame.baseline_m)
    baseline_m = frame.baseline_m if own else recipe.virtual_baseline_m
    disparity = disparity_from_depth(depth, camera, baseline_m, num_threads=1)
    if name == "disparity":
        return disparity
    profile = find_road_profile(disparity)
    return None if profile is None else transform_disparity(disparity, profile, num_threads=1)[0]
