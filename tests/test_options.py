"""Options are said once: tables, commands, keyword arguments and checks agree with the fields."""

from __future__ import annotations

import ast
import inspect
from dataclasses import fields
from pathlib import Path
from typing import Any, TypedDict, get_args, get_type_hints

import click
import numpy as np
import pytest
from click.testing import CliRunner

import nimprep
import nimprep.kitti
import nimprep.torch
from nimprep.cli import main
from nimprep.conversion.journal import option_values
from nimprep.conversion.options import AppendKeywords, ConvertKeywords, ConvertOptions
from nimprep.derive.methods import FILLS, METHODS
from nimprep.errors import ArrayError, LayoutError, NimprepError, OptionError
from nimprep.kitti.names import TARGETS
from nimprep.modality import MODALITIES
from nimprep.options import options_of
from nimprep.readers import READERS, ReaderOptions, open_reader
from nimprep.readers.datasets import DATASETS
from nimprep.splits import SPLIT_RULES
from nimprep.store.spec import PRESETS, chunk_codec
from tests.fakes import write_gmrp

MADE: dict[str, Any] = {"convert": nimprep.ConvertOptions, "append": nimprep.AppendOptions}

OTHER: dict[str, Any] = {
    "description": "d.json",
    "camera": (30.0, 30.0, 16.0, 12.0),
    "gravity": (0.0, 1.0, 0.0),
    "distortion": "refuse",
    "size": "depth",
    "depth_scale": 0.002,
    "label_map": "0:0,9:1",
    "target": "lane",
    "depth_from": "lidar",
    "sparse": True,
    "label_set": "road",
    "variations": ("clone",),
    "camera_index": 1,
    "lists": "lists",
}
"""A value for each option of readers that is not its default."""

OF_FOLDERS = {"camera", "gravity", "distortion", "size", "depth_scale", "label_map"}

TAKES = {
    "gmrp": OF_FOLDERS,
    "kitti-road": {"gravity", "target", "depth_from", "sparse"},
    "folder": OF_FOLDERS | {"description"},
    **{name: OF_FOLDERS | {*dataset.options} for name, dataset in DATASETS.items()},
}

FLAGS = {"label_set": "--labels"}


def test_choices_are_those_of_the_one_table_of_each() -> None:
    options = options_of(nimprep.ConvertOptions)
    for name, table in (
        ("normals", METHODS),
        ("fill", FILLS),
        ("codec", PRESETS),
        ("split_by", SPLIT_RULES),
        ("target", TARGETS),
        ("normal_dtype", MODALITIES["normal"].dtypes),
        ("reader", ("auto", *READERS)),
    ):
        assert sorted(options[name].choices) == sorted(table), name
    assert set(get_args(get_type_hints(chunk_codec)["preset"])) == set(PRESETS)


@pytest.mark.parametrize("command", MADE)
def test_a_command_has_just_the_options_that_the_fields_say(command: str) -> None:
    found: Any = main.get_command(click.Context(main), command)
    given = {p.name: p for p in found.params if isinstance(p, click.Option)}
    options = options_of(MADE[command])
    assert given.keys() - options.keys() == {"intrinsics", "allow_skipped", "quiet"}
    assert list(options) == [f.name for f in fields(MADE[command])]
    for name, option in options.items():
        assert given[name].default == option.default, name
        assert (given[name].help or "") == option.help, name
        assert tuple(getattr(given[name].type, "choices", ())) == option.choices, name


@pytest.mark.parametrize(
    ("call", "made", "keywords"),
    [
        (nimprep.convert, nimprep.ConvertOptions, ConvertKeywords),
        (nimprep.append_frames, nimprep.AppendOptions, AppendKeywords),
    ],
)
def test_the_keyword_arguments_of_a_call_are_the_fields(
    call: Any, made: Any, keywords: Any
) -> None:
    assert isinstance(keywords, type(TypedDict("Some", {})))
    assert get_type_hints(keywords) == get_type_hints(made)
    assert get_type_hints(call)["changes"].__args__ == (keywords,)
    parameters = [p for p in inspect.signature(call).parameters if p != "changes"]
    # Or it could not be given by its name.
    assert not set(parameters) & get_type_hints(made).keys()


@pytest.mark.parametrize("made", MADE.values(), ids=MADE)
def test_the_documentation_names_every_field(made: Any) -> None:
    for name, option in options_of(made).items():
        assert f"    {name} : " in made.__doc__
        assert option.help in made.__doc__


@pytest.mark.parametrize("made", MADE.values(), ids=MADE)
def test_a_value_that_is_no_choice_or_out_of_bounds_is_refused(made: Any) -> None:
    checked = 0
    for name, option in options_of(made).items():
        wrong = ["hope"] if option.choices else []
        wrong += [] if option.least is None else [option.least - 1]
        wrong += [] if option.most is None else [option.most + 1]
        for value in wrong:
            with pytest.raises(ArrayError, match=f"^{name}: expected "):
                made(**{name: value})
            checked += 1
    assert checked > 5


def test_options_are_given_by_name_alone() -> None:
    for made in MADE.values():
        with pytest.raises(TypeError, match="positional"):
            made("gmrp")


@pytest.mark.parametrize("reader", READERS)
def test_a_reader_takes_its_own_options_and_no_other(reader: Any, tmp_path: Path) -> None:
    assert OTHER.keys() == options_of(ReaderOptions).keys() - {"reader"}
    needed = {"description": "d.json"} if reader == "folder" else {}
    for name, value in OTHER.items():
        options = ReaderOptions(**{"reader": reader, **needed, name: value})
        with pytest.raises(LayoutError) as raised:
            open_reader(tmp_path / "nowhere", options)
        assert isinstance(raised.value, OptionError) == (name not in TAKES[reader]), name


