"""A frame: what it makes of the images that it is given."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from nimprep import Camera, Frame
from nimprep.errors import ArrayError
from nimprep.frame import ByteImage, FloatImage
from nimprep.modality import MODALITIES

CAMERA = Camera(fx=10, fy=10, cx=1, cy=1, width=3, height=2)
MASK = np.array([[True, False, False], [False, True, False]])


def test_depth_that_is_none_is_0_in_a_frame() -> None:
    depth = np.array([[np.nan, np.inf, 2.0], [-np.inf, 1e-20, 3.0]])
    frame = Frame("a", CAMERA, depth_m=depth)
    assert frame.depth_m is not None
    assert frame.depth_m.tolist() == [[0, 0, 2], [0, 0, 3]]
    assert frame.depth_m.dtype == np.float32
    assert replace(frame, depth_m=depth + 1).depth_m.tolist() == [[0, 0, 3], [0, 1, 4]]


def test_a_negative_depth_or_one_of_another_size_is_no_frame() -> None:
    depth = np.ones((2, 3), np.float32)
    depth[1, 2] = -0.5
    with pytest.raises(ArrayError, match=r"^frame 'a': depth_m: .* found -0\.5 at .* \(2, 1\)"):
        Frame("a", CAMERA, depth_m=depth)
    with pytest.raises(ArrayError, match=r"^frame 'b': depth_m: expected the camera's size"):
        Frame("b", CAMERA, depth_m=depth.T)


@pytest.mark.parametrize("name", list(MODALITIES))
def test_what_is_masked_is_none_and_colours_cannot_be(name: str) -> None:
    record = MODALITIES[name]
    image = np.full_like(record.blank(CAMERA.shape), 1)
    mask = MASK if image.ndim == 2 else np.stack([MASK, MASK & False, MASK & False], axis=-1)
    masked = np.ma.array(image, mask=mask)
    attribute = record.attribute or name
    given = {attribute: masked} if hasattr(Frame, attribute) else {"others": {name: masked}}
    if record.values == "colors":
        with pytest.raises(ArrayError, match=rf"^frame 'a': {name}: .*found 2 masked"):
            Frame("a", CAMERA, **given)
        return
    found = Frame("a", CAMERA, **given).image(name)
    assert type(found) is np.ndarray
    assert found.dtype == image.dtype
    expected = image.copy()
    expected[MASK] = record.absent
    assert np.array_equal(found, expected, equal_nan=expected.dtype.kind == "f")


def test_an_image_that_must_be_there_is_asked_for_by_its_modality() -> None:
    frame = Frame("a", CAMERA, depth_m=np.ones((2, 3), np.float32), others={"distance": MASK})
    assert frame["depth"] is frame.depth_m
    assert list(frame) == ["depth", "distance"]
    assert "depth" in frame
    assert "rgb" not in frame
    assert frame["distance"] is MASK
    with pytest.raises(
        ArrayError, match=r"^frame 'a': expected rgb, found depth, distance; ask for one"
    ):
        frame["rgb"]
    with pytest.raises(ArrayError, match="found 'depth_m'"):
        frame["depth_m"]


def test_what_checkers_are_told_of_an_images_type_is_so() -> None:
    kinds = {np.uint8: get_args(ByteImage), np.float32: get_args(FloatImage)}
    assert sorted((*kinds[np.uint8], *kinds[np.float32])) == sorted(MODALITIES)
    for kind, names in kinds.items():
        assert {MODALITIES[name].blank((2, 3)).dtype for name in names} == {np.dtype(kind)}
