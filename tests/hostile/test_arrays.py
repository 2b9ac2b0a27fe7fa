"""NumPy files: headers that lie, that are code, and what is no array of numbers."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import strategies as st

from nimprep.errors import DecodeError
from nimprep.images import read_array, read_depth, read_header
from nimprep.kitti.images import read_confidence
from tests.hostile.fuzzing import fuzz, limited_time, survives
from tests.hostile.pictures import npy, npy_of, picture

FOOTPRINT = "somebody_was_here"


class Intruder:
    """Leaves a file behind when it is unpickled."""

    def __reduce__(self) -> tuple[object, ...]:
        return (exec, (f"open({FOOTPRINT!r}, 'w')",))


def text(descr: object = "<f4", order: object = "False", shape: object = "(24, 32)") -> str:
    return f"{{'descr': {descr!r}, 'fortran_order': {order}, 'shape': {shape}, }}\n"


RECORD = np.zeros((24, 32), [("z", "<f4"), ("label", "u1")])
OBJECTS = np.full((2, 2), None)
OBJECTS[0, 0] = Intruder()

BAD = {
    "objects": npy(OBJECTS, pickled=True),
    "a pickle": pickle.dumps(Intruder()),
    "records": npy(RECORD),
    "a shape of 2**64": npy_of(text(shape=f"({1 << 32}, {1 << 32})")),
    "a shape of 100000x100000": npy_of(text(shape="(100000, 100000)")),
    "a shape without end": npy_of(text(shape=f"({'9' * 5000},)")),
    "many dimensions": npy_of(text(shape=f"({'1, ' * 100})"), bytes(4)),
    "a negative side": npy_of(text(shape="(-1, 32)"), bytes(64)),
    "fewer numbers than claimed": npy(picture("float32", 1))[:-4],
    "code for a shape": npy_of(text(shape="(().__class__.__bases__[0],)")),
    "code for a type": npy_of(text(descr="<f4', __import__('os').system('true'), '")),
    "brackets in brackets": npy_of("(" * 60_000),
    "minus after minus": npy_of(f"{'-' * 60_000}1"),
    "a header longer than the file": b"\x93NUMPY\2\0\xff\xff\xff\xff{",
    "a type of no size": npy_of(text(descr="<U0"), bytes(64)),
    "a type of 99 bytes": npy_of(text(descr="<f99"), bytes(64)),
    "dates": npy_of(text(descr="<M8[ns]"), bytes(8 * 24 * 32)),
    "version 9": npy_of(text(), bytes(4 * 24 * 32), version=9),
    "an archive": b"PK\3\4" + bytes(60),
    "nothing": b"",
}


@pytest.mark.parametrize("case", BAD)
def test_a_file_that_is_no_array_of_numbers_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, case: str
) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "a.npy"
    path.write_bytes(BAD[case])
    for reader in (read_array, read_depth, read_header, read_confidence):
        with limited_time(), pytest.raises(DecodeError, match=r"a\.npy: expected"):
            reader(path)
    assert not Path(FOOTPRINT).exists()


@pytest.mark.parametrize("dtype", ["<f2", ">f4", "<f8", "|u1", ">u2", "<i4", "|b1"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_an_array_reads_back(tmp_path: Path, dtype: str, order: str) -> None:
    array = np.asarray(np.arange(6).reshape(2, 3) % 2, dtype, order=order)
    np.save(tmp_path / "a.npy", array)
    found = read_array(tmp_path / "a.npy")
    assert np.array_equal(found, array)
    assert found.flags.c_contiguous
    assert found.dtype == array.dtype.newbyteorder("=")


HEADERS = st.builds(
    text,
    descr=st.sampled_from(["<f4", "|u1", "|O", "<U9", "f4", "|V8", "<c8", ">f8", "?"]),
    order=st.sampled_from(["False", "True", "1", "None"]),
    shape=st.lists(st.integers(-2, 1 << 40), max_size=4).map(lambda s: str(tuple(s)))
    | st.sampled_from(["(24, 32)", "(24,32,1)", "[24, 32]", "()", "(24L, 32L)", "24", "(1e3, 2)"]),
)


@fuzz(
    150,
    header=HEADERS | st.text(max_size=60).filter(lambda t: t.isascii()),
    data=st.binary(max_size=64) | st.just(bytes(4 * 24 * 32)),
    version=st.sampled_from([1, 2, 3]),
)
def test_any_header_is_read_or_refused(
    tmp_path: Path, header: str, data: bytes, version: int
) -> None:
    path = tmp_path / "a.npy"
    path.write_bytes(npy_of(header, data, version))
    for reader in (read_array, read_depth, read_confidence):
        survives("arrays, .npy", lambda reader=reader: reader(path))
