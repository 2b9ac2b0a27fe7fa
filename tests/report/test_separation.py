"""What tells the road from other classes: exact where a scene is, and right about what it is of."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from click.testing import CliRunner

import nimprep
from nimprep.cli import main
from nimprep.derive.recipe import Recipe
from nimprep.errors import ArrayError
from nimprep.frame import Frame, LabelClass
from nimprep.modality import MODALITIES
from nimprep.readers import open_reader
from nimprep.report import separation
from nimprep.report.collect import collect
from nimprep.report.features import numbers_of, sources
from nimprep.report.separation import (
    Row,
    Score,
    Separation,
    frame_areas,
    measure_separation,
    spread,
)
from nimprep.report.separation_table import advice, separation_table
from nimprep.report.store_page import write_report
from nimprep.splits import hash_order
from tests.derive.roads import CAMERA, ROADS, plane_of, road_depth

from .stores import HEIGHT, WIDTH, Folder

MEASURED = ("rgb", "depth", "label")
LOOKED = sources({name: MODALITIES[name] for name in MEASURED}, Recipe())


def road_frame() -> Frame:
    """Return a flat road with one upright board on it: 1 road, 2 board, 0 what is beyond."""
    depth = road_depth(plane_of(*ROADS["flat"]))
    label = np.where(depth > 0, 1, 0).astype(np.uint8)
    board = np.zeros(depth.shape, bool)
    board[60:120, 90:130] = True
    depth[board] = depth[120, 110]
    label[board] = 2
    rgb = np.zeros((*depth.shape, 3), np.uint8)
    rgb[label == 2] = (0, 30, 0)
    return Frame("a", CAMERA, rgb=rgb, depth_m=depth.astype(np.float32), label=label)


def areas_by_label(frame: Frame, *others: int) -> dict[str, dict[int, float]]:
    areas, _ = frame_areas(frame, LOOKED, 1, others)
    return {f"{LOOKED[n].label}: {name}": found for (n, name), found in areas.items()}


def test_what_stands_on_a_road_is_told_by_its_height_without_a_mistake() -> None:
    found = areas_by_label(road_frame(), 2)
    assert found["Elevation (fitted): "][2] == pytest.approx(0, abs=0.02)
    assert found["Elevation (fitted): size without sign"][2] == pytest.approx(0, abs=0.03)
    assert found["Colour: brightness"][2] == 0
    assert found["Normals (nim-edge): angle to the road's median"][2] < 0.05
    # Depth alone tells little: the road goes on at both sides of the board's distance.
    assert 0.1 < found["Depth: "][2] < 0.9
    assert found["Disparity: "][2] == pytest.approx(1 - found["Depth: "][2], abs=1e-6)


def test_ignored_pixels_and_holes_take_no_part() -> None:
    frame = road_frame()
    assert frame.label is not None
    assert frame.rgb is not None
    assert frame.depth_m is not None
    label, rgb, depth = frame.label.copy(), frame.rgb.copy(), frame.depth_m.copy()
    rgb[label == 1] = 200
    before = areas_by_label(replace(frame, rgb=rgb), 2)
    # Road that is ignored, or has no depth, is as dark as can be: brightness tells all the same.
    label[150:, :80], rgb[150:, :80] = 255, 0
    depth[150:, 160:], rgb[150:, 160:] = 0, 0
    found = areas_by_label(replace(frame, rgb=rgb, label=label, depth_m=depth), 2)
    assert before["Colour: brightness"] == found["Colour: brightness"] == {2: 1.0}
    # A class that has no depth anywhere has too few pixels.
    assert all(0 not in of for of in areas_by_label(frame, 0).values())


def test_a_normal_is_measured_by_its_angle_to_the_roads_own_direction() -> None:
    tilted = np.array([0, -np.cos(0.3), -np.sin(0.3)], np.float32)
    vectors = np.array([[0, -1, 0], [0, -1, 0], tilted, [0, 0, 0]], np.float32)
    road = np.array([True, True, False, True])
    angles = numbers_of(MODALITIES["normal"], vectors, road)["angle to the road's median"]
    np.testing.assert_allclose(angles[:3], [0, 0, np.degrees(0.3)], atol=0.03)
    assert np.isnan(angles[3])
    none = numbers_of(MODALITIES["normal"], vectors, np.array([False, False, False, True]))
    assert np.isnan(next(iter(none.values()))).all()


def test_numbers_of_each_kind_say_where_there_are_none() -> None:
    hha = np.array([[0, 0, 0], [9, 0, 7]], np.uint8)
    road = np.ones(2, bool)
    found = numbers_of(MODALITIES["hha"], hha, road)
    assert list(found) == list(MODALITIES["hha"].channels)
    assert np.isnan([v[0] for v in found.values()]).all()
    assert [float(v[1]) for v in found.values()] == [9, 0, 7]
    elevation = np.array([np.nan, -0.5], np.float32)
    raw, size = numbers_of(MODALITIES["elevation"], elevation, road).values()
    assert np.isnan([raw[0], size[0]]).all()
    assert (raw[1], size[1]) == (-0.5, 0.5)
    depth = numbers_of(MODALITIES["depth"], np.array([0, 3], np.float32), road)[""]
    assert np.isnan(depth[0])
    assert depth[1] == 3


def test_a_choice_that_makes_no_difference_is_one_row(folder: Folder) -> None:
    rows = {row.name: row for row in measured(folder.store()).rows}
    # These frames have no calibrated road, so that there is one road only.
    assert "Elevation: size without sign" in rows
    assert rows["Elevation"].options == ""
    assert not any("fitted" in name or "calibrated" in name for name in rows)
    # Of HHA the height depends on the ground, the disparity does not.
    assert rows["HHA: horizontal disparity"].stored


def test_without_a_calibrated_road_nothing_is_said_of_one() -> None:
    there = {name: MODALITIES[name] for name in ("depth", "elevation")}
    labels = [source.label for source in sources(there, Recipe(), calibrated=False)]
    assert labels.count("Elevation") == 1
    assert not any("fitted" in label or "calibrated" in label for label in labels)
    both = [source.label for source in sources(there, Recipe())]
    assert {"Elevation (calibrated)", "Elevation (fitted)"} <= set(both)


def test_a_method_that_only_chooses_among_others_is_no_source() -> None:
    made = {source.label for source in LOOKED if source.modality.name == "normal"}
    assert made == {"Normals (nim)", "Normals (nim-edge)"}


def test_pixels_are_spread_evenly_and_no_more_than_asked_for() -> None:
    every = np.arange(100_000)
    few = spread(every, 1000)
    assert np.array_equal(few, np.unique(few))
    assert 990 <= few.size <= 1000
    assert np.diff(few).max() < 300
    # In no step with rows of 1280 pixels: nearly every column occurs.
    assert np.unique(few % 1280).size > 500
    assert np.array_equal(spread(every[:50], 1000), every[:50])


def scene(height: int) -> npt.NDArray[np.uint8]:
    """Return a label: other above, road below, a cone of some rows on it."""
    label = np.zeros((HEIGHT, WIDTH), np.uint8)
    label[12:] = 1
    label[20 : 20 + height, :8] = 2
    return label


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    made = Folder(tmp_path / "raw")
    for split in ("train", "train", "train", "val", "test"):
        made.add(split, label=scene(4))
    return made


def measured(path: Path, road: str | None = None, **options: int) -> Separation:
    store = nimprep.open_store(path)
    return measure_separation(store, collect(store).classes, road, **options)


def test_a_stores_road_is_its_lowest_large_class_unless_it_is_named(folder: Folder) -> None:
    path = folder.store()
    found = measured(path)
    assert found.road is not None
    assert found.road.name == "road"
    assert [c.name for c in found.others] == ["other", "cone"]
    assert found.frames == 5
    named = measured(path, "cone")
    assert named.road is not None
    assert named.road.name == "cone"
    assert [c.name for c in named.others] == ["other", "road"]
    with pytest.raises(ArrayError, match="expected a class of other, road, cone, found 'raod'"):
        measured(path, "raod")


def test_rows_say_what_is_stored_and_how_to_have_the_rest(folder: Folder) -> None:
    found = measured(folder.store())
    stored = {row.name for row in found.rows if row.stored}
    assert {"Colour: brightness", "Depth", "Normals (nim): angle to the road's median"} <= stored
    assert "HHA (floor): height above ground" in stored
    assert not any(name.startswith(("Elevation", "Disparity")) for name in stored)
    made = {row.name: (row.added, row.options) for row in found.rows if not row.stored}
    edge = made.get("Normals (nim-edge): angle to the road's median")
    assert edge in (None, ("", "--normals nim-edge"))
    assert [row.rank for row in found.rows] == sorted((r.rank for r in found.rows), reverse=True)
    for row in found.rows:
        for score in row.scores:
            if score is not None:
                assert 0.5 <= score.auc <= 1
                assert score.low - 1e-12 <= score.auc <= score.high + 1e-12


def test_the_same_is_found_on_any_number_of_threads(folder: Folder) -> None:
    path = folder.store()
    assert measured(path, num_threads=1) == measured(path, num_threads=3)


def test_a_sample_of_a_large_store_has_frames_of_every_class(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(separation, "FRAMES", 4)
    folder = Folder(tmp_path / "raw")
    last = hash_order([f"a/{number:03d}" for number in range(12)])[-1]
    for number in range(12):
        name = f"a/{number:03d}"
        folder.add("train", name, label=scene(4 if name == last else 0))
    found = measured(folder.store())
    assert found.frames == 4
    cone = [c.name for c in found.others].index("cone")
    assert found.rows[0].scores[cone] is not None
    assert {row.scores[cone].frames for row in found.rows if row.scores[cone]} == {1}


def test_one_class_and_no_label_are_explained(tmp_path: Path) -> None:
    one, none = Folder(tmp_path / "one" / "raw"), Folder(tmp_path / "none" / "raw")
    for folder, value in ((one, 1), (none, 255)):
        for split in ("train", "val", "test"):
            folder.add(split, label=np.full((HEIGHT, WIDTH), value, np.uint8))
    assert "two classes" in measured(one.store()).reason
    found = measured(none.store())
    assert "No pixel of this store has a label" in found.reason
    assert separation_table(found)["rows"] == []
    assert advice(found) == []


def test_classes_beyond_the_columns_are_counted(
    folder: Folder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(separation, "COLUMNS", 1)
    found = measured(folder.store())
    assert [c.name for c in found.others] == ["other"]
    assert found.left_out == 1
    assert separation_table(found)["left_out"] == 1


def test_the_side_is_one_for_all_frames(tmp_path: Path) -> None:
    # Dark road under bright, then bright under dark: brightness tells nothing of both.
    folder = Folder(tmp_path / "raw")
    for number in range(4):
        rgb = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
        rgb[12:] = 200 if number % 2 else 0
        rgb[:12] = 100
        folder.add("train", rgb=rgb, label=scene(0))
    found = measured(folder.store())
    row = next(row for row in found.rows if row.name == "Colour: brightness")
    assert row.scores[0] is not None
    assert (row.scores[0].auc, row.scores[0].low, row.scores[0].high) == (0.5, 0, 1)


def test_elevation_tells_most_on_real_frames(reference_data: Path) -> None:
    """By its distance from the fitted road: anomalies lie above it and below."""
    [gmrp] = open_reader(reference_data / "gmrp").ids
    frame = open_reader(reference_data / "gmrp").read(gmrp, MEASURED)
    found = areas_by_label(frame, 0, 2)
    size = {c: 1 - area for c, area in found["Elevation (fitted): size without sign"].items()}
    assert size[2] == pytest.approx(0.957, abs=0.004)
    assert size[0] > 0.98
    assert size[2] > 1 - found["Elevation (fitted): "][2] + 0.01
    assert size[2] > max(found["Colour: brightness"][2], 1 - found["Colour: brightness"][2]) + 0.01
    reader = open_reader(reference_data / "kitti_road")
    for name, expected in (("training/um_000000", 0.925), ("training/umm_000000", 0.909)):
        found = areas_by_label(reader.read(name, MEASURED), 0)
        size = 1 - found["Elevation (fitted): size without sign"][0]
        assert size > expected - 0.006
        signed = 1 - found["Elevation (fitted): "][0]
        assert signed > 1 - found["Elevation (calibrated): "][0] + 0.02


def test_the_page_and_the_command_say_it(folder: Folder, tmp_path: Path) -> None:
    path, page = folder.store(), tmp_path / "page.html"
    done = CliRunner().invoke(main, ["report", str(path), str(page), "--quiet"])
    assert done.exit_code == 0
    assert "\nroad from other: " in f"\n{done.output}"
    html = page.read_text()
    assert "What tells road from the rest here" in html
    assert "Colour: brightness" in html
    assert "over 5 frames" in html
    again = [str(path), str(page), "--quiet", "--overwrite", "--road"]
    done = CliRunner().invoke(main, ["report", *again, "cone"])
    assert "\ncone from road: " in done.output
    done = CliRunner().invoke(main, ["report", *again, "street"])
    assert done.exit_code == 1
    assert "expected a class of other, road, cone, found 'street'" in done.output


def test_the_page_of_a_store_without_labels_says_why_there_is_no_table(tmp_path: Path) -> None:
    folder = Folder(tmp_path / "raw")
    folder.add("train", label=np.full((HEIGHT, WIDTH), 255, np.uint8))
    made = write_report(folder.store(), tmp_path / "page.html")
    assert made.separation.road is None
    assert "No pixel of this store has a label." in (tmp_path / "page.html").read_text()


def test_advice_names_the_options_that_store_what_tells_more() -> None:
    def row(name: str, area: float, stored: bool, added: str = "", options: str = "") -> Row:
        score = Score(area, True, area, area, 1)
        return Row(name, name, stored, added, options, (score,), 0.0)

    road, other = (LabelClass(i, name, (0, 0, 0)) for i, name in enumerate(("road", "other")))

    def said(*rows: Row) -> list[str]:
        return advice(Separation(road, (other,), 0, 1, rows, ("rgb", "depth")))

    stored = row("Depth", 0.7, True)
    assert said(stored) == ["road from other: Depth tells most, 0.700; the store has it."]
    assert said(row("Elevation", 0.9, False, "elevation"), stored) == [
        "road from other: Elevation tells most, 0.900; of what the store has Depth, 0.700. "
        "To have it: nimprep convert with --modalities rgb,depth,elevation"
    ]
    assert said(row("Elevation", 0.705, False, "elevation"), stored)[0].endswith(
        "and Depth, which the store has, no less: 0.700."
    )
    edge = row("Normals (nim-edge)", 0.9, False, "normal", "--normals nim-edge")
    assert said(edge, stored)[0].endswith("rgb,depth,normal --normals nim-edge")
