"""Pack predictions into the zip that the KITTI road benchmark takes."""

from __future__ import annotations

import warnings
from collections.abc import Collection
from dataclasses import dataclass, field, replace
from functools import partial as bind
from pathlib import Path

import numpy as np

from nimprep.errors import LayoutError, NimprepError
from nimprep.files import check_file
from nimprep.images import read_header
from nimprep.kitti.archive import ZipWhole
from nimprep.kitti.bev import BEV_SHAPE, bring_to_bev, frame_calibration, is_bev
from nimprep.kitti.calibration import frame_shape
from nimprep.kitti.confidences import SUFFIXES, Confidences, confidence_files, listed
from nimprep.kitti.images import confidence_shape, png_bytes, reason_against_array
from nimprep.kitti.names import (
    PredictionName,
    Target,
    nearest_name,
    official_names,
    prediction_name,
)
from nimprep.parallel import Progress, map_frames


@dataclass(frozen=True)
class Submission:
    """Tell what was packed.

    Attributes
    ----------
    path : Path
        The zip.
    names : tuple of str
        Its entries, in order.
    transformed : int
        How many of them were transformed to the bird's-eye view.
    """

    path: Path
    names: tuple[str, ...]
    transformed: int


@dataclass
class _Inventory:
    """Sort a folder's files into what belongs in the zip and what stands against it."""

    files: dict[PredictionName, Path] = field(default_factory=dict)
    missing: list[str] = field(default_factory=list)
    extra: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)

    def problems(self) -> str:
        """Return what is missing, extra or wrong, in one line; empty = nothing."""
        parts = []
        for kind in ("missing", "extra", "wrong"):
            names = getattr(self, kind)
            if names:
                parts.append(f"{len(names)} {kind}: {listed(names)}")
        return "; ".join(parts)


@dataclass(frozen=True)
class _Entry:
    """Hold one PNG of the zip."""

    name: PredictionName
    data: bytes
    transformed: bool
    values: int


