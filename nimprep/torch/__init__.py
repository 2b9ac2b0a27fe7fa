"""A store as PyTorch data: datasets, a loader, transforms, and NIM as a layer.

The public names are imported on first use, so that ``import nimprep.torch`` stays quick.
"""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from nimprep.errors import NimprepError

if find_spec("torch") is None:
    raise NimprepError(
        "nimprep.torch: expected PyTorch, found none installed; pip install 'nimprep[torch]'"
    )

if TYPE_CHECKING:
    from nimprep.torch.collation import collate as collate
    from nimprep.torch.dataset import StoreDataset as StoreDataset
    from nimprep.torch.loader import StoreLoader as StoreLoader
    from nimprep.torch.nim import NIM as NIM
    from nimprep.torch.normalization import Normalize as Normalize
    from nimprep.torch.scaling import Scaling as Scaling
    from nimprep.torch.setups import SETUPS as SETUPS

_HOME = {
    "NIM": "nimprep.torch.nim",
    "Normalize": "nimprep.torch.normalization",
    "SETUPS": "nimprep.torch.setups",
    "Scaling": "nimprep.torch.scaling",
    "StoreDataset": "nimprep.torch.dataset",
    "StoreLoader": "nimprep.torch.loader",
    "collate": "nimprep.torch.collation",
}

__all__ = [*_HOME]


if not TYPE_CHECKING:
    # A type checker knows the names above, and that there are no others.
    def __getattr__(name: str) -> Any:
        if name not in _HOME:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
