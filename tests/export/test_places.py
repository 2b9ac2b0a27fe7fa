"""Exported files stay inside OUT, and OUT is whole or not there."""

from __future__ import annotations

import resource
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

import nimprep
from nimprep.cli import main
from nimprep.errors import LayoutError
from nimprep.export import FORMATS, export_frames
from nimprep.export.places import files_of, flat_names, id_of
from nimprep.store.reader import Store
from tests.fakes import write_gmrp

pytestmark = pytest.mark.filterwarnings("ignore:.*(8 bits|not in the store|colour is JPEG)")


def run(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["export", *map(str, arguments)])


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    root = tmp_path_factory.mktemp("gmrp")
    raw = write_gmrp(root / "raw", frames=4)
    return nimprep.convert(raw, root / "s.zarr", camera=(30, 30, 15, 11), shard_length=2)


@pytest.fixture(params=FORMATS)
def form(request: pytest.FixtureRequest) -> str:
    if request.param == "rerun":
        pytest.importorskip("rerun")
    return str(request.param)


HOSTILE = (
    "../x",
    "..",
    ".",
    "/x",
    "//x",
    "a/../../x",
    "a/..",
    "a/./b",
    "a//b",
    "a/",
    "",
    "/",
    ".hidden",
    "a/.hidden/b",
    "x\0y",
    "x\ny",
    "x\u202ey",
    "x\ud800y",
    "x" * 300,
    "ä" * 130,
)


@pytest.mark.parametrize("frame_id", HOSTILE, ids=lambda i: ascii(i[:12]))
def test_an_id_that_could_lead_outside_is_refused_before_anything_is_written(
    store: Store, tmp_path: Path, frame_id: str
) -> None:
    other = nimprep.open_store(store.path)
    other.ids = (frame_id, *store.ids[1:])
    inner = tmp_path / "a" / "b"
    inner.mkdir(parents=True)
    for form in ("png", "npz"):
        with pytest.raises(LayoutError, match="expected an id that can be a file's name") as error:
            export_frames(other, inner / "out", form)
        assert "\n" not in str(error.value)
    assert [p.name for p in tmp_path.rglob("*")] == ["a", "b"]
    # The other frames can be had.
    assert len(export_frames(other, inner / "out", "npz", "1:4")) == 3
    assert sorted(p.name for p in tmp_path.rglob("*.npz")) == [f"00000{i}.npz" for i in (1, 2, 3)]


NAMELESS = {"", "x\ud800y", "x" * 300, "ä" * 130}


@pytest.mark.parametrize("frame_id", [i for i in HOSTILE if i not in NAMELESS], ids=ascii)
def test_a_flat_name_stays_in_its_folder_and_says_its_id(frame_id: str) -> None:
    (name,) = flat_names([frame_id], ".png").values()
    assert id_of(name) == frame_id
    assert Path(name).name == name
    assert name.isascii()
    assert not name.startswith(".")


@pytest.mark.parametrize("frame_id", sorted(NAMELESS), ids=lambda i: ascii(i[:12]))
def test_an_id_without_a_flat_name_is_refused(frame_id: str) -> None:
    with pytest.raises(LayoutError, match="expected an id that can be a file's name"):
        flat_names([frame_id], ".png")


def test_flat_names_are_as_many_as_the_ids() -> None:
    ids = ["a/b", "a_b", "a__b", "a%2Fb", "a b", "a.b", "a.png", "a.jpg/b", "~a", "ä", "A.PNG"]
    names = flat_names(ids, ".png")
    assert len(set(names.values())) == len(ids)
    assert [id_of(name) for name in names.values()] == ids
    assert names["a/b"] == "a%2Fb"
    assert names["a.b"] == "a.b"
    assert not any(".png" in name or ".jpg" in name for name in names.values())
    with pytest.raises(LayoutError, match="'a': expected each id once"):
        flat_names(["a", "a"], ".png")


