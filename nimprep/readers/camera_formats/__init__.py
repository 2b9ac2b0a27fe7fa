"""Camera files in the formats that people have, told by what they hold."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from nimprep.errors import CameraError
from nimprep.files import read_file
from nimprep.readers.camera_formats.colmap import is_colmap, numbers_of_colmap
from nimprep.readers.camera_formats.documents import numbers_of_document
from nimprep.readers.camera_formats.numbers import CameraNumbers, numbers_of_text
from nimprep.readers.camera_formats.plain_text import (
    has_matrices,
    keyed_lines,
    keyed_numbers,
    numbers_of_bare,
    numbers_of_matrices,
    without_comments,
)
from nimprep.readers.camera_formats.rows import CameraTable, is_table, table_of
from nimprep.readers.camera_formats.yaml_events import parse_yaml
from nimprep.readers.description import CameraSource
from nimprep.schema import MAX_BYTES, check_json, parse_json

__all__ = ["CameraNumbers", "CameraTable", "numbers_from_document", "numbers_from_file"]

_OWN = {"fx", "fy", "cx", "cy"}


def numbers_from_file(
    path: Path, source: CameraSource, *, pipes: bool = False
) -> CameraNumbers | CameraTable:
    """Read a camera file of any format: JSON, YAML, COLMAP's, KITTI's, numbers or a table.

    Parameters
    ----------
    source : CameraSource
        Says more where a file alone does not: `keys`, `key` and `columns`.
    pipes : bool
        Take a pipe too.

    Raises
    ------
    CameraError
        It cannot be read, is of no format known here, or has several cameras.
    """
    data = read_file(path, MAX_BYTES, "a readable camera file", CameraError, pipes=pipes)
    where, start = str(path), data.removeprefix(b"\xef\xbb\xbf").lstrip()[:1]
    if path.suffix.lower() == ".json" or start == b"{":
        try:
            document = parse_json(data)
        except ValueError as error:
            raise CameraError(f"{where}: expected JSON, found {error}") from error
        return numbers_from_document(document, where, source)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise CameraError(
            f"{where}: expected a camera in text, found binary data; give the camera in JSON"
        ) from error
    if path.suffix.lower() in (".yaml", ".yml") or text.startswith("%YAML"):
        return _checked(numbers_of_document(parse_yaml(text, where), where, source), where)
    return _from_text(text, where, source)


def _from_text(text: str, where: str, source: CameraSource) -> CameraNumbers | CameraTable:
    if source.columns or is_table(text):
        return table_of(text, where, source.columns)
    if is_colmap(text):
        return numbers_of_colmap(text, where, source)
    plain = without_comments(text)
    numbers = numbers_of_text(plain) if len(plain) < 10_000 else None
    if numbers is not None:
        return numbers_of_bare(numbers, where)
    lines = keyed_lines(plain)
    if lines:
        matrices = keyed_numbers(lines)
        if has_matrices(matrices) and not source.keys:
            return numbers_of_matrices(matrices, where, source)
        flat: dict[str, Any] = {n: list(v) if len(v) > 1 else v[0] for n, v in matrices.items()}
        found = numbers_of_document({**lines, **flat}, where, source)
        if found is not None:
            return found
    return _checked(numbers_of_document(parse_yaml(plain, where), where, source), where)


def numbers_from_document(document: Any, where: str, source: CameraSource) -> CameraNumbers:
    """Return the camera of a JSON document.

    Raises
    ------
    CameraError
        It has none, or several.
    """
    if isinstance(document, list):
        flat = [x for row in document for x in (row if isinstance(row, list) else [row])]
        if flat and all(isinstance(x, (int, float)) for x in flat):
            return numbers_of_bare(tuple(map(float, flat[:64])), where)
    own = isinstance(document, Mapping) and _OWN <= document.keys()
    if own and not source.keys and source.key is None:
        check_json(document, "camera", where, CameraError)
    found = numbers_of_document(document, where, source)
    if found is None:
        check_json(document, "camera", where, CameraError)
    return _checked(found, where)


def _checked(found: CameraNumbers | None, where: str) -> CameraNumbers:
    if found is None or any(map(math.isnan, found.intrinsics)):
        raise CameraError(
            f"{where}: expected a camera file (JSON, ROS or OpenCV YAML, COLMAP, KITTI, numbers, a "
            "table), found none; give fx, fy, cx and cy in JSON"
        )
    return found
