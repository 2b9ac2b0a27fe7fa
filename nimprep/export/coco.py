"""Frames as COCO's JSON, a mask of each class of each image::

OUT/
  images/000001.png                  8-bit colour
  annotations/instances_train.json   instances_val.json, instances_test.json; images, annotations,
                                     categories; image_info_*.json where no labels are asked for
  encodings.json

An annotation is all pixels of one class in one image, compressed RLE, iscrowd 0, as COCO-Stuff has
them: a store has classes, no instances. A category's id is the class's. Ignored pixels are in no
annotation, all others in one. Any other modality that is asked for by name stands in a folder of
its name, as with --format png.

Sources: cocodataset.org/#format-data; the run lengths' text is that of cocoapi's maskApi.c,
rleToString: counts go down columns and begin with zeros; from the fourth on they are less the one
two before; five bits a character from the lowest, sign extended, the sixth says that more come.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.export.layout import Folder, Job, Layout, as_png, as_stored, record_of, unchanged
from nimprep.export.places import write_new
from nimprep.frame import IGNORE_LABEL
from nimprep.parallel import Progress

IN_JSON = frozenset({"label"})
"""What has no folder."""


def run_lengths(mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
    """Return how many zeros, ones, zeros ... follow each other down the columns of (H, W)."""
    flat = mask.ravel(order="F")
    edges = np.flatnonzero(flat[1:] != flat[:-1]) + 1
    first = [0, 0] if flat[0] else [0]
    return np.diff(np.concatenate([first, edges, [flat.size]]))


def rle_text(counts: npt.NDArray[np.int64]) -> str:
    """Return run lengths as COCO's compressed text."""
    rest = counts.astype(np.int64)
    rest[3:] -= counts[1:-2]
    characters, going = [], []
    open_ = np.ones(len(rest), bool)
    while open_.any():
        low = rest & 0x1F
        rest = rest >> 5
        more = open_ & np.where(low & 0x10, rest != -1, rest != 0)
        characters.append((low | (more * 0x20)) + 48)
        going.append(open_)
        open_ = more
    table = np.stack(characters, axis=1).astype(np.uint8)
    return bytes(table[np.stack(going, axis=1)]).decode("ascii")


def masks_of(label: npt.NDArray[np.uint8]) -> list[dict[str, Any]]:
    """Return an annotation of each class that a label image has, less its ids."""
    found = []
    for value in np.unique(label):
        if value == IGNORE_LABEL:
            continue
        mask = label == value
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        top, left = int(rows[0]), int(columns[0])
        found.append(
            {
                "category_id": int(value),
                "segmentation": {"size": list(mask.shape), "counts": rle_text(run_lengths(mask))},
                "area": int(mask.sum()),
                "bbox": [left, top, int(columns[-1]) + 1 - left, int(rows[-1]) + 1 - top],
                "iscrowd": 0,
            }
        )
    return found


def folders(job: Job, progress: Progress | None) -> Mapping[str, Folder]:
    """Return the folder of each modality; labels are in the JSON."""
    made = {"rgb": as_png({}, "images", unchanged)}
    return {
        name: made[name] if name in made else as_stored(record_of(job.store, name))
        for name in job.modalities
        if name not in IN_JSON
    }


def finish(folder: Path, job: Job, seen: Sequence[Any]) -> None:
    """Write the JSON of each split that has frames."""
    found = dict(zip((i for i, _ in job.frames), seen, strict=True))
    labelled = IN_JSON <= set(job.modalities)
    for split, indices in job.splits.items():
        if not indices:
            continue
        document = _document(job, indices)
        if labelled:
            numbered = ((i, mask) for i in indices for mask in found[i])
            document["annotations"] = [
                {"id": number, "image_id": i + 1, **mask}
                for number, (i, mask) in enumerate(numbered, 1)
            ]
        name = f"{'instances' if labelled else 'image_info'}_{split}.json"
        data = json.dumps(document, separators=(",", ":"), ensure_ascii=False).encode()
        write_new(folder / "annotations" / name, data)


def _document(job: Job, indices: Sequence[int]) -> dict[str, Any]:
    about, sizes = job.store.about, job.store.tables.image_size
    return {
        "info": {"description": about.dataset},
        "licenses": [],
        "images": [
            {
                "id": i + 1,
                "file_name": f"{job.names[i]}.png",
                "width": int(sizes[i][1]),
                "height": int(sizes[i][0]),
                "frame_id": job.store.ids[i],
                "group": job.store.tables.group[i],
            }
            for i in indices
        ],
        "categories": [
            {"id": c.id, "name": c.name, "supercategory": about.dataset, "color": list(c.color)}
            for c in job.store.classes
        ],
    }


COCO = Layout("coco", (("rgb",), ("label",)), folders, finish, others=None, look=masks_of)
