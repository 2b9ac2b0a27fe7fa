"""Frames as PASCAL VOC's segmentation has them::

OUT/
  JPEGImages/000001.jpg          colour, JPEG: loaders of VOC ask for this ending
  SegmentationClass/000001.png   class ids, with VOC's palette; 255 = void
  ImageSets/Segmentation/        train.txt, val.txt, trainval.txt, test.txt: a name a line
  labelmap.txt                   name:r,g,b:: of each class, as CVAT and Datumaro read it
  encodings.json

Any other modality that is asked for by name stands in a folder of its name, as with --format png.

Source: Everingham et al., The PASCAL Visual Object Classes Challenge 2012 (VOC2012) Development
Kit, sections 2.4 and 8.2.1; its VOClabelcolormap.m.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.export.layout import Folder, Job, Layout, as_stored, record_of
from nimprep.export.places import write_new
from nimprep.parallel import Progress

QUALITY = 95
"""Of the JPEGs, whose colour is as fine as their brightness."""


def voc_palette() -> npt.NDArray[np.uint8]:
    """Return VOC's colours, (256, 3) R, G, B: the id's bits dealt out to the channels."""
    colors = np.zeros((256, 3), np.uint8)
    rest = np.arange(256)
    for bit in range(7, -1, -1):
        for channel in range(3):
            colors[:, channel] |= (((rest >> channel) & 1) << bit).astype(np.uint8)
        rest = rest >> 3
    return colors


def folders(job: Job, progress: Progress | None) -> Mapping[str, Folder]:
    """Return the folder of each modality."""
    made = {
        "rgb": Folder("JPEGImages", jpeg_bytes, suffix=".jpg"),
        "label": Folder("SegmentationClass", palette_png_bytes),
    }
    if "rgb" in job.modalities:
        job.notes.append(
            f"colour is JPEG of quality {QUALITY}, as VOC's loaders ask for, which changes values; "
            "--format png or coco keeps them"
        )
    return {
        name: made[name] if name in made else as_stored(record_of(job.store, name))
        for name in job.modalities
    }


def jpeg_bytes(image: npt.NDArray[np.uint8]) -> bytes:
    """Return (H, W, 3) R, G, B as JPEG."""
    import cv2

    asked = [cv2.IMWRITE_JPEG_QUALITY, QUALITY]
    asked += [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    _, data = cv2.imencode(".jpg", np.ascontiguousarray(image[:, :, ::-1]), asked)
    return data.tobytes()


def palette_png_bytes(label: npt.NDArray[np.uint8]) -> bytes:
    """Return (H, W) class ids as a PNG with VOC's palette."""
    from PIL import Image

    height, width = label.shape
    image = Image.frombytes("P", (width, height), np.ascontiguousarray(label).tobytes())
    image.putpalette(voc_palette().tobytes())
    buffer = io.BytesIO()
    image.save(buffer, "PNG")
    return buffer.getvalue()


def finish(folder: Path, job: Job, seen: Sequence[Any]) -> None:
    """Write the lists and the classes."""
    splits = {name: list(indices) for name, indices in job.splits.items()}
    splits["trainval"] = sorted(splits["train"] + splits["val"])
    for split, indices in splits.items():
        lines = "".join(f"{job.names[i]}\n" for i in indices)
        write_new(folder / "ImageSets" / "Segmentation" / f"{split}.txt", lines.encode())
    for split in ("train", "val"):
        if not splits[split]:
            job.notes.append(f"{split}.txt is empty, as no frame is of {split}")
    colors = voc_palette()
    lines = "# label:color_rgb:parts:actions\n"
    for each in job.store.classes:
        red, green, blue = colors[each.id]
        name = " ".join(each.name.replace(":", " ").split())
        lines += f"{name}:{red},{green},{blue}::\n"
    write_new(folder / "labelmap.txt", lines.encode())


VOC = Layout("voc", (("rgb",), ("label",)), folders, finish, others=None)
