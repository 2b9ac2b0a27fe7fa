"""A dataset with planes of its own, thermal and confidence, and a reader of it."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from nimprep.frame import Frame
from nimprep.modality import MODALITIES, Modality
from nimprep.plane import plane_from
from nimprep.readers import READERS, Layout
from nimprep.readers.base import WrappedReader
from nimprep.readers.gmrp import open_gmrp
from tests.fakes import SIZE, write_gmrp, write_png

THERMAL = {
    "dtype": "uint16",
    "scale": 0.01,
    "offset": -273.15,
    "units": "degC",
    "long_name": "surface temperature",
    "fill": 0,
    "resize": "linear",
}
CONFIDENCE = {"dtype": "uint8"}
PLANES = (plane_from("thermal", THERMAL), plane_from("confidence", CONFIDENCE))


def raw_thermal(number: int, size: tuple[int, int] = SIZE) -> npt.NDArray[np.uint16]:
    """Return hundredths of a kelvin, none in a corner."""
    rng = np.random.default_rng(100 + number)
    raw = rng.integers(28000, 32000, size, dtype=np.uint16)
    raw[:3, :4] = 0
    return raw


def degrees(raw: npt.NDArray[np.uint16]) -> npt.NDArray[np.float32]:
    """Return degrees Celsius, NaN where there is none."""
    return np.where(raw == 0, np.nan, raw * 0.01 - 273.15).astype(np.float32)


def raw_confidence(number: int, size: tuple[int, int] = SIZE) -> npt.NDArray[np.uint8]:
    """Return any byte."""
    return np.random.default_rng(200 + number).integers(0, 256, size, dtype=np.uint8)


def write_thermal(root: Path, frames: int = 5, size: tuple[int, int] = SIZE) -> Path:
    """Write a dataset in GMRP's layout that has planes beside it."""
    write_gmrp(root, frames, size)
    for number in range(frames):
        write_png(root / "thermal" / f"{number:06d}.png", raw_thermal(number, size))
        write_png(root / "confidence" / f"{number:06d}.png", raw_confidence(number, size))
    return root


class ThermalReader(WrappedReader):
    """Read GMRP's layout and the planes beside it."""

    planes: tuple[Modality, ...] = PLANES

    def __init__(self, root: Path, *, labels: bool = True) -> None:
        super().__init__(open_gmrp(root, labels=labels))
        self.info = replace(self.info, planes=self.planes)

    def _file(self, name: str, frame_id: str) -> Path:
        return self.root / name / f"{frame_id}.png"

    def sources(self, frame_id: str) -> tuple[Path, ...]:
        planes = (self._file(plane.name, frame_id) for plane in self.planes)
        return (*super().sources(frame_id), *planes)

    def read(self, frame_id: str, modalities: Collection[str] = MODALITIES) -> Frame:
        frame = self._reader.read(frame_id, modalities)
        others: dict[str, npt.NDArray[np.generic]] = {}
        for plane in self.planes:
            if plane.name in modalities:
                raw = cv2.imread(str(self._file(plane.name, frame_id)), cv2.IMREAD_UNCHANGED)
                assert raw is not None
                others[plane.name] = degrees(raw) if plane.has_none else raw
        return replace(frame, others=others)


def use_reader(patch: pytest.MonkeyPatch, kind: type[ThermalReader] = ThermalReader) -> None:
    """Let datasets in GMRP's layout be read with their planes."""
    patch.setattr("tests.thermal.chosen", kind, raising=False)
    patch.setitem(READERS, "gmrp", Layout("rgb/", "tests.thermal:chosen", ("depth_u16",)))
