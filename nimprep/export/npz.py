"""Frames as one NumPy archive each: every modality in physical units, and what belongs to it."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.splits import SPLIT_NAMES
from nimprep.store.reader import Store

_LEVEL = 1
"""zlib's level: higher ones take several times as long for a few per cent."""

_EPOCH = (1980, 1, 1, 0, 0, 0)
"""The earliest time a zip can hold, for the same bytes every time."""


def frame_arrays(
    store: Store, index: int, modalities: Sequence[str] | None = None
) -> dict[str, npt.NDArray[Any]]:
    """Return what a frame's file holds, by name; images are of the frame's own size.

    Parameters
    ----------
    modalities : sequence of str, optional
        Those of the store that are wanted; None = all.

    Returns
    -------
    dict
        As far as the store has them: `rgb` (H, W, 3) uint8, R, G, B; `depth_m` (H, W) float32,
        metres, 0 = none; `normal` (H, W, 3) float32 unit vectors in the camera frame, (0, 0, 0) =
        none; `hha` (H, W, 3) uint8; `label` (H, W) uint8, 255 = ignore; what else it has, the
        dataset's own planes too, as `Frame` says. Always: `K` (3, 3) float64,
        pixels; `baseline_m`, `cam_to_road` (3, 4) and `gravity` (3,), NaN = none; `id`, `split` and
        `group`, text.
    """
    frame, tables = store[index], store.tables
    found: dict[str, npt.NDArray[Any]] = {}
    for modality in store.modalities if modalities is None else modalities:
        if (image := frame.image(modality)) is not None:
            found[store.modality(modality).attribute or modality] = image
    return found | {
        "K": tables.intrinsics[index],
        "baseline_m": tables.baseline[index : index + 1].reshape(()),
        "cam_to_road": tables.cam_to_road[index],
        "gravity": tables.gravity[index],
        "id": np.array(frame.id),
        "split": np.array(SPLIT_NAMES.get(int(tables.split[index]), "none")),
        "group": np.array(frame.group),
    }


def npz_bytes(arrays: dict[str, npt.NDArray[Any]]) -> bytes:
    """Return the file's bytes; the same arrays give the same bytes."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=_LEVEL) as archive:
        for name, array in arrays.items():
            packed = io.BytesIO()
            np.lib.format.write_array(packed, np.asarray(array, order="C"), allow_pickle=False)
            entry = zipfile.ZipInfo(f"{name}.npy", date_time=_EPOCH)
            entry.create_system = 3
            entry.external_attr = 0o100644 << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, packed.getbuffer(), compresslevel=_LEVEL)
    return buffer.getvalue()
