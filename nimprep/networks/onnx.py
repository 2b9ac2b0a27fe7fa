"""A run as an ONNX file, for machines without PyTorch."""

from __future__ import annotations

import json
import logging
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import torch

from nimprep import __version__
from nimprep.errors import ArrayError
from nimprep.files import whole_file
from nimprep.networks.network import SMALLEST
from nimprep.networks.onnx_network import GraphInput, GraphNetwork
from nimprep.networks.run_model import RunModel, load_run

OPSET = 18
"""Of ONNX's operators: the oldest that PyTorch's exporter writes, read by runtimes of 2023 on."""

OUTPUT = "logits"

_LIBRARIES = ("onnx", "onnxscript")


@dataclass(frozen=True)
class OnnxFile:
    """Describe an ONNX file.

    Attributes
    ----------
    path : Path
    opset : int
    size : (int, int)
        Height and width that it takes, pixels.
    inputs : tuple of GraphInput
    """

    path: Path
    opset: int
    size: tuple[int, int]
    inputs: tuple[GraphInput, ...]


def export_onnx(
    run: RunModel | Path | str,
    out: Path | str,
    size: tuple[int, int] | None = None,
    *,
    overwrite: bool = False,
) -> OnnxFile:
    """Write a trained network as ONNX, the normals computed inside.

    Inputs, as far as the setup needs them: rgb (1, 3, H, W) uint8, depth (1, 1, H, W) float32
    metres, intrinsics (1, 3, 3) float32. What the graph cannot compute is an input of its own:
    hha (1, 3, H, W) uint8; elevation and disparities (1, 1, H, W) float32; normal (1, 3, H, W)
    float32, where the training's were made by another method than "nim", or of filled depth; canny
    (1, 1, H, W) uint8 for GSCNN. The output is logits, (1, C, H, W) float32. One frame at a time,
    of `size`. The file's metadata has classes, setup, scaling and what the inputs are.

    Parameters
    ----------
    run : path or RunModel
        The folder of a run of `nimprep train`, its best.pt, or what `load_run` made of it.
    out : path
        The file.
    size : (int, int), optional
        Height and width; None = of the frames that it was trained on.
    overwrite : bool
        The file may be there.

    Raises
    ------
    ArrayError
        The extra onnx is not installed; the run cannot be read; the size is too small; or the
        network has what ONNX has no word for.
    LayoutError
        The file is there already, or cannot be written.
    """
    check_libraries()
    model = run if isinstance(run, RunModel) else load_run(run)
    height, width = size or model.checkpoint.size
    if min(height, width) < SMALLEST:
        raise ArrayError(
            f"size: expected {SMALLEST} pixels or more each way, found {width}x{height}; networks "
            "take no smaller images"
        )
    model.to("cpu")
    graph = GraphNetwork(model).eval()
    with whole_file(Path(out), overwrite=overwrite) as partial:
        program = _exported(graph, height, width)
        program.model.metadata_props.update(_metadata(model, graph, (height, width)))
        program.save(partial)
    return OnnxFile(Path(out), OPSET, (height, width), graph.given)


def check_libraries() -> None:
    """Raise `ArrayError` where the extra is not installed."""
    missing = [name for name in _LIBRARIES if find_spec(name) is None]
    if missing:
        raise ArrayError(
            f"onnx: expected the packages {', '.join(_LIBRARIES)}, found no {missing[0]}; "
            "pip install 'nimprep[onnx]'"
        )


def _exported(graph: GraphNetwork, height: int, width: int) -> Any:
    """Return PyTorch's ONNX program of a graph."""
    lengths = {"height": height, "width": width}
    examples = []
    for entry in graph.given:
        shape = [n if isinstance(n, int) else lengths[n] for n in entry.shape]
        examples.append(torch.ones(shape, dtype=entry.dtype))
    names = [entry.name for entry in graph.given]
    with _quiet():
        try:
            return torch.onnx.export(
                graph,
                tuple(examples),
                dynamo=True,
                opset_version=OPSET,
                input_names=names,
                output_names=[OUTPUT],
                verbose=False,
            )
        except torch.onnx.errors.OnnxExporterError as error:
            network = type(graph.network).__name__
            raise ArrayError(
                f"{network}: expected operations that ONNX has, found others; use load_run"
            ) from error


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep what the exporter tells its developers from those who export."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(before)


def _metadata(model: RunModel, graph: GraphNetwork, size: tuple[int, int]) -> Mapping[str, str]:
    """Return what the file says of itself, each as JSON."""
    found, scaling = model.checkpoint, model.inputs.scaling
    said: dict[str, Any] = {
        "version": __version__,
        "network": found.network,
        "setup": found.setup,
        "classes": [{"id": entry.id, "name": entry.name} for entry in model.classes],
        "inputs": {entry.name: entry.about for entry in graph.given},
        "size": size,
        "scaling": {"scale": scaling.scale, "offset": scaling.offset, "cut": scaling.cut},
        "recipe": found.recipe,
        "normal_dtype": found.normal_dtype,
    }
    return {f"nimprep.{name}": json.dumps(value) for name, value in said.items()}
