"""What a trained network is, in one file: its weights, and all that is needed to use them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from nimprep import __version__
from nimprep.errors import ArrayError, NimprepError
from nimprep.files import whole_file
from nimprep.frame import LabelClass
from nimprep.networks.build import NETWORKS, build_network
from nimprep.networks.network import Network
from nimprep.networks.weights import MARK, read_weights, tensors_in
from nimprep.schema import check_json

BEST = "best.pt"
"""The checkpoint within a run's folder."""

FORMAT = "1.0"
"""Of a checkpoint; a file of another major version is refused."""


@dataclass(frozen=True)
class Checkpoint:
    """Describe a trained network and hold its weights.

    Attributes
    ----------
    network : str
        A name in `NETWORKS`.
    width : float
    stages : int
        As for `build_network`.
    setup : str or tuple of str
        As `StoreDataset` takes it.
    groups : tuple of tuple of str
        The modalities, and views of them, of each image that the network takes, in the order of its
        channels; two where it fuses.
    channels : tuple of int
        Channels of each of those images.
    classes : tuple of LabelClass
        What each channel of the logits stands for.
    scale, offset : dict of str to tuple of float
        How each modality's numbers became the network's, by `nimprep.torch.Scaling`.
    cut : dict of str to (float, float)
        The range to which they were cut before, as there.
    recipe : dict
        How the derived modalities were made: the fields of `nimprep.derive.recipe.Recipe`.
    size : (int, int)
        Height and width of the frames it was trained on, pixels.
    figures : dict
        What the training says of it: epoch, step, loss, scores.
    state : dict of str to Tensor
        The network's `state_dict`.
    normal_dtype : str, optional
        What the normals were stored as, and so rounded to, where they came from a store; None =
        they were computed as they were read, or there are none.
    version : str
        Of nimprep, that wrote it.
    """

    network: str
    width: float
    stages: int
    setup: str | tuple[str, ...]
    groups: tuple[tuple[str, ...], ...]
    channels: tuple[int, ...]
    classes: tuple[LabelClass, ...]
    scale: dict[str, tuple[float, ...]]
    offset: dict[str, tuple[float, ...]]
    cut: dict[str, tuple[float, float]]
    recipe: dict[str, Any]
    size: tuple[int, int]
    figures: dict[str, Any] = field(default_factory=dict)
    state: dict[str, Tensor] = field(default_factory=dict, repr=False)
    normal_dtype: str | None = None
    version: str = __version__

    @property
    def fusion(self) -> bool:
        """Whether the network takes its modalities apart."""
        return len(self.groups) > 1

    def build(self) -> Network:
        """Return the network with these weights, in evaluation mode, on the CPU.

        Raises
        ------
        ArrayError
            They do not fit it.
        """
        network = build_network(
            self.network, self.channels, len(self.classes), self.width, stages=self.stages
        )
        own = {name: tensor.shape for name, tensor in network.state_dict().items()}
        if own != {name: tensor.shape for name, tensor in self.state.items()}:
            raise ArrayError(
                f"checkpoint: expected the weights of {self.network} at width {self.width:g}, "
                "found others; train it anew"
            )
        network.load_state_dict(self.state)
        return network.eval()


def save_checkpoint(
    checkpoint: Checkpoint, path: Path, error: type[NimprepError] = ArrayError
) -> None:
    """Write a checkpoint, whole or not at all, over one that is there.

    The file is a dict of plain values and tensors, which ``torch.load(weights_only=True)`` reads:
    "state" has the weights, "checkpoint" the other fields (schemas/checkpoint.schema.json).

    Raises
    ------
    NimprepError
        Of the class given: it cannot be written.
    """
    said = {name: _plain(value) for name, value in vars(checkpoint).items() if name != "state"}
    document = {MARK: checkpoint.network, "checkpoint": {"format": FORMAT, **said}}
    save_whole({**document, "state": checkpoint.state}, path, error)


