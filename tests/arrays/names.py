"""The package's public names, and which of them take tensors or no arrays at all."""

from __future__ import annotations

import inspect
from importlib import import_module
from pkgutil import iter_modules
from typing import Any

import nimprep

TENSORS = {
    "nimprep.torch.NIM",
    "nimprep.torch.Normalize",
    "nimprep.torch.collate",
    *(f"nimprep.torch.transforms.{name}" for name in ("crop", "flip", "jitter", "resize")),
    *(f"nimprep.torch.transforms.Random{name}" for name in ("Crop", "HorizontalFlip", "Scale")),
    *(f"nimprep.torch.transforms.{name}" for name in ("ColorJitter", "Compose", "Resize")),
    *(f"nimprep.torch.transforms.{name}" for name in ("Albumentations", "Torchvision")),
}
"""What takes PyTorch's tensors: they are never masked, read-only or of another machine's bytes."""

NO_ARRAYS = {
    *(f"nimprep.{name}" for name in ("AppendOptions", "ConvertOptions", "NimprepError", "Store")),
    *(f"nimprep.{name}" for name in ("append_frames", "convert", "merge_stores", "open_store")),
    *("nimprep.RoadProfile", "nimprep.torch.Scaling", "nimprep.warm_up"),
    *("nimprep.torch.StoreDataset", "nimprep.torch.StoreLoader"),
    *(f"nimprep.kitti.read_{name}" for name in ("calibration", "velodyne")),
    *(f"nimprep.kitti.write_{name}" for name in ("depth", "overlays")),
    *(f"nimprep.kitti.{n}" for n in ("evaluate_predictions", "pack_submission")),
    "nimprep.kitti.transform_folder",
    "nimprep.metrics.PrecisionRecallCurve",
}
"""What takes files, stores and plain numbers."""

MODULES = (
    "nimprep",
    "nimprep.kitti",
    "nimprep.metrics",
    "nimprep.torch",
    "nimprep.torch.transforms",
)
"""What has functions of arrays and tensors."""


def public_members(name: str) -> dict[str, Any]:
    """Return the public functions and classes of a module, by their full names."""
    module = import_module(name)
    own = [n for n, m in vars(module).items() if getattr(m, "__module__", "") == name]
    public = getattr(module, "__all__", [n for n in own if not n.startswith("_")])
    members = {f"{name}.{n}": getattr(module, n) for n in public}
    return {n: m for n, m in members.items() if inspect.isfunction(m) or inspect.isclass(m)}


def public_names() -> set[str]:
    """Return the public functions and classes of `MODULES`."""
    return {name for module in MODULES for name in public_members(module)}


def functions_elsewhere() -> dict[str, Any]:
    """Return the public functions of the package's other rooms that have public names."""
    rooms = [m.name for m in iter_modules(nimprep.__path__, "nimprep.") if m.ispkg]
    others = [m for m in rooms if m not in MODULES and hasattr(import_module(m), "__all__")]
    found = [member for module in others for member in public_members(module).items()]
    return {name: member for name, member in found if inspect.isfunction(member)}
