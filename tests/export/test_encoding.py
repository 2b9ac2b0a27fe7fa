"""Modalities as PNGs: hha/000001.png and normal/000001.png say what the store says, as stated."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from click.testing import CliRunner

import nimprep
from nimprep.cli import main
from nimprep.errors import ArrayError, StoreError
from nimprep.export import export_frames
from nimprep.export.encoding import describe_encoding, encode_image
from nimprep.modality import MODALITIES
from nimprep.plane import plane_from
from nimprep.schema import schema_problems
from nimprep.store.reader import Store
from tests.fakes import write_gmrp

CAMERA = (30.25, 31.5, 15.125, 12.5)
ALL = ("rgb", "depth", "normal", "hha", "disparity", "transformed_disparity", "elevation", "label")


def read(path: Path) -> npt.NDArray[Any]:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image is not None, path
    return np.asarray(image[:, :, ::-1] if image.ndim == 3 else image)


def decoded(image: npt.NDArray[Any], encoding: dict[str, Any]) -> npt.NDArray[np.float64]:
    """Return what a PNG says, by what encodings.json says alone; NaN = none."""
    numbers = image.astype(np.float64)
    values = (numbers - encoding["subtract"]) * encoding["scale"] + encoding["offset"]
    if encoding["none"] is not None:
        same = numbers == encoding["none"]
        values[same if numbers.ndim == 2 else same.all(axis=2)] = np.nan
    # The formula for people says the same.
    formula = eval(encoding["value"], {"png": numbers})
    some = np.isfinite(values)
    np.testing.assert_allclose(values[some], formula[some], rtol=1e-6, atol=1e-9)
    return values


@pytest.fixture(scope="module", params=["int8", "int16"])
def store(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Store:
    root = tmp_path_factory.mktemp("encoding")
    return nimprep.convert(
        write_gmrp(root / "raw", frames=3, size=(48, 64)),
        root / "s.zarr",
        camera=(60, 60, 31.5, 23.5),
        modalities=ALL[:4] + ALL[-1:],
        normal_dtype=request.param,
    )


def exported(store: Store, out: Path, *modalities: str) -> dict[str, Any]:
    assert export_frames(store, out, modalities=modalities) == list(store.ids)
    document: dict[str, Any] = json.loads((out / "encodings.json").read_text())
    assert schema_problems(document, "encodings") == []
    assert list(document["modalities"]) == [m for m in store.modalities if m in modalities]
    return document["modalities"]


def test_normals_and_hha_decode_to_the_stores_within_the_stated_step(
    store: Store, tmp_path: Path
) -> None:
    encodings = exported(store, tmp_path / "out", "hha", "normal")
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        "hha",
        "normal",
        "encodings.json",
        "camera.json",
        "split.json",
    }
    assert encodings["normal"]["channels"] == ["x right", "y down", "z forward"]
    for frame in store:
        assert frame.normal is not None
        assert frame.hha is not None
        image = read(tmp_path / "out" / "normal" / f"{frame.id}.png")
        bits = 8 * image.dtype.itemsize
        assert bits == encodings["normal"]["bits"]
        found = decoded(image, encodings["normal"])
        none = ~frame.normal.any(axis=2)
        # A hole in the depth, in either: and no other pixel.
        assert none.any()
        np.testing.assert_array_equal(np.isnan(found).all(axis=2), none)
        step = encodings["normal"]["scale"]
        assert step == 1 / {8: 127, 16: 32767}[bits]
        # A frame's are brought to unit length again.
        assert np.abs(found - frame.normal)[~none].max() <= step
        lengths = np.linalg.norm(found[~none], axis=1, keepdims=True)
        assert np.abs(found[~none] / lengths - frame.normal[~none]).max() < 1e-6
        # Unit vectors that face the camera.
        assert np.abs(lengths - 1).max() <= 1.5 * step
        hha = decoded(read(tmp_path / "out" / "hha" / f"{frame.id}.png"), encodings["hha"])
        some = frame.hha.any(axis=2)
        np.testing.assert_array_equal(np.isnan(hha).all(axis=2), ~some)
        np.testing.assert_array_equal(hha[some], frame.hha[some])


def test_every_modality_has_a_folder_and_says_how_it_is_read(tmp_path: Path) -> None:
    raw = write_gmrp(tmp_path / "raw", frames=3, size=(48, 64))
    (raw / "camera.json").write_text(
        json.dumps({"fx": 60, "fy": 60, "cx": 31.5, "cy": 23.5, "baseline_m": 0.055})
    )
    store = nimprep.convert(
        raw, tmp_path / "s.zarr", camera=raw / "camera.json", modalities=list(ALL)
    )
    encodings = exported(store, tmp_path / "out", *ALL)
    for frame in store:
        for name in ALL:
            encoding = encodings[name]
            image = read(tmp_path / "out" / encoding["files"].format(id=frame.id))
            found = decoded(image, encoding)
            stored = frame.image(name)
            assert stored is not None
            if name == "label":
                np.testing.assert_array_equal(np.where(np.isnan(found), 255, found), stored)
                continue
            expected = np.asarray(stored, dtype=np.float64)
            some = np.isfinite(found)
            assert some.any(), name
            # Normals are brought to unit length when a store is read; nothing else differs.
            step = encoding["scale"] if encoding["units"] == "1" else 1e-5
            assert np.abs(found - expected)[some].max() <= step, name


@pytest.mark.parametrize(
    ("name", "value", "none"),
    [
        ("rgb", "png", None),
        ("hha", "png", [0, 0, 0]),
        ("depth", "png / 1000", 0),
        ("disparity", "png / 256", 0),
        ("transformed_disparity", "(png - 32768) / 128", 0),
        ("elevation", "(png - 32768) / 1000", 0),
        ("label", "png", 255),
    ],
)
def test_formulas_are_those_of_the_stores_integers(name: str, value: str, none: object) -> None:
    said = describe_encoding(MODALITIES[name])
    assert (said["value"], said["none"]) == (value, none)


def test_normals_of_either_depth_say_their_formula() -> None:
    for dtype, value in (("int8", "(png - 128) / 127"), ("int16", "(png - 32768) / 32767")):
        modality = MODALITIES["normal"].as_dtype(dtype)
        assert describe_encoding(modality)["value"] == value
        largest = np.iinfo(dtype).max
        vectors = np.array([[[0, 0, -largest], [largest, 0, 0], [0, 0, 0]]], dtype)
        middle = largest + 1
        assert encode_image(vectors, modality).tolist() == [
            [[middle, middle, 1], [middle + largest, middle, middle], [0, 0, 0]]
        ]


@pytest.mark.parametrize(
    ("definition", "value", "none"),
    [
        ({"dtype": "uint8"}, "png", None),
        ({"dtype": "int8", "scale": 0.5, "fill": -128}, "(png - 128) * 0.5", 0),
        ({"dtype": "int16", "scale": 0.01, "offset": 20}, "(png - 32768) * 0.01 + 20", None),
        ({"dtype": "uint16", "scale": 0.25, "offset": -5, "fill": 7}, "png * 0.25 + -5", 7),
    ],
)
def test_a_datasets_own_planes_are_said_as_exactly(
    definition: dict[str, Any], value: str, none: int | None
) -> None:
    plane = plane_from("thermal", definition)
    said = describe_encoding(plane)
    assert (said["value"], said["none"]) == (value, none)
    limits = np.iinfo(plane.dtype)
    integers = np.array([[limits.min, -1 if limits.min else 1, 0, limits.max]], plane.dtype)
    found = decoded(encode_image(integers, plane), said)
    expected = integers.astype(np.float64) * plane.scale + plane.offset
    if plane.has_none:
        expected[integers == plane.fill] = np.nan
    np.testing.assert_allclose(found, expected)


def test_the_command_writes_what_it_is_told_to(store: Store, tmp_path: Path) -> None:
    arguments = ["export", str(store.path), str(tmp_path / "out"), "--format", "png"]
    done = CliRunner().invoke(main, [*arguments, "--modalities", "hha, normal"])
    assert (done.exit_code, done.stderr) == (0, "")
    assert (tmp_path / "out" / "hha" / f"{store.ids[0]}.png").is_file()
    assert (tmp_path / "out" / "normal" / f"{store.ids[0]}.png").is_file()
    assert not (tmp_path / "out" / "rgb").exists()
    told = CliRunner().invoke(main, ["export", "--help"]).output
    assert "n = (png - 128) / 127" in told
    assert "(png - 32768) / 32767" in told
    wrong = CliRunner().invoke(
        main,
        [*arguments[:2], str(tmp_path / "no"), "--format", "png", "--modalities", "normals"],
    )
    assert wrong.exit_code == 1
    assert "found 'normals'" in wrong.stderr
    assert not (tmp_path / "no").exists()
    rerun = ["export", str(store.path), str(tmp_path / "no.rrd"), "--format", "rerun"]
    assert CliRunner().invoke(main, [*rerun, "--modalities", "hha"]).exit_code == 2


def test_archives_hold_what_is_asked_for(store: Store, tmp_path: Path) -> None:
    export_frames(store, tmp_path / "out", "npz", modalities=["normal", "depth"])
    with np.load(tmp_path / "out" / f"{store.ids[0]}.npz") as archive:
        assert {"depth_m", "normal", "K"} <= set(archive)
        assert not {"rgb", "hha", "label"} & set(archive)


def test_with_colour_and_depth_the_folder_converts_back(store: Store, tmp_path: Path) -> None:
    exported(store, tmp_path / "out", "rgb", "depth", "hha")
    again = nimprep.convert(
        tmp_path / "out",
        tmp_path / "again.zarr",
        description=tmp_path / "out" / "description.json",
        modalities=["rgb", "depth"],
    )
    for name in ("rgb", "depth"):
        for number in range(len(store)):
            images = (one.arrays[name].read(number) for one in (store, again))
            np.testing.assert_array_equal(*images)


def test_a_wrong_call_in_python_is_refused(store: Store, tmp_path: Path) -> None:
    with pytest.raises(ArrayError, match="put them in a list"):
        export_frames(store, tmp_path / "out", modalities="hha")
    with pytest.raises(ArrayError, match="'png' or 'npz' with them"):
        export_frames(store, tmp_path / "out.rrd", "rerun", modalities=["hha"])
    with pytest.raises(StoreError, match="expected modalities of rgb"):
        export_frames(store, tmp_path / "out", modalities=[])
