import json
from dataclasses import MISSING, fields, replace
from pathlib import Path
from typing import Any, NotRequired, get_origin, get_type_hints

import pytest

import nimprep
from nimprep.schema import load_schema, schema_problems
from nimprep.store import attributes
from nimprep.store.attributes import PastSplit, Source, Split, StoreAttributes
from nimprep.store.metadata import read_attributes, write_attributes
from nimprep.store.resplit import resplit
from tests.fakes import write_gmrp

SCHEMA = load_schema("store")
FIELDS = [field for field in fields(StoreAttributes) if field.name != "document"]
OPTIONAL = [f.name for f in FIELDS if not (f.default is MISSING and f.default_factory is MISSING)]


@pytest.fixture(scope="module")
def document(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("attributes")
    write_gmrp(folder / "gmrp")
    (folder / "gmrp" / "camera.json").write_text('{"fx": 30, "fy": 31, "cx": 15, "cy": 11}')
    return nimprep.convert(folder / "gmrp", folder / "out.zarr").attributes


def test_the_fields_are_the_properties_of_the_schema() -> None:
    assert sorted(field.name for field in FIELDS) == sorted(SCHEMA["properties"])


def test_what_the_schema_requires_has_no_default() -> None:
    required = [field.name for field in FIELDS if field.name not in OPTIONAL]
    assert sorted(required) == sorted(SCHEMA["required"])


@pytest.mark.parametrize(
    ("part", "kind"), [("split", Split), ("split_before", PastSplit), ("source", Source)]
)
def test_the_parts_that_have_a_type_are_those_of_the_schema(part: str, kind: Any) -> None:
    forms = SCHEMA["properties"][part].get("oneOf", [SCHEMA["properties"][part]])
    names = {name for form in forms for name in form["properties"]}
    always = set.intersection(*(set(form["required"]) for form in forms))
    hints = get_type_hints(kind, include_extras=True)
    assert names == set(hints)
    assert always == {name for name in names if get_origin(hints[name]) is not NotRequired}


def test_an_object_stays_what_it_is_to_the_order_of_its_names(document: dict[str, Any]) -> None:
    for names in (document, sorted(document), sorted(document, reverse=True)):
        found = {
            "mine": {"a": [1.0, None]},
            **{n: document[n] for n in names},
            "calibration": {"by": "me", "origin": "user", "on": 3},
            "skipped": [],
            "frame_metadata": {},
            "yours": None,
        }
        again = StoreAttributes.from_json(found).to_json()
        assert json.dumps(again) == json.dumps(found)


def test_a_new_object_has_its_names_in_the_order_of_the_fields(document: dict[str, Any]) -> None:
    about = StoreAttributes.from_json(document)
    values = {field.name: getattr(about, field.name) for field in FIELDS}
    made = StoreAttributes(**values)
    assert made == about
    assert json.dumps(made.to_json()) == json.dumps(document)
    assert [n for n in values if n in document] == list(document)


def test_what_is_replaced_keeps_its_place_and_the_rest_stays(document: dict[str, Any]) -> None:
    found = {"mine": 1, **document}
    again = replace(StoreAttributes.from_json(found), codec="other").to_json()
    assert list(again.items()) == [(k, "other" if k == "codec" else v) for k, v in found.items()]


@pytest.mark.parametrize("name", OPTIONAL)
def test_what_gets_its_default_goes_and_what_gets_a_value_comes(
    document: dict[str, Any], name: str
) -> None:
    about = StoreAttributes.from_json(document)
    default = attributes._DEFAULTS[name]
    added = replace(about, **{name: {"there": 1}})
    assert added.to_json() == {**document, name: {"there": 1}}
    again = replace(StoreAttributes.from_json(added.to_json()), **{name: default})
    assert again.to_json() == {k: v for k, v in document.items() if k != name}


def test_a_store_tells_its_attributes_by_name_as_they_are_now(tmp_path: Path) -> None:
    write_gmrp(tmp_path / "gmrp", frames=3)
    (tmp_path / "gmrp" / "camera.json").write_text('{"fx": 30, "fy": 31, "cx": 15, "cy": 11}')
    store = nimprep.convert(tmp_path / "gmrp", tmp_path / "out.zarr", modalities=("rgb", "depth"))
    assert type(store.attributes) is dict
    assert store.about.to_json() == store.attributes
    assert schema_problems(store.about.to_json(), "store") == []
    store.attributes["dataset"] = "another"
    assert store.about.dataset == "another"


def test_a_users_own_attributes_outlive_a_new_split_untouched(tmp_path: Path) -> None:
    write_gmrp(tmp_path / "gmrp", frames=3)
    (tmp_path / "gmrp" / "camera.json").write_text('{"fx": 30, "fy": 31, "cx": 15, "cy": 11}')
    out = tmp_path / "out.zarr"
    nimprep.convert(tmp_path / "gmrp", out, modalities=("rgb", "depth"))
    mine = {"mine": {"z": 1.0, "a": [None]}, **read_attributes(out)}
    mine["source"] = {"url": "somewhere", **mine["source"]}
    write_attributes(out, mine)
    before = read_attributes(out)
    resplit(out, seed=5)
    after = read_attributes(out)
    assert list(after) == list(before)
    assert {n for n in after if after[n] != before[n]} == {"split", "tables", "digest"}
    assert json.dumps(after["mine"]) == json.dumps(mine["mine"])
    assert json.dumps(after["source"]) == json.dumps(mine["source"])
