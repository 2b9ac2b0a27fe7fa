"""Camera files as readers take them: the least that a description must say of one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from nimprep.errors import CameraError
from nimprep.inspection.calibrations import Calibration
from nimprep.readers.camera_formats import CameraNumbers, numbers_from_file
from nimprep.readers.description import CameraSource

_NAMES = ("fx", "fy", "cx", "cy")
_NUMBERS = {*_NAMES, "width", "height", "baseline_m"}


def calibration_by_reader(path: Path) -> Calibration | None:
    """Return what a reader makes of a camera file by itself; None = it finds none."""
    found = _read(path, CameraSource(files=path.name))
    if found is None:
        return None
    fx, fy, cx, cy = found.intrinsics
    if min(fx, fy) < 10 or min(cx, cy) <= 0 or not 0.2 < fx / fy < 5:
        return None
    numbers = dict(zip(_NAMES, found.intrinsics, strict=True))
    if found.size is not None:
        numbers |= {"height": float(found.size[0]), "width": float(found.size[1])}
    if math.isfinite(found.baseline_m):
        numbers["baseline_m"] = found.baseline_m
    return Calibration(numbers)


def camera_form(path: Path, says: Calibration) -> dict[str, Any]:
    """Return what a description says of a camera file, without `files`: the least that will do."""
    keys = {name: place for name, place in says.keys.items() if name in _NUMBERS}
    forms: tuple[dict[str, Any], ...] = ({}, {"key": says.key}, {"keys": keys})
    for form in forms:
        if all(form.values()) and _agrees(
            _read(path, CameraSource(files="", **form)), says.numbers
        ):
            return form
    return {"key": says.key} if says.key else {"keys": keys} if keys else {}


def _read(path: Path, source: CameraSource) -> CameraNumbers | None:
    try:
        found = numbers_from_file(path, source)
    except CameraError:
        return None
    return found if isinstance(found, CameraNumbers) else None


def _agrees(found: CameraNumbers | None, numbers: Mapping[str, float]) -> bool:
    """Tell whether a reader finds the numbers, the baseline included where there is one."""
    if found is None:
        return False
    pairs = zip(found.intrinsics, (numbers[name] for name in _NAMES), strict=True)
    same = all(math.isclose(a, b, rel_tol=1e-6, abs_tol=1e-3) for a, b in pairs)
    return same and ("baseline_m" not in numbers or math.isfinite(found.baseline_m))
