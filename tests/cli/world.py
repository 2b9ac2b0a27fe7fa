"""A folder with something for every command to work on, and a call of each.

Tests loop over `CALLS`, and fail where a command is not there.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
from click.testing import CliRunner, Result

import nimprep
from nimprep.cli import main
from tests.fakes import SIZE, depth_image, write_png
from tests.kitti.scenes import HEIGHT, WIDTH, noise, road_folder
from tests.training.runs import make_run

CLASSES = ("other", "road")
COLOURS = [[0, 0, 0], [0, 200, 0]]


READ = {
    *("src", "store", "stores", "predictions", "gt", "images"),
    *("calib", "description", "camera", "import_file", "split_file", "lists"),
    *("run", "config", "weights"),
}
"""Parameters that name what is read alone."""


@dataclass(frozen=True)
class Call:
    """A call of a command that goes well in a world.

    Attributes
    ----------
    arguments : tuple of str or Path
        Paths are relative to the world; `NEW` is what is written.
    writes : str
        What that is: a "file", a "folder" that is new or empty, "files" in a folder that may have
        others, or a "store"; "" = nothing, or what is there already.
    parameter : str
        Which parameter of the command names it.
    """

    arguments: tuple[str | Path, ...]
    writes: str = ""
    parameter: str = "out"

    def at(self, root: Path, out: Path | None = None) -> list[str]:
        """Return the arguments in a world, with another place to write to if one is named."""
        paths = {NEW: out or root / NEW}
        return [str(paths.get(a, root / a)) if isinstance(a, Path) else a for a in self.arguments]

    def __str__(self) -> str:
        return " ".join(map(str, self.arguments))


S, RAW, NEW = Path("s.zarr"), Path("raw"), Path("new")
LARGE, RUN = Path("large.zarr"), Path("run")
TRAIN = ("--network", "espnet", "--setup", "rgb", "--width", "0.06", "--epochs", "1")
DESCRIBED = ("--description", Path("raw.json"))
EVALUATE = ("evaluate", S, Path("predictions"))
MAPS, TRUTH, IMAGES, CALIB = (
    Path(name)
    for name in ("maps", *(f"road/training/{n}" for n in ("gt_image_2", "image_2", "calib")))
)
KITTI_EVALUATE = ("kitti", "evaluate", MAPS, TRUTH, "--view", "perspective")
CALLS = {
    "inspect": [
        Call(("inspect", RAW)),
        Call(("inspect", Path("road"), "--json")),
        Call(("inspect", RAW, "--write", NEW), "file", "write"),
    ],
    "convert": [Call(("convert", RAW, NEW, *DESCRIBED), "store")],
    "append": [Call(("append", Path("more"), S, *DESCRIBED))],
    "merge": [Call(("merge", S, Path("t.zarr"), NEW), "store")],
    "info": [Call(("info", S)), Call(("info", S, "--json"))],
    "validate": [Call(("validate", S, "--deep")), Call(("validate", S, "--json"))],
    "split": [
        Call(("split", S)),
        Call(("split", S, "--seed", "5")),
        Call(("split", S, "--export", NEW), "file", "export_file"),
    ],
    "evaluate": [
        *(Call((*EVALUATE, "--format", f)) for f in ("text", "json", "markdown", "latex")),
        Call((*EVALUATE, Path("others"), "--format", "text")),
        Call((*EVALUATE, "--html", NEW), "file", "html"),
    ],
    "export": [
        Call(("export", S, NEW, "--format", "png"), "folder"),
        Call(("export", S, NEW, "--format", "npz"), "folder"),
        Call(("export", S, NEW, "--format", "rgbx"), "folder"),
        Call(("export", S, NEW, "--format", "roadformer"), "folder"),
        Call(("export", S, NEW, "--format", "voc"), "folder"),
        Call(("export", S, NEW, "--format", "coco"), "folder"),
        Call(("export", S, NEW, "--format", "rerun"), "file"),
    ],
    "train": [Call(("train", LARGE, *TRAIN, "--out", NEW), "folder")],
    "predict": [Call(("predict", LARGE, RUN, "--split", "all", "--out", NEW), "folder")],
    "report": [Call(("report", S, NEW), "file")],
    "view": [Call(("view", S, "--port", "0"))],
    "synth": [Call(("synth", NEW, "--frames", "1", "--size", "32x24"), "folder")],
    "demo": [Call(("demo", NEW), "folder")],
    "warm-up": [Call(("warm-up",))],
    "kitti depth": [Call(("kitti", "depth", Path("road"), NEW), "files")],
    "kitti bev": [Call(("kitti", "bev", MAPS, NEW, "--calib", CALIB), "files")],
    "kitti evaluate": [Call(KITTI_EVALUATE), Call((*KITTI_EVALUATE, "--json"))],
    "kitti pack": [Call(("kitti", "pack", MAPS, NEW, "--partial", "--calib", CALIB), "file")],
    "kitti overlay": [Call(("kitti", "overlay", MAPS, TRUTH, IMAGES, NEW), "files")],
}
EVERY = [call for calls in CALLS.values() for call in calls]


def commands(group: click.Group = main, prefix: str = "") -> Iterator[tuple[str, click.Command]]:
    """Yield every command that is no group, by the words that call it."""
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if isinstance(command, click.Group):
            yield from commands(command, f"{prefix}{name} ")
        elif command is not None:
            yield f"{prefix}{name}", command


def run(arguments: list[str]) -> Result:
    """Call nimprep in this process."""
    return CliRunner().invoke(main, arguments)


def make_world(root: Path, classes: tuple[str, ...] = CLASSES, dataset: str = "world") -> Path:
    """Make the folder: datasets, a store of each, a trained network, predictions, a KITTI folder.

    Parameters
    ----------
    classes, dataset
        Names in the datasets, which may be hostile.
    """
    description = {
        "format": "nimprep-folder",
        "version": "1.0",
        "name": dataset,
        "rgb": "rgb/{id}.png",
        "depth": {"files": "depth/{id}.png", "scale_m": 0.001, "invalid": [0, 65535]},
        "label": {"files": "label/{id}.png"},
        "classes": [{"id": i, "name": name, "color": COLOURS[i]} for i, name in enumerate(classes)],
        "camera": {"fx": 30, "fy": 31, "cx": 15, "cy": 11},
        "group": "{group}/*",
    }
    root.mkdir(parents=True, exist_ok=True)
    (root / "raw.json").write_text(json.dumps(description))
    options = {"description": root / "raw.json", "shard_length": 2, "split_by": "frame"}
    sets = (("raw", "s", "a", SIZE), ("more", "t", "b", SIZE), ("large", "large", "c", (64, 72)))
    for name, store, scene, size in sets:
        _write_frames(root / name, scene, size)
        nimprep.convert(root / name, root / f"{store}.zarr", **options)
    make_run(root / LARGE, root / RUN, "espnet", "rgb")
    for folder in ("predictions", "others"):
        for number in range(3):
            guess = np.full(SIZE, number % 2, np.uint8)
            write_png(root / folder / "a" / f"{number}.png", guess)
    road_folder(root / "road")
    write_png(root / "maps" / "um_road_000000.png", noise(0, HEIGHT, WIDTH))
    # A test frame, as the benchmark's zip takes no other.
    road_folder(root / "road", split="testing")
    return root


def _write_frames(folder: Path, scene: str, size: tuple[int, int]) -> None:
    for number in range(3):
        rng = np.random.default_rng(number)
        name = f"{scene}/{number}.png"
        write_png(folder / "rgb" / name, rng.integers(0, 256, (*size, 3), dtype=np.uint8))
        write_png(folder / "depth" / name, depth_image(number, size))
        label = np.zeros(size, np.uint8)
        label[size[0] // 2 :] = 1
        write_png(folder / "label" / name, label)
