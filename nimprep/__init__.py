"""Turn RGB-D road datasets into fast, checked multimodal Zarr stores.

The public names are imported on first use, so that ``import nimprep`` stays quick.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nimprep.camera import Camera as Camera
    from nimprep.derive.normals import estimate_normals as estimate_normals
    from nimprep.errors import NimprepError as NimprepError
    from nimprep.frame import Frame as Frame

__version__ = "0.1.0"

_HOME = {
    "Camera": "nimprep.camera",
    "Frame": "nimprep.frame",
    "NimprepError": "nimprep.errors",
    "estimate_normals": "nimprep.derive.normals",
}

__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
