"""Predictions of a store's frames are those of the network, in files that others take."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from click.testing import CliRunner

import nimprep
from nimprep.cli import main
from nimprep.errors import ArrayError, LayoutError, StoreError
from nimprep.evaluation import evaluate_predictions
from nimprep.frame import LabelClass
from nimprep.networks import NETWORKS, load_run, read_checkpoint
from nimprep.networks.beside import extra_inputs
from nimprep.options import options_of
from nimprep.schema import schema_problems
from nimprep.torch import StoreDataset
from nimprep.torch.scaling import Scaling
from nimprep.training import PredictOptions, TrainOptions, predict, train
from nimprep.training.data import Feed
from nimprep.training.precision import Precision
from nimprep.training.predict_options import PredictKeywords
from nimprep.training.scoring import score_split
from tests.fakes import NYU_LIKE, contents, depth_image, write_png
from tests.thermal import use_reader, write_thermal
from tests.training.runs import change_run, make_run
from tests.training.stores import SMALL, make_store

CPU: dict[str, Any] = {"device": "cpu"}


def labels_in(folder: Path) -> dict[str, Any]:
    """Return label images by frame id."""
    found = {p.relative_to(folder).as_posix()[:-4]: p for p in folder.rglob("*.png")}
    return {name: cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for name, path in found.items()}


def scores_in(folder: Path) -> dict[str, Any]:
    """Return scores by frame id."""
    place = folder / "scores"
    return {p.relative_to(place).as_posix()[:-4]: np.load(p) for p in place.rglob("*.npy")}


EVERY = [
    ("unet", "rgb"),
    ("fcn8s", "depth"),
    ("segnet", "hha"),
    ("unet", "rgb+d"),
    ("gscnn", "rgb+d"),
    ("gscnn", "nim-depth"),
    ("espnet", "nim-rgb+d"),
    ("unet", "rgb+elevation"),
    ("unet", "depth-minmax"),
    ("unet", ("rgb", "depth3", "mask")),
    ("mfnet", "nim-rgb+d"),
    ("mfnet", "rgb+t-disparity"),
    ("mfnet", "rgb+disparity"),
    ("depthaware", "rgb+d"),
    ("depthaware", "nim-rgb+d"),
    ("fusenet", ("rgb", "normal+elevation")),
    ("rtfnet18", "rgb+hha"),
]


@pytest.mark.parametrize(("network", "setup"), EVERY, ids=lambda part: str(part))
@pytest.mark.parametrize("normalize", ["constants", "train"])
def test_files_hold_what_a_plain_loop_finds(
    store: Path, tmp_path: Path, network: Any, setup: Any, normalize: str
) -> None:
    if normalize == "train" and network not in ("mfnet", "gscnn"):
        pytest.skip("two networks tell")
    run = make_run(store, tmp_path / "run", network, setup, normalize=normalize)
    done = predict(store, run, tmp_path / "p", split="val", save_scores=True, **CPU)
    checkpoint = read_checkpoint(run)
    net = checkpoint.build()
    scaling = Scaling(checkpoint.scale, checkpoint.offset, checkpoint.cut)
    fusion = NETWORKS[network].fusion
    data = StoreDataset(store, "val", setup, fusion, normalize=scaling)
    depths = StoreDataset(store, "val", modalities=("depth",))
    assert done.ids == data.ids
    labels, scores = labels_in(tmp_path / "p"), scores_in(tmp_path / "p")
    assert labels.keys() == scores.keys() == {*data.ids}
    for sample, depth in zip(data, depths, strict=True):
        inputs = sample["inputs"] if fusion else (sample["inputs"],)
        images = [image[None] for image in inputs]
        more = extra_inputs(net, images, data.selection, data.scaling, depth["depth"][None])
        with torch.no_grad():
            found = net(*images, *more).softmax(dim=1)[0].numpy()
        np.testing.assert_allclose(scores[sample["id"]], found, atol=2e-6)
        assert scores[sample["id"]].std(axis=(1, 2)).max() > 5e-5
        np.testing.assert_array_equal(labels[sample["id"]], scores[sample["id"]].argmax(axis=0))


def test_evaluate_finds_the_scores_of_the_training(store: Path, tmp_path: Path) -> None:
    options: dict[str, Any] = {**SMALL, "network": "mfnet", "setup": "nim-rgb+d", "epochs": 1}
    train(store, tmp_path / "run", **options)
    predict(store, tmp_path / "run", tmp_path / "p", split="val", save_scores=True, **CPU)
    figures = read_checkpoint(tmp_path / "run").figures
    for folder in (tmp_path / "p", tmp_path / "p" / "scores"):
        found = evaluate_predictions(store, folder)
        assert found.split == "val"
        assert found.mean["iou"] == pytest.approx(figures["iou"], abs=1e-12)
    document = json.loads((tmp_path / "p" / "predictions.json").read_text())
    assert schema_problems(document, "predictions") == []
    assert (document["network"], document["split"], document["frames"]) == ("mfnet", "val", 2)


SIZES = {"a": (64, 80), "sub/b": (70, 70), "c": (66, 72), "d": (64, 80), "e": (65, 71)}


def store_of_sizes(tmp_path: Path) -> Path:
    """Convert frames of several sizes, of two classes; half of each frame is of the second."""
    for name, size in SIZES.items():
        colors = np.random.default_rng(1).integers(0, 256, (*size, 3), dtype=np.uint8)
        write_png(tmp_path / "raw" / "color" / f"{name}.png", colors)
        write_png(tmp_path / "raw" / "depth" / f"{name}.png", depth_image(1, size))
        label = np.full(size, 40, np.uint16)
        label[: size[0] // 2] = 0
        write_png(tmp_path / "raw" / "label" / f"{name}.png", label)
    description = {k: v for k, v in NYU_LIKE.items() if k not in ("camera", "group")}
    description["depth"] = {"files": "depth/{id}.png", "scale_m": 0.001, "invalid": [0, 65535]}
    description["label"] = {**NYU_LIKE["label"], "map": {"40": 7}}
    description["classes"] = [NYU_LIKE["classes"][0], {**NYU_LIKE["classes"][1], "id": 7}]
    (tmp_path / "description.json").write_text(json.dumps(description))
    given = {"description": tmp_path / "description.json", "camera": (50, 50, 25, 20)}
    return Path(nimprep.convert(tmp_path / "raw", tmp_path / "s.zarr", **given).path)


@pytest.mark.parametrize("network", ["gscnn", "depthaware"])
def test_training_scores_frames_of_several_sizes_as_predict_does(
    tmp_path: Path, network: Any
) -> None:
    store = store_of_sizes(tmp_path)
    run = make_run(store, tmp_path / "run", network, "rgb+hha", normalize="train")
    opened, net = nimprep.open_store(store), read_checkpoint(run).build().eval()
    options = TrainOptions(network=network, setup="rgb+hha", normalize="train", **SMALL)
    feed = Feed(opened, options)
    feed.fit(net)
    precision = Precision(options, torch.device("cpu"))
    found = score_split(net, feed, feed.open("train"), options, precision, lambda: None)
    done = predict(store, run, tmp_path / "p", split="train", **CPU)
    expected = evaluate_predictions(store, done.folder, "train")
    np.testing.assert_array_equal(found.confusion, expected.confusion)


def test_frames_of_several_sizes_are_predicted_at_their_own(tmp_path: Path) -> None:
    store = store_of_sizes(tmp_path)
    run = make_run(store, tmp_path / "run", "mfnet", "rgb+hha")
    common: dict[str, Any] = {"split": "all", "save_scores": True, **CPU}
    predict(store, run, tmp_path / "one", **common)
    predict(store, run, tmp_path / "three", batch=3, **common)
    labels = labels_in(tmp_path / "one")
    assert {name: image.shape for name, image in labels.items()} == SIZES
    assert {*np.unique(np.concatenate([*map(np.ravel, labels.values())]))} <= {0, 7}
    other = scores_in(tmp_path / "three")
    for name, scores in scores_in(tmp_path / "one").items():
        np.testing.assert_allclose(other[name], scores, atol=1e-6)
    model = load_run(run)
    opened = nimprep.open_store(store)
    for index, frame in enumerate(opened):
        found = model.predict(frame.rgb, frame.depth_m, opened.camera(index))
        np.testing.assert_array_equal(found, labels[frame.id])
    assert evaluate_predictions(store, tmp_path / "one").mean


def test_frames_smaller_than_any_network_takes_are_padded(store: Path, tmp_path: Path) -> None:
    run = make_run(store, tmp_path / "run", "gscnn", "rgb+d")
    small = tmp_path / "small"
    small.mkdir()
    from tests.torch.stores import make_store as make_small

    done = predict(make_small(small), run, tmp_path / "p", split="all", **CPU)
    shapes = {image.shape for image in labels_in(done.folder).values()}
    assert shapes == {(24, 32)}


# Other stores than the training's.


@pytest.fixture(scope="module")
def run(store: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a run of normals that the store holds."""
    return make_run(store, tmp_path_factory.mktemp("run"), "mfnet", ("rgb", "normal+hha"))


