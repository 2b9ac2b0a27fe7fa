"""What a folder, archive or recording is: everything found out about it, as one object."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from nimprep.errors import DecodeError, LayoutError, NimprepError
from nimprep.files import read_file, read_start
from nimprep.inspection.arrangement import arranged
from nimprep.inspection.depth_guess import depth_encodings, sorted_depth
from nimprep.inspection.describe import describe
from nimprep.inspection.document import MOST_LINES, found_document, holding_document
from nimprep.inspection.encodings import Encoding
from nimprep.inspection.examination import Examination, Plane, examined
from nimprep.inspection.holdings import Holding, holding_at
from nimprep.inspection.kinds import Kind
from nimprep.inspection.layouts import (
    description_of,
    fitting_reader,
    meant_instead,
    needs_camera,
    reader_of_names,
)
from nimprep.inspection.survey import Survey, survey_folder
from nimprep.readers import ReaderName
from nimprep.readers.description_file import description_from_document
from nimprep.readers.folder import FolderReader

_MOST_TRIED = 20_000
"""A description of more files is not tried: pairing them all takes a reader seconds."""


@dataclass
class Inspection:
    """Hold what was found out.

    Attributes
    ----------
    source : Path
    what : str
        One sentence.
    kind : str
        "reader", "images", "points", "archive", "recording", "container", "store", "file" or
        "nothing".
    reader : str, optional
    found : Examination, optional
        Of a folder.
    depth : list of (Plane, list of Encoding)
        The likeliest encoding first; empty where numbers are no depth.
    holdings : list of Holding
    notes, next_steps : list of str
    description : dict, optional
        To start from.
    """

    source: Path
    what: str = "nothing that nimprep knows"
    kind: str = "nothing"
    reader: ReaderName | None = None
    found: Examination | None = None
    depth: list[tuple[Plane, list[Encoding]]] = field(default_factory=list)
    holdings: list[Holding] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    next_steps: list[str] = field(default_factory=list)
    description: dict[str, Any] | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return it as JSON has it (schemas/inspection.schema.json)."""
        found = self.found
        return {
            "format": "nimprep-inspection",
            "version": "1.0",
            "source": str(self.source),
            "kind": self.kind,
            "what": self.what,
            "reader": self.reader,
            **found_document(found, self.depth),
            "holdings": [holding_document(holding, self.source) for holding in self.holdings],
            "problems": [] if found is None else found.problems[:MOST_LINES],
            "notes": self.notes,
            "next": self.next_steps,
            "description": self.description,
        }


def inspect_source(source: Path | str) -> Inspection:
    """Find out what a folder or file of raw data is.

    Raises
    ------
    LayoutError
        It is missing, or nothing in it is known.
    """
    source = Path(source)
    if not source.exists():
        raise LayoutError(f"{source}: expected a folder or file to look at, found none; check it")
    made = Inspection(source)
    if source.is_file():
        _look_at_file(made)
    elif (source / "zarr.json").is_file():
        _look_at_store(made)
    else:
        _look_at_folder(made, survey_folder(source))
    if made.kind == "nothing":
        problems = made.found.problems if made.found else []
        empty = made.found is not None and not made.found.survey.files
        what = "an empty folder" if empty else "nothing that is known"
        raise LayoutError(
            f"{source}: expected images, an archive or a recording, found "
            f"{problems[0] if problems else what}; name the folder that has them"
        )
    return made


def _look_at_file(made: Inspection) -> None:
    source = made.source
    fitting = fitting_reader(source, made.notes)
    if fitting:
        _of_reader(made, *fitting)
        return
    try:
        holding = holding_at(source)
    except DecodeError as error:
        raise LayoutError(f"{error}; name a file that can be read") from error
    if holding is None:
        _look_at_folder(made, Survey(source.parent, (source.name,)))
        beside = made.kind == "nothing" and fitting_reader(source.parent, []) is not None
        if beside or made.kind == "images":
            planes = made.found is not None and made.found.planes
            of = f" ({made.what.rpartition('as ')[2]})" if planes else ""
            made.kind, made.what = "file", f"an image{of}" if planes else "a file that is no image"
            made.notes, made.description = [], None
            made.next_steps = [f"nimprep inspect {made.source.parent} looks at all of them"]
        return
    made.kind = holding.kind if holding.kind != "image" else "file"
    made.what, made.holdings = holding.what, [holding]
    made.next_steps = [holding.step] if holding.step else []
    inner = _reader_in(holding.names)
    if inner:
        made.what += f" that holds {inner}"


