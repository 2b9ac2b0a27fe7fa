"""torchvision beside a PyTorch of another build, as where PyTorch is for the CPU alone.

Its compiled operators cannot be loaded there, and it does not import without their names. The
transforms are Python and use none of them, so the names are all that is missing.
"""

from __future__ import annotations

import importlib
import re
from types import ModuleType

import torch

_LIBRARY = torch.library.Library("torchvision", "FRAGMENT")
_MISSING = re.compile(r"operator torchvision::(\w+) does not exist")


def transforms() -> ModuleType:
    """Return `torchvision.transforms.v2`, its operators named where they could not be loaded."""
    for _ in range(50):
        try:
            return importlib.import_module("torchvision.transforms.v2")
        except RuntimeError as error:
            missing = _MISSING.search(str(error))
            if missing is None:
                raise
            _LIBRARY.define(f"{missing[1]}(Tensor x) -> Tensor")
    raise AssertionError("torchvision asks for operators without end")
