"""Depth of public layouts, each by its own encoding, against the scene behind each frame."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nimprep.images import read_header, read_plane
from nimprep.readers.cameras import GivenCamera
from nimprep.readers.depth_values import depth_image, raw_depth
from nimprep.readers.description_file import description_from_document
from nimprep.readers.matching import Place
from tests.cases.cases import layout_scene

CAMERA = GivenCamera("file", "camera.json", (80, 80, 47.5, 20))
CITY_FX, CITY_BASELINE_M = 2262.52 * 96 / 2048, 0.209313
MAT = "nyu_depth_v2_labeled.mat"

DEPTHS: dict[str, tuple[dict[str, Any], dict[tuple[str, int | None], int], float]] = {
    "orfd": (
        {"scale_m": 1 / 256},
        {
            ("training/c2021_0228_1819/dense_depth/1623721491895.png", None): 0,
            ("testing/y2021_0228_1807/dense_depth/1623721492595.png", None): 7,
        },
        1 / 256,
    ),
    "cityscapes": (
        {
            "values": "disparity",
            "scale_px": 1 / 256,
            "offset_px": -1 / 256,
            "baseline_m": CITY_BASELINE_M,
            "fx": CITY_FX,
        },
        {
            ("disparity/train/aachen/aachen_000000_000019_disparity.png", None): 0,
            ("disparity/test/berlin/berlin_000001_000019_disparity.png", None): 7,
        },
        # Half a 256th of a pixel at the scene's farthest, 30 m; so below.
        0.5 / 256 * 30.1**2 / (CITY_FX * CITY_BASELINE_M),
    ),
    "kitti_semantics": (
        {"values": "disparity", "scale_px": 1 / 256, "baseline_m": 0.54},
        {
            ("training/disp_occ_0/000000_10.png", None): 0,
            ("training/disp_occ_0/000002_10.png", None): 2,
        },
        0.5 / 256 * 30.1**2 / (80 * 0.54),
    ),
    "vkitti2": (
        {"scale_m": 0.01, "invalid": [65535]},
        {
            ("Scene01/clone/frames/depth/Camera_0/depth_00000.png", None): 0,
            ("Scene02/15-deg-left/frames/depth/Camera_1/depth_00002.png", None): 2,
        },
        0.01,
    ),
    "r2d": (
        {"bytes": "RGB", "scale_m": 1000 / (2**24 - 1), "invalid": [2**24 - 1]},
        {
            ("training/Town02/depth/000000.png", None): 0,
            ("testing/Town06/depth/000001.png", None): 7,
        },
        0.5 * 1000 / 2**24,
    ),
    "sunrgbd": (
        {"scale_m": 0.001, "rotate_right": 3, "clip_m": 8},
        {
            ("kv1/NYUdata/NYU0001/depth_bfx/NYU0001.png", None): 0,
            ("xtion/sun3ddata/brown_bm_1/brown_bm_1/depth/0000103-000003411096.png", None): 3,
        },
        0.001,
    ),
    "nyuv2_mat": (
        {"key": "depths", "axes": "NWH", "scale_m": 1},
        {(MAT, 0): 0, (MAT, 3): 3},
        0,
    ),
    "nyuv2_nicr": (
        {"scale_m": 0.001},
        {("train/depth/0000.png", None): 0, ("test/depth_raw/0003.png", None): 3},
        0.001,
    ),
    "tum": (
        {"scale_m": 1 / 5000},
        {("depth/1305031102.160407.png", None): 0},
        1 / 5000,
    ),
}


@pytest.mark.parametrize("name", DEPTHS)
def test_depth_of_a_public_layout_is_the_scene_s(layout: Callable[[str], Path], name: str) -> None:
    depth, frames, most = DEPTHS[name]
    document = {"format": "nimprep-folder", "version": "1.1", "name": name, "rgb": "{id}.png"}
    source = description_from_document({**document, "depth": {"files": "{id}", **depth}}, name)
    assert source.depth is not None
    root = layout(name)
    for (file, index), seed in frames.items():
        place = Place(root / file, index)
        found = depth_image(place, source.depth, raw_depth(place, source.depth), CAMERA)
        wanted = np.minimum(layout_scene(seed)[1], depth.get("clip_m", np.inf))
        # TUM's 16 bits of 1/5000 m end at 13.107 m.
        wanted = np.minimum(wanted, 65535 / 5000) if name == "tum" else wanted
        header = read_header(place.path, source.depth.layout)
        assert (header.height, header.width) == found.shape == wanted.shape
        assert np.array_equal(found > 0, wanted > 0)
        assert np.abs(found - wanted).max() <= most + 1e-6


def test_colour_of_nyu_s_mat_file_is_turned_upright(layout: Callable[[str], Path]) -> None:
    document = {"format": "nimprep-folder", "version": "1.1", "name": "nyu"}
    rgb = {"files": MAT, "key": "images", "axes": "NCWH"}
    source = description_from_document({**document, "rgb": rgb}, "nyu").rgb
    root = layout("nyuv2_mat")
    assert read_header(root / MAT, source.layout).frames == 4
    assert np.array_equal(read_plane(root / MAT, source.layout, 2), layout_scene(2)[0])
