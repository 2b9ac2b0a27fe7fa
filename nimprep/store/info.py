"""What a store says of itself: one object, printed as JSON or as text."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from nimprep.depth_unit import unit_words
from nimprep.doubts.judge import sentence
from nimprep.frame import IGNORE_LABEL
from nimprep.splits import are_categories, count_splits
from nimprep.store.attributes import StoreAttributes
from nimprep.store.depth_loss import loss_text
from nimprep.store.reader import Store, open_store
from nimprep.text import printable


def store_info(path: Store | Path | str) -> dict[str, Any]:
    """Return what a store holds (schemas/info.schema.json), given where it is or opened.

    Raises
    ------
    StoreError
        There is no store, or it is not complete.
    """
    store = path if isinstance(path, Store) else open_store(path)
    about, tables = store.about, store.tables
    sizes = Counter((int(h), int(w)) for h, w in tables.image_size)
    return {
        "path": str(store.path),
        "format_version": about.format_version,
        "tool_version": about.tool_version,
        "complete": about.complete,
        "dataset": about.dataset,
        "references": about.references,
        "frames": len(store),
        "sizes": [{"height": h, "width": w, "frames": n} for (h, w), n in sorted(sizes.items())],
        "classes": about.classes,
        "modalities": {name: _modality(store, name) for name in store.modalities},
        "depth_percentiles_m": about.depth_percentiles_m,
        "depth_unit_m": depth.step if (depth := store.stored.get("depth")) else None,
        "depth_most_m": depth.most if depth else None,
        "depth_lost": about.depth_lost,
        "calibration": {**about.calibration, **_camera(store)},
        "crop": about.crop,
        "codec": about.codec,
        "split": {
            **about.split,
            "frames": count_splits(store.splits.values()),
            **({"official": official} if (official := _official_frames(about)) else {}),
        },
        "label_pixels": _label_pixels(store),
        "groups": dict(sorted(Counter(g for g in tables.group if g).items())),
        "depth_sources": _depth_sources(about),
        "skipped": about.skipped,
        "normals_chosen": about.normals_chosen,
        "doubts": about.doubts,
        "findings": about.findings,
        "normal_noise": about.normal_noise,
        "source": about.source,
    }


def _modality(store: Store, name: str) -> dict[str, Any]:
    array = store.arrays[name]
    stored = sum(store.storage.sizes([array.shard_key(i) for i in array.shards]).values())
    raw = int(np.prod(array.shape)) * array.dtype.itemsize
    return {
        **store.about.modalities[name],
        "shape": list(array.shape),
        "dtype": str(array.dtype),
        "shard_length": array.shard_length,
        "bytes": stored,
        "bytes_uncompressed": raw,
    }


def _label_pixels(store: Store) -> dict[str, dict[str, int]] | None:
    """Count each split's pixels by label; None = no labels, or a store that keeps no counts."""
    pixels = store.tables.class_pixels
    if pixels is None or not store.classes:
        return None
    labels = [*map(str, store.about.class_ids), str(IGNORE_LABEL)]
    splits = np.array(list(store.splits.values()))
    sums = {name: pixels[splits == name].sum(axis=0, dtype=np.int64) for name in np.unique(splits)}
    return {str(name): dict(zip(labels, of.tolist(), strict=True)) for name, of in sums.items()}


def _depth_sources(about: StoreAttributes) -> dict[str, int]:
    """Count frames by where their depth came from, where the dataset says."""
    column = about.frame_metadata.get("depth_source")
    if column is None:
        return {}
    values = column["values"]
    names = (values[i] for i in column["of_frame"] if i < len(values))
    return dict(sorted(Counter(n for n in names if n and isinstance(n, str)).items()))


def _camera(store: Store) -> dict[str, Any]:
    """Return the intrinsics where all frames share them, else null, and the baselines' range."""
    k = store.tables.intrinsics
    same = bool((k == k[0]).all() and np.isfinite(k[0]).all())
    baseline = store.tables.baseline[np.isfinite(store.tables.baseline)]
    road = ~np.isnan(store.tables.cam_to_road).any(axis=(1, 2))
    return {
        "intrinsics": k[0].tolist() if same else None,
        "baseline_m": [float(baseline.min()), float(baseline.max())] if baseline.size else None,
        "frames_with_cam_to_road": int(road.sum()),
        "gravity": dict(sorted(Counter(map(store.gravity_source, range(len(store)))).items())),
    }


def _official_frames(about: StoreAttributes) -> int:
    """Return how many frames have the split that the dataset's authors chose."""
    # A file may move them.
    rule = about.split["rule"]
    return 0 if rule == "file" else sum(map(len, about.fixed_splits.values()))


