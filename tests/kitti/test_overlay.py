"""Pictures of outcomes: their colours, both views, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nimprep.errors import ArrayError, DecodeError, LayoutError
from nimprep.kitti.images import GroundTruth
from nimprep.kitti.overlay import OverlayFolders, draw_overlay, write_overlays

from .scenes import HEIGHT, WIDTH, ground_truth, noise, read_png, write_calibration, write_png


def test_each_outcome_has_its_colour_over_the_darkened_photograph() -> None:
    image = np.full((1, 5, 3), 100, np.uint8)
    truth = GroundTruth(
        positive=np.array([[True, True, False, False, True]]),
        evaluated=np.array([[True, True, True, True, False]]),
    )
    confidence = np.array([[200, 100, 200, 100, 200]], np.uint8)
    drawn = draw_overlay(image, confidence, truth)
    hit, miss, false_alarm, rejection, outside = drawn[0].tolist()
    assert hit == [50, 177, 50]
    assert miss == [177, 50, 50]
    assert false_alarm == [50, 50, 177]
    assert rejection == outside == [100, 100, 100]
    assert (image == 100).all()


def test_a_pixel_at_the_threshold_is_called_road() -> None:
    truth = GroundTruth(np.ones((1, 2), bool), np.ones((1, 2), bool))
    confidence = np.array([[132, 131]], np.uint8)
    drawn = draw_overlay(np.zeros((1, 2, 3), np.uint8), confidence, truth, 132 / 255)
    assert drawn[0].argmax(axis=1).tolist() == [1, 0]


def test_sizes_must_agree() -> None:
    truth = GroundTruth(np.ones((2, 2), bool), np.ones((2, 2), bool))
    with pytest.raises(ArrayError, match="confidence: expected the image's size"):
        draw_overlay(np.zeros((2, 2, 3), np.uint8), np.zeros((2, 3), np.uint8), truth)


@pytest.fixture
def folders(tmp_path: Path) -> OverlayFolders:
    road = np.zeros((HEIGHT, WIDTH), bool)
    road[30:, 40:80] = True
    write_png(tmp_path / "pred" / "um_road_000000.png", np.where(road, 255, 0).astype(np.uint8))
    write_png(tmp_path / "gt" / "um_road_000000.png", ground_truth(road))
    write_png(tmp_path / "img" / "um_000000.png", np.full((HEIGHT, WIDTH, 3), 90, np.uint8))
    write_calibration(tmp_path / "calib" / "um_000000.txt")
    return OverlayFolders(tmp_path / "pred", tmp_path / "gt", tmp_path / "img", tmp_path / "calib")


def test_a_perfect_prediction_is_green_where_the_road_is(
    folders: OverlayFolders, tmp_path: Path
) -> None:
    (written,) = write_overlays(folders, tmp_path / "out")
    assert written == tmp_path / "out" / "um_road_000000.png"
    drawn = read_png(written)
    assert drawn[40, 60].tolist() == [45, 45 + 127, 45]
    assert drawn[10, 10].tolist() == [90, 90, 90]


def test_pictures_come_in_the_birds_eye_view_too(folders: OverlayFolders, tmp_path: Path) -> None:
    (written,) = write_overlays(folders, tmp_path / "out", view="bev")
    drawn = read_png(written)
    assert drawn.shape == (800, 400, 3)
    assert drawn[760, 200].tolist() == [45, 172, 45]


def test_a_missing_truth_or_image_is_named(folders: OverlayFolders, tmp_path: Path) -> None:
    (folders.images / "um_000000.png").rename(folders.images / "um_000001.png")
    with pytest.raises(LayoutError, match=r"um_000000\.png: expected the image of um_road_000000"):
        write_overlays(folders, tmp_path / "out")
    truth = folders.ground_truth / "um_road_000000.png"
    truth.rename(truth.with_name("um_lane_000000.png"))
    with pytest.raises(LayoutError, match=r"found none for um_road_000000\.png"):
        write_overlays(folders, tmp_path / "out")


def test_a_photograph_of_another_size_is_refused(folders: OverlayFolders, tmp_path: Path) -> None:
    write_png(folders.images / "um_000000.png", noise(0, HEIGHT, WIDTH + 2, 3))
    with pytest.raises(DecodeError, match=r"expected 122x60 pixels like .*found 120x60"):
        write_overlays(OverlayFolders(*list(vars(folders).values())[:3]), tmp_path / "out")


def test_sources_are_never_drawn_into(folders: OverlayFolders) -> None:
    with pytest.raises(LayoutError, match="sources are never written to"):
        write_overlays(folders, folders.images)
