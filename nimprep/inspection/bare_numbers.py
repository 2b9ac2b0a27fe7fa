"""Files of bare numbers, row by row: depth without a header, as large as the colour images say."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from nimprep.errors import DecodeError
from nimprep.images import Layout, Raw, read_plane
from nimprep.inspection.samples import MOST_SAMPLES, Sample, roughness

ENDINGS = frozenset((".bin", ".raw", ".dat", ".depth", ".z16"))
"""Endings that such files have."""

_TYPES = {2: ("uint16",), 4: ("float32",)}
_CALM = 0.2
"""Roughness of depth; that of bytes that are something else is some 0.3 and more."""


def bare_layout(paths: Sequence[Path], sizes: Iterable[tuple[int, int]]) -> Raw | None:
    """Return what bare numbers are, by files' size and the size of images; None = no image.

    Parameters
    ----------
    paths : sequence of Path
        All must be of one size.
    sizes : iterable of (width, height)
        Of the images beside them.
    """
    counts = {path.stat().st_size for path in paths[:MOST_SAMPLES]}
    if len(counts) != 1:
        return None
    (count,) = counts
    for width, height in sizes:
        for dtype in _TYPES.get(count // max(1, width * height), ()):
            raw = Raw(dtype=dtype, width=width, height=height)
            if count % (width * height) == 0 and _is_calm(paths[0], raw):
                return raw
    return None


def _is_calm(path: Path, raw: Raw) -> bool:
    samples = bare_samples([path], raw)
    return bool(samples) and 0 < roughness(samples[0].pixels) < _CALM


def bare_samples(paths: Sequence[Path], raw: Raw) -> list[Sample]:
    """Read some files of bare numbers; what cannot be is left out."""
    samples: list[Sample] = []
    step = max(1, len(paths) // MOST_SAMPLES)
    for path in paths[::step][:MOST_SAMPLES]:
        try:
            samples.append(Sample(path, read_plane(path, Layout(raw=raw)), "raw"))
        except DecodeError:
            continue
    return samples
