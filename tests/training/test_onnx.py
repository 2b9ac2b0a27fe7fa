"""ONNX files give what the runs they are made of give, the normals included."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from click.testing import CliRunner

import nimprep
from nimprep.cli import main
from nimprep.errors import ArrayError, LayoutError
from nimprep.networks import load_run
from nimprep.networks.onnx import OPSET, check_libraries, export_onnx
from tests.training.runs import make_run

NORMALS = {"depth", "intrinsics"}

CASES = [
    ("fcn8s", "nim-depth", NORMALS),
    ("segnet", "nim-depth", NORMALS),
    ("unet", ("hha", "elevation", "depth-minmax", "mask"), {"hha", "elevation", "depth"}),
    ("deeplabv3plus", "nim-depth", NORMALS),
    ("denseaspp", "nim-depth", NORMALS),
    ("dupsampling", "nim-depth", NORMALS),
    ("espnet", "nim-depth", NORMALS),
    ("gscnn", "nim-rgb+d", NORMALS | {"rgb", "canny"}),
    ("fusenet", "nim-rgb+d", NORMALS | {"rgb"}),
    ("depthaware", "nim-rgb+d", NORMALS | {"rgb"}),
    ("mfnet", "nim-rgb+d", NORMALS | {"rgb"}),
    ("rtfnet18", "nim-rgb+d", NORMALS | {"rgb"}),
]


@pytest.mark.parametrize(("network", "setup", "names"), CASES, ids=[c[0] for c in CASES])
def test_onnxruntime_gives_the_same_scores(
    store: Path, tmp_path: Path, network: Any, setup: Any, names: set[str]
) -> None:
    ort = pytest.importorskip("onnxruntime")
    run, out = make_run(store, tmp_path / "run", network, setup), tmp_path / "x.onnx"
    told = CliRunner().invoke(main, ["export", str(run), str(out), "--onnx"])
    assert told.exit_code == 0, told.output
    assert f"opset {OPSET}, " in told.stdout
    session = ort.InferenceSession(str(out), providers=["CPUExecutionProvider"])
    assert {entry.name for entry in session.get_inputs()} == names
    said = session.get_modelmeta().custom_metadata_map
    model, opened = load_run(run), nimprep.open_store(store)
    classes = [{"id": entry.id, "name": entry.name} for entry in opened.classes]
    assert json.loads(said["nimprep.classes"]) == classes
    for index in range(3):
        frame, camera = opened[index], opened.camera(index)
        canny = cv2.Canny(np.ascontiguousarray(frame["rgb"]), 10, 100)
        given: dict[str, Any] = {}
        for name in names - {"intrinsics"}:
            image = canny if name == "canny" else frame[name]
            given[name] = (image.transpose(2, 0, 1) if image.ndim == 3 else image[None])[None]
        if "intrinsics" in names:
            given["intrinsics"] = camera.matrix.astype(np.float32)[None]
        logits = session.run(["logits"], given)[0]
        scores = torch.from_numpy(logits).softmax(dim=1)[0].numpy()
        expected = model.predict(frame.rgb, frame.depth_m, camera, scores=True)[1]
        np.testing.assert_allclose(scores, expected, atol=1e-4)
        # Tighter in all but a few pixels, where a normal falls on the edge of two steps.
        assert np.mean(np.abs(scores - expected) > 1e-6) < 0.01


def test_what_cannot_be_exported_is_told(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = make_run(store, tmp_path / "run", "unet", "rgb")
    (tmp_path / "there.onnx").write_bytes(b"mine")
    with pytest.raises(LayoutError, match=r"there\.onnx: expected"):
        export_onnx(run, tmp_path / "there.onnx")
    with pytest.raises(ArrayError, match="size: expected 64 pixels or more each way"):
        export_onnx(run, tmp_path / "x.onnx", (32, 64))
    for more, said in [
        ([], "expected --format of a store, or --onnx of a run, found neither"),
        (["--onnx", "--format", "png"], "expected --onnx of a run alone"),
        (["--format", "png", "--size", "64,64"], "expected --onnx with --size"),
    ]:
        told = CliRunner().invoke(main, ["export", str(run), str(tmp_path / "y"), *more])
        assert (told.exit_code, said in told.stderr) == (2, True)
    monkeypatch.setattr("nimprep.networks.onnx.find_spec", lambda name: None)
    with pytest.raises(ArrayError, match=r"pip install 'nimprep\[onnx\]'"):
        check_libraries()
