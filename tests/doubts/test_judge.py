"""From signs to doubts: which, of which frames, and what is said."""

from __future__ import annotations

import re
from dataclasses import asdict

import numpy as np
import pytest

from nimprep.camera import Camera
from nimprep.doubts.depth import camera_signs, depth_signs, staircase_signs
from nimprep.doubts.gravity import GRAVITY_KINDS
from nimprep.doubts.judge import RULES, TITLES, Doubt, judge, sentence
from nimprep.doubts.labels import LABEL_KINDS
from nimprep.doubts.raw import raw_signs
from tests.doubts.streets import CAMERA, rough_street, street

GOOD = {
    **raw_signs(rough_street(), name="depth/0.png"),
    **depth_signs(street(), CAMERA, 65.535),
    **camera_signs(CAMERA),
    "exif_orientation": 1.0,
    **staircase_signs(street(), np.ones(street().shape, bool)),
}

DOUBTFUL = {
    "byte-order": ({"swapped_roughness": 0.25}, '4.0 times .*"byte_order": "swapped"'),
    "rotated-bits": ({"multiples_of_8": 1.0}, '^all of .*SUN RGB-D.*"rotate_right": 3'),
    "eight-bits": ({"largest_raw": 213.0}, "213 only, as those of an 8-bit image"),
    "saturated": ({"at_most_raw": 0.03}, '^3% of the raw .* the largest .*"invalid"'),
    "disparity-name": ({"disparity_name": 1.0}, 'names.*"values": "disparity"'),
    "grows-downwards": ({"row_correlation": 0.91}, '0.91.*"values": "disparity"'),
    "sparse": (
        {"with_neighbours": 0.02, "alone": 0.83},
        "^2% .*few as of LiDAR.* 83% have no normal.*--fill linear",
    ),
    "staircase": ({"staircase": 0.3}, "^30% .*filled in .*steps.*--fill linear$"),
    "camera-height": ({"camera_height_m": 13.2}, "13.2 m above .*--depth-scale"),
    "normalised-camera": ({"focal_px": 0.86, "view_deg": 179.0}, "0.86 pixels, as where .* share"),
    "principal-point": ({"cx_share": 7.5, "cy_share": 5.6}, "cx at 7.5 of its width"),
    "field-of-view": ({"view_deg": 5.3}, "5.3 degrees"),
    "exif-orientation": ({"exif_orientation": 6.0}, 'orientation, 6,.*"orientation": "ignore"'),
    "beyond-range": ({"beyond_range": 0.27}, "^27% .* beyond 65.535 m"),
}


def judged(*signs: dict[str, float], filled: bool = False) -> list[Doubt]:
    return judge([(f"{n}", s) for n, s in enumerate(signs)], filled=filled, most_m=65.535)


def test_nothing_is_doubted_of_good_frames_or_of_none() -> None:
    assert judged(GOOD, GOOD) == judged({}, {}) == judged() == []


def test_every_rule_has_a_sign_that_frames_have_and_a_case_here() -> None:
    assert {rule.sign for rule in RULES} <= GOOD.keys()
    assert {rule.kind for rule in RULES} | {"beyond-range"} == DOUBTFUL.keys()
    assert DOUBTFUL.keys() | LABEL_KINDS | GRAVITY_KINDS == TITLES.keys()


@pytest.mark.parametrize("kind", DOUBTFUL)
def test_a_doubt_names_what_was_found_and_what_to_do(kind: str) -> None:
    changes, text = DOUBTFUL[kind]
    bad = GOOD | changes
    (doubt,) = judged(bad, bad, bad, bad, bad, bad)
    assert doubt.kind == kind
    assert (doubt.frames, doubt.count) == (list("01234"), 6)
    assert re.search(text, doubt.text)
    assert sentence(asdict(doubt)) == f"{doubt.text} (6 frames, first '0')"


@pytest.mark.parametrize("kind", DOUBTFUL)
def test_the_frames_are_those_that_the_doubt_is_of(kind: str) -> None:
    (doubt,) = judged(GOOD, GOOD | DOUBTFUL[kind][0], {})
    assert (doubt.frames, doubt.count) == (["1"], 1)
    assert sentence(asdict(doubt)).endswith(" (1 frame, first '1')")


@pytest.mark.parametrize(
    "kind",
    ["byte-order", "rotated-bits", "eight-bits", "grows-downwards", "camera-height"],
)
def test_one_odd_scene_among_many_is_no_doubt_of_the_data_set(kind: str) -> None:
    assert judged(*[GOOD] * 3, GOOD | DOUBTFUL[kind][0]) == []


def test_a_few_far_frames_are_no_doubt_of_the_range() -> None:
    assert judged(*[GOOD] * 9, GOOD | {"beyond_range": 0.9}) == []


def test_frames_that_do_not_tell_are_not_asked() -> None:
    (doubt,) = judged({}, {}, {}, GOOD | {"camera_height_m": 0.05})
    assert doubt.kind == "camera-height"


def test_depth_that_is_filled_has_neighbours() -> None:
    assert judged(GOOD | DOUBTFUL["sparse"][0], filled=True) == []


def test_a_tiny_image_may_have_a_short_focal_length() -> None:
    assert judged(GOOD | camera_signs(Camera.from_fov(69.4, 3, 2))) == []


def test_the_camera_of_an_image_ten_times_as_large_is_doubted_twice() -> None:
    large = Camera(1386.0, 1386.0, 960.0, 540.0, 128, 96)
    kinds = [doubt.kind for doubt in judged(GOOD | camera_signs(large))]
    assert kinds == ["principal-point", "field-of-view"]
