"""Stores whose depth counts in another unit than millimetres: what everything makes of them."""

from __future__ import annotations

import json
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import nimprep
from nimprep.cli import main
from nimprep.errors import DecodeError, DepthLossWarning, LayoutError, StoreError
from nimprep.export.formats import export_frames
from nimprep.schema import schema_problems
from nimprep.store.info import info_text, store_info
from nimprep.store.statistics import channel_statistics
from nimprep.store.validate import validate_store
from tests.checksums import edit_attributes
from tests.fakes import contents, write_gmrp, write_png

pytestmark = pytest.mark.filterwarnings("ignore:.*no calibration", "ignore:.*nominal")

SIZE = (24, 32)
CAMERA = (30.0, 30.0, 15.5, 8.0)
Write = Callable[[Path, np.ndarray], object]


def far_road(number: int = 0, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Return a road to 655 m under a sky without depth, float64 metres."""
    rows = np.arange(size[0])[:, None] - 8.0
    road = 1.2 * 30 / np.maximum(rows, 1e-9) + 0.01 * number
    wall = np.linspace(40, 655, size[1])[None, :]
    return np.where(rows > 0, road, np.where(rows > -3, wall, 0)) * np.ones(size)


def write_folder(
    root: Path, depth: dict[str, Any], write: Write, suffix: str, frames: int = 3
) -> dict[str, Any]:
    """Write a described dataset; return what `convert` takes beside its folder."""
    for number in range(frames):
        rng = np.random.default_rng(number)
        write_png(root / f"rgb/{number}.png", rng.integers(0, 256, (*SIZE, 3), dtype=np.uint8))
        path = root / f"depth/{number}{suffix}"
        path.parent.mkdir(exist_ok=True)
        write(path, far_road(number))
    document = {
        "format": "nimprep-folder",
        "version": "1.1",
        "name": "far",
        "rgb": "rgb/{id}.png",
        "depth": {"files": f"depth/{{id}}{suffix}", **depth},
    }
    (root / "d.json").write_text(json.dumps(document))
    return {"description": root / "d.json", "camera": CAMERA}


def centimetres(root: Path, **depth: Any) -> dict[str, Any]:
    """Write Virtual KITTI's depth: centimetres, 65535 for the sky."""

    def write(path: Path, depth_m: np.ndarray) -> None:
        raw = np.rint(depth_m * 100).astype(np.uint16)
        write_png(path, np.where(depth_m > 0, raw, 65535).astype(np.uint16))

    return write_folder(root, {"scale_m": 0.01, "invalid": [65535], **depth}, write, ".png")


def floats(root: Path, **depth: Any) -> dict[str, Any]:
    """Write float32 metres."""
    write = lambda path, depth_m: np.save(path, depth_m.astype(np.float32))  # noqa: E731
    return write_folder(root, {"scale_m": 1, **depth}, write, ".npy")


def converted(root: Path, options: dict[str, Any], **more: Any) -> nimprep.Store:
    return nimprep.convert(root, root.parent / "s.zarr", **{**options, **more})


def quiet_convert(*args: Any, **options: Any) -> nimprep.Store:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return nimprep.convert(*args, **options)


def test_centimetres_are_stored_as_they_are(tmp_path: Path) -> None:
    root = tmp_path / "raw"
    options = centimetres(root)
    store = quiet_convert(root, tmp_path / "s.zarr", **options)
    depth = store.modality("depth")
    assert (depth.step, depth.most, depth.rounded) == (0.01, 655.35, False)
    assert store.about.format_version == "2.0"
    assert store.about.modalities["depth"]["unit_m"] == 0.01
    for number, frame in enumerate(store):
        raw = np.rint(far_road(number) * 100)
        assert np.array_equal(store.arrays["depth"].read(number), raw)
        assert frame.depth_m is not None
        assert np.array_equal(frame.depth_m, (raw / np.float32(100)).astype(np.float32))
    assert frame.depth_m.max() == pytest.approx(655, abs=0.005)
    assert validate_store(store.path, deep=True).problems == []
    assert validate_store(store.path, deep=True).checks["frames recomputed"] == 3
    assert schema_problems(store_info(store), "info") == []


def test_the_bytes_do_not_depend_on_workers_or_on_a_kill(tmp_path: Path) -> None:
    root = tmp_path / "raw"
    options = centimetres(root) | {"shard_length": 1}
    nimprep.convert(root, tmp_path / "a.zarr", workers=1, **options)
    whole = (root / "depth/1.png").read_bytes()
    (root / "depth/1.png").write_bytes(whole[:-20])
    with pytest.raises(DecodeError):
        nimprep.convert(root, tmp_path / "b.zarr", workers=3, **options)
    (root / "depth/1.png").write_bytes(whole)
    nimprep.convert(root, tmp_path / "b.zarr", workers=3, **options)
    assert contents(tmp_path / "a.zarr") == contents(tmp_path / "b.zarr")


def test_other_libraries_read_metres_by_the_scale_factor(tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    root = tmp_path / "raw"
    store = converted(root, centimetres(root))
    with xarray.open_zarr(store.path) as found:
        assert found.depth.attrs["units"] == "m"
        np.testing.assert_allclose(
            found.depth.values, np.where(far_road() > 0, [f.depth_m for f in store], np.nan)
        )
        assert "depth in cm" in found.channel_sums.attrs["channels"]


def test_loaders_give_metres_and_as_stored_the_store_s_integers(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch")
    from nimprep.torch import NIM, StoreDataset, StoreLoader
    from nimprep.torch.normalization import Normalize

    root = tmp_path / "raw"
    store = converted(root, centimetres(root))
    depth_m = np.stack([frame.depth_m for frame in store])
    plain = StoreDataset(store.path, split=None, setup="depth", normalize="none")
    assert np.array_equal(plain[1]["inputs"][0].numpy(), depth_m[1])
    for batch in StoreLoader(plain, batch_size=3, num_threads=2):
        assert np.array_equal(batch["inputs"][:, 0].numpy(), depth_m)
    # Divided by 10 m, as of every store.
    scaled = StoreDataset(store.path, split=None, setup="depth")
    np.testing.assert_allclose(scaled[1]["inputs"][0].numpy(), depth_m[1] / 10, rtol=1e-6)
    stored = StoreDataset(store.path, split=None, setup="depth", dtype="stored")
    assert stored[1]["depth"].dtype == torch.uint16
    assert np.array_equal(stored[1]["depth"][0].numpy(), store.arrays["depth"].read(1))
    assert torch.equal(Normalize(stored)(stored[1])["inputs"], scaled[1]["inputs"])
    # Transforms and the layer take metres.
    seen = StoreDataset(store.path, split=None, setup="depth", transform=lambda s: s)
    np.testing.assert_allclose(seen[1]["inputs"], scaled[1]["inputs"], rtol=1e-6)
    made = StoreDataset(store.path, split=None, setup="nim-depth", normals="nim")[0]["inputs"]
    layer = NIM()(torch.from_numpy(depth_m[:1, None]), plain[0]["intrinsics"][None])[0]
    assert torch.allclose(made, layer, atol=1e-4)
    assert np.allclose(made.permute(1, 2, 0), store[0].normal, atol=0.02)


def test_statistics_and_percentiles_are_in_metres(tmp_path: Path) -> None:
    root = tmp_path / "raw"
    store = converted(root, centimetres(root))
    depth_m = np.stack([frame.depth_m for frame in store]).astype(np.float64)
    known = np.sort(depth_m[depth_m > 0])
    found = channel_statistics(store, None)["depth"]
    np.testing.assert_allclose(found.mean, [known.mean()], rtol=1e-6)
    np.testing.assert_allclose(found.std, [known.std()], rtol=1e-6)
    percentiles = store.about.depth_percentiles_m
    assert percentiles is not None
    for share, value in percentiles.items():
        assert value == pytest.approx(known[-(-int(share) * known.size // 100) - 1], abs=1e-4)


@pytest.mark.parametrize("unit", ["auto", "cm", "0.0125", "1/64", 1 / 256])
def test_pngs_of_any_unit_come_back_with_every_value(tmp_path: Path, unit: Any) -> None:
    root = tmp_path / "raw"
    options = centimetres(root, range_m=[None, 250])
    store = converted(root, options, depth_unit=unit)
    export_frames(store, tmp_path / "png")
    document = json.loads((tmp_path / "png/description.json").read_text())
    assert document["depth"]["scale_m"] == store.modality("depth").step
    back = nimprep.convert(
        tmp_path / "png", tmp_path / "t.zarr", description=tmp_path / "png/description.json"
    )
    assert back.modality("depth").step == store.modality("depth").step
    for one, other in zip(store, back, strict=True):
        assert np.array_equal(one.depth_m, other.depth_m)


def test_pngs_of_depth_finer_than_a_millimetre_say_how_they_come_back(tmp_path: Path) -> None:
    root = tmp_path / "raw"
    store = converted(root, floats(root, range_m=[None, 6]), depth_unit=0.0002)
    with pytest.warns(UserWarning, match=r"depth in 0\.2 mm: .* --depth-unit 0\.0002"):
        export_frames(store, tmp_path / "png")
    back = nimprep.convert(
        tmp_path / "png",
        tmp_path / "t.zarr",
        description=tmp_path / "png/description.json",
        depth_unit=0.0002,
    )
    assert np.array_equal(store[0].depth_m, back[0].depth_m)


def test_the_other_exports_and_the_report_are_in_metres(tmp_path: Path) -> None:
    root = tmp_path / "raw"
    store = converted(root, centimetres(root))
    export_frames(store, tmp_path / "npz", "npz")
    with np.load(tmp_path / "npz/1.npz") as found:
        assert np.array_equal(found["depth_m"], store[1].depth_m)
    from nimprep.report.collect import collect, physical
    from nimprep.report.depth_charts import depth_quantiles

    facts = collect(store)
    (last,) = depth_quantiles(facts, (1.0,))
    assert last == pytest.approx(655, abs=0.01)
    assert facts.depth.number_of(int(facts.farthest.max())) == pytest.approx(655, abs=0.01)
    stored = store.arrays["depth"].read(0)
    assert np.nanmax(physical(store, "depth", stored)) == pytest.approx(655, abs=0.01)


def test_a_recording_is_told_the_unit(tmp_path: Path) -> None:
    rerun = pytest.importorskip("rerun")
    from nimprep.export.rerun import _entries

    root = tmp_path / "raw"
    image = _entries(converted(root, centimetres(root)), 0)["camera/depth"]
    assert isinstance(image, rerun.DepthImage)
    assert image.meter.as_arrow_array().to_pylist() == [100.0]


def test_floats_that_are_said_to_go_far_have_the_unit_for_it(tmp_path: Path) -> None:
    root = tmp_path / "raw"
    options = floats(root, range_m=[None, 655.2])
    # A wall near by, 3 mm deeper with each pixel; and something far away.
    raw = np.tile(np.float32(2) + np.arange(SIZE[1], dtype=np.float32) * np.float32(0.003), (24, 1))
    raw[0, 0] = 655
    np.save(root / "depth/1.npy", raw)
    store = quiet_convert(root, tmp_path / "s.zarr", **options)
    assert store.modality("depth").step == 0.01
    assert store.about.depth_lost is None
    depth_m, normal = store[1].depth_m, store[1].normal
    assert depth_m is not None
    assert normal is not None
    assert np.abs(depth_m - raw).max() <= 0.00501
    # The normals are those of depth before it was rounded, which would not give them.
    made, rough = (nimprep.estimate_normals(d, store[1].camera) for d in (raw, depth_m))
    assert np.abs(normal - made).max() < 1.5 / 127
    assert np.abs(rough - made).max() > 0.1
    report = validate_store(store.path, deep=True)
    assert report.problems == []
    assert report.checks["frames not recomputed, depth being rounded"] == 3


def test_floats_of_which_nobody_says_how_far_they_go_are_millimetres_and_the_loss_is_said(
    tmp_path: Path,
) -> None:
    root = tmp_path / "raw"
    options = floats(root)
    with pytest.warns(DepthLossWarning) as said:
        store = nimprep.convert(root, tmp_path / "s.zarr", **options)
    raw = np.stack([far_road(n) for n in range(3)])
    lost, known = (raw > 65.5355).sum(), (raw > 0).sum()
    found = store.about.depth_lost
    assert found is not None
    assert (found["pixels"], found["frames"]) == (lost, 3)
    assert found["share"] == pytest.approx(lost / known)
    assert (found["beyond_m"], found["farthest_m"]) == (65.535, 655)
    assert "nearer_m" not in found
    wanted = f"{100 * lost / known:.2g} % of the depth, in 3 frames, is none in the store: it lies"
    line = f"{wanted} beyond 65.535 m, the farthest at 655 m; --depth-unit 0.01 keeps it"
    assert [line in str(one.message) for one in said if one.category is DepthLossWarning] == [True]
    assert line in info_text(store_info(store))
    assert "1 mm, to 65.535 m" in info_text(store_info(store))
    from nimprep.report.collect import collect
    from nimprep.report.findings import find

    (finding,) = (f for f in find(store, collect(store)) if f.kind == "depth-lost")
    assert finding.severity == "problem"
    assert line[1:] in finding.text
    assert validate_store(store.path, deep=True).problems == []
    # What the line says helps.
    store = quiet_convert(root, tmp_path / "t.zarr", depth_unit=0.01, **options)
    assert store.about.depth_lost is None


def test_depth_nearer_than_half_a_unit_is_said_too(tmp_path: Path) -> None:
    root = tmp_path / "raw"
    options = floats(root)
    raw = np.load(root / "depth/0.npy")
    raw[-1, -1] = 0.4
    np.save(root / "depth/0.npy", raw)
    said = r"nearer than 0\.5 m; a finer --depth-unit keeps it"
    with pytest.warns(DepthLossWarning, match=said):
        store = nimprep.convert(root, tmp_path / "s.zarr", depth_unit=1, **options)
    assert store.about.depth_lost == {
        "pixels": 1,
        "frames": 1,
        "share": pytest.approx(1 / (raw.astype(bool).sum() * 3)),
        "nearer_m": 0.5,
    }


@pytest.mark.parametrize(
    ("depth", "unit_m", "rounded"),
    [
        ({"scale_m": 0.01}, 0.01, False),
        ({"scale_m": 0.01, "offset_m": -0.02}, 0.01, False),
        ({"scale_m": 0.01, "offset_m": -0.005}, 0.01, True),
        ({"scale_m": 0.01, "values": "distance"}, 0.01, True),
        ({"scale_m": 0.001, "range_m": [None, 100]}, 0.001, False),
        ({"scale_m": 1000 / 65535, "clip_m": 60}, 1000 / 65535, False),
    ],
)
def test_a_description_tells_the_unit(
    tmp_path: Path, depth: dict[str, Any], unit_m: float, rounded: bool
) -> None:
    root = tmp_path / "raw"
    write = lambda path, metres: write_png(path, np.full(SIZE, 500, np.uint16))  # noqa: E731
    options = write_folder(root, depth, write, ".png", frames=1)
    held = converted(root, options, modalities=("rgb", "depth")).modality("depth")
    assert held.step == pytest.approx(unit_m, rel=1e-12)
    assert held.rounded is rounded


def test_a_bad_first_frame_does_not_change_the_unit(tmp_path: Path) -> None:
    root = tmp_path / "raw"
    options = centimetres(root)
    (root / "depth/0.png").write_bytes(b"no image")
    store = converted(root, options, on_error="skip")
    assert store.modality("depth").step == 0.01
    assert len(store) == 2


def more_frames(tmp_path: Path, make: Callable[..., dict[str, Any]]) -> tuple[Path, dict[str, Any]]:
    """Write three frames with ids of their own."""
    root = tmp_path / "more"
    options = make(root)
    for folder in ("rgb", "depth"):
        for path in sorted((root / folder).iterdir()):
            path.rename(path.with_stem(f"x{path.stem}"))
    return root, options


def test_frames_are_appended_in_the_store_s_unit(tmp_path: Path) -> None:
    root = tmp_path / "raw"
    store = converted(root, centimetres(root))
    more, options = more_frames(tmp_path, centimetres)
    grown = nimprep.append_frames(more, store.path, **options).store
    assert grown.about.format_version == "2.0"
    assert grown.modality("depth").step == 0.01
    for number in range(3):
        assert np.array_equal(grown[number].depth_m, grown[number + 3].depth_m)
    assert validate_store(grown.path, deep=True).problems == []


def test_finer_depth_is_not_appended_to_a_store_that_would_round_it(tmp_path: Path) -> None:
    root = tmp_path / "raw"
    store = converted(root, centimetres(root))
    more, options = more_frames(tmp_path, floats)
    with pytest.raises(LayoutError, match=r"steps of 1 cm, which .* found finer ones; convert it"):
        nimprep.append_frames(more, store.path, **options)


def test_what_an_append_loses_is_said_of_all(tmp_path: Path) -> None:
    root = tmp_path / "raw"
    options = floats(root)
    with pytest.warns(DepthLossWarning):
        store = converted(root, options)
    before = store.about.depth_lost
    more, options = more_frames(tmp_path, floats)
    with pytest.warns(DepthLossWarning, match="in 6 frames"):
        grown = nimprep.append_frames(more, store.path, **options).store
    assert before is not None
    assert grown.about.depth_lost == {**before, "pixels": 2 * before["pixels"], "frames": 6}
    merged = nimprep.merge_stores(
        [grown.path, grown.path], tmp_path / "m.zarr", prefixes=["a", "b"]
    )
    assert merged.about.depth_lost == {**before, "pixels": 4 * before["pixels"], "frames": 12}


def test_stores_of_one_unit_merge_and_others_are_refused(tmp_path: Path) -> None:
    root = tmp_path / "raw"
    options = centimetres(root, range_m=[None, 60])
    one = nimprep.convert(root, tmp_path / "a.zarr", **options).path
    other = nimprep.convert(root, tmp_path / "b.zarr", depth_unit="mm", **options).path
    merged = nimprep.merge_stores([one, one], tmp_path / "m.zarr", prefixes=["a/", "b/"])
    assert merged.modality("depth").step == 0.01
    assert merged.about.depth_percentiles_m == nimprep.open_store(one).about.depth_percentiles_m
    assert validate_store(merged.path, deep=True).problems == []
    arguments = ["merge", str(one), str(other), str(tmp_path / "n.zarr"), "--prefix", "a/,b/"]
    done = CliRunner().invoke(main, arguments)
    assert done.exit_code == 1
    assert done.stderr.strip() == (
        f"error: {other}: expected a depth unit of 1 cm as in {one}, found 1 mm; convert one of "
        "the two anew with --depth-unit 0.01"
    )


def test_a_store_of_another_unit_is_refused_by_versions_before_and_where_it_is_mislabelled(
    tmp_path: Path,
) -> None:
    root = tmp_path / "raw"
    path = Path(converted(root, centimetres(root)).path)
    # Those before 2.0 take every 1.x for millimetres, and refuse another number before the dot.
    assert json.loads((path / "zarr.json").read_text())["attributes"]["nimprep"]["format_version"]
    edit_attributes(path, format_version="1.2")
    with pytest.raises(StoreError, match=r"expected store format 2\.0, found '1\.2'"):
        nimprep.open_store(path)
    modalities = nimprep.store.metadata.read_attributes(path)["modalities"]
    del modalities["depth"]["unit_m"]
    edit_attributes(path, modalities=modalities)
    with pytest.raises(StoreError, match=r"depth.*expected scale_factor 0\.001, found 0\.01"):
        nimprep.open_store(path)
    edit_attributes(path, format_version="2.0")
    with pytest.raises(StoreError, match=r"expected store format 1\.2, found '2\.0'"):
        nimprep.open_store(path)


def test_the_command_takes_the_unit_and_says_it(tmp_path: Path) -> None:
    root = tmp_path / "raw"
    options = centimetres(root, range_m=[None, 90])
    command = ["convert", str(root), str(tmp_path / "s.zarr"), "--description"]
    command += [str(options["description"]), "--intrinsics", "30,30,15.5,8"]
    done = CliRunner().invoke(main, [*command, "--depth-unit", "1/512"])
    assert done.exit_code == 0, done.stderr
    assert "unit     1/512 m, to 127.998 m" in done.stdout
    done = CliRunner().invoke(main, [*command, "--depth-unit", "512"])
    assert done.exit_code == 2
    assert "--depth-unit: expected 0.0001 to 1 m, found 512; give metres per unit" in done.stderr


def test_gmrp_stays_in_millimetres_to_the_byte(tmp_path: Path) -> None:
    root = write_gmrp(tmp_path / "gmrp", frames=5, size=(12, 16))
    options = {"shard_length": 3, "camera": (15.0, 15.5, 7.5, 5.5)}
    store = nimprep.convert(root, tmp_path / "s.zarr", **options)
    assert store.about.format_version == "1.2"
    before = contents(Path(__file__).parent.parent / "store/data/format-1.1")
    after = contents(Path(store.path))
    assert before.keys() == after.keys()
    # What is derived depends on the machine's arithmetic.
    same = [n for n in before if n.split("/")[0] in ("rgb", "depth", "label")]
    assert len(same) == 9
    assert [n for n in same if before[n] != after[n]] == []
    document = json.loads(after["zarr.json"])["attributes"]["nimprep"]
    was = json.loads(before["zarr.json"])["attributes"]["nimprep"]
    assert document["modalities"]["depth"] == was["modalities"]["depth"]
    assert document.keys() == was.keys()


def test_orfd_s_frame_is_stored_as_it_is(reference_data: Path, tmp_path: Path) -> None:
    from nimprep.images import read_depth

    source = shutil.copytree(reference_data / "orfd", tmp_path / "orfd")
    scene = "testing/y0613_1242"
    document = {
        "format": "nimprep-folder",
        "version": "1.1",
        "name": "orfd",
        "id": "{id}",
        "rgb": f"{scene}/image_data/{{id}}.png",
        "depth": {"files": f"{scene}/dense_depth/{{id}}.png", "scale_m": 0.00390625},
        "camera": f"{scene}/calib/{{id}}.txt",
    }
    (source / "d.json").write_text(json.dumps(document))
    options = {"description": source / "d.json", "modalities": ("rgb", "depth", "normal")}
    store = quiet_convert(source, tmp_path / "s.zarr", **options)
    (path,) = (source / scene / "dense_depth").iterdir()
    raw = read_depth(path)
    depth_m = store[0].depth_m
    assert depth_m is not None
    assert (raw / 256 > 65.535).sum() > 0.02 * (raw > 0).sum()
    assert (depth_m[raw > 0] == 0).mean() <= 0.001
    assert np.abs(depth_m - raw / 256).max() <= 0.01
    assert np.array_equal(store.arrays["depth"].read(0), raw)
    assert validate_store(store.path, deep=True).problems == []
