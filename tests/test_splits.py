import json
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nimprep.errors import SplitError
from nimprep.splits import (
    SplitName,
    assign_splits,
    count_splits,
    extend_splits,
    hash_order,
    held_out_count,
    split_by_frame,
    split_by_group,
    splits_from_file,
    write_split_file,
)

IDS = [f"{number:06d}" for number in range(40)]


def test_3896_frames_split_as_gmrp_does() -> None:
    splits = split_by_frame([f"{number:06d}" for number in range(1, 3897)])
    assert count_splits(splits.values()) == {"train": 2726, "val": 585, "test": 585}


def test_the_order_is_that_of_sha256_and_never_changes() -> None:
    # Worked out with sha256sum: printf '0:000001' | sha256sum, and so on.
    assert hash_order(["000001", "000002", "000003"]) == ["000002", "000003", "000001"]


@pytest.mark.parametrize(
    ("frames", "each"), [(0, 0), (1, 0), (2, 0), (3, 1), (6, 1), (7, 2), (100, 15)]
)
def test_few_frames_still_leave_one_for_train(frames: int, each: int) -> None:
    assert held_out_count(frames) == each


def test_a_seed_changes_who_is_held_out_and_nothing_else() -> None:
    first, second = split_by_frame(IDS, seed=0), split_by_frame(IDS, seed=1)
    assert first != second
    assert count_splits(first.values()) == count_splits(second.values())


def test_the_order_of_the_ids_does_not_matter() -> None:
    assert split_by_frame(IDS) == split_by_frame(IDS[::-1])


@given(st.lists(st.integers(1, 30), min_size=3, max_size=20), st.integers(0, 5))
def test_no_group_straddles_and_every_split_has_a_group(sizes: list[int], seed: int) -> None:
    groups = {f"{g}/{i}": f"g{g}" for g, size in enumerate(sizes) for i in range(size)}
    splits = split_by_group(groups, seed)
    of_group: dict[str, set[str]] = {}
    for frame_id, group in groups.items():
        of_group.setdefault(group, set()).add(splits[frame_id])
    assert all(len(found) == 1 for found in of_group.values())
    assert set(splits.values()) == {"train", "val", "test"}


def test_many_even_groups_come_near_the_default_sizes() -> None:
    groups = {f"{g}/{i}": f"g{g}" for g in range(40) for i in range(10)}
    assert count_splits(split_by_group(groups).values()) == {"train": 280, "val": 60, "test": 60}


def test_frames_without_a_group_cannot_be_split_by_group() -> None:
    with pytest.raises(SplitError, match="expected a group"):
        split_by_group({"a": "x", "b": ""})


def test_two_groups_cannot_fill_three_splits() -> None:
    with pytest.raises(SplitError, match="at least 3 groups, found 2"):
        split_by_group({"a": "x", "b": "y"})


def test_fixed_test_frames_stay_and_the_others_become_train_and_val() -> None:
    groups = {f"training/{i}": "um" for i in range(20)} | {"testing/0": "um", "testing/1": "um"}
    splits = assign_splits(groups, "stratified", fixed={"testing/0": "test", "testing/1": "test"})
    assert count_splits(splits.values()) == {"train": 17, "val": 3, "test": 2}
    assert splits["testing/0"] == "test"


def test_a_stratified_split_holds_the_same_share_of_every_group() -> None:
    groups = {f"{g}{i}": g for g in "abc" for i in range(20)}
    splits = assign_splits(groups, "stratified")
    counts = Counter((groups[i], split) for i, split in splits.items())
    assert all(counts[g, "val"] == counts[g, "test"] == 3 for g in "abc")


KITTI = {"um": 95, "umm": 96, "uu": 98}
"""Training frames of the benchmark, by category."""


def test_an_eighth_of_each_of_kittis_categories_is_253_and_36() -> None:
    groups = {f"training/{c}_{i:06d}": c for c, number in KITTI.items() for i in range(number)}
    splits = assign_splits(groups, "eighth")
    assert count_splits(splits.values()) == {"train": 253, "val": 36, "test": 0}
    for category in KITTI:
        members = [i for i, group in groups.items() if group == category]
        val = {i for i in members if splits[i] == "val"}
        # The twelve whose hashes come first.
        assert val == set(hash_order(members, 0)[:12])


