import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from click.testing import CliRunner

import nimprep
from nimprep.cli import main
from nimprep.schema import load_schema, schema_problems
from nimprep.store.checksums import attributes_digest
from nimprep.store.info import store_info
from nimprep.store.metadata import read_attributes, write_attributes
from nimprep.store.spec import FORMAT_VERSION
from nimprep.store.validate import validate_store
from tests.checksums import renew_checksums
from tests.fakes import write_gmrp, write_nyu_like

CASES = Path(__file__).parent / "invalid_attributes"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    root = write_gmrp(folder / "gmrp", frames=4)
    write_gmrp(root, frames=1, size=(20, 40))
    (root / "rgb" / "000004.png").unlink(missing_ok=True)
    with pytest.warns(UserWarning, match="nominal"):
        nimprep.convert(root, folder / "s.zarr", shard_length=2)
    return folder / "s.zarr"


@pytest.fixture
def store(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "s.zarr"))


def test_what_convert_writes_is_valid_in_depth(store: Path) -> None:
    report = validate_store(store, deep=True)
    assert report.problems == []
    assert report.frames == 4
    assert report.checks["chunks"] == 4 * len(nimprep.open_store(store).modalities)
    assert report.checks["frames recomputed"] == 4


def test_what_validate_and_info_print_fits_their_schemas(store: Path) -> None:
    assert schema_problems(validate_store(store).to_dict(), "validation") == []
    assert schema_problems(store_info(store), "info") == []


def edit(name: str, change: Callable[[np.ndarray], None]) -> Callable[[Path], None]:
    """Change an array through zarr, so that every checksum fits what it then holds."""

    def apply(store: Path) -> None:
        array = zarr.open_group(store, mode="r+")[name]
        values = np.array(array[...])
        change(values)
        array[...] = values
        renew_checksums(store)

    return apply


def setter(place: Any, value: Any) -> Callable[[np.ndarray], None]:
    def change(values: np.ndarray) -> None:
        values[place] = value

    return change


def flip_byte(name: str, place: int) -> Callable[[Path], None]:
    def apply(store: Path) -> None:
        path = next(p for p in sorted((store / name / "c").rglob("*")) if p.is_file())
        data = bytearray(path.read_bytes())
        data[place] ^= 4
        path.write_bytes(data)

    return apply


def edit_json(name: str, change: Callable[[dict[str, Any]], None]) -> Callable[[Path], None]:
    def apply(store: Path) -> None:
        path = store / name / "zarr.json"
        document = json.loads(path.read_text())
        change(document)
        path.write_text(json.dumps(document))
        renew_checksums(store)

    return apply


def own_array(store: Path, shape: tuple[int, ...], dims: tuple[str, ...] | None) -> None:
    """Put an array of somebody's own into a store."""
    group = zarr.open_group(store, mode="r+")
    group.create_array("weather", shape=shape, dtype="uint8", dimension_names=dims)


def remove(name: str) -> Callable[[Path], None]:
    def apply(store: Path) -> None:
        path = store / name
        path.unlink() if path.is_file() else shutil.rmtree(path)

    return apply


