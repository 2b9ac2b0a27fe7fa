"""Frames as RoadFormer reads them (its `MMCarlaDataset`, on mmsegmentation)::

OUT/
  images/training/000001.png        8-bit colour
  normal/training/000001.png        16-bit x right, y down, z forward: (n + 1) / 2 * 65535
  annotations/training/000001.png   8-bit grey: class ids; 255 = ignore
  .../validation/ .../testing/      val and test
  classes.txt, encodings.json

Where there is no normal, (0, 0, 0), each channel is 32768 by the formula; no unit vector is that.
Asked for by name: depth/, disparity/ and tdisp/, grey, the store's numbers moved up from 0.

RoadFormer's loader for its own data, SYN-UDTIRI, takes classes from colours and knows three of
them; `annotations` has ids instead, as mmsegmentation's `LoadAnnotations` reads them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy.typing as npt

from nimprep.export.layout import (
    Folder,
    Job,
    Layout,
    as_png,
    as_stored,
    record_of,
    unchanged,
    write_classes,
)
from nimprep.export.normal_pictures import normal_entry, normal_numbers
from nimprep.parallel import Progress

OTHERS = {"depth": "depth", "disparity": "disparity", "transformed_disparity": "tdisp"}
"""The folders of what RoadFormer takes in the place of normals, by one setting of its own."""


def folders(job: Job, progress: Progress | None) -> Mapping[str, Folder]:
    """Return the folder of each modality."""
    made = {
        "rgb": as_png({}, "images/{split}", unchanged),
        "normal": as_png(normal_entry(16), "normal/{split}", _normals),
        "label": as_png({}, "annotations/{split}", unchanged),
    }
    for name in set(OTHERS) & set(job.modalities):
        made[name] = as_stored(record_of(job.store, name), f"{OTHERS[name]}/{{split}}")
    return {name: made[name] for name in job.modalities}


def _normals(normal: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return normal_numbers(normal, 16)


def finish(folder: Path, job: Job, seen: Sequence[Any]) -> None:
    """Write the classes: the folders are the lists."""
    for split in ("train", "val"):
        if not job.splits[split]:
            job.notes.append(f"{ROADFORMER.splits[split]} is empty, as no frame is of {split}")
    write_classes(folder, job)


ROADFORMER = Layout(
    "roadformer",
    (("rgb",), ("normal",), ("label",)),
    folders,
    finish,
    others=tuple(OTHERS),
    splits={"train": "training", "val": "validation", "test": "testing"},
)