def test_a_recording_has_no_files_that_an_id_could_name(store: Store, tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    other = nimprep.open_store(store.path)
    other.ids = ("../../x", "/etc/x", *store.ids[2:])
    export_frames(other, tmp_path / "a" / "b.rrd", "rerun")
    assert sorted(str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*")) == ["a", "a/b.rrd"]


def test_ids_in_each_others_way_are_refused() -> None:
    with pytest.raises(LayoutError, match=r"'a\.png/b': expected room .* frame file 'a\.png'"):
        files_of(["a", "a.png/b"], ".png")
    with pytest.raises(LayoutError, match="'a': expected each id once"):
        files_of(["a", "a"], ".png")
    assert set(files_of(["a", "a/b", "a.b"], ".png")) == {"a", "a/b", "a.b"}


def test_a_place_that_is_taken_is_refused_and_left_alone(
    store: Store, tmp_path: Path, form: str
) -> None:
    full, file, link = tmp_path / "full", tmp_path / "file", tmp_path / "link"
    full.mkdir()
    (full / "mine").write_text("mine")
    file.write_text("mine")
    link.symlink_to(tmp_path / "nowhere")
    before = sorted(tmp_path.rglob("*"))
    for out in (full, file, link, store.path / "out", store.path):
        result = run(store.path, out, "--format", form)
        assert result.exit_code == 1, out
        assert result.stderr.startswith(f"error: {out}: expected ")
        assert result.stderr.count("\n") == 1
    assert sorted(tmp_path.rglob("*")) == before
    assert not (store.path / "out").exists()


def test_an_empty_folder_is_taken_and_folders_above_are_made(store: Store, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    assert run(store.path, tmp_path / "empty", "--format", "npz").exit_code == 0
    assert run(store.path, tmp_path / "new" / "er", "--format", "npz").exit_code == 0
    assert len(list((tmp_path / "empty").iterdir())) == 4
    assert len(list((tmp_path / "new" / "er").iterdir())) == 4


def damaged(store: Store, place: Path) -> Path:
    """Return a copy of the store whose last shard of each image is cut."""
    copy = Path(shutil.copytree(store.path, place))
    for modality in store.modalities:
        (path,) = (p for p in (copy / modality / "c" / "1").rglob("*") if p.is_file())
        path.write_bytes(path.read_bytes()[:-40])
    return copy


def test_a_damaged_frame_leaves_nothing(store: Store, tmp_path: Path, form: str) -> None:
    source = damaged(store, tmp_path / "s.zarr")
    result = run(source, tmp_path / "out", "--format", form)
    assert result.exit_code == 1
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["s.zarr"]


@pytest.mark.parametrize("after", [1, 4])
def test_ctrl_c_leaves_nothing(store: Store, tmp_path: Path, form: str, after: int) -> None:
    def progress(step: str, frames: int) -> Callable[[], None]:
        left = iter(range(after - 1))

        def done() -> None:
            if next(left, None) is None:
                raise KeyboardInterrupt

        return done

    with pytest.raises(KeyboardInterrupt):
        export_frames(store, tmp_path / "out", form, progress=progress)
    assert list(tmp_path.iterdir()) == []


@contextmanager
def files_of_at_most(size: int) -> Iterator[None]:
    """Let the system refuse to write more into any file, as a full disk would."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("size", [0, 700])
def test_a_disk_that_is_full_leaves_nothing(
    store: Store, tmp_path: Path, form: str, size: int
) -> None:
    with files_of_at_most(size), pytest.raises(LayoutError, match="expected to write it"):
        export_frames(store, tmp_path / "out", form)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("missing", [20_000, 4_000, 300])
def test_a_disk_that_gets_full_while_a_recording_is_written_leaves_nothing(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, missing: int
) -> None:
    pytest.importorskip("rerun")
    export_frames(store, tmp_path / "whole", "rerun")
    size = (tmp_path / "whole").stat().st_size
    assert size > 30_000
    monkeypatch.setattr("nimprep.export.rerun._ROOM", 4096)
    with files_of_at_most(size - missing), pytest.raises(LayoutError, match="expected to write it"):
        export_frames(store, tmp_path / "out", "rerun")
    assert [path.name for path in tmp_path.iterdir()] == ["whole"]


def test_what_comes_meanwhile_is_not_replaced(store: Store, tmp_path: Path, form: str) -> None:
    out = tmp_path / "out"

    def progress(step: str, frames: int) -> Callable[[], None]:
        out.write_text("mine")
        return lambda: None

    with pytest.raises(LayoutError, match="expected a new"):
        export_frames(store, out, form, progress=progress)
    assert out.read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_wrong_call_exits_2_and_an_unknown_frame_1(store: Store, tmp_path: Path) -> None:
    assert run(store.path, tmp_path / "out").exit_code == 2
    assert run(store.path, tmp_path / "out", "--format", "jpeg").exit_code == 2
    unknown = run(store.path, tmp_path / "out", "--format", "npz", "--frames", "nobody")
    assert unknown.exit_code == 1
    assert "found 'nobody'" in unknown.stderr
    assert run(tmp_path / "none.zarr", tmp_path / "out", "--format", "npz").exit_code == 1
    assert list(tmp_path.iterdir()) == []


def test_the_command_says_how_many_frames_it_wrote(store: Store, tmp_path: Path) -> None:
    result = run(store.path, tmp_path / "out", "--format", "npz", "--frames", "0:2,000003")
    assert result.stdout == f"{tmp_path / 'out'}: 3 frames\n"
    assert result.stderr == ""