def save_whole(document: Mapping[str, Any], path: Path, error: type[NimprepError]) -> None:
    """Write a dict of plain values and tensors, whole or not at all, over a file that is there.

    Raises
    ------
    NimprepError
        Of the class given: it cannot be written.
    """
    with whole_file(path, overwrite=True, error=error) as partial:
        try:
            torch.save(dict(document), partial)
        except RuntimeError as caught:
            # What PyTorch makes of a disk that is full.
            reason = str(caught).partition("\n")[0]
            raise error(
                f"{path}: expected to write it, found {reason}; see that the disk has room"
            ) from caught


def _plain(value: Any) -> Any:
    """Return a field's value as the file holds it."""
    if isinstance(value, LabelClass):
        return {"id": value.id, "name": value.name, "color": list(value.color)}
    if isinstance(value, (tuple, list)):
        return [_plain(item) for item in value]
    if isinstance(value, dict):
        return {name: _plain(item) for name, item in value.items()}
    return value


def read_checkpoint(path: Path | str) -> Checkpoint:
    """Read what `save_checkpoint` wrote; nothing in the file is run.

    Parameters
    ----------
    path : path
        The file, or the folder of a run of `nimprep train`.

    Raises
    ------
    ArrayError
        It is not there, cannot be read, is of another version or no checkpoint.
    """
    path = Path(path)
    if path.is_dir():
        path = path / BEST
        if not path.exists():
            raise ArrayError(
                f"{path}: expected the weights of a run of nimprep train, found none; let it end "
                "its first epoch"
            )
    found = read_weights(path)
    said = found.get("checkpoint")
    if MARK not in found or not isinstance(said, dict):
        raise ArrayError(
            f"{path}: expected a checkpoint of nimprep train, found another file; weights alone "
            "go into build_network(weights=...)"
        )
    form = str(said.get("format", "none"))
    if form.partition(".")[0] != FORMAT.partition(".")[0]:
        raise ArrayError(
            f"{path}: expected a checkpoint of format {FORMAT}, found {form}; read it with the "
            "nimprep that wrote it, or a later one"
        )
    check_json(said, "checkpoint", f"{path}", ArrayError)
    return _checked(Checkpoint(**_fields(said), state=tensors_in(found)), path)


def _fields(said: Mapping[str, Any]) -> dict[str, Any]:
    """Return a document's values as the fields are, what is no field's left out."""

    def rows(values: Mapping[str, Any]) -> dict[str, tuple[float, ...]]:
        return {name: tuple(row) for name, row in values.items()}

    classes = (LabelClass(c["id"], c["name"], tuple(c["color"])) for c in said["classes"])
    setup = said["setup"]
    made: dict[str, Any] = {
        "setup": setup if isinstance(setup, str) else tuple(setup),
        "groups": tuple(tuple(group) for group in said["groups"]),
        "channels": tuple(said["channels"]),
        "classes": tuple(classes),
        "scale": rows(said["scale"]),
        "offset": rows(said["offset"]),
        "cut": rows(said["cut"]),
        "size": tuple(said["size"]),
    }
    plain = ("network", "width", "stages", "recipe", "figures", "version")
    made["normal_dtype"] = said.get("normal_dtype")
    return {**{name: said[name] for name in plain}, **made}


def _checked(checkpoint: Checkpoint, path: Path) -> Checkpoint:
    """Return a checkpoint whose fields agree with each other."""
    if checkpoint.network not in NETWORKS:
        raise ArrayError(
            f"{path}: expected one of {', '.join(NETWORKS)}, found {checkpoint.network!r}; read "
            "it with the nimprep that wrote it, or a later one"
        )
    if len(checkpoint.channels) != len(checkpoint.groups) or not checkpoint.state:
        raise ArrayError(
            f"{path}: expected channels of each group and weights, found "
            f"{checkpoint.channels} for {checkpoint.groups} and {len(checkpoint.state)} tensors; "
            "train it anew"
        )
    return checkpoint
