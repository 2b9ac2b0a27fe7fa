"""Print how well each modality alone tells road from other classes, by the kind of depth.

    python scripts/benchmark_features.py [--each] [--times]

The area under the ROC curve: 0.5 tells nothing, 1 makes no mistake. Means over the frames of a
kind, whichever side is the higher, as in `nimprep report`: a frame of GMRP (active stereo, no
calibration); KITTI road with depth from stereo; KITTI road with dense depth that the paper's
authors made of LiDAR, the same thinned to every fifth row and fourth column, and that filled
linearly; and synthetic streets, exact but for noise of 0.3 % of the distance, as a time-of-flight
camera's. There is no labelled road by a real one here. Real frames come from
NIMPREP_REFERENCE_DATA (default ../shared/data from the project's root). --each prints every frame,
--times how long each image takes to make, ms on one thread.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import nimprep
from nimprep import Camera
from nimprep.derive.recipe import Recipe
from nimprep.frame import Frame
from nimprep.modality import MODALITIES
from nimprep.readers import ReaderOptions, open_reader
from nimprep.report.features import Source, image_of, sources
from nimprep.report.separation import frame_areas
from nimprep.synthetic import render_frame

PROJECT = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("NIMPREP_REFERENCE_DATA", PROJECT.parent / "shared" / "data"))
GIVEN = ("rgb", "depth", "label")
ROAD = 1
OTHERS = {0: "rest", 2: "anomaly"}


def frames() -> Iterator[tuple[str, Frame]]:
    """Yield the frames with what they are."""
    for kind, folder, options, origin in (
        ("active stereo (GMRP)", "gmrp", {}, None),
        ("stereo (KITTI)", "kitti_road", {"depth_from": "stereo"}, "stereo"),
        ("LiDAR, completed (KITTI)", "kitti_road", {}, "depth_u16"),
    ):
        if not (DATA / folder).is_dir():
            continue
        reader = open_reader(DATA / folder, ReaderOptions(**options))
        for name in reader.ids:
            if origin is not None and reader.depth_source(name) != origin:
                continue
            frame = reader.read(name, GIVEN)
            if frame.depth_m.any() and (frame.label == ROAD).any():
                yield kind, frame
                yield from thinned(frame) if origin == "depth_u16" else ()
    camera = Camera.from_fov(69.4, 640, 360)
    rng = np.random.default_rng(0)
    for index in range(8):
        made = render_frame(0, index, camera)
        noise = rng.normal(1, 0.003, made.label.shape).astype(np.float32)
        depth = made.depth_exact_m * noise
        name = f"street {index}"
        yield (
            "time of flight (synthetic)",
            Frame(name, camera, rgb=made.rgb, depth_m=depth, label=made.label),
        )


def thinned(frame: Frame) -> Iterator[tuple[str, Frame]]:
    """Yield the frame with few of its pixels, as a scanner has, and with these filled."""
    few = np.zeros_like(frame.depth_m)
    few[::5, ::4] = frame.depth_m[::5, ::4]
    yield "LiDAR, sparse (KITTI, thinned)", replace(frame, depth_m=few)
    filled, _ = nimprep.fill_depth(few, "linear")
    # Of the same pixels as the completed frame.
    depth = np.where(frame.depth_m > 0, filled, 0)
    yield "LiDAR, sparse, --fill linear", replace(frame, depth_m=depth)


def areas(frame: Frame, looked: list[Source]) -> dict[tuple[str, int], float]:
    """Return the area, the road being the higher side, by what the number is called and class."""
    found, _ = frame_areas(frame, looked, ROAD, tuple(OTHERS))
    return {
        (f"{looked[number].label}{': ' if name else ''}{name}", other): area
        for (number, name), by_class in found.items()
        for other, area in by_class.items()
    }


def show(title: str, several: list[dict[tuple[str, int], float]]) -> None:
    """Print a table of means, the best first."""
    names = list(dict.fromkeys(name for found in several for name, _ in found))
    classes = [c for c in OTHERS if any(other == c for found in several for _, other in found)]
    mean = {}
    for key in ((name, c) for name in names for c in classes):
        known = [found[key] for found in several if key in found]
        area = float(np.mean(known)) if known else float("nan")
        mean[key] = max(area, 1 - area)
    heads = "  ".join(f"{OTHERS[c]:>8s}" for c in classes)
    print(f"\n{title}: road against\n{'':58s}{heads}")
    for name in sorted(names, key=lambda n: -np.nanmean([mean[n, c] for c in classes])):
        cells = "  ".join(f"{mean[name, c]:8.3f}" for c in classes)
        print(f"  {name:56s}{cells}", flush=True)


def made_in_ms(frame: Frame, source: Source) -> float:
    times = []
    for _ in range(6):
        start = time.perf_counter()
        image_of(source, frame)
        times.append(1000 * (time.perf_counter() - start))
    return float(np.median(times[1:]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--each", action="store_true", help="every frame, not the means alone")
    parser.add_argument("--times", action="store_true", help="how long each takes to make")
    options = parser.parse_args()
    looked = sources({name: MODALITIES[name] for name in GIVEN}, Recipe())
    kinds: dict[str, list[Frame]] = {}
    for kind, frame in frames():
        kinds.setdefault(kind, []).append(frame)
    for kind, members in kinds.items():
        found = [areas(frame, looked) for frame in members]
        for frame, one in zip(members, found, strict=True):
            if options.each:
                show(f"{kind}, {frame.id}", [one])
        show(f"{kind}, {len(members)} frame{'s' if len(members) > 1 else ''}", found)
        if options.times:
            for source in looked:
                if source.recipe is not None:
                    print(f"  {source.label:56s}{made_in_ms(members[0], source):8.1f} ms")


if __name__ == "__main__":
    main()