def arguments(name: str) -> list[str]:
    if name == "sparse":
        return ["--sparse"]
    if name == "camera":
        return ["--intrinsics", "30,30,16,12"]
    value = OTHER[name]
    return [flag_of(name), ",".join(value) if isinstance(value, tuple) else str(value)]


def flag_of(name: str) -> str:
    return FLAGS.get(name, f"--{name.replace('_', '-')}")


@pytest.mark.parametrize("command", MADE)
@pytest.mark.parametrize("name", sorted(OTHER.keys() - TAKES["gmrp"]))
def test_an_option_that_the_reader_has_not_is_a_wrong_call(
    tmp_path: Path, command: str, name: str
) -> None:
    gmrp, store = write_gmrp(tmp_path / "gmrp", 1), tmp_path / "s.zarr"
    if command == "append":
        nimprep.convert(gmrp, store, camera=(30, 30, 16, 12), modalities=("rgb", "label"))
    call = [command, str(gmrp), str(store), "--reader", "gmrp", *arguments(name)]
    result = CliRunner().invoke(main, call)
    assert result.exit_code == 2
    flag = flag_of(name)
    found = str(OTHER[name])
    assert result.stderr == (
        f"error: {flag}: expected options of the reader gmrp (--camera or --intrinsics, "
        f"--gravity, --distortion, --size, --depth-scale, --label-map), found {found!r}; "
        f"leave out {flag}\n"
    )
    assert store.exists() == (command == "append")


def test_the_layout_that_is_found_decides_which_options_there_are(tmp_path: Path) -> None:
    gmrp = write_gmrp(tmp_path / "gmrp")
    with pytest.raises(OptionError, match="--target: expected options of the reader gmrp"):
        nimprep.convert(gmrp, tmp_path / "s.zarr", target="lane")


def test_what_tells_in_a_store_is_kept_for_a_conversion_that_goes_on() -> None:
    free = {"workers", "restart", "on_error", "scheduler", "overwrite"}
    values = option_values(nimprep.ConvertOptions())
    assert values.keys() == options_of(nimprep.ConvertOptions).keys() - free


WRONG_TYPES = [
    ({"seed": None}, "seed: expected a whole number, found None"),
    ({"seed": 1.5}, r"seed: expected a whole number, found 1\.5"),
    ({"labels": "no"}, "labels: expected True or False, found 'no'"),
    ({"overwrite": 1}, "overwrite: expected True or False, found 1"),
    ({"workers": "2"}, "workers: expected a whole number, found '2'"),
    ({"workers": True}, "workers: expected a whole number, found True"),
    ({"shard_length": 2.5}, r"shard_length: expected a whole number, found 2\.5"),
    (
        {"depth_scale": 5000},
        r"depth_scale: expected 1000 or less, found 5000\.0; give metres per unit: 0\.0002, not",
    ),
    ({"depth_scale": float("nan")}, "depth_scale: expected a finite number, found nan"),
    ({"noise": "0.1", "normals": "nim-edge"}, "noise: expected a finite number"),
    ({"codec": None}, "codec: expected one of fast, small, found None"),
    ({"codec": ["fast"]}, "codec: expected one of fast, small, found"),
    ({"split_file": 3}, "split_file: expected a file, found 3"),
    ({"split_file": "a.json", "split_by": "group"}, "split_file: expected it or split_by"),
    ({"scheduler": 8786}, "scheduler: expected a name, found 8786"),
    ({"crop": (1, 2)}, r"crop: expected 'auto' or four whole numbers from 0, found \(1, 2\)"),
    ({"crop": (1, 2, 3, -4)}, "crop: expected 'auto' or four whole numbers from 0"),
    ({"crop": "aut"}, "crop: expected 'auto' or four whole numbers from 0, found 'aut'"),
    ({"camera": ""}, "camera: expected a file, found ''"),
    ({"camera": (1.0, 2.0)}, "camera: expected a file or four numbers"),
    ({"camera": (1.0, 2.0, 3.0, "x")}, "camera: expected a file or four numbers"),
    ({"modalities": "rgb,depth"}, "modalities: expected a sequence of names, found 'rgb,depth'"),
]


@pytest.mark.parametrize(("given", "said"), WRONG_TYPES)
def test_a_value_of_another_type_is_refused_before_anything_is_done(given: Any, said: str) -> None:
    with pytest.raises(NimprepError, match=f"^{said}"):
        ConvertOptions(**given)


def test_what_numpy_gives_is_taken_as_python_has_it() -> None:
    options = ConvertOptions(
        seed=np.int64(3),
        sparse=np.bool_(True),
        depth_scale=np.float32(0.5),
        crop=np.array([1, 2, 3, 4]),
        camera=np.array([20.0, 20.0, 16.0, 12.0]),
        shard_length=np.uint8(8),
    )
    assert options == ConvertOptions(
        seed=3,
        sparse=True,
        depth_scale=0.5,
        crop=(1, 2, 3, 4),
        camera=(20.0, 20.0, 16.0, 12.0),
        shard_length=8,
    )
    assert type(options.seed) is int
    assert type(options.crop[0]) is int


def test_a_type_checker_knows_which_names_the_package_has() -> None:
    for package in (nimprep, nimprep.torch, nimprep.kitti):
        tree = ast.parse(Path(package.__file__).read_text())
        said = {
            alias.asname
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }
        assert {*package.__all__} - {"__version__"} <= said
        hooks = [n for n in tree.body if isinstance(n, ast.FunctionDef)]
        assert "__getattr__" not in {hook.name for hook in hooks}