def _reader_in(names: Sequence[str]) -> str:
    """Return what files in an archive look like by their names alone."""
    text = " ".join(names)
    if "/depth_u16/" in f"/{text}":
        return "GMRP's layout"
    if "/gt_image_2/" in f"/{text}" or "training/image_2/" in text:
        return "KITTI road's layout"
    known = reader_of_names(names)
    return f"files of the dataset {known}" if known else ""


def _look_at_store(made: Inspection) -> None:
    path = made.source / "zarr.json"
    try:
        document = json.loads(read_file(path, 1 << 25))
        ours = "nimprep" in document.get("attributes", {})
    except (DecodeError, ValueError, AttributeError, RecursionError):
        ours = False
    made.kind = "store"
    made.what = "a store of nimprep" if ours else "a Zarr store that is not nimprep's"
    made.next_steps = [f"nimprep info {made.source}"] if ours else ["export its images first"]


def _look_at_folder(made: Inspection, survey: Survey) -> None:
    found = made.found = examined(survey)
    made.holdings = found.holdings
    for store in survey.stores:
        made.notes.append(f"{store} is a store, which is not looked into; nimprep info says more")
    whole = made.source == survey.root
    fitting = fitting_reader(survey.root, made.notes) if whole else None
    for plane in sorted_depth(found.of_kind(Kind.DEPTH, Kind.DISPARITY)):
        made.depth.append((plane, depth_encodings(found, plane)))
    near = None if fitting else meant_instead(made.source)
    if near is not None:
        made.notes.append(f"did you mean {near}?")
    if fitting:
        _of_reader(made, *fitting)
    elif found.planes:
        made.kind, made.what = "images", _summary(found)
        _describe(made, found)
    elif found.holdings:
        first = found.holdings[0]
        made.kind = first.kind if first.kind != "image" else "images"
        made.what = f"{len(found.holdings)} kinds of file, the first {first.what}"
        made.next_steps = list(dict.fromkeys(h.step for h in found.holdings if h.step))
    elif found.clouds:
        made.kind, made.what = "points", "point clouds without images"
    elif near is not None or survey.stores:
        made.kind, made.what = "images", "no images itself"
    if near is not None:
        made.next_steps.insert(0, f"nimprep inspect {near}")


def _of_reader(made: Inspection, reader: ReaderName, frames: int) -> None:
    made.reader, made.kind = reader, "reader"
    made.what = f"a dataset of {frames} frames in the layout {reader}"
    made.description = description_of(reader, made.source)
    camera = " --intrinsics fx,fy,cx,cy" if needs_camera(made.description) else ""
    made.next_steps = [f"nimprep convert {made.source} OUT.zarr{camera}"]


def _describe(made: Inspection, found: Examination) -> None:
    """Add a description to start from, and how far it goes."""
    arrangement = arranged(found, made.depth)
    if arrangement is None:
        made.notes.append("no colour images, which a dataset needs")
        return
    described = describe(found, arrangement)
    made.description = described.document
    made.notes += [f"{path} is a description already" for path in _descriptions(found)]
    made.notes += described.notes
    made.next_steps = [f"nimprep inspect {made.source} --write FILE.json"]
    if len(found.survey.files) > _MOST_TRIED:
        return
    try:
        description = description_from_document(described.document, "description")
        reader = FolderReader(found.survey.root, description)
        count, of = len(reader.ids), arrangement.color.plane.count
        rest = f", {of - count} of {of} colour images are in none of them" if count < of else ""
        made.notes.append(f"the description gives {count} frames{rest}")
    except NimprepError as error:
        reason = " ".join(str(error).split())
        made.notes.append(f"the description needs your help: {reason}")


def _descriptions(found: Examination) -> list[str]:
    """Return the folder descriptions that lie beside the images."""
    paths = [template.members[0].path for template in found.texts if template.ending == ".json"]
    return [path for path in paths[:20] if _is_description(found.survey.root / path)]


def _is_description(path: Path) -> bool:
    try:
        return b'"nimprep-folder"' in read_start(path, 4096)
    except DecodeError:
        return False


def _summary(found: Examination) -> str:
    counts: dict[str, int] = {}
    for plane in found.planes:
        counts[plane.kind] = counts.get(plane.kind, 0) + plane.count
    kinds = ", ".join(f"{count} {kind}" for kind, count in counts.items())
    return f"images told by pattern and values as {kinds}"