@pytest.mark.parametrize(
    ("frames", "val"), [(1, 0), (2, 0), (3, 1), (8, 1), (11, 1), (12, 2), (20, 3)]
)
def test_an_eighth_is_the_nearest_number_and_one_where_there_are_three(
    frames: int, val: int
) -> None:
    splits = assign_splits({str(i): "um" for i in range(frames)}, "eighth")
    assert count_splits(splits.values()) == {"train": frames - val, "val": val, "test": 0}


def test_frames_that_join_fill_up_the_eighth_of_their_scene() -> None:
    groups = {f"{c}_{i:06d}": c for c, number in KITTI.items() for i in range(number)}
    first = {i: c for n, (i, c) in enumerate(groups.items()) if n % 3}
    splits = extend_splits(groups, assign_splits(first, "eighth"), "eighth")
    assert count_splits(splits.values()) == {"train": 253, "val": 36, "test": 0}


def test_a_split_file_goes_round(tmp_path: Path) -> None:
    splits = split_by_frame(IDS)
    write_split_file(tmp_path / "split.json", splits)
    assert splits_from_file(tmp_path / "split.json", IDS) == splits


def test_frames_a_file_does_not_name_belong_to_none(tmp_path: Path) -> None:
    write_split_file(tmp_path / "split.json", {"a": "train"})
    assert splits_from_file(tmp_path / "split.json", ["a", "b"]) == {"a": "train", "b": "none"}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"train": ["a", "unknown"]}, "found 'unknown' in 'train'"),
        ({"train": ["a"], "val": ["a"]}, "each frame once, found 'a' twice"),
        ({"version": "2.0"}, "1.0"),
        ({"train": "a"}, "train"),
        ({"extra": 1}, "extra"),
    ],
)
def test_a_wrong_split_file_is_refused(
    tmp_path: Path, change: dict[str, object], words: str
) -> None:
    document = {"format": "nimprep-split", "version": "1.0", "train": [], "val": [], "test": []}
    path = tmp_path / "split.json"
    path.write_text(json.dumps({**document, **change}))
    with pytest.raises(SplitError, match=words):
        splits_from_file(path, ["a", "b"])


SCENES = {f"{scene}/{i}": scene for scene in ("um", "umm", "uu", "lab") for i in range(11)}


@pytest.mark.parametrize("rule", ["frame", "group", "stratified", "eighth"])
@pytest.mark.parametrize("fixed", [{}, {"um/3": "test"}, {"um/3": "train", "uu/1": "val"}])
def test_joining_an_empty_dataset_is_splitting_it(rule: str, fixed: dict[str, SplitName]) -> None:
    assert extend_splits(SCENES, {}, rule, 4, fixed) == assign_splits(SCENES, rule, 4, fixed)


@given(st.integers(0, 60), st.integers(0, 60), st.integers(0, 5))
def test_frames_that_join_fill_up_what_is_held_out(old: int, new: int, seed: int) -> None:
    ids = [f"{number:06d}" for number in range(old + new)]
    known = split_by_frame(ids[:old], seed)
    splits = extend_splits(dict.fromkeys(ids, ""), known, "frame", seed)
    assert list(splits) == ids
    assert {i: splits[i] for i in ids[:old]} == known
    before, after = count_splits(known.values()), count_splits(splits.values())
    held_out = held_out_count(old + new)
    # Few new frames may be too few for both; val comes first.
    assert after["val"] == min(held_out, before["val"] + new)
    left = new - (after["val"] - before["val"])
    assert after["test"] == min(held_out, before["test"] + left)


def test_frames_that_join_are_taken_in_hash_order() -> None:
    ids = ["a", "b", "000001", "000002", "000003"]
    splits = extend_splits(dict.fromkeys(ids, ""), {"a": "train", "b": "train"})
    # 5 frames hold out 1 and 1; the order is that of the test by sha256sum above.
    assert splits == {
        "a": "train",
        "b": "train",
        "000002": "val",
        "000003": "test",
        "000001": "train",
    }


