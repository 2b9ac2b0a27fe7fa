"""Case 22: colour and thermal in one PNG of four channels, as MFNet has them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

import nimprep
from nimprep.torch import StoreDataset


@pytest.mark.filterwarnings("ignore:.*no calibration")
def test_the_fourth_channel_is_thermal_and_colour_is_untouched(
    case: Callable[[str], Path], tmp_path: Path
) -> None:
    root = case("22-")
    document = json.loads((root / "d.json").read_text())
    document |= {
        "version": "1.1",
        "planes": {"thermal": {"files": "rgb/{id}.png", "channel": 3, "dtype": "uint8"}},
    }
    description = tmp_path / "d.json"
    description.write_text(json.dumps(document))
    store = nimprep.convert(root, tmp_path / "s.zarr", description=description)
    data = StoreDataset(store.path, None, "rgb+thermal", normalize="none")
    for number, frame in enumerate(store):
        four = cv2.imread(str(root / "rgb" / f"{number}.png"), cv2.IMREAD_UNCHANGED)
        assert four is not None
        assert np.array_equal(frame["rgb"], np.load(root / f"rgb_{number}.npy"))
        assert np.array_equal(frame["thermal"], four[..., 3])
        assert np.array_equal(data[number]["inputs"][3].numpy(), four[..., 3])