def scores_of(store: Path, run: Path, out: Path) -> dict[str, Any]:
    predict(store, run, out, save_scores=True, **CPU)
    return scores_in(out)


def same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    return one.keys() == other.keys() and all(np.array_equal(one[k], other[k]) for k in one)


def test_what_a_store_lacks_is_derived_as_in_training(
    store: Path, run: Path, tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    plain = make_store(tmp_path / "plain", modalities=("rgb", "depth"))
    expected = scores_of(store, run, tmp_path / "a")
    assert same(expected, scores_of(plain, run, tmp_path / "b"))
    wide = make_store(tmp_path / "wide", normal_dtype="int16")
    assert same(expected, scores_of(wide, run, tmp_path / "c"))
    assert not [w for w in recwarn if w.category is UserWarning]


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (
            {"normals": "nim-edge"},
            "normal made as in training, with method nim,.*found method nim-edge",
        ),
        ({"sign_filter": True}, "normal made as in training, .*found sign_filter True"),
        ({"hha_ground": "lowest"}, "hha made as in training, with ground floor, found no ground"),
    ],
)
def test_what_was_made_otherwise_is_said_and_made_as_in_training(
    store: Path, run: Path, tmp_path: Path, changed: dict[str, Any], said: str
) -> None:
    other = make_store(tmp_path / "other", **changed)
    expected = scores_of(store, run, tmp_path / "a")
    with pytest.warns(UserWarning, match=said):
        found = scores_of(other, run, tmp_path / "b")
    assert same(expected, found)


