"""What was found out, as JSON has it (schemas/inspection.schema.json)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nimprep.inspection.encodings import Encoding
from nimprep.inspection.examination import Examination, Plane
from nimprep.inspection.holdings import Holding
from nimprep.inspection.templates import Template

_WIDTH = 100
"""What fits in a line of so many characters stands in one."""

MOST_LINES = 20
"""So many names and problems are listed."""


def description_bytes(description: dict[str, Any]) -> bytes:
    """Return a description as people edit it: a class, or an image of depth, in one line."""
    return _laid_out(description, "").encode() + b"\n"


def _laid_out(value: Any, indent: str) -> str:
    whole = json.dumps(value)
    if not indent or len(indent) + len(whole) > _WIDTH:
        inner = indent + "  "
        if isinstance(value, dict) and value:
            lines = [f"{inner}{json.dumps(k)}: {_laid_out(v, inner)}" for k, v in value.items()]
            return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
        if isinstance(value, list) and value:
            lines = [inner + _laid_out(each, inner) for each in value]
            return "[\n" + ",\n".join(lines) + f"\n{indent}]"
    return whole


def found_document(
    found: Examination | None, depth: Sequence[tuple[Plane, list[Encoding]]]
) -> dict[str, Any]:
    """Return what was found in a folder; None = it is none."""
    return {
        "files": 0 if found is None else len(found.survey.files),
        "sampled": found is not None and found.survey.cut,
        "patterns": [] if found is None else _patterns(found),
        "depth": [_depth(plane, encodings) for plane, encodings in depth],
        "cameras": [] if found is None else _cameras(found),
        "splits": {} if found is None else split_counts(found),
    }


def _patterns(found: Examination) -> list[dict[str, Any]]:
    root = found.survey.root
    lines = [
        {
            "files": plane.pattern,
            "count": plane.count,
            "bytes": _bytes(root, plane.template),
            "kind": plane.kind,
            "evidence": list(plane.guess.evidence),
            "size": list(plane.samples[0].size),
            **_array(plane),
            "channels": plane.samples[0].channels,
            "dtype": str(plane.samples[0].pixels.dtype),
            "range": _range(plane),
        }
        for plane in found.planes
    ]
    rest = (
        *((c.template, "camera") for c in found.cameras),
        *((template, "points") for template in found.clouds),
        *((template, "text") for template in found.texts),
        *((template, "other") for template in found.others),
    )
    lines += [
        {
            "files": template.pattern,
            "count": len(template.members),
            "bytes": _bytes(root, template),
            "kind": kind,
            "evidence": [],
        }
        for template, kind in rest
    ]
    return lines


def _array(plane: Plane) -> dict[str, str]:
    if plane.held is None or not plane.held.key:
        return {}
    return {"key": plane.held.key, "axes": plane.held.axes}


def _bytes(root: Path, template: Template) -> int:
    """Return how many bytes files take together, by the first 50 of them."""
    some = template.members[:50]
    sizes = []
    for member in some:
        try:
            sizes.append((root / member.path).stat().st_size)
        except OSError:
            continue
    return round(sum(sizes) / max(1, len(sizes)) * len(template.members))


def _range(plane: Plane) -> list[float] | None:
    ends = []
    for sample in plane.samples:
        values = sample.pixels[np.isfinite(sample.pixels)]
        if values.size:
            ends += [float(values.min()), float(values.max())]
    return [min(ends), max(ends)] if ends else None


def _depth(plane: Plane, encodings: Sequence[Encoding]) -> dict[str, Any]:
    return {
        "files": plane.pattern,
        "encodings": [
            {
                "name": encoding.name,
                "score": round(encoding.score, 2),
                "depth": {"files": plane.pattern, **_array(plane), **encoding.document},
                "reasons": list(encoding.reasons),
            }
            for encoding in encodings[:4]
        ],
    }


def _cameras(found: Examination) -> list[dict[str, Any]]:
    return [
        {
            "files": camera.template.pattern,
            "count": len(camera.template.members),
            "numbers": dict(camera.calibration.numbers),
            "key": camera.calibration.key,
            "depth_scale": camera.calibration.depth_scale,
        }
        for camera in found.cameras
    ]


def holding_document(holding: Holding, source: Path) -> dict[str, Any]:
    path = holding.path
    name = path.relative_to(source) if path.is_relative_to(source) and path != source else path
    return {
        "path": str(name),
        "kind": holding.kind,
        "what": holding.what,
        "names": list(holding.names[:MOST_LINES]),
        "step": holding.step,
    }


def split_counts(found: Examination) -> dict[str, int]:
    """Return how many files of the pattern with most the folders named as splits have."""
    best: dict[str, int] = {}
    for plane in found.planes:
        counts: dict[str, int] = {}
        for member in plane.template.members:
            if "split" in member.captured:
                name = member.captured["split"]
                counts[name] = counts.get(name, 0) + 1
        if sum(counts.values()) > sum(best.values()):
            best = counts
    return best
