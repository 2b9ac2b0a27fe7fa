"""Real frames: read rightly nothing is doubted of them, with room to spare; read wrongly it is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nimprep.doubts import judge as rules
from nimprep.doubts.depth import camera_signs, depth_signs
from nimprep.doubts.judge import judge
from nimprep.doubts.raw import CERTAINLY_SWAPPED, check_byte_order, raw_signs
from nimprep.errors import DecodeError
from tests.doubts.real_frames import RealFrame, dense_frames, kitti_scan, rendered_depth

MOST_M = 65.535


@pytest.fixture(scope="module")
def frames(reference_data: Path) -> list[RealFrame]:
    return list(dense_frames(reference_data))


def signs_of(frame: RealFrame) -> dict[str, float]:
    raw = {} if frame.raw is None else raw_signs(frame.raw, [65535])
    return {**raw, **depth_signs(frame.depth_m, frame.camera, MOST_M), **camera_signs(frame.camera)}


def kinds(*signs: dict[str, float]) -> list[str]:
    found = judge([(f"{n}", s) for n, s in enumerate(signs)], filled=False, most_m=MOST_M)
    return [doubt.kind for doubt in found]


def test_nothing_is_doubted_of_frames_read_rightly(frames: list[RealFrame]) -> None:
    assert len(frames) >= 13
    for frame in frames:
        assert kinds(signs_of(frame)) == [], frame.name


def test_their_signs_leave_a_margin_to_every_bound(frames: list[RealFrame]) -> None:
    measured = [signs_of(frame) for frame in frames]

    def all_of(name: str) -> list[float]:
        return [signs[name] for signs in measured if name in signs]

    assert min(all_of("swapped_roughness")) > 100 * rules.SWAPPED_ROUGHNESS
    assert max(all_of("multiples_of_8")) < 0.2
    assert min(all_of("largest_raw")) > 50 * rules.EIGHT_BITS
    assert max(all_of("row_correlation")) < -0.45
    assert min(all_of("with_neighbours")) > 0.98
    assert max(all_of("beyond_range")) < 0.04 < rules.BEYOND_RANGE / 2
    heights = all_of("camera_height_m")
    assert len(heights) >= 11
    assert 0.45 < min(heights)
    assert max(heights) < 2.1
    assert 40 < min(all_of("view_deg"))
    assert max(all_of("view_deg")) < 90


def test_their_bytes_swapped_they_are_refused(frames: list[RealFrame]) -> None:
    raws = [frame.raw for frame in frames if frame.raw is not None]
    assert len(raws) >= 6
    for raw in raws:
        signs = raw_signs(raw.byteswap())
        assert signs["swapped_roughness"] < CERTAINLY_SWAPPED / 20
        with pytest.raises(DecodeError, match="byte_order"):
            check_byte_order(signs, "")


def test_the_largest_value_of_kittis_own_depth_is_told_where_nothing_is_said_of_it(
    frames: list[RealFrame],
) -> None:
    raws = {frame.name: frame.raw for frame in frames if frame.raw is not None}
    told = {name for name, raw in raws.items() if "saturated" in kinds(raw_signs(raw))}
    assert told == {"testing/um_000000", "training/uu_000000"}


def test_bits_rotated_by_3_and_8_bits_are_told(frames: list[RealFrame]) -> None:
    # SUN RGB-D's sensors see less far than 8.192 m, where the highest bits would come in below.
    near = [f.raw % 8192 for f in frames if f.raw is not None]
    assert all(kinds(raw_signs(raw << 3)) == ["rotated-bits"] for raw in near)
    assert all("eight-bits" in kinds(raw_signs(raw >> 8)) for raw in near)


def test_disparity_read_as_depth_is_told_on_every_road(frames: list[RealFrame]) -> None:
    for frame in frames:
        depth = frame.depth_m
        nearness = np.divide(20, depth, out=np.zeros_like(depth), where=depth > 0)
        assert "grows-downwards" in kinds(signs_of(replace(frame, depth_m=nearness, raw=None)))


def test_a_camera_on_a_road_8_times_as_far_is_told_to_be_too_high(frames: list[RealFrame]) -> None:
    roads = [frame for frame in frames if "camera_height_m" in signs_of(frame)]
    for frame in roads:
        far = replace(frame, depth_m=frame.depth_m * np.float32(8))
        assert "camera-height" in kinds(signs_of(far)), frame.name


def test_a_scan_as_measured_lacks_neighbours(reference_data: Path) -> None:
    frame = kitti_scan(reference_data)
    assert kinds(signs_of(frame)) == ["sparse"]
    assert signs_of(frame)["with_neighbours"] < 0.01


def test_rendered_objects_do_not_grow_downwards_enough(reference_data: Path) -> None:
    for frame in rendered_depth(reference_data):
        assert signs_of(frame)["row_correlation"] < 0.25 < rules.ROW_CORRELATION
        assert set(kinds(signs_of(frame))) <= {"beyond-range"}
