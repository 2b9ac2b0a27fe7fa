"""What a network with NIM in it refuses, each in one line."""

from pathlib import Path
from typing import Any

import pytest
import torch

from nimprep.errors import ArrayError
from nimprep.networks import NimNetwork, build_network
from tests.networks.frames import made, taken

WRONG: list[tuple[dict[str, Any], str]] = [
    ({"rgb": None}, "rgb: expected it for setup 'nim-rgb\\+d', found none"),
    ({"depth_m": None}, "depth_m: expected it"),
    ({"intrinsics": None}, "intrinsics: expected it"),
    ({"rgb": torch.full((2, 3, 64, 80), 200.0)}, "floats from 200 to 200"),
    ({"rgb": torch.zeros(2, 3, 64, 80, dtype=torch.int32)}, "or floats from 0 to 1, found"),
    ({"rgb": torch.zeros(2, 64, 80, 3)}, "rgb: expected \\(B, 3, H, W\\)"),
    ({"rgb": torch.zeros(2, 3, 64, 64)}, "one batch and size, found rgb \\(2, 64, 64\\)"),
    ({"depth_m": torch.full((2, 64, 80), 2000.0)}, "expected metres, .* found 2000"),
    ({"depth_m": torch.full((2, 64, 80), 0.002)}, "expected metres, .* found 0.002"),
    ({"depth_m": torch.full((2, 64, 80), -1.0)}, "expected metres >= 0, found 10240 negative"),
    ({"depth_m": torch.ones(2, 64, 80, dtype=torch.int16)}, "floating-point metres"),
    ({"depth_m": torch.ones(64, 80)}, "depth_m: expected \\(B, 1, H, W\\)"),
    ({"intrinsics": torch.ones(3, 3)}, "expected \\[\\[fx, 0, cx\\]"),
    ({"intrinsics": torch.eye(4)}, "intrinsics: expected floating \\(B, 3, 3\\)"),
    ({"canny": torch.zeros(2, 1, 64, 80)}, "MFNet takes no edges"),
]


@pytest.mark.parametrize(("changed", "said"), WRONG)
def test_what_cannot_be_right_is_one_line(changed: Any, said: str, path: Path) -> None:
    model = NimNetwork(made("mfnet", "nim-rgb+d", True), "nim-rgb+d").eval()
    with pytest.raises(ArrayError, match=said):
        model(**{**taken(path), **changed})


def test_pixels_without_depth_may_be_infinite(path: Path) -> None:
    model = NimNetwork(made("unet", "nim-depth"), "nim-depth").eval()
    given = taken(path)
    odd = torch.where(given["depth_m"] == 0, torch.inf, given["depth_m"])
    odd[:, :40] = torch.inf
    none = torch.where(torch.isfinite(odd), odd, 0)
    assert torch.equal(
        model.inputs(depth_m=odd, intrinsics=given["intrinsics"])[0],
        model.inputs(depth_m=none, intrinsics=given["intrinsics"])[0],
    )


@pytest.mark.parametrize(
    ("setup", "options", "said"),
    [
        ("disparity", {}, "setup: expected one of rgb, depth, .* found 'disparity'"),
        ("depth3", {}, "found 'depth3'"),
        ("rgb", {}, r"expected one of inputs=3 for 'rgb', found 6"),
        ("nim-rgb+d", {"method": "best"}, "method: expected one of"),
        ("nim-rgb+d", {"method": "nim-edge", "sign_filter": True}, "sign_filter"),
        ("nim-rgb+d", {"noise": 0.1}, "noise: expected None"),
        ("nim-rgb+d", {"normalize": "train"}, "normalize: .* give its scaling"),
        ("nim-rgb+d", {"hha_ground": "sky"}, "hha_ground: expected one of lowest, floor"),
        ("nim-rgb+d", {"normal_dtype": "int4"}, "normal_dtype: expected one of int8, int16"),
    ],
)
def test_a_setup_or_option_that_does_not_fit_is_one_line(
    setup: Any, options: Any, said: str
) -> None:
    network = build_network("unet", 6, 3, width=0.125)
    with pytest.raises(ArrayError, match=said):
        NimNetwork(network, setup, **options)
    with pytest.raises(ArrayError, match="expected one that build_network made, found Conv2d"):
        NimNetwork(torch.nn.Conv2d(6, 3, 1), setup)  # type: ignore[arg-type]