def test_a_dataset_with_too_many_held_out_gets_no_more() -> None:
    known = dict.fromkeys(IDS[:20], "val") | dict.fromkeys(IDS[20:25], "test")
    splits = extend_splits(dict.fromkeys(IDS, ""), known)
    # 40 frames hold out 6 and 6.
    assert count_splits(splits.values()) == {"train": 14, "val": 20, "test": 6}


def test_each_scene_fills_up_for_itself_when_stratified() -> None:
    known = assign_splits({i: g for i, g in SCENES.items() if g != "lab"}, "stratified")
    splits = extend_splits(SCENES, known, "stratified")
    for scene in ("um", "umm", "uu", "lab"):
        counts = count_splits(s for i, s in splits.items() if SCENES[i] == scene)
        assert counts == {"train": 7, "val": 2, "test": 2}


@given(
    st.lists(st.integers(1, 30), min_size=3, max_size=12),
    st.lists(st.integers(1, 30), max_size=12),
    st.integers(0, 5),
)
def test_no_group_straddles_when_frames_join(
    before: list[int], after: list[int], seed: int
) -> None:
    old = {f"{g}/{i}": f"g{g}" for g, size in enumerate(before) for i in range(size)}
    # Every second scene that comes is one that is there.
    names = [f"g{g}" if g % 2 and g < len(before) else f"new{g}" for g in range(len(after))]
    new = {f"n{g}/{i}": names[g] for g, size in enumerate(after) for i in range(size)}
    known = split_by_group(old, seed)
    splits = extend_splits(old | new, known, "group", seed)
    of_group: dict[str, set[str]] = {}
    for frame_id, group in (old | new).items():
        of_group.setdefault(group, set()).add(splits[frame_id])
    assert all(len(found) == 1 for found in of_group.values())
    assert {i: splits[i] for i in old} == known


def test_new_scenes_go_where_frames_are_short() -> None:
    old = {f"{scene}/{i}": scene for scene in "abcdefgh" for i in range(10)}
    new = {f"{scene}/{i}": scene for scene in "ijklmnop" for i in range(10)}
    splits = extend_splits(old | new, split_by_group(old), "group")
    # 160 frames hold out 24 and 24; whole scenes of 10 come nearest with 20.
    assert count_splits(splits.values()) == {"train": 120, "val": 20, "test": 20}


def test_a_single_scene_that_joins_may_be_held_out() -> None:
    old = {f"{scene}/{i}": scene for scene in "abcdefghij" for i in range(10)}
    known = {i: {"a": "val", "b": "test"}.get(scene, "train") for i, scene in old.items()}
    new = {f"k/{i}": "k" for i in range(10)}
    # 110 frames hold out 17 and 17: 20 are nearer to that than 10.
    splits = extend_splits(old | new, known, "group")
    assert {splits[i] for i in new} == {"val"}


def test_a_frame_without_a_scene_cannot_join_by_group() -> None:
    known = split_by_group(SCENES)
    with pytest.raises(SplitError, match=r"stray: expected a group .* \(1 of 1 frames\)"):
        extend_splits({**SCENES, "stray": ""}, known, "group")
    with pytest.raises(SplitError, match="expected one of frame"):
        extend_splits(SCENES, known, "colour")


def test_what_the_authors_fixed_stays_so_when_frames_join() -> None:
    ids = dict.fromkeys(IDS, "um")
    known = assign_splits(dict.fromkeys(IDS[:10], "um"), "stratified", 0, {IDS[0]: "test"})
    fixed: dict[str, SplitName] = {IDS[0]: "test", IDS[20]: "test", IDS[21]: "test"}
    splits = extend_splits(ids, known, "stratified", 0, fixed)
    assert {i for i, s in splits.items() if s == "test"} == set(fixed)
    # Of the 37 that are free, val gets its 6 and nobody is test.
    assert count_splits(splits.values()) == {"train": 31, "val": 6, "test": 3}


def test_frames_that_join_a_split_made_by_a_file_have_none() -> None:
    splits = extend_splits({"a": "", "b": ""}, {"a": "val"}, "file")
    assert splits == {"a": "val", "b": "none"}