def test_without_depth_the_stores_own_are_taken_and_that_is_said(
    store: Path, run: Path, tmp_path: Path
) -> None:
    for name, modalities in (("none", ("rgb", "label")), ("own", ("rgb", "normal", "hha"))):
        make_store(tmp_path / name, modalities=modalities, normals="nim-edge")
    with pytest.raises(StoreError, match="expected depth for a network of "):
        predict(tmp_path / "none" / "s.zarr", run, tmp_path / "p", **CPU)
    assert not (tmp_path / "p").exists()
    with pytest.warns(UserWarning, match="taken as they are"):
        predict(tmp_path / "own" / "s.zarr", run, tmp_path / "q", **CPU)


def test_normals_that_were_computed_as_frames_were_read_are_again(
    store: Path, tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    run = make_run(store, tmp_path / "run", "unet", "nim-depth", normals="nim-edge")
    found = scores_of(store, run, tmp_path / "p")
    net = read_checkpoint(run).build()
    for sample in StoreDataset(store, "test", "nim-depth", normals="nim-edge"):
        with torch.no_grad():
            expected = net(sample["inputs"][None]).softmax(dim=1)[0].numpy()
        np.testing.assert_allclose(found[sample["id"]], expected, atol=2e-6)
    assert not [w for w in recwarn if w.category is UserWarning]


def test_classes_are_found_by_name(store: Path, run: Path, tmp_path: Path) -> None:
    here = tmp_path / "run"
    shutil.copytree(run, here)
    classes = read_checkpoint(run).classes
    expected = labels_in(predict(store, run, tmp_path / "a", **CPU).folder)
    # What the network calls 2 is the store's 0, and so on.
    turned = tuple(replace(c, name=classes[(c.id + 1) % 3].name) for c in classes)
    change_run(here, classes=turned)
    done = predict(store, here, tmp_path / "b", save_scores=True, **CPU)
    for name, label in labels_in(done.folder).items():
        np.testing.assert_array_equal(label, (expected[name] + 1) % 3)
        np.testing.assert_array_equal(scores_in(done.folder)[name].argmax(axis=0), label)
    change_run(here, classes=(*classes[:2], LabelClass(2, "sky", (0, 0, 0))))
    with pytest.raises(StoreError, match="found none called 'sky' among background, "):
        predict(store, here, tmp_path / "c", **CPU)
    bare = make_store(tmp_path / "bare", labels=False, modalities=("rgb", "depth"))
    named = labels_in(predict(bare, here, tmp_path / "d", **CPU).folder)
    assert all(np.array_equal(named[name], expected[name]) for name in expected)


def test_classes_that_a_network_has_not_are_said(store: Path, tmp_path: Path) -> None:
    run = make_run(store, tmp_path / "run", "unet", "rgb")
    found = read_checkpoint(run)
    state = {
        name: tensor[:2] if tensor.shape[:1] == (3,) and "final" not in name else tensor
        for name, tensor in found.state.items()
    }
    from nimprep.networks import build_network, save_checkpoint

    net = build_network("unet", 3, 2, found.width)
    own = {n: state.get(n, t)[: t.shape[0]] if t.ndim else t for n, t in net.state_dict().items()}
    save_checkpoint(replace(found, classes=found.classes[1:], state=own), run / "best.pt")
    with pytest.warns(UserWarning, match="found background too, which it never predicts"):
        done = predict(store, run, tmp_path / "p", save_scores=True, **CPU)
    for name, label in labels_in(done.folder).items():
        assert {*np.unique(label)} <= {1, 2}
        scores = scores_in(done.folder)[name]
        assert scores.shape[0] == 3
        assert not scores[0].any()
    assert evaluate_predictions(store, done.folder).classes[0].name == "background"


@pytest.mark.filterwarnings("ignore:.*frames have no depth")
def test_frames_without_depth_are_named(tmp_path: Path, store: Path, run: Path) -> None:
    other = make_store(tmp_path, 3)
    raw = tmp_path / "raw"
    name = nimprep.open_store(other).ids[int(nimprep.open_store(other).indices("test")[0])]
    (raw / "depth_u16" / f"{name}.png").unlink()
    description = {
        "format": "nimprep-folder",
        "version": "1.0",
        "name": "some",
        "rgb": "rgb/{id}.png",
        "depth": {"files": "depth_u16/{id}.png", "scale_m": 0.001, "missing": "none"},
        "label": {"files": "label/{id}.png"},
        "classes": [
            {"id": c.id, "name": c.name, "color": list(c.color)}
            for c in nimprep.open_store(other).classes
        ],
    }
    (tmp_path / "d.json").write_text(json.dumps(description))
    some = nimprep.convert(
        raw, tmp_path / "some.zarr", description=tmp_path / "d.json", camera=(60, 60, 31.5, 31.5)
    ).path
    with pytest.warns(UserWarning, match=f"none anywhere in 1 \\({name}\\)"):
        predict(some, run, tmp_path / "p", **CPU)


@pytest.mark.filterwarnings("ignore:.*no calibration")
def test_planes_of_a_dataset_are_taken_too(tmp_path: Path) -> None:
    raw = write_thermal(tmp_path / "raw", 8, (64, 80))
    with pytest.MonkeyPatch.context() as patch:
        use_reader(patch)
        store = Path(nimprep.convert(raw, tmp_path / "s.zarr").path)
    run = make_run(store, tmp_path / "run", "mfnet", "rgb+thermal")
    found = scores_of(store, run, tmp_path / "p")
    data = StoreDataset(store, "test", "rgb+thermal", fusion=True)
    net, model, opened = read_checkpoint(run).build(), load_run(run), nimprep.open_store(store)
    for sample, index in zip(data, data.indices, strict=True):
        with torch.no_grad():
            expected = net(*(i[None] for i in sample["inputs"])).softmax(dim=1)[0].numpy()
        np.testing.assert_allclose(found[sample["id"]], expected, atol=2e-6)
        frame = opened[int(index)]
        labels = model.predict(frame.rgb, planes={"thermal": frame["thermal"]})
        np.testing.assert_array_equal(labels, found[sample["id"]].argmax(axis=0))


# The folder and the command.


def test_a_folder_is_whole_or_not_there_and_nothing_is_replaced_unasked(
    store: Path, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "p"
    predict(store, run, out, **CPU)
    before = contents(out)
    with pytest.raises(LayoutError, match="expected a new or empty folder"):
        predict(store, run, out, **CPU)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("nimprep.training.prediction._Writer.write", _interrupted)
        with pytest.raises(KeyboardInterrupt):
            predict(store, run, out, overwrite=True, **CPU)
        with pytest.raises(KeyboardInterrupt):
            predict(store, run, tmp_path / "q", **CPU)
    assert contents(out) == before
    assert [path.name for path in tmp_path.iterdir()] == ["p"]
    predict(store, run, out, split="val", overwrite=True, **CPU)
    assert contents(out).keys() != before.keys()
    assert [path.name for path in tmp_path.iterdir()] == ["p"]
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "a.txt").write_text("a")
    with pytest.raises(LayoutError, match=r"found 'a.txt' in it"):
        predict(store, run, tmp_path / "mine", overwrite=True, **CPU)
    with pytest.raises(LayoutError, match="outside"):
        predict(store, run, store / "p", **CPU)


def _interrupted(*args: Any) -> None:
    raise KeyboardInterrupt


def test_the_command_says_where_predictions_are(store: Path, run: Path, tmp_path: Path) -> None:
    here = tmp_path / "mine"
    shutil.copytree(run, here)
    call = ["predict", str(store), str(here), "--device", "cpu"]
    told = CliRunner().invoke(main, call)
    assert told.exit_code == 0, told.output
    assert told.stdout == f"{here}-test: 2 frames\n"
    told = CliRunner().invoke(
        main,
        [
            *call[:2],
            str(here / "best.pt"),
            "--split",
            "val",
            "--save-scores",
            "--out",
            str(tmp_path / "v"),
        ],
    )
    assert told.stdout.splitlines()[1] == f"{tmp_path / 'v'}/scores: 2 frames' scores"
    told = CliRunner().invoke(main, ["evaluate", str(store), str(tmp_path / "v")])
    assert told.exit_code == 0, told.output
    for more, code, said in [
        ([], 1, "expected a new or empty folder"),
        (["--batch", "0"], 2, "0 is not in the range"),
        (["--split", "some"], 2, "'some' is not one of"),
        (["--split", "none", "--out", "o"], 1, "expected frames in split 'none', found 2 in test"),
        (["--device", "tpu", "--out", "o"], 1, "device: expected auto, cpu"),
    ]:
        told = CliRunner().invoke(main, [*call, *more])
        assert (told.exit_code, said in told.stderr) == (code, True), told.stderr
        assert "Traceback" not in told.stderr
    told = CliRunner().invoke(main, ["predict", str(store), str(tmp_path / "nowhere")])
    assert told.exit_code == 1
    assert told.stderr.startswith(f"error: {tmp_path / 'nowhere'}: expected")


def test_the_command_has_just_the_options_that_the_fields_say() -> None:
    found: Any = main.get_command(None, "predict")  # type: ignore[arg-type]
    given = {p.name: p for p in found.params}
    options = options_of(PredictOptions)
    assert given.keys() - options.keys() == {"store", "run", "out", "quiet"}
    assert PredictKeywords.__annotations__.keys() == options.keys()
    with pytest.raises(ArrayError, match="batch: expected 1 or more"):
        PredictOptions(batch=0)
