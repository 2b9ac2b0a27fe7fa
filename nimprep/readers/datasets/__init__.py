"""Public datasets known by name: a JSON file each (schemas/dataset.schema.json), as data."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from nimprep.readers.signs import Listings, Sign, probed

FOLDER = Path(__file__).parent


@dataclass(frozen=True)
class Dataset:
    """Hold what a dataset's file says.

    Attributes
    ----------
    name : str
        The reader's.
    document : mapping
        All of it; see schemas/dataset.schema.json.
    """

    name: str
    document: Mapping[str, Any] = field(repr=False)

    @property
    def about(self) -> str:
        """What is where, for people."""
        return str(self.document["about"])

    @property
    def signs(self) -> tuple[Sign, ...]:
        """What must be there."""
        return tuple(s if isinstance(s, str) else tuple(s) for s in self.document["signs"])

    @property
    def each(self) -> bool:
        """Whether the signs are those of one sequence, of which it may have several."""
        return bool(self.document.get("each"))

    @property
    def not_signs(self) -> tuple[Sign, ...]:
        """What must not be there."""
        return tuple(self.document.get("not_signs", ()))

    @property
    def over(self) -> tuple[str, ...]:
        """Readers whose signs it has too."""
        return tuple(self.document.get("over", ()))

    @property
    def roots(self) -> tuple[str, ...]:
        """Folders in which it may lie."""
        return tuple(self.document.get("roots", ("",)))

    @property
    def file(self) -> str | None:
        """What the one file is called that may be given in place of its folder."""
        return self.document.get("file")

    @property
    def described(self) -> bool:
        """Whether its description says all of it, without its code."""
        return bool(self.document.get("described", True))

    @property
    def refused(self) -> Sequence[Mapping[str, Any]]:
        """Folders that look like it and cannot be read."""
        refused: Sequence[Mapping[str, Any]] = self.document.get("refused", ())
        return refused

    @property
    def options(self) -> Mapping[str, Mapping[str, Any]]:
        """What each option of its own means."""
        options: Mapping[str, Mapping[str, Any]] = self.document.get("options", {})
        return options

    def pattern(self, kind: str) -> str | None:
        """Return the pattern of a kind of file, "depth" or "camera"; None = there is none."""
        said = self.document["description"].get(kind)
        files = said.get("files") if isinstance(said, Mapping) else said
        return files if isinstance(files, str) else None

    def found(self, root: Path, listings: Listings) -> Dataset:
        """Return the dataset as it is in a folder: with the cases that hold there."""
        document = self.document
        for case in self.document.get("cases", ()):
            there = "there" not in case or listings.has(root, case["there"])
            if there and not ("not_there" in case and listings.has(root, case["not_there"])):
                document = merged(document, case["change"])
        for folder, others in document.get("folders", {}).items():
            described = _moved(document["description"], folder, others, root, listings)
            document = {**document, "description": described}
        return Dataset(self.name, document)

    def choice(self, label_set: str | None) -> Mapping[str, Any]:
        """Return what a label set, or the usual one, merges into the description."""
        said = self.options.get("label_set")
        if said is None:
            return {}
        chosen = said["choices"][label_set or said["default"]]
        return _label_set(chosen) if isinstance(chosen, str) else chosen


def merged(document: Any, change: Any) -> Any:
    """Return a document with another merged into it, as RFC 7396 has it: null takes a key away."""
    if not isinstance(change, Mapping):
        return change
    made = dict(document) if isinstance(document, Mapping) else {}
    for key, value in change.items():
        if value is None:
            made.pop(key, None)
        else:
            made[key] = merged(made.get(key), value)
    return made


def _moved(
    document: Any, folder: str, others: Sequence[str], root: Path, listings: Listings
) -> Any:
    """Return a description whose patterns of a folder are of that which has such files."""
    if isinstance(document, Mapping):
        return {k: _moved(v, folder, others, root, listings) for k, v in document.items()}
    if not isinstance(document, str) or not document.startswith(f"{folder}/"):
        return document
    places = (place + document[len(folder) :] for place in (folder, *others))
    return next((p for p in places if listings.find(root, probed(p)) is not None), document)


def _label_set(name: str) -> Mapping[str, Any]:
    found: Mapping[str, Any] = json.loads((FOLDER / "labels" / f"{name}.json").read_text("utf-8"))
    return found


def _load() -> dict[str, Dataset]:
    paths = sorted(FOLDER.glob("*.json"))
    return {path.stem: Dataset(path.stem, json.loads(path.read_text("utf-8"))) for path in paths}


DATASETS: Mapping[str, Dataset] = _load()
"""By name; their files are checked against the schema by a test, not when they are loaded."""


FLAGS = {
    "label_set": "--labels",
    "variations": "--variations",
    "camera_index": "--camera-index",
    "lists": "--lists",
}
"""What the options that datasets may have are called on the command line."""


def having(option: str) -> str:
    """Return which datasets have an option, for people."""
    return ", ".join(name for name, each in DATASETS.items() if option in each.options) or "none"


def defaults_of(option: str) -> str:
    """Return what the datasets that have an option take without it, for people."""
    values = {
        name: ",".join(each.options[option].get("default", ["all"]))
        for name, each in DATASETS.items()
        if option in each.options
    }
    return "; ".join(f"{name} {value}" for name, value in values.items()) or "all"


def label_sets() -> str:
    """Return which label sets there are, for people; the usual one of each dataset first."""
    said = []
    for name, each in DATASETS.items():
        if "label_set" in each.options:
            usual, choices = (
                each.options["label_set"]["default"],
                each.options["label_set"]["choices"],
            )
            said.append(f"{name} {', '.join([usual, *(c for c in choices if c != usual)])}")
    return "; ".join(said) or "none"
