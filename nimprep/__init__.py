"""Turn RGB-D road datasets into fast, checked multimodal Zarr stores.

The public names are imported on first use, so that ``import nimprep`` stays quick.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nimprep.camera import Camera as Camera
    from nimprep.conversion.options import ConvertOptions as ConvertOptions
    from nimprep.conversion.run import convert as convert
    from nimprep.derive.completion import fill_depth as fill_depth
    from nimprep.derive.gravity import estimate_gravity as estimate_gravity
    from nimprep.derive.hha import encode_hha as encode_hha
    from nimprep.derive.normals import estimate_normals as estimate_normals
    from nimprep.errors import NimprepError as NimprepError
    from nimprep.frame import Frame as Frame
    from nimprep.store.reader import Store as Store
    from nimprep.store.reader import open_store as open_store

__version__ = "0.1.0"

_HOME = {
    "Camera": "nimprep.camera",
    "ConvertOptions": "nimprep.conversion.options",
    "Frame": "nimprep.frame",
    "NimprepError": "nimprep.errors",
    "Store": "nimprep.store.reader",
    "convert": "nimprep.conversion.run",
    "encode_hha": "nimprep.derive.hha",
    "estimate_gravity": "nimprep.derive.gravity",
    "estimate_normals": "nimprep.derive.normals",
    "fill_depth": "nimprep.derive.completion",
    "open_store": "nimprep.store.reader",
}

__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
