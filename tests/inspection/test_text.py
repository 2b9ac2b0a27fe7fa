"""What inspect prints for people."""

from __future__ import annotations

from pathlib import Path

from click.testing import CliRunner

from nimprep.cli import main
from nimprep.inspection.inspection import inspect_source
from nimprep.inspection.wording import inspection_text
from tests.inspection import scenes


def test_one_screen_says_patterns_depth_evidence_and_what_to_do(tmp_path: Path) -> None:
    scenes.replica(tmp_path)
    text = CliRunner().invoke(main, ["inspect", str(tmp_path)]).output
    assert len(text.splitlines()) < 40
    for part in (
        "room0/results/depth{id}.png",
        "likely 1/6553.5 m",
        "cam_params.json states 6553.5",
        "by the camera file",
        "is a guess",
        "--write FILE.json",
    ):
        assert part in text


def test_an_encoding_that_values_cannot_tell_is_perhaps_one_and_another_is_named(
    tmp_path: Path,
) -> None:
    scenes.nameless(tmp_path)
    text = inspection_text(inspect_source(tmp_path).to_dict())
    assert "perhaps 1/256 m" in text
    assert "else millimetres" in text


def test_pictures_of_depth_are_said_to_be_none(tmp_path: Path) -> None:
    for k in range(3):
        color, depth = scenes.street(k)
        scenes.save(tmp_path / f"RGB/{k}.jpg", color)
        scenes.save(tmp_path / f"Depth/{k}.png", (255 * depth / depth.max()).astype("uint8"))
    text = inspection_text(inspect_source(tmp_path).to_dict())
    assert "depth: only pictures of it, whose values are no metres; use the raw depth" in text


def test_names_that_would_steer_a_terminal_are_written_out(tmp_path: Path) -> None:
    scenes.icl_nuim(tmp_path)
    scenes.save(tmp_path / "rgb\x1b[31m/0.png", scenes.street(0)[0])
    text = CliRunner().invoke(main, ["inspect", str(tmp_path)]).output
    assert "\x1b" not in text
    assert "rgb\\x1b[31m" in text
