"""Signs in raw values: swapped bytes, rotated bits, eight bits, names."""

from __future__ import annotations

import numpy as np
import pytest

from nimprep.doubts.raw import CERTAINLY_SWAPPED, check_byte_order, raw_signs
from nimprep.errors import DecodeError
from tests.doubts.streets import rough_street


def test_right_values_are_far_rougher_with_their_bytes_swapped() -> None:
    signs = raw_signs(rough_street())
    assert signs["swapped_roughness"] > 8
    check_byte_order(signs, "depth/0.png")


def test_swapped_values_are_refused_and_named() -> None:
    right = rough_street()
    signs = raw_signs(right.byteswap())
    expected = 1 / raw_signs(right)["swapped_roughness"]
    assert signs["swapped_roughness"] == pytest.approx(expected)
    assert expected < CERTAINLY_SWAPPED
    with pytest.raises(DecodeError, match=r'^depth/0.png: .*"byte_order": "swapped".*file anew$'):
        check_byte_order(signs, "depth/0.png")


def test_the_machine_order_of_the_array_does_not_matter() -> None:
    right = rough_street()
    assert raw_signs(right.astype(">u2")) == raw_signs(right) == raw_signs(right.astype("<u2"))


def test_swapped_lidar_is_refused_though_no_two_of_its_pixels_touch() -> None:
    raw = np.zeros_like(rough_street())
    raw[40::3, ::4] = rough_street()[40::3, ::4]
    assert raw_signs(raw)["swapped_roughness"] > 8
    with pytest.raises(DecodeError, match="byte_order"):
        check_byte_order(raw_signs(raw.byteswap()), "")


def test_noise_is_as_rough_one_way_as_the_other() -> None:
    noise = np.random.default_rng(0).integers(0, 65536, (96, 128), dtype=np.uint16)
    assert raw_signs(noise)["swapped_roughness"] == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize("step", [256, 257])
def test_eight_bits_stretched_to_sixteen_are_not_taken_for_swapped(step: int) -> None:
    check_byte_order(raw_signs(rough_street(25) * np.uint16(step)), "")


def test_the_share_of_multiples_of_8_is_an_eighth_and_all_where_bits_are_rotated() -> None:
    right = rough_street(500)
    assert right.max() < 8192
    rotated = (right << 3) | (right >> 13)
    assert raw_signs(right)["multiples_of_8"] == pytest.approx(1 / 8, abs=0.03)
    assert raw_signs(rotated)["multiples_of_8"] == 1


def test_the_largest_value_is_that_of_pixels_with_depth() -> None:
    raw = rough_street(20)
    raw[:30], raw[30:40], raw[40:42] = 65535, 40000, 50000
    signs = raw_signs(raw, invalid=[40000, (49000.0, None)])
    assert signs["largest_raw"] == raw[42:].max() <= 255


def test_values_are_not_measured_where_there_are_few_or_no_integers() -> None:
    few = np.zeros((96, 128), np.uint16)
    few[:3, :100] = 8
    for raw in (few, np.full((96, 128), 8.0, np.float32), np.full((1, 1), 8, np.uint16)):
        assert raw_signs(raw) == {"disparity_name": 0}


def test_one_flat_wall_is_no_sign_of_swapped_bytes() -> None:
    assert "swapped_roughness" not in raw_signs(np.full((96, 128), 1500, np.uint16))


@pytest.mark.parametrize(
    ("name", "disparity"),
    [
        ("disparity/aachen/0_disparity.png", 1),
        ("disp_occ_0/000000_10.png", 1),
        ("left/0001_disp.png", 1),
        ("Disp0GT.pfm", 1),
        ("depth/0.png", 0),
        ("display/depth/0.png", 0),
        ("dispatch_7.png", 0),
    ],
)
def test_names_that_say_disparity_are_told(name: str, disparity: int) -> None:
    assert raw_signs(rough_street(), name=name)["disparity_name"] == disparity


def test_swapped_signed_numbers_are_refused_though_half_of_them_are_negative() -> None:
    right = rough_street(500).astype(np.int16)
    assert right.min() >= 0
    check_byte_order(raw_signs(right), "")
    with pytest.raises(DecodeError, match="byte_order"):
        check_byte_order(raw_signs(right.byteswap()), "")


@pytest.mark.parametrize("dtype", ["u2", "i2", "u4", "i4"])
def test_the_share_of_the_largest_value_of_a_type_is_measured_unless_it_means_none(
    dtype: str,
) -> None:
    raw = rough_street(500).astype(dtype)
    assert raw_signs(raw)["at_most_raw"] == 0
    most = np.iinfo(dtype).max
    raw[:, ::4] = most
    assert raw_signs(raw)["at_most_raw"] == pytest.approx(0.25, abs=0.05)
    assert raw_signs(raw)["largest_raw"] < most
    assert raw_signs(raw, [most])["at_most_raw"] == 0


def test_an_image_that_has_8_bits_is_none_kept_in_16() -> None:
    assert raw_signs(np.full((50, 50), 100, np.uint8)).keys() == {"disparity_name"}
