"""What a store's page says, as data for its template and its gallery."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from nimprep.report.artist import Artist, Look
from nimprep.report.charts import class_shares
from nimprep.report.collect import Collected
from nimprep.report.figures import Chart
from nimprep.report.findings import Finding, checks
from nimprep.report.pictures import css_color, data_uri, encode_picture, normal_sphere
from nimprep.splits import SPLIT_CODES
from nimprep.store.info import store_info
from nimprep.store.reader import Store

_ORIGINS = {
    "file": "a calibration file",
    "user": "numbers given by the user",
    "nominal": "the sensor's nominal field of view, not calibrated",
}
_LISTED = 12
"""Groups and frames that are named before the rest is counted."""


def describe(
    store: Store, facts: Collected, findings: Sequence[Finding], charts: dict[str, Chart]
) -> dict[str, Any]:
    """Return what the template prints, but for the gallery."""
    info = store_info(store)
    return {
        "info": info,
        "charts": charts,
        "others": [
            {"id": f"chart-other-{i}", "title": name} for i, name in enumerate(facts.pooled)
        ],
        "references": [_reference(each) for each in info["references"]],
        "splits": _splits(store, facts),
        "classes": _classes(store, facts),
        "groups": _groups(store),
        "camera": _camera(store, info),
        "findings": [_finding(store, f) for f in findings],
        "checks": checks(store),
        "step": facts.step,
        "holes": _hole_facts(store, facts),
    }


def _reference(said: Mapping[str, str]) -> list[tuple[str, str]]:
    """Return whose a dataset is, a row each: what those who use the store respect and cite."""
    names = {
        "title": "Dataset",
        "licence": "Licence",
        "citation": "Cite",
        "paper": "Paper",
        "url": "From",
    }
    return [(shown, said[name]) for name, shown in names.items() if name in said]


def _splits(store: Store, facts: Collected) -> list[dict[str, Any]]:
    rows = []
    for name, code in SPLIT_CODES.items():
        members = store.tables.split == code
        number = int(members.sum())
        if number or name != "none":
            rows.append({"name": name, "frames": number, "share": number / len(store)})
    return rows


def _classes(store: Store, facts: Collected) -> list[dict[str, Any]]:
    """Return a row per class: its share of each split's labelled pixels, and how many frames."""
    if "label" not in store.modalities:
        return []
    shares = class_shares(store, facts)
    return [
        {
            "id": entry.id,
            "name": entry.name,
            "color": css_color(entry.color),
            "shares": {split: float(share[i]) for split, share in shares.items()},
            "frames": int((facts.classes[:, i] > 0).sum()),
        }
        for i, entry in enumerate(store.classes)
    ]


def _groups(store: Store) -> dict[str, Any]:
    """Return the largest groups with their frames per split, and how many more there are."""
    counts: dict[str, Counter[int]] = {}
    for group, code in zip(store.tables.group, store.tables.split.tolist(), strict=True):
        if group:
            counts.setdefault(group, Counter())[code] += 1
    ordered = sorted(counts.items(), key=lambda item: (-item[1].total(), item[0]))
    rows = [
        {
            "name": name,
            "frames": of.total(),
            "splits": [of[code] for code in SPLIT_CODES.values()],
        }
        for name, of in ordered[:_LISTED]
    ]
    return {"rows": rows, "more": len(ordered) - len(rows), "number": len(ordered)}


def _hole_facts(store: Store, facts: Collected) -> dict[str, float] | None:
    if "depth" not in store.modalities:
        return None
    share = facts.hole_share
    return {"all": float(1 - facts.valid.sum() / facts.pixels.sum()), "worst": float(share.max())}


def _finding(store: Store, finding: Finding) -> dict[str, Any]:
    return {
        "severity": finding.severity,
        "title": finding.title,
        "text": finding.text,
        "number": len(finding.frames),
        "pairs": [(store.ids[a], store.ids[b]) for a, b in finding.pairs[:5]],
        "more_pairs": max(0, len(finding.pairs) - 5),
        "ids": [store.ids[i] for i in finding.frames[:_LISTED]],
        "more": max(0, len(finding.frames) - _LISTED),
    }


def _camera(store: Store, info: dict[str, Any]) -> dict[str, Any]:
    """Return the first frame's camera, what others differ in, and coordinates of its drawing."""
    camera = store.camera(0)
    k = store.tables.intrinsics
    sizes = store.tables.image_size
    same = bool((k == k[0]).all() and (sizes == sizes[0]).all())
    left, right = (math.degrees(math.atan(d / camera.fx)) for d in _reach(camera.cx, camera.width))
    up, down = (math.degrees(math.atan(d / camera.fy)) for d in _reach(camera.cy, camera.height))
    spans = {
        name: (float(values.min()), float(values.max()))
        for name, values in (
            ("fx", k[:, 0, 0]),
            ("fy", k[:, 1, 1]),
            ("cx", k[:, 0, 2]),
            ("cy", k[:, 1, 2]),
        )
    }
    return {
        "camera": camera,
        "same": same,
        "spans": spans,
        "origin": _ORIGINS[info["calibration"]["origin"]],
        "angles": {"left": left, "right": right, "up": up, "down": down},
        "horizontal": left + right,
        "vertical": up + down,
        "baseline": info["calibration"]["baseline_m"],
        "with_road": info["calibration"]["frames_with_cam_to_road"],
        "gravity": _gravity(store),
        "wedge": _wedge(left, right),
    }