SHALLOW = {
    "a missing shard": (remove("rgb/c/1"), "rgb"),
    "a missing array": (remove("normal"), "normal"),
    "a missing table": (remove("intrinsics"), "intrinsics"),
    "a table without its chunk": (remove("split/c"), "split"),
    "a table whose only chunk is gone": (remove("split/c/0"), "split"),
    "a table in many chunks": (
        edit_json("split", lambda d: d["chunk_grid"]["configuration"].update(chunk_shape=[2])),
        "one chunk",
    ),
    "a table without dimensions": (edit_json("split", lambda d: d.pop("dimension_names")), "split"),
    "another byte order": (
        edit_json(
            "depth",
            lambda d: d["codecs"][0]["configuration"]["codecs"][0].update(
                configuration={"endian": "big"}
            ),
        ),
        "byte order",
    ),
    "consolidated metadata that says otherwise": (
        edit_json(
            "",
            lambda d: d["consolidated_metadata"]["metadata"]["depth"]["attributes"].update(
                scale_factor=0.1
            ),
        ),
        "'depth' as in its own file",
    ),
    "an array of nimprep's that nobody speaks of": (
        lambda store: shutil.copytree(store / "depth", store / "elevation"),
        "elevation",
    ),
    "somebody's array of another number of frames": (
        lambda store: own_array(store, (3,), ("frame",)),
        "weather: expected 4 along 'frame'",
    ),
    "somebody's array of images of another size": (
        lambda store: own_array(store, (4, 7), ("frame", "y")),
        "along 'y'",
    ),
    "a copy of an array's metadata under a name that leads elsewhere": (
        edit_json("", lambda d: d["consolidated_metadata"]["metadata"].update({"../x": {}})),
        "a name that can be none's",
    ),
    "an unknown way of filling": (
        edit_json(
            "",
            lambda d: d["attributes"]["nimprep"]["modalities"]["normal"]["parameters"].update(
                fill="x"
            ),
        ),
        "fill",
    ),
    "a damaged index": (flip_byte("depth", -10), "wrong checksum"),
    "a damaged table": (flip_byte("split", 3), "split"),
    "a split that does not exist": (edit("split", setter(0, 7)), "split"),
    "a frame larger than the arrays": (edit("image_size", setter((0, 0), 999)), "size within"),
    "a frame of no size": (edit("image_size", setter((0, 1), 0)), "size within"),
    "a camera without focal length": (edit("intrinsics", setter((1, 0, 0), 0)), "fx"),
    "a camera with skew": (edit("intrinsics", setter((1, 0, 1), 9)), "frame 1"),
    "a camera not of the image": (edit("intrinsics", setter((1, 0, 2), 1e6)), "scale"),
    "a negative baseline": (edit("baseline", setter(2, -1)), "positive baseline"),
    "a cam_to_road that is no rotation": (edit("cam_to_road", setter(2, 1)), "rotation"),
    "an id twice": (edit("frame_id", setter(0, "000001")), "unique"),
    "an attribute gone": (
        edit_json("depth", lambda d: d["attributes"].pop("scale_factor")),
        "scale_factor",
    ),
    "another dtype": (edit_json("label", lambda d: d.update(data_type="int8")), "data type"),
    "an absurd shape": (
        edit_json("label", lambda d: d.update(shape=[1 << 40, 24, 40])),
        "label",
    ),
    "codecs that are not ours": (
        edit_json("rgb", lambda d: d["codecs"][0]["configuration"]["codecs"].pop(2)),
        "chunk codecs",
    ),
    "metadata that is malformed": (edit_json("rgb", lambda d: d.pop("chunk_grid")), "malformed"),
}


@pytest.mark.parametrize("case", SHALLOW)
def test_validate_finds(store: Path, case: str) -> None:
    damage, words = SHALLOW[case]
    damage(store)
    report = validate_store(store)
    assert not report.valid
    assert any(words in problem for problem in report.problems), report.problems


def a_note(store: Path) -> None:
    (store / "notes.txt").write_text("mine")
    (store / "rgb" / "notes.txt").write_text("mine")


def a_group(store: Path) -> None:
    group = zarr.open_group(store, mode="r+").create_group("predictions")
    group.create_array("ours", shape=(2, 3), dtype="uint8")


def an_attribute(store: Path) -> None:
    zarr.open_group(store, mode="r+").attrs["license"] = "CC-BY-4.0"
    zarr.open_group(store, mode="r+", use_consolidated=False)["rgb"].attrs["comment"] = "mine"


OWN = {
    "notes": (a_note, ["'notes.txt'", "'rgb/notes.txt'"]),
    "an array": (lambda store: own_array(store, (4,), ("frame",)), ["'weather'"]),
    "an array without dimensions": (lambda store: own_array(store, (9,), None), ["'weather'"]),
    "a group with an array": (a_group, ["'predictions'"]),
    "attributes": (an_attribute, ["attribute 'comment' of 'rgb'", "attribute 'license'"]),
}


@pytest.mark.filterwarnings("ignore:Consolidated metadata")
@pytest.mark.filterwarnings("ignore:Object at")
@pytest.mark.parametrize("consolidated", [False, True])
@pytest.mark.parametrize("case", OWN)
def test_what_somebody_put_into_a_store_is_named_and_no_fault(
    store: Path, case: str, consolidated: bool
) -> None:
    put, names = OWN[case]
    put(store)
    if consolidated or case == "attributes":
        zarr.consolidate_metadata(store)
    report = validate_store(store, deep=True)
    assert report.problems == []
    assert report.extras == names
    assert schema_problems(report.to_dict(), "validation") == []
    told = CliRunner().invoke(main, ["validate", str(store)])
    assert told.exit_code == 0
    assert f"not nimprep's, and not checked: {', '.join(names)}\n" in told.stdout
    assert validate_store(store, deep=True).extras == names


def test_a_store_as_it_was_written_has_nothing_of_somebody_elses(store: Path) -> None:
    assert validate_store(store).extras == []
    assert "not checked" not in CliRunner().invoke(main, ["validate", str(store)]).stdout


