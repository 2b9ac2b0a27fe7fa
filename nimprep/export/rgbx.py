"""Frames as CMX, DFormer and Sigma read them (`RGBXDataset` of each)::

OUT/
  RGB/000001.png     8-bit colour
  Depth/000001.png   8-bit grey: near is dark, 255 the farthest, 0 = no depth
  HHA/000001.png     8-bit R, G, B: horizontal disparity, height, angle; (0, 0, 0) = none
  Normal/000001.png  asked for by name: (n + 1) / 2 * 255 of x right, y down, z forward
  Label/000001.png   8-bit grey: class id + 1; 0 = ignore
  train.txt, val.txt, test.txt
  classes.txt, encodings.json

The three subtract 1 from labels in 8 bits, so that 0 becomes 255, which their loss ignores. All
read 8 bits of X: CMX divides what OpenCV reads by 255, DFormer and Sigma have OpenCV read grey. So
depth is one scale over the whole store, 99 % of whose depth lies within it; the depth that DFormer
ships is stretched image by image, which says no distance.

A line of the lists is "./000001". CMX and Sigma join it to each folder and add an ending; DFormer
takes what stands behind the first "/". So one list serves all three.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.export.layout import Folder, Job, Layout, as_png, unchanged, write_classes
from nimprep.export.normal_pictures import normal_entry, normal_numbers
from nimprep.export.places import write_new
from nimprep.parallel import Progress, map_frames
from nimprep.store.frames import from_integers
from nimprep.store.reader import Store

SHARE = 0.99
"""Of all depth, so much is within the scale: single pixels far off would coarsen all others."""


def folders(job: Job, progress: Progress | None) -> Mapping[str, Folder]:
    """Return the folder of each modality."""
    made = {
        "rgb": as_png({}, "RGB", unchanged),
        "hha": as_png({}, "HHA", unchanged),
        "normal": as_png(normal_entry(8), "Normal", lambda image: normal_numbers(image, 8)),
        "label": as_png(
            {"value": "png - 1", "subtract": 1, "none": 0},
            "Label",
            lambda image: (image + np.uint8(1)).astype(np.uint8),
        ),
    }
    if "depth" in job.modalities:
        most_m = depth_range(job.store, progress)
        job.notes.append(
            f"depth is in 8 bits, as the networks read it: steps of {most_m / 255:.3g} m, 255 from "
            f"{most_m:.4g} m on; --format png keeps all of it"
        )
        made["depth"] = as_png(
            {"bits": 8, "value": f"png * {most_m / 255:.9g}", "scale": most_m / 255, "none": 0},
            "Depth",
            lambda image: depth_numbers(image, most_m),
        )
    return {name: made[name] for name in job.modalities}


def depth_numbers(depth_m: npt.NDArray[np.float32], most_m: float) -> npt.NDArray[np.uint8]:
    """Return depth as 1 to 255, the nearest whole number of 255ths of `most_m`; 0 = none."""
    steps = np.clip(np.rint(depth_m * np.float32(255 / most_m)), 1, 255)
    return np.where(depth_m > 0, steps, 0).astype(np.uint8)


def depth_range(store: Store, progress: Progress | None) -> float:
    """Return the depth that `SHARE` of all the store's pixels with depth do not exceed, metres."""
    array = store.arrays["depth"]
    counts = np.zeros(1 << 16, np.int64)

    def count(index: int) -> npt.NDArray[np.int64]:
        height, width = store.camera(index).shape
        return np.bincount(array.read(index)[:height, :width].ravel(), minlength=1 << 16)

    for found in map_frames("range of depth", count, range(len(store)), progress):
        counts += found
    counts[0] = 0
    if not counts.any():
        return 1.0
    below = np.cumsum(counts)
    found = np.searchsorted(below, SHARE * below[-1]).astype(array.dtype)
    return float(from_integers(array.modality, found.reshape(1, 1))[0, 0])


def finish(folder: Path, job: Job, seen: Sequence[Any]) -> None:
    """Write the lists and the classes."""
    for split, indices in job.splits.items():
        lines = "".join(f"./{job.names[i]}\n" for i in indices)
        write_new(folder / f"{split}.txt", lines.encode())
    for split in ("train", "test"):
        if not job.splits[split]:
            job.notes.append(
                f"{split}.txt is empty, as no frame is of {split}"
                + ("; evaluate on val.txt" if job.splits["val"] and split == "test" else "")
            )
    write_classes(folder, job)


RGBX = Layout("rgbx", (("rgb",), ("depth", "hha"), ("label",)), folders, finish, others=("normal",))
