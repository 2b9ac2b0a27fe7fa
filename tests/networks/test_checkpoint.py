"""A file holds all that a trained network is, and gives it back; what is no such file is told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from nimprep import __version__
from nimprep.derive.recipe import Recipe
from nimprep.errors import ArrayError, LayoutError
from nimprep.frame import LabelClass
from nimprep.networks import (
    NETWORKS,
    Checkpoint,
    build_network,
    read_checkpoint,
    save_checkpoint,
)
from nimprep.schema import load_schema

CLASSES = (LabelClass(0, "ground", (0, 0, 0)), LabelClass(7, "lichen", (9, 8, 7)))
RECIPE = {
    "normals": "nim-edge",
    "sign_filter": False,
    "noise": 0.5,
    "hha_ground": "floor",
    "fill": "none",
    "store_filled": False,
    "virtual_baseline_m": 0.5,
}


def made(name: str = "mfnet", **changes: Any) -> Checkpoint:
    torch.manual_seed(0)
    fusion = NETWORKS[name].fusion
    groups = (("rgb",), ("normal",)) if fusion else (("rgb", "normal"),)
    channels = (3, 3) if fusion else (6,)
    network = build_network(name, channels, 2, 0.25)
    return Checkpoint(
        network=name,
        width=0.25,
        stages=5,
        setup="nim-rgb+d",
        groups=groups,
        channels=channels,
        classes=CLASSES,
        scale={"rgb": (0.1, 0.2, 0.3)},
        offset={"rgb": (1.0, 2.0, 3.0)},
        cut={"depth": (0.0, 20.0)},
        recipe=RECIPE,
        size=(96, 128),
        figures={"epoch": 3, "step": 12, "f_score": None, "loss": 0.5},
        state=network.state_dict(),
        **changes,
    )


@pytest.mark.parametrize("name", ["mfnet", "unet", "fusenet"])
def test_what_is_written_is_read_again(tmp_path: Path, name: str) -> None:
    checkpoint = made(name)
    save_checkpoint(checkpoint, tmp_path / "run" / "best.pt")
    for place in (tmp_path / "run", tmp_path / "run" / "best.pt", str(tmp_path / "run")):
        found = read_checkpoint(place)
        assert replace(found, state={}) == replace(checkpoint, state={})
        assert found.state.keys() == checkpoint.state.keys()
        assert all(torch.equal(found.state[k], v) for k, v in checkpoint.state.items())
        assert found.version == __version__
        assert found.fusion == NETWORKS[name].fusion
    network = found.build()
    assert not network.training
    images = [torch.rand(1, n, 64, 96) for n in checkpoint.channels]
    again = build_network(name, checkpoint.channels, 2, 0.25, tmp_path / "run" / "best.pt").eval()
    assert not again.loaded.initial
    with torch.no_grad():
        assert torch.equal(network(*images), again(*images))
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["best.pt"]


def test_weights_of_another_network_are_refused(tmp_path: Path) -> None:
    save_checkpoint(made(), tmp_path / "best.pt")
    with pytest.raises(ArrayError, match="found those of a mfnet of other sizes"):
        build_network("mfnet", (3, 1), 2, 0.25, tmp_path / "best.pt")
    with pytest.raises(ArrayError, match=r"expected the weights of mfnet at width 0\.5"):
        replace(made(), width=0.5).build()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"checkpoint": None}, "expected a checkpoint of nimprep train, found another file"),
        ({"nimprep_network": ...}, "expected a checkpoint of nimprep train"),
        ({"format": "2.0"}, "expected a checkpoint of format 1.0, found 2.0; read it with"),
        ({"format": ...}, "expected a checkpoint of format 1.0, found none"),
        ({"network": "resnet"}, "expected one of fcn8s, .*found 'resnet'"),
        ({"network": 3}, "expected JSON of schema 'checkpoint', found .*network"),
        ({"classes": []}, "expected JSON of schema 'checkpoint', found .*classes"),
        ({"width": ...}, "expected JSON of schema 'checkpoint', found .*width"),
        ({"size": [1, 2, 3]}, "expected JSON of schema 'checkpoint', found .*size"),
        ({"channels": [3]}, "expected channels of each group and weights"),
        ({"state": {}}, ".*and 0 tensors"),
        ({"state": [1]}, ".*and 0 tensors"),
    ],
)
def test_a_file_that_says_something_else_is_one_line(
    tmp_path: Path, change: dict[str, Any], said: str
) -> None:
    save_checkpoint(made(), tmp_path / "best.pt")
    found = torch.load(tmp_path / "best.pt", weights_only=True)
    for name, value in change.items():
        place = found if name in found else found["checkpoint"]
        if value is ...:
            del place[name]
        else:
            place[name] = value
    torch.save(found, tmp_path / "best.pt")
    with pytest.raises(ArrayError, match=rf"best.pt: {said}") as raised:
        read_checkpoint(tmp_path / "best.pt")
    assert "\n" not in str(raised.value)


def test_keys_of_a_later_minor_version_are_left_out(tmp_path: Path) -> None:
    save_checkpoint(made(), tmp_path / "best.pt")
    found = torch.load(tmp_path / "best.pt", weights_only=True)
    found["checkpoint"] |= {"format": "1.7", "more": [1]}
    torch.save(found, tmp_path / "best.pt")
    assert replace(read_checkpoint(tmp_path / "best.pt"), state={}) == replace(made(), state={})


def test_what_is_missing_or_cut_short_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ArrayError, match=r"nowhere: expected a file of weights, found No such"):
        read_checkpoint(tmp_path / "nowhere")
    with pytest.raises(ArrayError, match="found none; let it end its first epoch"):
        read_checkpoint(tmp_path)
    save_checkpoint(made(), tmp_path / "best.pt")
    whole = (tmp_path / "best.pt").read_bytes()
    for length in (0, 1, 100, len(whole) // 2, len(whole) - 1):
        (tmp_path / "best.pt").write_bytes(whole[:length])
        with pytest.raises(ArrayError, match="expected a file of weights, found "):
            read_checkpoint(tmp_path)


def test_what_cannot_be_written_leaves_what_was_there(tmp_path: Path) -> None:
    save_checkpoint(made(), tmp_path / "best.pt")
    before = (tmp_path / "best.pt").read_bytes()

    def full(*_: object) -> None:
        raise RuntimeError("[enforce fail at inline_container.cc:672] . unexpected pos\nframe 1")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(torch, "save", full)
        with pytest.raises(
            LayoutError, match=r"found .*unexpected pos; see that the disk has room"
        ):
            save_checkpoint(made(), tmp_path / "best.pt", LayoutError)
    assert (tmp_path / "best.pt").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["best.pt"]


def test_the_schema_has_each_field_of_a_recipe() -> None:
    document = load_schema("checkpoint")["properties"]["recipe"]
    assert document["properties"].keys() == vars(Recipe()).keys()