DEEP = {
    "a flipped bit in an image": (flip_byte("rgb", 40), "wrong checksum"),
    "a label out of range": (edit("label", setter((1, 2, 3), 9)), "found [9]"),
    "a normal that is not unit": (edit("normal", setter((1, 9, 9), (50, 0, 0))), "unit vectors"),
    "a normal where no depth is": (
        edit("normal", setter((1, 0, 6), (0, 0, -127))),
        "exactly where depth is",
    ),
    "a normal missing": (edit("normal", setter((1, 9, 9), 0)), "exactly where depth is"),
    "sums that are not the images'": (edit("channel_sums", setter((1, 0, 1), 5)), "channel_sums"),
    "hha missing": (edit("hha", setter((1, 9, 9), 0)), "value where depth is"),
    "hha of another scene": (edit("hha", setter((1, 9, 9), 77)), "'hha' makes of the depth"),
    "gravity that is no direction": (edit("gravity", setter(1, 0)), "unit vector beside HHA"),
    "another gravity": (edit("gravity", setter(1, (0, 0, 1))), "gravity: expected"),
    "a normal of another surface": (
        edit("normal", setter((1, 9, 9), (-127, 0, 0))),
        "makes of the depth",
    ),
    "padding that is not": (edit("label", setter((1, -1, -1), 1)), "padding"),
    "depth in the padding": (edit("depth", setter((1, -1, -1), 500)), "padding"),
}


@pytest.mark.parametrize("case", DEEP)
def test_only_a_deep_validation_finds(store: Path, case: str) -> None:
    damage, words = DEEP[case]
    damage(store)
    assert validate_store(store).valid
    report = validate_store(store, deep=True)
    assert not report.valid
    assert any(words in problem for problem in report.problems), report.problems


def test_a_group_in_two_splits_is_found_where_groups_must_not_straddle(tmp_path: Path) -> None:
    root, description = write_nyu_like(tmp_path / "nyu")
    path = nimprep.convert(root, tmp_path / "s.zarr", description=description).path
    assert validate_store(path).valid
    attributes = read_attributes(path)
    write_attributes(path, {**attributes, "split": {"rule": "group", "seed": 0}})
    edit("split", setter(slice(None), [0, 1, 0, 0]))(path)
    assert any("in two" in problem for problem in validate_store(path).problems)


def test_the_attributes_of_a_real_store_fit_the_schema(made: Path) -> None:
    assert schema_problems(read_attributes(made), "store") == []


def test_every_invalid_example_is_found_with_its_verdict(made: Path, tmp_path: Path) -> None:
    cases = sorted(CASES.glob("*.json"))
    assert len(cases) == 19
    for number, path in enumerate(cases):
        case = json.loads(path.read_text())
        attributes = {**read_attributes(made), **case["change"]}
        for name in case.get("without", []):
            del attributes[name]
        problems = schema_problems(attributes, "store")
        assert any(case["verdict"] in problem for problem in problems), (path.name, problems)
        store = Path(shutil.copytree(made, tmp_path / str(number)))
        root = json.loads((store / "zarr.json").read_text())
        attributes = {**attributes, "format_version": FORMAT_VERSION}
        if "digest" in attributes:
            attributes["digest"] = attributes_digest(attributes)
        root["attributes"]["nimprep"] = attributes
        (store / "zarr.json").write_text(json.dumps(root))
        if "format_version" not in case["change"] and "format_version" not in case.get(
            "without", []
        ):
            assert not validate_store(store).valid


def test_every_schema_is_itself_valid() -> None:
    from jsonschema import Draft202012Validator

    folder = Path(__file__).parents[2] / "schemas"
    names = sorted(path.name.removesuffix(".schema.json") for path in folder.glob("*.schema.json"))
    assert {"camera", "folder", "info", "split", "store", "validation"} <= set(names)
    for name in names:
        Draft202012Validator.check_schema(load_schema(name))
        assert load_schema(name)["$id"].startswith(f"urn:nimprep:schema:{name}:")


@pytest.mark.parametrize("fault", [RuntimeError, MemoryError, ImportError, ZeroDivisionError])
@pytest.mark.parametrize("place", ["layout_problems", "recipe_from", "map_in_order", "check_table"])
def test_a_fault_of_the_program_is_none_of_the_stores(
    store: Path, place: str, fault: type[Exception], monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*arguments: object, **named: object) -> None:
        raise fault("a bug")

    monkeypatch.setattr(f"nimprep.store.validate.{place}", broken)
    with pytest.raises(fault, match="a bug"):
        validate_store(store)
