"""Each kind of doubt, planted once and found; and a store where nothing is found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nimprep
from nimprep.report.collect import collect
from nimprep.report.findings import Finding, checks, find
from nimprep.report.gallery import order_of_interest
from nimprep.splits import SplitRule
from nimprep.store.info import info_text, store_info
from nimprep.store.reader import Store
from tests.kitti.scenes import road_folder

from .stores import HEIGHT, WIDTH, Folder, gmrp_store, photograph


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    """Return four frames of train, two of val and two of test, with nothing wrong."""
    made = Folder(tmp_path / "raw")
    for split, number in (("train", 4), ("val", 2), ("test", 2)):
        for _ in range(number):
            made.add(split)
    return made


def found(folder: Folder) -> tuple[Store, dict[str, Finding]]:
    store = nimprep.open_store(folder.store())
    return store, {f.kind: f for f in find(store, collect(store))}


def numbers(store: Store, *ids: str) -> tuple[int, ...]:
    return tuple(sorted(store.ids.index(i) for i in ids))


def test_a_sound_store_has_no_findings(folder: Folder) -> None:
    store, findings = found(folder)
    assert findings == {}
    assert len(checks(store)) == 9


def test_frames_with_few_valid_pixels_are_found(folder: Folder) -> None:
    depth = np.zeros((HEIGHT, WIDTH), np.uint16)
    depth[:10] = 2000
    few = folder.add("train", depth_mm=depth)
    depth[:13] = 2000
    folder.add("train", depth_mm=depth)
    store, findings = found(folder)
    assert set(findings) == {"few-valid"}
    assert findings["few-valid"].frames == numbers(store, few)
    assert findings["few-valid"].severity == "problem"


def test_sparse_depth_is_no_doubt_where_every_frame_is_sparse(tmp_path: Path) -> None:
    folder = Folder(tmp_path / "raw")
    depth = np.zeros((HEIGHT, WIDTH), np.uint16)
    depth[::4, ::4] = 2000 + np.arange(48).reshape(6, 8)
    for split in ("train", "val", "test"):
        folder.add(split, depth_mm=depth)
    assert found(folder)[1] == {}


def test_what_was_doubted_at_conversion_comes_first(folder: Folder) -> None:
    label = np.zeros((HEIGHT, WIDTH), np.uint8)
    folder.split = {"train": [], "val": [], "test": []}
    folder.root = folder.root.parent / "again" / "raw"
    for split in ("train", "val", "test"):
        folder.add(split, label=label + 1)
    store = nimprep.open_store(folder.store())
    first, *_ = find(store, collect(store))
    (doubt,) = store.about.doubts
    assert (first.kind, first.severity) == ("doubt-class-missing", "problem")
    assert first.title == "Classes that are nowhere"
    assert first.text == f"3 frames: {doubt['text']}."
    assert [store.ids[n] for n in first.frames] == doubt["frames"]


def test_saturated_depth_is_found(folder: Folder) -> None:
    depth = np.full((HEIGHT, WIDTH), 3000, np.uint16) + np.arange(WIDTH, dtype=np.uint16)
    depth[0, :8] = 20000
    frame = folder.add("test", depth_mm=depth)
    depth[0, :8] = 3000
    depth[0, :7] = 20000
    folder.add("test", depth_mm=depth)
    store, findings = found(folder)
    assert findings["saturated"].frames == numbers(store, frame)
    assert "20 m" in findings["saturated"].text


def test_frames_and_splits_without_a_class_are_found(folder: Folder) -> None:
    label = np.zeros((HEIGHT, WIDTH), np.uint8)
    label[12:] = 1
    lacking = folder.add("train", label=label)
    _, findings = found(folder)
    assert [f.kind for f in findings.values()] == ["without-class-2"]
    assert findings["without-class-2"].title == "Frames without cone"
    assert "1 frame of 9 labelled frames" in findings["without-class-2"].text
    assert lacking


def test_a_class_that_a_split_lacks_is_a_problem(tmp_path: Path) -> None:
    folder = Folder(tmp_path / "raw")
    label = np.zeros((HEIGHT, WIDTH), np.uint8)
    label[12:] = 1
    for _ in range(3):
        folder.add("train")
    frame = folder.add("test", label=label)
    store, findings = found(folder)
    assert findings["class-2-not-in-test"].severity == "problem"
    assert findings["class-2-not-in-test"].frames == numbers(store, frame)
    assert "class-2-not-in-train" not in findings


def test_frames_without_any_label_are_a_problem_unless_all_are_of_test(folder: Folder) -> None:
    ignored = np.full((HEIGHT, WIDTH), 255, np.uint8)
    hidden = folder.add("test", label=ignored)
    store, findings = found(folder)
    assert set(findings) == {"unlabelled"}
    assert findings["unlabelled"].frames == numbers(store, hidden)
    assert findings["unlabelled"].severity == "look"
    folder.root = folder.root.parent / "again" / "raw"
    folder.split = {"train": [], "val": [], "test": []}
    for split in ("train", "train", "test"):
        folder.add(split)
    folder.add("train", label=ignored)
    assert found(folder)[1]["unlabelled"].severity == "problem"


def test_near_duplicates_are_found_across_splits_but_not_within_one(folder: Folder) -> None:
    picture = photograph(77)
    brighter = np.clip(picture.astype(int) + 9, 0, 255).astype(np.uint8)
    one = folder.add("train", rgb=picture)
    two = folder.add("test", rgb=brighter)
    folder.add("val", rgb=photograph(78))
    folder.add("val", rgb=photograph(78))
    store, findings = found(folder)
    assert set(findings) == {"near-duplicate-test-train"}
    finding = findings["near-duplicate-test-train"]
    assert finding.pairs == ((store.ids.index(two), store.ids.index(one)),)
    assert finding.frames == numbers(store, one, two)
    assert finding.severity == "problem"


@pytest.mark.parametrize("split_by", ["eighth", "stratified"])
def test_categories_are_no_scenes(tmp_path: Path, split_by: SplitRule) -> None:
    names = tuple(f"{c}_{i:06d}" for c in ("um", "uu") for i in range(8))
    road = road_folder(tmp_path / "road", names)
    road_folder(road, ("um_000000",), "testing")
    store = nimprep.convert(road, tmp_path / "a.zarr", modalities=("label",), split_by=split_by)
    assert not {"shared-scene-test", "shared-scene-val"} & {
        f.kind for f in find(store, collect(store))
    }
    assert "train and test frames of one scene" not in checks(store)
    assert "2 categories" in info_text(store_info(store.path))


def test_scenes_in_train_and_test_are_found(folder: Folder) -> None:
    folder.add("train", scene="yard")
    folder.add("test", scene="yard")
    store, findings = found(folder)
    assert set(findings) == {"shared-scene-test"}
    assert [store.tables.group[i] for i in findings["shared-scene-test"].frames] == ["yard"] * 2
    assert "1 of 4 scenes" in findings["shared-scene-test"].text


def test_flat_pictures_are_found_and_are_no_duplicates(folder: Folder) -> None:
    black = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    frames = [folder.add(split, rgb=black) for split in ("train", "test")]
    store, findings = found(folder)
    assert set(findings) == {"flat"}
    assert findings["flat"].frames == numbers(store, *frames)


def test_frames_that_the_conversion_left_out_are_named(folder: Folder) -> None:
    store = nimprep.open_store(folder.store())
    skipped = [{"id": f"yard/{i}", "reason": "truncated"} for i in range(7)]
    store.attributes["skipped"] = skipped
    (finding,) = find(store, collect(store))
    assert finding.frames == ()
    assert "7 frames" in finding.text
    assert "yard/0 (truncated); yard/1" in finding.text
    assert finding.text.endswith("and 2 more.")


def test_labels_of_no_class_are_found(folder: Folder) -> None:
    path = folder.store()
    store = nimprep.open_store(path)
    facts = collect(store)
    facts.undeclared[3] = 5
    (finding,) = find(store, facts)
    assert finding.kind == "undeclared-class"
    assert finding.frames == (3,)
    assert "5 pixels" in finding.text


def test_ids_that_are_no_class_are_counted(folder: Folder) -> None:
    store = nimprep.open_store(folder.store())
    store.classes = store.classes[:2]
    facts = collect(store)
    assert (facts.undeclared == 4 * 8).all()


def test_a_store_of_one_frame_without_labels_is_sound(tmp_path: Path) -> None:
    store = nimprep.open_store(gmrp_store(tmp_path, 1, labels=False))
    assert find(store, collect(store)) == []


def test_frames_of_interest_come_first_and_every_stratum_soon(folder: Folder) -> None:
    for _ in range(40):
        folder.add("train", scene="long")
    store = nimprep.open_store(folder.store())
    findings = [
        Finding("a", "look", "", "", frames=(7, 8, 9)),
        Finding("b", "problem", "", "", frames=(3, 5), pairs=((5, 3),)),
    ]
    order = order_of_interest(store, findings)
    assert sorted(order) == list(range(len(store)))
    # Problems, looks and the sample in turn; a pair's frames one after the other.
    assert [i for i in order if i in (3, 5)] == [5, 3]
    assert order[0] == 5
    assert order[1] in (7, 8, 9)
    assert {5, 3, 7, 8, 9} <= set(order[:9])
    strata = {(int(store.tables.split[i]), store.tables.group[i]) for i in order[:14]}
    assert len(strata) == 4
    assert order_of_interest(store, findings) == order