def info_text(info: dict[str, Any]) -> str:
    """Return the object of `store_info` as lines for a person, whatever names it holds."""
    sizes = ", ".join(f"{s['width']}x{s['height']}" for s in info["sizes"])
    split = info["split"]
    counts = ", ".join(f"{name} {count}" for name, count in split["frames"].items())
    rule = f"by {split['rule']}" + (f", seed {split['seed']}" if "seed" in split else "")
    if official := split.get("official", 0):
        others = info["frames"] - official
        rule = "as its authors chose" + (f", {others} of them {rule}" if others else "")
    rows = [
        ("store", f"{info['path']} (format {info['format_version']})"),
        ("dataset", f"{info['dataset']}, {info['frames']} frames of {sizes} pixels"),
        ("split", f"{counts} ({rule})"),
        ("depth", _depth_text(info)),
        ("camera", _camera_text(info)),
    ]
    if info["depth_unit_m"] is not None:
        rows.insert(4, ("unit", _unit_text(info)))
    if info["depth_lost"] is not None:
        rows.append(("lost", loss_text(info["depth_lost"])))
    if info["normal_noise"]:
        rows.append(("noise", _noise_text(info["normal_noise"])))
    if info["depth_sources"]:
        sources = ", ".join(f"{name} {count}" for name, count in info["depth_sources"].items())
        rows.insert(4, ("from", sources))
    if "given" in (gravity := info["calibration"]["gravity"]):
        rows.append(("gravity", ", ".join(f"{name} {n}" for name, n in gravity.items())))
    if any(info["crop"].values()):
        margins = ", ".join(f"{side} {n}" for side, n in info["crop"].items())
        rows.append(("crop", f"{margins} pixels cut off"))
    if info["groups"]:
        categories = are_categories(info["dataset"], info["split"]["rule"])
        kind = "categories" if categories else "scenes"
        rows.append(("groups", f"{len(info['groups'])} {kind}"))
    if info["classes"]:
        rows.append(("classes", ", ".join(f"{c['id']} {c['name']}" for c in info["classes"])))
    for reference in info["references"]:
        rows += [
            (name, " ".join(reference[key].split()))
            for name, key in (("of", "title"), ("licence", "licence"), ("cite", "citation"))
            if key in reference
        ]
    if info["skipped"]:
        rows.append(("skipped", f"{len(info['skipped'])} bad frames of the source"))
    if info["normals_chosen"] is not None:
        rows.append(("normals", _chosen_text(info["normals_chosen"])))
    rows += [("doubt", sentence(doubt)) for doubt in info["doubts"]]
    rows += [("finding", sentence(finding)) for finding in info["findings"]]
    lines = [f"{name:<9}{printable(text)}" for name, text in rows]
    lines.append("")
    wide = max(10, *(len(name) + 1 for name in info["modalities"]))
    lines.append(f"{'modality':<{wide}}{'dtype':<8}{'made by':<14}{'MB':>9}{'of raw':>9}")
    for name, m in info["modalities"].items():
        share = m["bytes"] / m["bytes_uncompressed"]
        made = m["method"] if m["method"] != "source" else "copied"
        megabytes = m["bytes"] / 1e6
        size = f"{megabytes:>9.2f}{share:>8.0%}"
        lines.append(printable(f"{name:<{wide}}{m['dtype']:<8}{made:<14}{size}"))
    return "\n".join(lines)


def _depth_text(info: dict[str, Any]) -> str:
    depth = info["depth_percentiles_m"]
    if depth is None:
        return "none"
    return (
        f"5 % below {depth['5']:.3f} m, median {depth['50']:.3f} m, 95 % below {depth['95']:.3f} m"
    )


def _noise_text(noise: dict[str, float]) -> str:
    text = f"{100 * noise['relative']:.3g} % of the distance" if noise["relative"] else "none found"
    text += f", turns normals by nim by {noise['expected_deg']:.1f} deg"
    if "roughness_deg" in noise:
        text += f", the road's by {noise['roughness_deg']:.1f} deg"
    return text


def _unit_text(info: dict[str, Any]) -> str:
    return f"{unit_words(info['depth_unit_m'])}, to {info['depth_most_m']:.6g} m"


def _chosen_text(chosen: dict[str, Any]) -> str:
    """Say which method of normals was chosen, and by which noise."""
    frames = chosen["frames"]
    if not frames:
        return f"{chosen['method']}, as no frame to measure noise on was good"
    relative, turns = (np.median([f[name] for f in frames]) for name in ("relative", "turns_deg"))
    noise = (
        f"noise of {relative:.2g} of the depth, which turns normals by up to {turns:.2g} degrees"
    )
    ids = f"{len(frames)} frame" + ("" if len(frames) == 1 else "s")
    found = noise if relative > 0 else "no noise"
    return f"{chosen['method']}, chosen by {found} (median of {ids}, first {frames[0]['id']!r})"


def _camera_text(info: dict[str, Any]) -> str:
    calibration = info["calibration"]
    k = calibration["intrinsics"]
    if k is None:
        text = "one per frame"
    else:
        text = f"fx {k[0][0]:.2f}, fy {k[1][1]:.2f}, cx {k[0][2]:.2f}, cy {k[1][2]:.2f}"
    origins = {
        "file": "from a calibration file",
        "user": "given by the user",
        "nominal": "nominal, not calibrated",
    }
    return f"{text} ({origins[calibration['origin']]})"