def pack_submission(
    predictions: Path | str,
    out: Path | str,
    calib: Path | str | None = None,
    *,
    target: Target = "road",
    partial: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Submission:
    """Check a folder of predictions and pack it for the benchmark's upload form.

    The zip holds bird's-eye views, 8-bit PNG, at its root; perspective predictions are transformed.
    It depends on the input alone, byte for byte, and is written whole or not at all.

    Parameters
    ----------
    predictions : folder
        ``<cat>_<type>_<number>`` or the frame's id (``um_000000``, ``testing/um_000000``), as .png
        (confidences of 8 or 16 bits; where all are 0 and 1, masks) or .npy (floating probabilities
        in [0, 1]), in perspective or in the bird's-eye view (400x800).
    out : path of the zip
    calib : folder, optional
        The test set's calibrations; needed for predictions in perspective. Sizes are checked
        against image_2 beside it where that is there.
    target : {"road", "lane"}
        All 290 frames, or the 96 of category um.
    partial : bool
        Pack what is there, for a trial.
    overwrite : bool
        Replace an existing zip.

    Warns
    -----
    UserWarning
        Predictions hold one or two values only.

    Raises
    ------
    LayoutError
        The zip exists; predictions are missing, extra or wrong, all of them named.
    DecodeError
        A prediction or a calibration is bad.
    """
    predictions, out = Path(predictions), Path(out)
    calib = None if calib is None else Path(calib)
    sources = (predictions, *([calib] if calib else []))
    check_file(out, *sources, overwrite=overwrite)
    inventory = _take_inventory(predictions, calib, target, partial)
    _refuse_problems(inventory, predictions, target, partial)
    confidences = Confidences(dict(sorted(inventory.files.items())))
    render = bind(_render_entry, confidences=confidences, calib=calib)
    entries: list[_Entry] = []
    with ZipWhole(out, *sources, overwrite=overwrite) as archive:
        for entry in map_frames("pack", render, list(confidences.files), progress):
            archive.add(entry.name.png, entry.data)
            entries.append(replace(entry, data=b""))
    _warn_of_poor_maps(predictions, entries)
    return Submission(out, tuple(e.name.png for e in entries), sum(e.transformed for e in entries))


def _refuse_problems(
    inventory: _Inventory, predictions: Path, target: Target, partial: bool
) -> None:
    problems = inventory.problems()
    if not problems and not inventory.files:
        problems = "none; name them by frame id (um_000000) or as the benchmark does"
    if problems:
        expected = "only" if partial else f"all {len(list(official_names(target)))}"
        raise LayoutError(
            f"{predictions}: expected {expected} test predictions of type {target}, "
            f"found {problems}"
        )


def _warn_of_poor_maps(predictions: Path, entries: list[_Entry]) -> None:
    for values, what in ((1, "one value"), (2, "two values")):
        names = [entry.name.stem for entry in entries if entry.values == values]
        if names:
            warnings.warn(
                f"{predictions}: expected confidences of many levels, found only {what} in "
                f"{len(names)} predictions ({listed(names)}); MaxF and AP sweep 256 thresholds",
                stacklevel=3,
            )


def _take_inventory(folder: Path, calib: Path | None, target: Target, partial: bool) -> _Inventory:
    wanted = list(official_names(target))
    inventory = _Inventory()
    official = set(wanted)
    for path in confidence_files(folder, "testing"):
        shown = path.relative_to(folder).as_posix()
        shown = shown if shown.isprintable() else ascii(shown)
        try:
            name = prediction_name(path, target)
        except LayoutError:
            name = None
        if name not in official or path.suffix.lower() not in SUFFIXES or name is None:
            inventory.extra.append(shown + _hint(path, name, target, official))
        elif name in inventory.files:
            inventory.wrong.append(f"{shown} (beside {inventory.files[name].name})")
        else:
            inventory.files[name] = path
            reason = _reason_against(path, name, calib)
            if reason:
                inventory.wrong.append(f"{shown} ({reason})")
    if not partial:
        inventory.missing = [name.png for name in wanted if name not in inventory.files]
    return inventory


def _hint(
    path: Path, name: PredictionName | None, target: Target, official: Collection[PredictionName]
) -> str:
    """Return what a file that is no prediction may have been meant to be; "" = nothing known."""
    if name in official:
        return f" (expected {' or '.join(SUFFIXES)})"
    nearest = nearest_name(path, target) if name is None else ""
    return f" ({nearest}?)" if nearest else ""


def _reason_against(path: Path, name: PredictionName, calib: Path | None) -> str:
    """Return why a prediction cannot be packed, from headers alone; empty = nothing speaks so."""
    try:
        is_array = path.suffix.lower() == ".npy"
        if is_array and (reason := reason_against_array(path)):
            return reason
        if not is_array:
            header = read_header(path)
            if header.kind != "grey" or header.bits not in (1, 8, 16):
                return f"expected 8-bit or 16-bit grey, found {header.bits}-bit {header.kind}"
        shape = confidence_shape(path)
        if is_bev(shape):
            return ""
        calibration = frame_calibration(calib, name.frame, path)
        expected = frame_shape(calibration)
        if expected is None:
            return (
                f"expected an image_2 folder beside {calibration.path.parent} to know its size, "
                "found none"
            )
    except NimprepError as error:
        return str(error)
    if expected != shape:
        return (
            f"expected {expected[1]}x{expected[0]} or {BEV_SHAPE[1]}x{BEV_SHAPE[0]}, "
            f"found {shape[1]}x{shape[0]}"
        )
    return ""


def _render_entry(name: PredictionName, confidences: Confidences, calib: Path | None) -> _Entry:
    confidence = confidences.read(name)
    view = bring_to_bev(confidence, confidences.files[name], calib, name.frame)
    values = np.count_nonzero(np.bincount(confidence.reshape(-1), minlength=256))
    return _Entry(name, png_bytes(view), view is not confidence, int(values))
