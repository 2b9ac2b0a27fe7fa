"""Camera files, told by what is in them, with what their numbers say of depth."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from nimprep.errors import DecodeError
from nimprep.files import read_file
from nimprep.schema import parse_json

ENDINGS = frozenset(
    [
        ".json",
        ".txt",
        ".yaml",
        ".yml",
        ".xml",
        ".ini",
        ".cfg",
        ".conf",
        ".csv",
        ".cam",
        ".calib",
        ".md",
    ]
)
_MOST_BYTES = 1 << 20
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_LINE = re.compile(r"^\s*[\"']?([A-Za-z_][\w.\[\], ]*?)[\"']?\s*[:=]\s*(.*)$")
_NUMBERS = re.compile(_NUMBER)
_PLAIN = re.compile(rf"^[\s,;\[\]]*(?:{_NUMBER}[\s,;\[\]]*)+$")

_NAMES = {
    "fx": ("fx", "fl_x", "f_x", "focal_x", "focal_length_x"),
    "fy": ("fy", "fl_y", "f_y", "focal_y", "focal_length_y"),
    "cx": ("cx", "u0", "ppx", "c_x", "principal_point_x"),
    "cy": ("cy", "v0", "ppy", "c_y", "principal_point_y"),
    "width": ("width", "w", "image_width", "img_width"),
    "height": ("height", "h", "image_height", "img_height"),
    "baseline": ("baseline", "baseline_m", "bf_baseline"),
}
_MATRICES = re.compile(
    r"(^|[._])(K|cam_K|k|intrinsic|intrinsics|intrinsic_matrix|camera_matrix|cam0|P2|P_rect_02|"
    r"M|K_rgb|color_intrinsic|m_calibrationColorIntrinsic|data)([._\d]*)$"
)
_SCALES = re.compile(
    r"depth_?(map)?_?(scale|factor)|png_depth_scale|^scale$|\.scale$|depth_?shift|"
    r"scaling_factor|units_per_met",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class Calibration:
    """Hold what a camera file says.

    Attributes
    ----------
    numbers : mapping
        fx, fy, cx, cy, pixels; width, height; baseline_m; as far as they are there.
    key : str
        Which matrix they are of; "" = none.
    keys : mapping of number to its place in JSON
    depth_scale : float, optional
        What the file gives as the scale of depth: units per metre, or metres per unit.
    table : tuple of str
        The head of a table with a row per frame.
    """

    numbers: Mapping[str, float]
    key: str = ""
    keys: Mapping[str, str] = field(default_factory=dict)
    depth_scale: float | None = None
    table: tuple[str, ...] = ()


def calibration_in(path: Path) -> Calibration | None:
    """Return what a camera file says; None = it is none, or cannot be read."""
    try:
        data = read_file(path, _MOST_BYTES)
    except DecodeError:
        return None
    if path.suffix.lower() == ".json":
        try:
            return _of_document(parse_json(data))
        except ValueError:
            return None
    if b"\0" in data[:4096]:
        return None
    return _of_text(data.decode("utf-8", "replace"))


def _flat(document: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(document, dict):
        for key, value in list(document.items())[:200]:
            yield from _flat(value, f"{name}.{key}" if name else str(key))
    elif name:
        yield name, document


def _of_document(document: Any) -> Calibration | None:
    if not isinstance(document, dict) or document.get("format") == "nimprep-folder":
        return None
    flat = dict(_flat(document))
    numbers: dict[str, float] = {}
    keys: dict[str, str] = {}
    for name, aliases in _NAMES.items():
        for key, value in flat.items():
            last = key.rpartition(".")[2].lower()
            if name not in keys and last in aliases and isinstance(value, int | float):
                numbers["baseline_m" if name == "baseline" else name] = float(value)
                keys["baseline_m" if name == "baseline" else name] = key
    matrix = ""
    if not {"fx", "fy", "cx", "cy"} <= numbers.keys():
        for key, value in flat.items():
            found = _of_matrix(_unnested(value)) if _MATRICES.search(key) else None
            if found:
                numbers, matrix, keys = {**numbers, **found}, key, {}
                break
    return _made(numbers, matrix, keys, _scale(flat))


def _unnested(value: Any) -> list[float]:
    if isinstance(value, list):
        return [number for item in value for number in _unnested(item)]
    return [float(value)] if isinstance(value, int | float) else []


def _scale(flat: Mapping[str, Any]) -> float | None:
    for key, value in flat.items():
        if _SCALES.search(key):
            found = _NUMBERS.search(str(value))
            if found and float(found[0]) > 0:
                return float(found[0])
    return None


def _of_matrix(values: list[float]) -> dict[str, float] | None:
    """Return the pinhole camera of 9, 12 or 16 numbers, by rows or by columns."""
    if len(values) not in (9, 12, 16):
        return None
    width = 3 if len(values) == 9 else 4
    rows = [values[k : k + width] for k in range(0, len(values), width)]
    if len(values) == 9 and rows[0][2] == rows[1][2] == 0 and rows[2][0] > 0:
        rows = [list(row) for row in zip(*rows, strict=True)]
    fx, cx, fy, cy = rows[0][0], rows[0][2], rows[1][1], rows[1][2]
    if fx > 1 and fy > 1 and cx > 0 and cy > 0 and abs(rows[1][0]) < 1e-6 and rows[2][2] == 1:
        return {"fx": fx, "fy": fy, "cx": cx, "cy": cy}
    return None


def _of_text(text: str) -> Calibration | None:
    named: dict[str, Any] = {}
    plain: list[float] = []
    lines = text.splitlines()
    for line in lines[:400]:
        match = _LINE.match(line)
        if match and (found := _NUMBERS.findall(match[2])):
            key, values = match[1].strip(), [float(number) for number in found]
            named.setdefault(key, values[0] if len(values) == 1 else values)
        elif _PLAIN.match(line) and len(plain) < 32:
            plain += [float(number) for number in _NUMBERS.findall(line)]
    if made := _of_document(named):
        numbers = {**_stereo_baseline(named), **made.numbers}
        # Middlebury's baseline is in millimetres, and its cameras are called cam0 and cam1.
        if "cam0" in named and "doffs" in named:
            numbers["baseline_m"] = numbers.get("baseline_m", 0.0) / 1000
            numbers["doffs"] = float(named["doffs"])
        return Calibration(numbers, made.key, {}, made.depth_scale)
    head = tuple(re.split(r",(?!\d\])\s*|\s+", lines[0].strip())) if lines else ()
    if {"K[0,0]", "K[1,1]"} <= set(head) or {"fx", "fy", "cx", "cy"} <= set(head):
        return _of_table(head, lines[1] if len(lines) > 1 else "")
    if named or not plain:
        return None
    matrix = _of_matrix(plain) or _of_matrix(plain[:9])
    if matrix:
        return Calibration(matrix)
    if len(plain) in (4, 6) and plain[0] > 10 and 0.5 < plain[0] / max(plain[1], 1e-9) < 2:
        names = ("fx", "fy", "cx", "cy", "width", "height")
        if all(number > 1 for number in plain):
            return Calibration(dict(zip(names, plain, strict=False)))
    return None


def _stereo_baseline(named: Mapping[str, Any]) -> dict[str, float]:
    """Return the baseline between KITTI's colour cameras, metres: P's fourth number is -fx b."""
    for left, right in (("P_rect_02", "P_rect_03"), ("P2", "P3")):
        first, second = named.get(left), named.get(right)
        if not isinstance(first, list) or not isinstance(second, list):
            continue
        if len(first) == len(second) == 12:
            baseline = (first[3] - second[3]) / first[0] if first[0] else 0.0
            if baseline > 0.01:
                return {"baseline_m": baseline}
    return {}


_COLUMNS = {"K[0,0]": "fx", "K[1,1]": "fy", "K[0,2]": "cx", "K[1,2]": "cy"}


def _of_table(head: tuple[str, ...], row: str) -> Calibration | None:
    names = tuple(_COLUMNS.get(name, name) for name in head)
    values = dict(zip(names, row.replace(",", " ").split(), strict=False))
    try:
        numbers = {name: float(values[name]) for name in ("fx", "fy", "cx", "cy")}
    except (KeyError, ValueError):
        return None
    return Calibration(numbers, table=names)


def _made(
    numbers: dict[str, float], key: str, keys: dict[str, str], scale: float | None
) -> Calibration | None:
    whole = {"fx", "fy", "cx", "cy"} <= numbers.keys()
    if not whole and scale is None:
        return None
    return Calibration(numbers, key, keys if whole else {}, scale)
