"""Variables of MATLAB files: both formats give the same, which is what was written."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io

from nimprep.errors import DecodeError
from nimprep.images import hdf5_cell_count, read_hdf5_cell
from nimprep.readers.matlab import matlab_variable, numbers_of, texts_of

NUMBERS = [
    np.arange(6, dtype=dtype).reshape(2, 3)
    for dtype in ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8")
]


def cells(*texts: str) -> Any:
    made = np.empty((1, len(texts)), object)
    made[0, :] = texts
    return made


@pytest.mark.parametrize("packed", [True, False])
def test_what_scipy_writes_is_read(tmp_path: Path, packed: bool) -> None:
    path = tmp_path / "a.mat"
    written = {f"n{i}": array for i, array in enumerate(NUMBERS)}
    structs = np.empty((1, 3), [("name", object), ("size", object), ("other", object)])
    for i in range(3):
        structs[0, i] = (f"room {i}", np.array([[i, 2.5]]), cells("x"))
    written |= {"texts": cells("a", "kitchen_0004", "é"), "structs": structs, "text": "plain"}
    scipy.io.savemat(path, written, do_compression=packed)
    for i, array in enumerate(NUMBERS):
        found = matlab_variable(path, f"n{i}")
        np.testing.assert_array_equal(found, array)
        assert found.dtype == array.dtype
        # By columns, as MATLAB counts.
        assert numbers_of(found, path, "n") == [0, 3, 1, 4, 2, 5]
    assert texts_of(matlab_variable(path, "texts"), path, "texts") == ["a", "kitchen_0004", "é"]
    assert matlab_variable(path, "text") == "plain"
    made = matlab_variable(path, "structs", {"name", "size"})
    assert [each["name"] for each in made] == ["room 0", "room 1", "room 2"]
    assert [each["size"].tolist() for each in made] == [[[i, 2.5]] for i in range(3)]
    assert {*made[0]} == {"name", "size"}


def write_hdf5(path: Path) -> None:
    """Write what MATLAB 7.3 does: arrays turned round, cells as references."""
    with h5py.File(path, "w") as file:
        file["numbers"] = np.arange(6, dtype="u2").reshape(2, 3).T

        def refer(name: str, values: list[Any]) -> Any:
            references = np.empty((len(values), 1), h5py.ref_dtype)
            for i, value in enumerate(values):
                references[i, 0] = file.create_dataset(f"#refs#/{name}{i}", data=value).ref
            return references

        letters = [np.array([[ord(c)] for c in text], "u2") for text in ("a", "kitchen_0004")]
        file["texts"] = refer("t", letters)
        file["text"] = letters[1]
        file["text"].attrs["MATLAB_class"] = np.bytes_("char")
        images = [np.full((4, 3), i, "u1") for i in range(2)]
        file.create_group("structs")["image"] = refer("i", images)
        file["structs"]["name"] = refer("s", letters)


def test_version_7_3_gives_the_same(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    write_hdf5(path)
    assert numbers_of(matlab_variable(path, "numbers"), path, "n") == [0, 3, 1, 4, 2, 5]
    assert texts_of(matlab_variable(path, "texts"), path, "texts") == ["a", "kitchen_0004"]
    assert matlab_variable(path, "text") == "kitchen_0004"
    made = matlab_variable(path, "structs", {"name"})
    assert len(made) == 2
    assert {*made[0]} == {"name"}


def test_a_cell_is_read_on_its_own(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    write_hdf5(path)
    assert hdf5_cell_count(path, "structs/image") == 2
    assert hdf5_cell_count(path, "numbers") == hdf5_cell_count(path, "nothing") == 0
    assert (read_hdf5_cell(path, "structs/image", 1) == np.full((4, 3), 1)).all()
    for key, number in (("structs/image", 2), ("structs/image", -1), ("numbers", 0), ("no", 0)):
        with pytest.raises(DecodeError, match=f"expected a cell {number} of '{key}'"):
            read_hdf5_cell(path, key, number)


def test_a_variable_that_is_not_there_is_said(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"b": 1})
    with pytest.raises(DecodeError, match="expected the variable 'a' in a MATLAB file"):
        matlab_variable(path, "a")
    write_hdf5(path)
    with pytest.raises(DecodeError, match="'a'"):
        matlab_variable(path, "a")
    path.write_bytes(b"no MATLAB file" * 40)
    with pytest.raises(DecodeError, match=r"MATLAB file of version 5 or 7\.3"):
        matlab_variable(path, "a")


@pytest.mark.parametrize("packed", [True, False])
def test_a_file_that_is_cut_or_changed_is_an_error_or_what_it_was(
    tmp_path: Path, packed: bool
) -> None:
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"a": cells("one", "two"), "b": NUMBERS[8]}, do_compression=packed)
    whole = path.read_bytes()
    rng = np.random.default_rng(5)
    for end in range(128, len(whole), 7):
        path.write_bytes(whole[:end])
        with pytest.raises(DecodeError):
            matlab_variable(path, "b")
    for _ in range(200):
        changed = bytearray(whole)
        changed[int(rng.integers(128, len(whole)))] = int(rng.integers(256))
        path.write_bytes(changed)
        with suppress(DecodeError):
            matlab_variable(path, "a")


def test_other_values_than_expected_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    for value in (np.array([0.5]), np.array([np.nan]), "text", None, []):
        with pytest.raises(DecodeError, match="expected whole numbers as 'n'"):
            numbers_of(value, path, "n")
    for value in (np.array([0.5]), [], ["a", None], [{}]):
        with pytest.raises(DecodeError, match="expected a cell array of texts as 't'"):
            texts_of(value, path, "t")
