"""What holds for every dataset that is known by name, and how they are told from each other."""

from __future__ import annotations

import re
import zipfile
from itertools import product
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner

import nimprep
from nimprep.cli import main
from nimprep.errors import ArrayError, LayoutError, OptionError
from nimprep.inspection.inspection import inspect_source
from nimprep.inspection.layouts import reader_of_names
from nimprep.readers import READERS, ReaderOptions, open_reader
from nimprep.readers.datasets import DATASETS, FLAGS, FOLDER, Dataset, merged
from nimprep.readers.description_file import description_from_document
from nimprep.readers.layouts import Layout
from nimprep.readers.named import described
from nimprep.readers.nearby import nearby_dataset
from nimprep.readers.patterns import placeholders
from nimprep.readers.recognition import recognised
from nimprep.readers.signs import Listings, expanded
from nimprep.schema import schema_problems
from tests.fakes import write_gmrp, write_png
from tests.kitti.scenes import road_folder
from tests.scenes import scene

ROOT = Path(nimprep.__file__).parent.parent


def test_there_are_datasets() -> None:
    assert "orfd" in DATASETS
    assert {*DATASETS} < {*READERS}


@pytest.mark.parametrize("name", DATASETS)
def test_a_file_fits_the_schema(name: str) -> None:
    assert schema_problems(DATASETS[name].document, "dataset") == []


def forms(dataset: Dataset) -> list[Dataset]:
    """Return the dataset with any of its cases or none."""
    cases = dataset.document.get("cases", [])
    found = []
    for chosen in product((False, True), repeat=len(cases)):
        document: Any = dataset.document
        for case, taken in zip(cases, chosen, strict=True):
            document = merged(document, case["change"]) if taken else document
        found.append(Dataset(dataset.name, document))
    return found


@pytest.mark.parametrize("name", DATASETS)
def test_every_form_of_it_is_a_description(name: str) -> None:
    for form in forms(DATASETS[name]):
        sets = form.options.get("label_set", {}).get("choices", [None])
        for label_set in sets:
            document = described(form, label_set)
            made = description_from_document(document, name)
            assert made.reference is not None
            assert all(made.reference.to_json().values())
            assert {*made.reference.to_json()} >= {"title", "licence", "citation", "url"}
            known = placeholders(made.rgb.files)
            for option in ("variations", "camera_index"):
                if option in form.options:
                    assert form.options[option]["placeholder"] in known


@pytest.mark.parametrize("name", DATASETS)
def test_it_has_a_page_in_the_index(name: str) -> None:
    page = ROOT / "docs" / "datasets" / f"{name}.md"
    text = page.read_text()
    reference = DATASETS[name].document["description"]["reference"]
    assert "```text" in text
    assert reference["url"] in text
    for part in ("licence", "citation"):
        assert reference[part] in " ".join(text.split())
    for option in DATASETS[name].options:
        assert FLAGS[option] in text
    assert f"datasets/{name}.md" in (ROOT / "docs" / "README.md").read_text()
    assert f"| `{name}` |" in (ROOT / "README.md").read_text()


def test_help_names_the_options_and_whose_they_are() -> None:
    done = CliRunner().invoke(main, ["convert", "--help"], terminal_width=300)
    for flag in FLAGS.values():
        assert re.search(rf"^ *{flag} ", done.stdout, re.M), flag
    command: Any = main.get_command(click.Context(main), "convert")
    said = {p.name: p.help for p in command.params if isinstance(p, click.Option)}
    for dataset in DATASETS.values():
        for option in dataset.options:
            assert dataset.name in said[option]


def test_the_wheel_has_the_files() -> None:
    # The build takes what is in the package's folder: data lies there, beside the code.
    assert FOLDER.is_relative_to(ROOT / "nimprep")
    assert {path.stem for path in FOLDER.glob("*.json")} == {*DATASETS}


# Recognition


def put(root: Path, *names: str) -> Path:
    for name in names:
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("")
    return root


