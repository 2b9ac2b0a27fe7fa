"""Loaders of networks, written from what each documents and does, not from what nimprep writes.

CMX: github.com/huaaaliu/RGBX_Semantic_Segmentation, README and dataloader/RGBXDataset.py.
DFormer: github.com/VCIP-RGBD/DFormer, figs/application_new_dataset and utils/dataloader.
Sigma: github.com/zifuwan/Sigma, README; its RGBXDataset is CMX's with labels read grey.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
import PIL.Image

Image = npt.NDArray[Any]


class Sample(NamedTuple):
    """What a network gets: rgb and x as OpenCV has them (B, G, R), label with 255 = ignored."""

    rgb: Image
    x: Image
    label: Image


def opened(path: Path, mode: int) -> Image:
    image = cv2.imread(str(path), mode)
    assert image is not None, path
    return image


@dataclass
class Rgbx:
    """One of the three.

    `x` is the folder of the second modality; `single` whether it has one channel.
    """

    network: str
    root: Path
    x: str = "Depth"
    single: bool = True

    def names(self, source: str) -> list[str]:
        lines = [line.strip() for line in (self.root / source).read_text().splitlines()]
        if self.network == "dformer":
            # "RGB/0.jpg": what stands between the first slash and the next, less the ending.
            lines = [line.split("/")[1].split(".jpg")[0] for line in lines]
            return [line.replace(".jpg", "").replace(".png", "") for line in lines]
        return lines

    def load(self, name: str) -> Sample:
        file = name + ".png"
        # COLOR_BGR2RGB, which they give as the mode to read in, is 4: any colour, in B, G, R.
        rgb = opened(self.root / "RGB" / file, cv2.COLOR_BGR2RGB)
        grey = cv2.IMREAD_UNCHANGED if self.network == "cmx" else cv2.IMREAD_GRAYSCALE
        label = opened(self.root / "Label" / file, grey)
        assert label.dtype == np.uint8
        if self.single:
            x = opened(self.root / self.x / file, grey)
            x = cv2.merge([x, x, x])
        else:
            x = opened(self.root / self.x / file, cv2.IMREAD_UNCHANGED)
        # They then divide by 255 and normalise.
        assert x.dtype == np.uint8
        return Sample(rgb, x, label - np.uint8(1))


@dataclass
class Voc:
    """VOC's segmentation as torchvision's VOCSegmentation and mmsegmentation's dataset read it."""

    root: Path

    def names(self, split: str) -> list[str]:
        text = (self.root / "ImageSets" / "Segmentation" / f"{split}.txt").read_text()
        return [line.strip() for line in text.splitlines()]

    def load(self, name: str) -> Sample:
        with (
            PIL.Image.open(self.root / "JPEGImages" / f"{name}.jpg") as image,
            PIL.Image.open(self.root / "SegmentationClass" / f"{name}.png") as mask,
        ):
            assert image.format == "JPEG"
            assert mask.mode == "P"
            pixels = np.asarray(image.convert("RGB"))
            return Sample(pixels, np.asarray(mask.convert("RGB")), np.asarray(mask))


@dataclass
class RoadFormer:
    """RoadFormer on mmsegmentation: github.com/LiJiahang617/Road-Former.

    mmseg_custom/datasets/mmcarla.py lists the files, mmcv_custom/transforms/loading.py
    (LoadMultimodalImageFromFile) reads them, mmsegmentation's LoadAnnotations reads labels.
    """

    root: Path
    modality: str = "normal"

    def names(self, split: str) -> list[str]:
        folder = self.root / "images" / split
        return sorted(str(path.relative_to(folder)) for path in folder.rglob("*.png"))

    def load(self, split: str, name: str) -> Sample:
        image = opened(self.root / "images" / split / name, cv2.IMREAD_UNCHANGED)
        other = opened(self.root / self.modality / split / name, cv2.IMREAD_UNCHANGED)
        if self.modality == "normal":
            assert other.ndim == 3
            # "normal img is uint16, multiplied by 65535, so must divided"
            other = other.astype(np.float32) / 65535
        label = np.asarray(PIL.Image.open(self.root / "annotations" / split / name))
        assert label.ndim == 2
        other = other[:, :, ::-1] if other.ndim == 3 else other
        return Sample(image[:, :, ::-1], other, label.astype(np.uint8))
