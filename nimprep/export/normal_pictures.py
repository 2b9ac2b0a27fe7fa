"""Normals as networks' layouts have them: (n + 1) / 2 of the largest number."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


def normal_numbers(normal: npt.NDArray[np.float32], bits: int) -> npt.NDArray[Any]:
    """Return (n + 1) / 2 of the largest number, rounded; no normal, (0, 0, 0), is in the middle."""
    most = (1 << bits) - 1
    return np.rint((normal.astype(np.float64) + 1) / 2 * most).astype(f"uint{bits}")


def normal_entry(bits: int) -> dict[str, Any]:
    """Return what encodings.json says of such normals."""
    most = (1 << bits) - 1
    return {
        "bits": bits,
        "value": f"png / {most} * 2 - 1",
        "subtract": 0,
        "scale": 2 / most,
        "offset": -1,
        "none": [1 << (bits - 1)] * 3,
    }