@pytest.mark.parametrize(
    ("pattern", "name", "fits"),
    [
        ("a/*.png", "a/1.PNG", True),
        ("a/*.png", "a/b/1.png", False),
        ("a/**/*.png", "a/1.png", True),
        ("a/**/*.png", "a/b/c/1.png", True),
        ("{x,y}/{n}.t", "y/1.t", True),
        ("{x,y}/{n}.t", "z/1.t", False),
        ("a/{n}_[0-9].t", "a/q_7.t", True),
        ("a/{n}_[0-9].t", "a/q_x.t", False),
        ("a/{n}_[0-9].t", "a/_7.t", False),
        ("*/b/", "a/b/1.t", True),
        ("*/b", "a/b/1.t", False),
        ("A/?.t", "a/1.t", True),
        ("a/.*", "a/.hidden", False),
        ("a/*", "a/Thumbs.db", False),
    ],
)
def test_a_sign_finds_what_it_says(tmp_path: Path, pattern: str, name: str, fits: bool) -> None:
    assert (Listings().find(put(tmp_path, name), pattern) is not None) == fits


def test_alternatives_are_spelled_out() -> None:
    assert expanded("{a,b}/{n}/{c,d}") == ["a/{n}/c", "a/{n}/d", "b/{n}/c", "b/{n}/d"]


def layout(*signs: str, **said: Any) -> Layout:
    return Layout("made up", "nimprep.readers.gmrp:open_gmrp", signs=signs, **said)


