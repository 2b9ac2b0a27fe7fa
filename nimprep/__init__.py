"""Turn RGB-D road datasets into fast, checked multimodal Zarr stores.

The public names are imported on first use, so that ``import nimprep`` stays quick.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nimprep.camera import Camera as Camera
    from nimprep.compilation.warmup import warm_up as warm_up
    from nimprep.conversion.append import append_frames as append_frames
    from nimprep.conversion.merge import merge_stores as merge_stores
    from nimprep.conversion.options import AppendOptions as AppendOptions
    from nimprep.conversion.options import ConvertOptions as ConvertOptions
    from nimprep.conversion.run import convert as convert
    from nimprep.derive.completion import fill_depth as fill_depth
    from nimprep.derive.disparity import depth_from_disparity as depth_from_disparity
    from nimprep.derive.disparity import disparity_from_depth as disparity_from_depth
    from nimprep.derive.elevation import estimate_elevation as estimate_elevation
    from nimprep.derive.elevation import estimate_road_plane as estimate_road_plane
    from nimprep.derive.elevation import road_plane as road_plane
    from nimprep.derive.gravity import estimate_gravity as estimate_gravity
    from nimprep.derive.hha import encode_hha as encode_hha
    from nimprep.derive.normals import estimate_normals as estimate_normals
    from nimprep.derive.road_profile import RoadProfile as RoadProfile
    from nimprep.derive.road_profile import estimate_road_profile as estimate_road_profile
    from nimprep.derive.road_profile import restore_disparity as restore_disparity
    from nimprep.derive.road_profile import transform_disparity as transform_disparity
    from nimprep.errors import NimprepError as NimprepError
    from nimprep.frame import Frame as Frame
    from nimprep.store.reader import Store as Store
    from nimprep.store.reader import open_store as open_store

__version__ = "0.1.0"

_HOME = {
    "AppendOptions": "nimprep.conversion.options",
    "Camera": "nimprep.camera",
    "ConvertOptions": "nimprep.conversion.options",
    "Frame": "nimprep.frame",
    "NimprepError": "nimprep.errors",
    "RoadProfile": "nimprep.derive.road_profile",
    "Store": "nimprep.store.reader",
    "append_frames": "nimprep.conversion.append",
    "convert": "nimprep.conversion.run",
    "depth_from_disparity": "nimprep.derive.disparity",
    "disparity_from_depth": "nimprep.derive.disparity",
    "encode_hha": "nimprep.derive.hha",
    "estimate_elevation": "nimprep.derive.elevation",
    "estimate_gravity": "nimprep.derive.gravity",
    "estimate_normals": "nimprep.derive.normals",
    "estimate_road_plane": "nimprep.derive.elevation",
    "estimate_road_profile": "nimprep.derive.road_profile",
    "fill_depth": "nimprep.derive.completion",
    "merge_stores": "nimprep.conversion.merge",
    "open_store": "nimprep.store.reader",
    "restore_disparity": "nimprep.derive.road_profile",
    "road_plane": "nimprep.derive.elevation",
    "transform_disparity": "nimprep.derive.road_profile",
    "warm_up": "nimprep.compilation.warmup",
}

__all__ = ["__version__", *_HOME]


if not TYPE_CHECKING:
    # A type checker knows the names above, and that there are no others.
    def __getattr__(name: str) -> Any:
        if name not in _HOME:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
