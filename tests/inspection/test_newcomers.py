"""What somebody new to a folder could misread: numbers without a unit, images left out."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from nimprep.cli import main
from nimprep.inspection.encodings import Clues, disparities_of, encodings_of
from nimprep.inspection.inspection import inspect_source
from nimprep.inspection.wording import inspection_text
from tests.fakes import write_gmrp, write_png


def photograph(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (64, 96, 3), dtype=np.uint8)


def ramp(seed: int) -> np.ndarray:
    """Return nearness of a ground, 0 at the top to 1 at the bottom."""
    rows = np.linspace(0, 1, 64)[:, None] ** (1 + 0.1 * seed)
    return np.broadcast_to(rows, (64, 96))


def stretched(seed: int) -> np.ndarray:
    return np.asarray(ramp(seed) * 65535).round().astype(np.uint16)


def test_relative_depth_stretched_in_every_image_is_never_called_likely(tmp_path: Path) -> None:
    for number in range(3):
        color = photograph(number)
        write_png(tmp_path / "raw" / "image" / f"{number}.png", color)
        write_png(tmp_path / "raw" / "midas" / f"{number}.png", stretched(number))
    text = inspection_text(inspect_source(tmp_path / "raw").to_dict())
    assert "if each was stretched, as relative depth is, no scale makes metres of it" in text
    assert "perhaps" in text
    assert "likely" not in text


@pytest.mark.parametrize("encodings", [encodings_of, disparities_of])
def test_one_image_at_full_scale_is_not_called_stretched(encodings: object) -> None:
    planes = [stretched(0), (ramp(1) * 60000).astype(np.uint16)]
    found = encodings(planes, Clues())  # type: ignore[operator]
    assert not any("stretched" in reason for each in found for reason in each.reasons)


def test_every_encoding_that_is_nearly_as_likely_is_said(tmp_path: Path) -> None:
    for number in range(3):
        color = photograph(number)
        room = 2.2 + 0.8 * np.sin(np.arange(96) / 20 + number) + np.zeros((64, 96))
        write_png(tmp_path / "raw" / "a" / f"{number}.png", color)
        write_png(tmp_path / "raw" / "b" / f"{number}.png", (room * 10000).astype(np.uint16))
    text = inspection_text(inspect_source(tmp_path / "raw").to_dict())
    assert "perhaps" in text
    assert "1/10000 m: 1.4 to 3 m" in text


@pytest.mark.parametrize("second", [0, 1])
def test_labels_of_three_16_bit_channels_are_labels(tmp_path: Path, second: int) -> None:
    for number in range(3):
        color = photograph(number)
        label = np.zeros((64, 96, 3), np.uint16)
        label[30:, :, 0] = 3
        label[40:50, 20:40, 1] = second
        write_png(tmp_path / "raw" / "RGB" / f"{number}.png", color)
        write_png(tmp_path / "raw" / "GT" / "LABELS" / f"{number}.png", label)
    found = inspect_source(tmp_path / "raw")
    assert found.description is not None
    assert found.description["label"] == {"files": "GT/LABELS/{id}.png", "channel": "R"}


def test_colour_images_that_make_no_frame_are_counted(tmp_path: Path) -> None:
    for number in range(3):
        color = photograph(number)
        depth = (1000 * (2 + ramp(number)[::-1])).astype(np.uint16)
        for time in ("10", "11"):
            write_png(tmp_path / "raw" / "image_2" / f"{number:06d}_{time}.png", color)
        write_png(tmp_path / "raw" / "depth" / f"{number:06d}_10.png", depth)
    found = inspect_source(tmp_path / "raw")
    assert "the description gives 3 frames, 3 of 6 colour images are in none of them" in found.notes


def test_a_folder_that_needs_no_description_says_so(tmp_path: Path) -> None:
    raw = write_gmrp(tmp_path / "gmrp")
    done = CliRunner().invoke(main, ["inspect", str(raw), "--write", str(tmp_path / "d.json")])
    assert done.exit_code == 1
    assert f"nimprep convert {raw} OUT.zarr reads it as it is" in done.stderr
    assert not (tmp_path / "d.json").exists()


def test_one_file_is_said_to_be_one(tmp_path: Path) -> None:
    raw = write_gmrp(tmp_path / "gmrp")
    (raw / "camera.json").write_text('{"fx": 30, "fy": 30, "cx": 16, "cy": 12}')
    image, camera = (inspect_source(raw / name) for name in ("rgb/000000.png", "camera.json"))
    assert image.what == "an image (1 colour)"
    assert camera.what == "a file that is no image"
    assert image.next_steps == [f"nimprep inspect {raw / 'rgb'} looks at all of them"]
    assert "1 file\n" in inspection_text(image.to_dict())


def test_a_description_that_is_written_has_a_class_in_a_line(tmp_path: Path) -> None:
    label = np.zeros((64, 96), np.uint8)
    label[30:] = 7
    for number in range(3):
        write_png(tmp_path / "raw" / "images" / f"{number}.png", photograph(number))
        write_png(tmp_path / "raw" / "labels" / f"{number}.png", label)
    target = tmp_path / "d.json"
    done = CliRunner().invoke(main, ["inspect", str(tmp_path / "raw"), "--write", str(target)])
    assert done.exit_code == 0
    lines = target.read_text().splitlines()
    assert '    {"id": 0, "name": "class 0", "color": [0, 0, 0]},' in lines
    assert '  "label": {"files": "labels/{id}.png"},' in lines
    assert max(map(len, lines)) <= 101
    assert json.loads(target.read_text()) == inspect_source(tmp_path / "raw").description


def test_a_command_that_is_misspelt_is_asked_for() -> None:
    done = CliRunner().invoke(main, ["covert", "a", "b"])
    assert done.exit_code == 2
    assert "No such command 'covert'. Did you mean 'convert'?" in done.stderr
    assert "Did you mean" not in CliRunner().invoke(main, ["xyzzy"]).stderr


@pytest.mark.parametrize(
    ("name", "needs"),
    [("depth", "convert assumes a nominal one"), ("distance", "which distance needs")],
)
def test_a_camera_that_is_not_found_is_said(tmp_path: Path, name: str, needs: str) -> None:
    for number in range(3):
        write_png(tmp_path / "raw" / "rgb" / f"{number}.png", photograph(number))
        (tmp_path / "raw" / name).mkdir(exist_ok=True)
        metres = (2 + ramp(number)[::-1]).astype(np.float32)
        np.save(tmp_path / "raw" / name / f"{number}.npy", metres)
    notes = inspect_source(tmp_path / "raw").notes
    assert f"no camera found, {needs}; add 'camera', or give --intrinsics" in notes