def test_a_folder_of_two_datasets_is_refused_unless_one_is_the_special_case(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(tmp_path, "left/1.png", "right/1.png", "more/1.png")
    monkeypatch.setitem(READERS, "one", layout("left/*.png"))
    assert recognised(tmp_path).reader == "one"
    monkeypatch.setitem(READERS, "two", layout("right/*.png"))
    with pytest.raises(LayoutError, match="those of one and two; say which is meant with --reader"):
        recognised(tmp_path)
    monkeypatch.setitem(READERS, "two", layout("right/*.png", over=("one",)))
    assert recognised(tmp_path).reader == "two"
    monkeypatch.setitem(READERS, "two", layout("right/*.png", not_signs=("more/*.png",)))
    assert recognised(tmp_path).reader == "one"


def test_folders_without_files_are_no_sign(tmp_path: Path) -> None:
    for folder in ("image_data", "dense_depth", "calib"):
        (tmp_path / "training" / "s" / folder).mkdir(parents=True)
    with pytest.raises(LayoutError, match="expected a known layout"):
        open_reader(tmp_path)


def test_a_layout_with_empty_folders_is_still_said_to_lack_files(tmp_path: Path) -> None:
    (tmp_path / "depth_u16").mkdir()
    (tmp_path / "rgb").mkdir()
    with pytest.raises(LayoutError, match="expected rgb files"):
        open_reader(tmp_path)


def test_of_many_files_few_folders_are_looked_into(tmp_path: Path) -> None:
    for number in range(60):
        put(tmp_path, f"a{number}/b/c/1.t")
    listings = Listings(most=50)
    assert listings.find(tmp_path, "*/b/c/2.t") is None
    assert listings.cut
    # What was looked into once is not looked into again.
    assert listings.find(tmp_path, "a0/b/c/1.t") is not None


def test_a_folder_is_read_once_however_many_signs_ask_for_it(tmp_path: Path) -> None:
    counted = []
    listings = Listings()
    known = listings.of

    def of(folder: str) -> Any:
        counted.append(folder)
        return known(folder)

    listings.of = of  # type: ignore[method-assign]
    put(tmp_path, *(f"rgb/{n}.png" for n in range(300)))
    for layout in READERS.values():
        for sign in layout.signs:
            listings.has(tmp_path, sign)
    assert len(listings._known) <= 2
    assert {*counted} <= {str(tmp_path), str(tmp_path / "rgb")}


@pytest.mark.parametrize("top", ["", "download/"])
def test_an_archive_is_known_by_the_names_in_it(tmp_path: Path, top: str) -> None:
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for folder, end in (("image_data", ".png"), ("calib", ".txt")):
            archive.writestr(f"{top}training/s/{folder}/1{end}", "")
    assert "files of the dataset orfd" in inspect_source(path).what
    assert reader_of_names(["a/b.png", "c.txt"]) is None


@pytest.mark.filterwarnings("ignore:.*padded to the largest")
def test_whose_frames_a_merged_store_has_is_said_once_each(tmp_path: Path) -> None:
    stores = []
    for name in ("a", "b"):
        root = tmp_path / name
        write_png(root / "training" / name / "image_data" / "1.png", scene(1).rgb)
        put(root, f"training/{name}/sparse_depth/1.png")
        only = {"labels": False, "modalities": ("rgb",), "camera": (30, 30, 17, 11)}
        stores.append(nimprep.convert(root, tmp_path / f"{name}.zarr", **only).path)
    road = road_folder(tmp_path / "road", ("um_000000",))
    made = nimprep.convert(road, tmp_path / "r.zarr", labels=False, modalities=("rgb",))
    merged_store = nimprep.merge_stores([*stores, made.path], tmp_path / "all.zarr")
    cited = [reference["citation"] for reference in merged_store.about.references]
    assert ["ICRA 2022" in c for c in cited] == [True, False]
    assert ["ITSC 2013" in c for c in cited] == [False, True]


def test_nearby_folders_are_asked_in_order(tmp_path: Path) -> None:
    inner = tmp_path / "a" / "b"
    inner.mkdir(parents=True)
    assert nearby_dataset(tmp_path, lambda folder: folder == inner) == inner
    assert nearby_dataset(inner, lambda folder: folder == tmp_path) == tmp_path
    assert nearby_dataset(inner, lambda folder: False) is None


# What a file of a dataset can say


MADE: dict[str, Any] = {
    "format": "nimprep-dataset",
    "version": "1.0",
    "about": "made up",
    "signs": ["*/*/rgb/cam{c}/*.png"],
    "unpack": {"depth": "depth.zip"},
    "options": {
        "label_set": {
            "choices": {
                "road": {"label": {"map": {"7": 1, "23": 255}, "default": 0}},
                "sky": {"label": {"map": {"23": 1}, "default": 0}},
            },
            "default": "road",
        },
        "variations": {"placeholder": "weather"},
        "camera_index": {"placeholder": "cam", "default": ["0"]},
        "lists": {"beside": [".", "../lists"]},
    },
    "cases": [
        {"there": "old.txt", "change": {"description": {"name": "made-old"}}},
        {"not_there": "*/*/label/*/*.png", "change": {"options": {"label_set": None}}},
    ],
    "description": {
        "format": "nimprep-folder",
        "version": "1.1",
        "name": "made",
        "rgb": "{place}/{weather}/rgb/cam{cam}/{n}.png",
        "id": "{place}/{weather}/{cam}/{n}",
        "group": "{place}",
        "split": {"lists": {"train": "train.lst", "test": "test.lst"}, "rest": "skip"},
        "label": {"files": "{place}/{weather}/label/cam{cam}/{n}.png"},
        "classes": [
            {"id": 0, "name": "other", "color": [0, 0, 0]},
            {"id": 1, "name": "it", "color": [0, 200, 0]},
        ],
        "camera": {"fx": 30, "fy": 30, "cx": 17, "cy": 11},
        "hha_ground": "lowest",
        "reference": {"title": "Made", "licence": "none", "citation": "Nobody", "url": "nowhere"},
    },
}


@pytest.fixture
def made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a dataset of two places, three weathers, two cameras; and let it be known."""
    assert schema_problems(MADE, "dataset") == []
    root = tmp_path / "raw"
    for seed, (place, weather, cam) in enumerate(
        product(("p", "q"), ("sun", "rain", "fog"), ("0", "1"))
    ):
        found = scene(seed)
        write_png(root / place / weather / "rgb" / f"cam{cam}" / "1.png", found.rgb)
        write_png(root / place / weather / "label" / f"cam{cam}" / "1.png", found.label)
    dataset = Dataset("made", MADE)
    opened = READERS["orfd"]._replace(signs=dataset.signs, dataset=dataset, roots=("",))
    monkeypatch.setitem(READERS, "made", opened)
    return root


def test_label_sets_give_what_they_say(made: Path) -> None:
    for label_set, values in ((None, {7: 1, 23: 255}), ("road", {7: 1, 23: 255}), ("sky", {23: 1})):
        reader = open_reader(made, ReaderOptions(label_set=label_set))
        raw, label = scene(0).label, reader.read("p/sun/0/1").label
        assert label is not None
        for value in (7, 11, 23, 26):
            assert {*label[raw == value].tolist()} == {values.get(value, 0)}
    with pytest.raises(OptionError, match=r"--labels: expected road or sky with .*, found 'hope'"):
        open_reader(made, ReaderOptions(label_set="hope"))


def test_variations_and_cameras_choose_frames(made: Path) -> None:
    def ids(**chosen: Any) -> list[str]:
        return [i.removesuffix("/1") for i in open_reader(made, ReaderOptions(**chosen)).ids]

    usual = [f"{place}/{weather}/0" for place, weather in product("pq", ("fog", "rain", "sun"))]
    assert ids() == usual
    assert ids(camera_index=1) == [i[:-1] + "1" for i in usual]
    assert ids(camera="1") == ids(camera=1) == ids(camera_index=1)
    assert ids(variations="sun,fog") == [i for i in usual if "rain" not in i]
    assert ids(variations=["rain"], camera_index=1) == ["p/rain/1", "q/rain/1"]
    with pytest.raises(LayoutError, match=r"expected weather snow.*, found fog, rain, sun; choose"):
        ids(variations=["sun", "snow"])
    with pytest.raises(LayoutError, match="expected cam 7"):
        ids(camera_index=7)
    with pytest.raises(ArrayError, match="camera_index: expected it or a number"):
        ids(camera=1, camera_index=0)


def test_frames_that_are_usually_left_out_are_said(made: Path) -> None:
    notes = open_reader(made).info.notes
    assert any("cam 0 alone" in note and "--camera-index" in note for note in notes)
    assert not any(
        "alone" in n for n in open_reader(made, ReaderOptions(camera_index=0)).info.notes
    )


def test_lists_may_lie_beside_or_where_the_option_says(made: Path, tmp_path: Path) -> None:
    free = open_reader(made)
    assert {free.fixed_split(i) for i in free.ids} == {None}
    assert any("--lists" in note for note in free.info.notes)
    elsewhere = tmp_path / "elsewhere"
    for folder in (elsewhere, tmp_path / "lists"):
        with pytest.raises(LayoutError, match=r"expected the folder of made's lists \(train.lst"):
            open_reader(made, ReaderOptions(lists=elsewhere))
        put(folder, "train.lst", "test.lst")
        (folder / "train.lst").write_text("p/sun/rgb/cam0/1.png\np/fog/rgb/cam0/1.png\n")
        (folder / "test.lst").write_text("q/sun/rgb/cam0/1.png\n")
        options = ReaderOptions(lists=elsewhere if folder == elsewhere else None)
        reader = open_reader(made, options)
        splits = {i: reader.fixed_split(i) for i in reader.ids}
        assert splits == {"p/sun/0/1": "train", "p/fog/0/1": "train", "q/sun/0/1": "test"}
        if folder == elsewhere:
            (folder / "train.lst").unlink()
            (folder / "test.lst").unlink()


def test_cases_change_what_it_is_and_what_it_takes(made: Path) -> None:
    put(made, "old.txt")
    assert open_reader(made).info.name == "made-old"
    for path in sorted(made.rglob("label/*/*.png")):
        path.unlink()
    with pytest.raises(OptionError, match="--labels: expected none with this form of made"):
        open_reader(made, ReaderOptions(label_set="road"))


def test_a_camera_file_that_is_called_like_a_number_is_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert ReaderOptions(camera="1").camera_index == 1
    (tmp_path / "1").write_text("30 30 16 12")
    assert ReaderOptions(camera="1").camera == "1"


def test_hha_is_counted_from_where_the_dataset_says_unless_the_user_does(
    made: Path, tmp_path: Path
) -> None:
    options = nimprep.ConvertOptions()
    assert options.resolved(open_reader(made)).hha_ground == "lowest"
    given = nimprep.ConvertOptions(hha_ground="floor")
    assert given.resolved(open_reader(made)).hha_ground == "floor"
    assert options.resolved(open_reader(write_gmrp(tmp_path / "gmrp"))).hha_ground == "floor"
    assert given.recipe.ground == options.recipe.ground == "floor"
