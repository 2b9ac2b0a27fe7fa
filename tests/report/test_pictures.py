"""What pixels of pictures are, by hand."""

from __future__ import annotations

import base64

import cv2
import numpy as np
import pytest

from nimprep.errors import ArrayError
from nimprep.frame import LabelClass
from nimprep.report.pictures import (
    NO_VALUE,
    ColorScale,
    css_color,
    data_uri,
    depth_picture,
    encode_picture,
    label_picture,
    normal_picture,
    normal_sphere,
    shrink,
    viridis,
)

CLASSES = (
    LabelClass(0, "other", (9, 9, 9)),
    LabelClass(1, "road", (0, 200, 0)),
    LabelClass(2, "cone", (220, 0, 0)),
)


def test_viridis_goes_from_dark_violet_to_yellow() -> None:
    colors = viridis()
    assert np.abs(colors[0].astype(int) - (68, 1, 84)).max() <= 1
    assert np.abs(colors[255].astype(int) - (253, 231, 37)).max() <= 2


def test_a_value_has_the_colour_at_its_place_and_none_is_grey() -> None:
    scale = ColorScale(10, 20)
    values = np.array([[10.0, 15.0, 20.0, 5.0, 99.0, np.nan]])
    drawn = scale.paint(values, np.isfinite(values))
    expected = [viridis()[i].tolist() for i in (0, 128, 255, 0, 255)]
    assert drawn[0].tolist() == [*expected, list(NO_VALUE)]


def test_depth_is_yellow_near_and_dark_far_by_ratios() -> None:
    scale = ColorScale(1, 16, "m", reverse=True, log=True)
    depth = np.array([[1, 4, 16, 0]], np.float32)
    drawn = depth_picture(depth, scale)
    assert drawn[0].tolist() == [
        viridis()[255].tolist(),
        viridis()[127].tolist(),
        viridis()[0].tolist(),
        list(NO_VALUE),
    ]


def test_no_colour_of_the_scale_is_the_grey_of_none() -> None:
    assert np.abs(viridis().astype(int) - NO_VALUE).max(axis=1).min() > 20


def test_ticks_are_round_and_within_the_scale() -> None:
    assert ColorScale(0, 10).ticks() == [0, 2, 4, 6, 8, 10]
    assert ColorScale(-0.3, 1.1).ticks() == [0, 0.5, 1]
    assert ColorScale(0.7, 22, log=True).ticks() == [1, 2, 5, 10, 20]
    scale = ColorScale(1, 16, log=True)
    assert scale.place([1, 4, 16]).tolist() == pytest.approx([0, 0.5, 1])
    assert scale.stops(3) == [css_color(viridis()[i]) for i in (0, 128, 255)]


@pytest.mark.parametrize(
    ("low", "high", "log"), [(1, 1, False), (2, 1, False), (0, 1, True), (0, np.nan, False)]
)
def test_a_scale_without_width_is_refused(low: float, high: float, log: bool) -> None:
    with pytest.raises(ArrayError, match="colour scale: expected"):
        ColorScale(low, high, log=log)


def test_normals_have_the_usual_colours() -> None:
    toward, up, right, none = (0, 0, -1), (0, -1, 0), (1, 0, 0), (0, 0, 0)
    drawn = normal_picture(np.array([[toward, up, right, none]], np.float32))
    assert drawn[0].tolist() == [[128, 128, 255], [128, 255, 128], [255, 128, 128], list(NO_VALUE)]


def test_the_ball_shows_each_normal_where_it_is_on_a_ball() -> None:
    ball = normal_sphere(101)
    assert ball.shape == (101, 101, 4)
    assert ball[50, 50].tolist() == [128, 128, 255, 255]
    top, right = ball[1, 50].astype(int), ball[50, 99].astype(int)
    assert top[1] > 240
    assert abs(top[0] - 128) < 3
    assert right[0] > 240
    assert abs(right[1] - 128) < 3
    assert ball[0, 0, 3] == ball[100, 100, 3] == 0


def test_labels_tint_the_photograph_and_leave_the_background() -> None:
    rgb = np.full((1, 5, 3), 100, np.uint8)
    label = np.array([[0, 1, 2, 255, 7]], np.uint8)
    drawn = label_picture(label, CLASSES, rgb)
    assert drawn[0].tolist() == [
        [100, 100, 100],
        [50, 150, 50],
        [160, 50, 50],
        [70, 70, 70],
        [177, 50, 177],
    ]
    assert (rgb == 100).all()
    assert label_picture(label, CLASSES)[0, 0].tolist() == list(NO_VALUE)


def test_shrinking_takes_the_mean_and_never_enlarges() -> None:
    image = np.zeros((4, 8, 3), np.uint8)
    image[:, 1::2] = 200
    assert (shrink(image, 4) == 100).all()
    assert shrink(image, 4).shape == (2, 4, 3)
    assert shrink(image, 100) is image
    assert shrink(np.zeros((1, 9, 3), np.uint8), 3).shape == (1, 3, 3)


@pytest.mark.parametrize("kind", ["png", "webp", "jpeg"])
def test_files_hold_the_picture_with_red_as_red(kind: str) -> None:
    image = np.zeros((16, 24, 3), np.uint8)
    image[..., 0] = 250
    data = encode_picture(image, kind, 90)  # type: ignore[arg-type]
    uri = data_uri(data, kind)
    assert uri.startswith(f"data:image/{kind};base64,")
    packed = np.frombuffer(base64.b64decode(uri.split(",")[1]), np.uint8)
    decoded = cv2.imdecode(packed, cv2.IMREAD_COLOR_RGB)
    assert np.abs(decoded.astype(int) - image).max() <= (0 if kind == "png" else 6)


def test_png_keeps_alpha() -> None:
    image = np.array([[[1, 2, 3, 4]]], np.uint8)
    packed = np.frombuffer(encode_picture(image, "png"), np.uint8)
    assert cv2.imdecode(packed, cv2.IMREAD_UNCHANGED)[0, 0].tolist() == [3, 2, 1, 4]
