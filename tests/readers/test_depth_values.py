"""Depth of every kind of number against what it was made of."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nimprep.errors import CameraError, DecodeError, OptionError
from nimprep.readers.cameras import GivenCamera, nominal_camera
from nimprep.readers.depth_values import (
    check_scale_option,
    checked_raw_signs,
    depth_image,
    raw_depth,
)
from nimprep.readers.description import DepthSource, PlaneSource
from nimprep.readers.distortion import Distortion
from nimprep.readers.matching import Place
from tests.fakes import write_png

H, W = 24, 32
FX, FY, CX, CY, BASELINE_M = 40.0, 50.0, 15.5, 11.0, 0.5
CAMERA = GivenCamera("file", "camera.json", (FX, FY, CX, CY), None, BASELINE_M)
V, U = np.mgrid[:H, :W].astype(np.float64)
DEPTH_M = 2 + 0.05 * V + 0.01 * U


def read(array: Any, tmp_path: Path, camera: GivenCamera = CAMERA, **described: Any) -> np.ndarray:
    """Return the depth of an array, as a .npy file that is described so."""
    path = tmp_path / "a.npy"
    np.save(path, array)
    options = {n: described.pop(n) for n in ("scale_m", "confidence_file") if n in described}
    place, source = Place(path), DepthSource(files="a.npy", **{"scale": 1.0, **described})
    extra = {"confidence": Place(options.pop("confidence_file"))} if len(options) else {}
    return depth_image(place, source, raw_depth(place, source), camera, **extra, **options)


@pytest.mark.parametrize("dtype", ["u2", "i2", "u4", "i4", "i8", "u8", "f2", "f4", "f8"])
def test_millimetres_of_any_type_become_the_nearest_float32(tmp_path: Path, dtype: str) -> None:
    raw = np.rint(DEPTH_M * 100).astype(dtype)
    found = read(raw, tmp_path, scale=0.001)
    assert found.dtype == np.float32
    assert np.array_equal(found, (raw.astype(np.float64) / 1000).astype(np.float32))


@pytest.mark.parametrize("scale", [1000 / (2**24 - 1), 0.0007, 1 / 65536, 1 / 5000, 2.0])
def test_a_scale_that_is_no_whole_number_s_inverse_is_exact_too(
    tmp_path: Path, scale: float
) -> None:
    raw = np.rint(DEPTH_M / scale).astype(np.uint32)
    wanted = (raw * np.float64(scale)).astype(np.float32)
    assert np.allclose(read(raw, tmp_path, scale=scale), wanted, rtol=1e-7, atol=0)


def test_an_offset_is_added_after_scaling_and_0_stays_none(tmp_path: Path) -> None:
    raw = np.rint((DEPTH_M - 0.25) * 1000).astype(np.uint16)
    raw[0] = 0
    found = read(raw, tmp_path, scale=0.001, offset=0.25)
    assert not found[0].any()
    assert np.abs(found[1:] - DEPTH_M[1:]).max() <= 0.00051


def test_disparity_becomes_depth_and_what_is_not_positive_none(tmp_path: Path) -> None:
    disparity = FX * BASELINE_M / DEPTH_M
    disparity[0], disparity[1], disparity[2] = -1, np.inf, np.nan
    found = read(disparity, tmp_path, values="disparity")
    assert not found[:3].any()
    assert np.allclose(found[3:], DEPTH_M[3:], rtol=1e-6)
    cityscapes = np.rint(disparity[3:] * 256 + 1).astype(np.uint16)
    cityscapes[0], cityscapes[1] = 0, 1
    found = read(cityscapes, tmp_path, values="disparity", scale=1 / 256, offset=-1 / 256)
    assert not found[:2].any()
    assert np.abs(found[2:] / DEPTH_M[5:] - 1).max() < 0.5 / 256 / 5


def test_disparity_is_of_the_image_s_own_camera(tmp_path: Path) -> None:
    whole = GivenCamera("file", "c.json", (FX, FY, CX, CY), (2 * H, 2 * W), BASELINE_M)
    disparity = FX * BASELINE_M / DEPTH_M
    with pytest.raises(CameraError, match=r"c\.json: expected a camera of .*32x24"):
        read(disparity, tmp_path, whole, values="disparity")
    given = {"fx": FX / 2, "baseline_m": 2 * BASELINE_M}
    found = read(disparity, tmp_path, whole, values="disparity", **given)
    assert np.allclose(found, DEPTH_M, rtol=1e-6)


def test_disparity_without_a_baseline_or_focal_length_is_refused(tmp_path: Path) -> None:
    bare = GivenCamera("file", "camera.json", (FX, FY, CX, CY))
    disparity = FX * BASELINE_M / DEPTH_M
    with pytest.raises(CameraError, match=r"found none; give it as 'baseline_m'"):
        read(disparity, tmp_path, bare, values="disparity")
    with pytest.raises(CameraError, match=r"expected a calibrated camera for disparity.*its fx"):
        read(disparity, tmp_path, nominal_camera(), values="disparity", baseline_m=0.5)
    found = read(disparity, tmp_path, nominal_camera(), values="disparity", baseline_m=0.5, fx=FX)
    assert np.allclose(found, DEPTH_M, rtol=1e-6)


def test_disparity_may_have_8_bits_and_depth_may_not(tmp_path: Path) -> None:
    disparity = np.rint(FX * BASELINE_M / DEPTH_M * 10).astype(np.uint8)
    found = read(disparity, tmp_path, values="disparity", scale=0.1)
    assert np.allclose(found, FX * BASELINE_M / (disparity / 10.0), rtol=1e-6)
    for values in ("depth", "distance"):
        with pytest.raises(DecodeError, match="found 8-bit; 8-bit depth images are for looking"):
            read(disparity, tmp_path, values=values)


def test_inverse_depth_is_turned_over(tmp_path: Path) -> None:
    raw = np.rint(10_000 / DEPTH_M).astype(np.uint16)
    raw[0] = 0
    found = read(raw, tmp_path, values="inverse", scale=1e-4)
    assert not found[0].any()
    assert np.allclose(found[1:], 1e4 / raw[1:], rtol=1e-6)
    with pytest.raises(DecodeError, match="negative"):
        read(-1 / DEPTH_M, tmp_path, values="inverse")


def test_distance_along_the_ray_becomes_depth(tmp_path: Path) -> None:
    distance = DEPTH_M * np.sqrt(1 + ((U - CX) / FX) ** 2 + ((V - CY) / FY) ** 2)
    assert distance.max() / DEPTH_M.max() > 1.05
    found = read(distance, tmp_path, values="distance")
    assert np.allclose(found, DEPTH_M, rtol=1e-6)
    with pytest.raises(CameraError, match="expected a calibrated camera for distance"):
        read(distance, tmp_path, nominal_camera(), values="distance")


def test_rays_are_reckoned_once_for_frames_of_one_camera() -> None:
    lens = Distortion("brown", (0.1, 0.0, 0.0, 0.0))
    for camera in (CAMERA, replace(CAMERA, distortion=lens)):
        lengths = camera.ray_lengths(H, W, "0")
        assert camera.ray_lengths(H, W, "1") is lengths
        with pytest.raises(ValueError, match="read-only"):
            lengths[0] = 1
    assert not np.array_equal(CAMERA.ray_lengths(H, W, "0"), lengths)
    other = replace(CAMERA, intrinsics=(FX, FY, CX + 1, CY))
    assert np.allclose(other.ray_lengths(H, W, "0")[:, 1:], CAMERA.ray_lengths(H, W, "0")[:, :-1])


def test_invalid_numbers_and_ranges_are_of_raw_values(tmp_path: Path) -> None:
    raw = np.rint(DEPTH_M * 1000).astype(np.uint16)
    raw[0], raw[1], raw[2], raw[3], raw[4] = 65535, 10, 60_000, 60_010, 20
    invalid = (65535, (None, 20.0), (60_000.0, 60_005.0))
    found = read(raw, tmp_path, scale=0.001, invalid=invalid)
    assert not found[[0, 1, 2, 4]].any()
    assert (found[3] == np.float32(60.01)).all()
    assert (found[5:] > 0).all()
    found = read(raw, tmp_path, scale=0.001, invalid=((60_000.0, None),))
    assert not found[[0, 2, 3]].any()


def test_depth_outside_a_range_is_none_and_beyond_the_clip_is_cut(tmp_path: Path) -> None:
    depth = DEPTH_M.copy()
    depth[0, 0], depth[0, 1] = np.inf, 0
    found = read(depth, tmp_path, range_m=(2.5, 3.0))
    inside = (depth >= 2.5) & (depth <= 3.0)
    assert np.array_equal(found > 0, inside)
    clipped = read(depth, tmp_path, clip_m=3.0)
    assert clipped[0, 0] == clipped[0, 1] == 0
    assert np.allclose(clipped[1:], np.minimum(depth[1:], 3), rtol=1e-6)


def test_depth_that_is_all_beyond_the_clip_is_refused(tmp_path: Path) -> None:
    read(DEPTH_M, tmp_path, clip_m=DEPTH_M.min() + 0.001)
    with pytest.raises(DecodeError, match=r"than 'clip_m' of 8 m, found 20 m and more at 10 m"):
        read(DEPTH_M, tmp_path, scale=10.0, clip_m=8.0)
    with pytest.raises(DecodeError, match=r"'clip_m' of 1 m, found 2 m and more at 1 m per unit"):
        read(DEPTH_M, tmp_path, clip_m=1.0)


def test_what_is_negative_lies_outside_a_range(tmp_path: Path) -> None:
    depth = DEPTH_M.copy()
    depth[0], depth[1] = -9999, 1e6
    for least in (0, 0.3):
        found = read(depth, tmp_path, range_m=(least, 100))
        assert not found[:2].any()
        assert (found[2:] > 0).all()
    with pytest.raises(DecodeError, match="expected metres >= 0"):
        read(depth, tmp_path, range_m=(None, 100))


@pytest.mark.parametrize("dtype", ["f2", "f4", "f8", "u2", "u4"])
def test_invalid_values_may_be_beyond_what_the_type_holds(tmp_path: Path, dtype: str) -> None:
    raw = np.rint(DEPTH_M * 10).astype(dtype)
    raw[0] = 60_000
    invalid = (1e6, 10**38, -1e38, (50_000, 3e38), (10**38, None), (None, -(10**38)))
    found = read(raw, tmp_path, scale=0.1, invalid=invalid)
    assert not found[0].any()
    assert (found[1:] > 0).all()


def test_signs_of_metres_are_none_of_disparity(tmp_path: Path) -> None:
    raw = np.full((40, 40), 65535, np.uint16)
    raw[:, ::2] = 16 * (1 + np.arange(40))[:, None]
    place = Place(tmp_path / "a.png")

    def kinds(**described: Any) -> set[str]:
        source = DepthSource(files="a.png", **described)
        return set(checked_raw_signs(raw, place, source, tmp_path))

    of_metres = {"multiples_of_8", "largest_raw", "at_most_raw"}
    assert of_metres <= kinds()
    assert not of_metres & kinds(values="disparity", scale=1 / 256, offset=0.0)
    # What a range or a clip makes of the largest value has been said.
    for said in ({"range_m": (None, 65)}, {"clip_m": 8.0}):
        assert "at_most_raw" not in kinds(**said)
        assert "at_most_raw" in kinds(**said, scale=0.0001)


def test_rotated_bits_are_turned_back_in_either_16_bit_type(tmp_path: Path) -> None:
    raw = (1000 + 2000 * np.arange(H * W).reshape(H, W) % 64_000).astype(np.uint16)
    rotated = (raw << np.uint16(3)) | (raw >> np.uint16(13))
    for stored in (rotated, rotated.view(np.int16)):
        found = read(stored, tmp_path, scale=0.001, rotate_right=3)
        assert np.array_equal(found, raw / np.float32(1000))
    with pytest.raises(DecodeError, match="expected 16-bit numbers to rotate by 3 bits"):
        read(raw.astype(np.uint32), tmp_path, scale=0.001, rotate_right=3)


def test_bytes_of_channels_make_whole_numbers_or_floats(tmp_path: Path) -> None:
    single = DEPTH_M.astype("<f4")
    rgba = single.view(np.uint8).reshape(H, W, 4)
    assert np.array_equal(read(rgba, tmp_path, bytes="RGBA", bytes_as="float32"), single)
    turned = np.ascontiguousarray(rgba[:, :, ::-1])
    assert np.array_equal(read(turned, tmp_path, bytes="ABGR", bytes_as="float32"), single)
    number = np.rint(DEPTH_M * 1e6).astype("<u4")
    three = number.view(np.uint8).reshape(H, W, 4)[:, :, :3]
    found = read(three, tmp_path, bytes="RGB", scale=1e-6)
    assert np.array_equal(found, (number / 1e6).astype(np.float32))
    with pytest.raises(DecodeError, match="expected channels RGBA of 8 bits, found 3 of uint8"):
        read(three, tmp_path, bytes="RGBA")
    with pytest.raises(DecodeError, match="expected channels RG of 8 bits, found 1 of uint16"):
        read(number.astype(np.uint16), tmp_path, bytes="RG")


def test_bytes_of_two_channels_the_wrong_way_round_are_refused(tmp_path: Path) -> None:
    raw = np.rint(np.tile(DEPTH_M, (2, 2)) * 1000).astype("<u2")
    image = np.dstack([raw.view(np.uint8).reshape(2 * H, 2 * W, 2), np.zeros_like(raw, np.uint8)])
    np.save(tmp_path / "a.npy", image)
    place = Place(tmp_path / "a.npy")
    right = DepthSource(files="a.npy", bytes="RG")
    assert np.array_equal(raw_depth(place, right), raw)
    checked_raw_signs(raw_depth(place, right), place, right, tmp_path)
    wrong = replace(right, bytes="GR")
    with pytest.raises(DecodeError, match='swapped; turn "bytes" around in the description'):
        checked_raw_signs(raw_depth(place, wrong), place, wrong, tmp_path)
    far = {"bytes": "BGR", "scale": 1000 / (2**24 - 1)}
    with pytest.raises(DecodeError, match=r"median depth .*; turn 'bytes' around in the desc"):
        read(image, tmp_path, **far)


def test_a_png_s_bytes_are_taken_by_its_channels_names(tmp_path: Path) -> None:
    number = np.rint(DEPTH_M * 1000).astype(np.uint32)
    image = np.dstack([number & 255, number >> 8, 0 * number]).astype(np.uint8)
    write_png(tmp_path / "a.png", image)
    place = Place(tmp_path / "a.png")
    source = DepthSource(files="a.png", bytes="RG", scale=0.001)
    assert np.array_equal(raw_depth(place, source), number)


def test_one_channel_of_several_is_depth(tmp_path: Path) -> None:
    raw = np.rint(DEPTH_M * 1000).astype(np.uint16)
    three = np.dstack([raw, raw, raw])
    assert np.array_equal(read(three, tmp_path, scale=0.001), raw / np.float32(1000))
    with_alpha = np.dstack([three, np.full_like(raw, 65535)])
    assert np.array_equal(read(with_alpha, tmp_path, scale=0.001), raw / np.float32(1000))
    three[5, 5, 1] += 1
    with pytest.raises(DecodeError, match=r"3 channels of uint16 that differ; .* 'channel'"):
        read(three, tmp_path, scale=0.001)
    green = read(three, tmp_path, scale=0.001, channel="G")
    assert np.array_equal(green, three[:, :, 1] / np.float32(1000))


@pytest.mark.parametrize("least", [1.0, 0.5])
def test_depth_is_none_where_its_confidence_is_too_low(tmp_path: Path, least: float) -> None:
    sure = np.linspace(0, 2, H * W, dtype=np.float32).reshape(H, W)
    sure[0, 0] = np.nan
    np.save(tmp_path / "sure.npy", sure)
    described = {
        "confidence": PlaneSource(files="sure.npy"),
        "confidence_file": tmp_path / "sure.npy",
        "least_confidence": least,
    }
    found = read(DEPTH_M, tmp_path, **described)
    assert np.array_equal(found > 0, sure >= least)
    np.save(tmp_path / "sure.npy", sure[:, :5])
    with pytest.raises(DecodeError, match=r"expected a confidence of depth's shape \(24, 32\)"):
        read(DEPTH_M, tmp_path, **described)


def test_whole_numbers_beyond_any_depth_are_refused(tmp_path: Path) -> None:
    raw = np.rint(DEPTH_M * 1000).astype(np.int64)
    raw[0, 0] = 1 << 40
    with pytest.raises(DecodeError, match="expected raw depth of at most 4294967296, found 1099"):
        read(raw, tmp_path, scale=0.001)
    raw[0, 0] = -1
    with pytest.raises(DecodeError, match="negative"):
        read(raw, tmp_path, scale=0.001)
    assert read(raw, tmp_path, scale=0.001, invalid=(-1,))[0, 0] == 0


def test_metres_per_unit_are_no_disparity_s(tmp_path: Path) -> None:
    source = DepthSource(files="a.npy", values="disparity")
    with pytest.raises(OptionError, match="--depth-scale: expected depth in metres per unit"):
        check_scale_option(0.001, source)
    check_scale_option(None, source)
    check_scale_option(0.001, DepthSource(files="a.npy"))
