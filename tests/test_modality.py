"""The record of each modality, and that what else names modalities agrees with it."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from dataclasses import fields
from pathlib import Path
from pkgutil import resolve_name

import numpy as np
import pytest

from nimprep import frame
from nimprep.camera import Camera
from nimprep.derive.recipe import DERIVED, Recipe
from nimprep.errors import ArrayError
from nimprep.frame import Frame
from nimprep.modality import MODALITIES, Modality
from nimprep.schema import load_schema
from nimprep.store.spec import NORMAL_SCALES, image_spec, stored_modalities
from nimprep.store.table_specs import TABLES

PACKAGE = Path(frame.__file__).parent
SCHEMAS = Path(__file__).parent.parent / "schemas"


def test_the_attributes_schema_knows_every_modality_and_no_other() -> None:
    known = load_schema("store")["properties"]["modalities"]["properties"]
    assert list(known) == list(MODALITIES)
    for name, modality in MODALITIES.items():
        choices = known[name].get("properties", {}).get("dtype", {}).get("enum", [])
        assert tuple(choices) == modality.dtypes
        assert ("dtype" in known[name].get("required", [])) == bool(modality.dtypes)


@pytest.mark.parametrize("modality", MODALITIES.values(), ids=lambda m: m.name)
def test_the_formats_page_has_a_row_of_every_modality(modality: Modality) -> None:
    page = (SCHEMAS / "README.md").read_text()
    row = re.search(rf"^\| `{modality.name}` \| (.*?) \| (.*?) \|", page, re.MULTILINE)
    assert row is not None
    dtypes = modality.dtypes or (modality.dtype,)
    assert row[1] == ", ".join(image_spec(modality, ()).dims)
    assert row[2] == " or ".join(dtypes)


@pytest.mark.parametrize("modality", MODALITIES.values(), ids=lambda m: m.name)
def test_a_fill_value_is_one_that_the_integers_can_be(modality: Modality) -> None:
    for dtype in modality.dtypes or (modality.dtype,):
        limits = np.iinfo(modality.as_dtype(dtype).dtype)
        assert limits.min <= modality.fill <= limits.max


def test_normals_have_the_steps_of_the_dtype_that_a_store_holds_them_in() -> None:
    held = stored_modalities({"normal": {"dtype": "int16"}, "rgb": {}})
    assert list(held) == ["rgb", "normal"]
    assert (held["normal"].dtype, held["normal"].steps) == ("int16", 32767)
    assert held["rgb"] is MODALITIES["rgb"]
    assert MODALITIES["normal"].as_dtype("int8") == MODALITIES["normal"]
    assert MODALITIES["elevation"].as_dtype("int8") is MODALITIES["elevation"]


def test_the_names_of_the_release_before_are_still_there() -> None:
    assert tuple(MODALITIES) == frame.MODALITIES
    assert {"disparity", "transformed_disparity", "elevation"} <= set(frame.ON_REQUEST)
    assert frame.PLANES["elevation"] == frame.Plane("int16", 1000, "m", -32768)
    assert frame.PLANES["depth"].none == 0
    assert frame.modality_name(" transformed-disparity") == "transformed_disparity"
    assert NORMAL_SCALES == {"int8": 127, "int16": 32767}


@pytest.mark.parametrize("name", DERIVED)
def test_a_derived_modality_is_made_and_described_by_the_functions_it_names(name: str) -> None:
    derived = MODALITIES[name].derived
    assert derived is not None
    assert set(derived.made_from) <= set(MODALITIES) - set(DERIVED)
    for path in (derived.make, derived.describe):
        assert path.startswith("nimprep.derive.")
        assert resolve_name(path).__doc__
    described = Recipe().describe(name)
    assert list(described) == ["method", "parameters"]
    assert described["parameters"]["fill"] == "none"


def test_a_record_imports_no_kernels() -> None:
    code = "import sys, nimprep.modality; print({'numba', 'cv2', 'torch'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


def test_an_image_of_a_frame_is_found_by_its_modalitys_name() -> None:
    camera = Camera(10, 10, 1, 1, 3, 2)
    depth = np.ones((2, 3), np.float32)
    thermal = np.full((2, 3), 290, np.float32)
    taken = Frame("a", camera, depth_m=depth, others={"normal": thermal, "thermal": thermal})
    assert taken.image("depth") is depth
    assert taken.image("normal") is None
    assert taken.image("thermal") is thermal
    with pytest.raises(ArrayError, match=r"image: expected one of rgb, .*thermal, found 'infrared"):
        taken.image("infrared")


def test_no_modality_has_the_name_of_what_else_a_frame_or_a_store_has() -> None:
    attributes = {modality.attribute or name for name, modality in MODALITIES.items()}
    images = {f.name for f in fields(Frame) if "NDArray" in str(f.type)} - {
        "others",
        "cam_to_road",
        "gravity",
    }
    assert images <= attributes
    taken = {f.name for f in fields(Frame)} - images
    assert not {*MODALITIES, *attributes} & {*taken, *TABLES}


def asked_by_name(path: Path) -> list[str]:
    """Return where a file compares something with a modality's name: `name == "normal"`."""
    found = []
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        asked: list[ast.expr] = []
        if isinstance(node, ast.Compare) and not isinstance(node.left, ast.Constant):
            sides = [side for side in node.comparators if not isinstance(side, ast.Subscript)]
            asked = [e for side in sides for e in getattr(side, "elts", [side])]
        if isinstance(node, ast.MatchValue):
            asked = [node.value]
        names = [e.value for e in asked if isinstance(e, ast.Constant)]
        found += [f"{path.name}:{node.lineno}: {name}" for name in names if name in MODALITIES]
    return found


def test_no_code_asks_for_a_modality_by_its_name(tmp_path: Path) -> None:
    asking = tmp_path / "a.py"
    asking.write_text(
        "x = name == 'normal'\ny = name in ('rgb', other)\nz = 'rgb' in names\n"
        "match name:\n    case 'hha':\n        pass\n"
    )
    assert asked_by_name(asking) == ["a.py:1: normal", "a.py:2: rgb", "a.py:5: hha"]
    assert [place for path in PACKAGE.rglob("*.py") for place in asked_by_name(path)] == []