def _reach(centre: float, size: int) -> tuple[float, float]:
    """Return the distances from the principal point to the image's two outer edges, pixels."""
    return centre + 0.5, size - 0.5 - centre


def _wedge(left: float, right: float) -> dict[str, float]:
    """Return the field of view from above: the camera at (100, 92), looking up, 80 far."""
    return {
        "left_x": 100 - 80 * math.sin(math.radians(left)),
        "left_y": 92 - 80 * math.cos(math.radians(left)),
        "right_x": 100 + 80 * math.sin(math.radians(right)),
        "right_y": 92 - 80 * math.cos(math.radians(right)),
    }


def _gravity(store: Store) -> dict[str, float] | None:
    """Return the median pitch (down is positive) and roll of the camera, degrees, and spreads."""
    gravity = store.tables.gravity
    gravity = gravity[np.isfinite(gravity).all(axis=1)]
    if not len(gravity):
        return None
    pitch = np.degrees(np.arcsin(np.clip(gravity[:, 2], -1, 1)))
    roll = np.degrees(np.arctan2(gravity[:, 0], gravity[:, 1]))
    return {
        "pitch": float(np.median(pitch)),
        "pitch_low": float(pitch.min()),
        "pitch_high": float(pitch.max()),
        "roll": float(np.median(roll)),
        "roll_low": float(roll.min()),
        "roll_high": float(roll.max()),
    }


def legends(store: Store, artist: Artist) -> list[dict[str, Any]]:
    """Return the key to each modality's pictures, in the order in which they are shown."""
    return [_legend(store, look) for look in artist.looks.values()]


def _legend(store: Store, look: Look) -> dict[str, Any]:
    modality = look.modality
    legend: dict[str, Any] = {"name": modality.name, "title": look.title, "about": look.about}
    legend |= {"scale": None, "sphere": None, "classes": None, "channels": modality.key}
    legend["plain"] = modality.values == "colors"
    if look.scale is not None:
        ticks = look.scale.ticks()
        places = look.scale.place(ticks)
        legend["scale"] = {
            "stops": look.scale.stops(),
            "unit": look.scale.unit,
            "ticks": [
                {"at": float(p), "text": f"{t:g}"} for t, p in zip(ticks, places, strict=True)
            ],
        }
    if modality.picture == "directions":
        legend["sphere"] = data_uri(encode_picture(normal_sphere(), "png"), "png")
    if modality.picture == "classes":
        legend["classes"] = [
            {"id": c.id, "name": c.name, "color": css_color(c.color)} for c in store.classes
        ]
    return legend


def gallery_data(
    store: Store,
    facts: Collected,
    findings: Sequence[Finding],
    artist: Artist,
    shown: Sequence[int] | None,
) -> dict[str, Any]:
    """Return what the gallery's script works on: a column per fact, an entry per frame.

    `shown` are the frames whose pictures are on the page; None = all, served when asked for.
    """
    groups = sorted(set(store.tables.group))
    of_group = {name: place for place, name in enumerate(groups)}
    codes = list(SPLIT_CODES.values())
    pixels = np.maximum(facts.pixels, 1)
    sizes = store.tables.image_size
    return {
        "served": shown is None,
        "ids": list(store.ids),
        "splits": list(SPLIT_CODES),
        "split": [codes.index(c) if c in codes else 3 for c in store.tables.split.tolist()],
        "groups": groups,
        "group": [of_group[name] for name in store.tables.group],
        "holes": (
            np.round(100 * facts.hole_share, 1).tolist() if "depth" in store.modalities else None
        ),
        "classes": [
            {"name": c.name, "color": css_color(c.color)}
            for c in (store.classes if "label" in store.modalities else ())
        ],
        # Rounded up, so that what is there is never 0.
        "shares": (np.ceil(10000 * facts.classes / pixels[:, None]) / 100).T.tolist(),
        "height": sizes[:, 0].tolist(),
        "width": sizes[:, 1].tolist(),
        "looks": [
            {"name": name, "title": look.title, "about": look.about}
            for name, look in artist.looks.items()
        ],
        # The look to see holes in.
        "depth": list(artist.looks).index("depth") if "depth" in artist.looks else 0,
        "findings": [{"title": f.title, "frames": list(f.frames)} for f in findings],
        "shown": list(range(len(store))) if shown is None else sorted(shown),
    }
