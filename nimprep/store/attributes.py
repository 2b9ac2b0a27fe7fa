"""What the root of a store says of it as a whole, by name and type."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from typing import Any, Literal, NotRequired, TypedDict, get_args

from nimprep.splits import SplitName, SplitRule
from nimprep.store.depth_loss import DepthLost

GRAVITY_FROM = "gravity_from"
"""The column of `frame_metadata` that says where frames' directions of gravity come from."""

GravitySource = Literal["given", "cam_to_road", "estimated", "none"]

GRAVITY_SOURCES: tuple[GravitySource, ...] = get_args(GravitySource)


class Split(TypedDict):
    """Say by which rule a store is split; that of a file has no seed."""

    rule: SplitRule | Literal["file"]
    seed: NotRequired[int]


class PastSplit(Split):
    """Say how a store was split as long as the chunk of its table `split` ends like this."""

    crc32c: int


class Source(TypedDict):
    """Identify what a store was made from, at once or in parts."""

    digest: str
    parts: NotRequired[list[dict[str, Any]]]


@dataclass(frozen=True, kw_only=True)
class StoreAttributes:
    """Hold the `nimprep` object of a store's root: schemas/store.schema.json describes the fields.

    Attributes
    ----------
    document : mapping
        The object as it was read: names that are no field's stay in it, and all keep their order.
    """

    format_version: str
    tool_version: str
    dataset: str
    classes: list[dict[str, Any]]
    modalities: dict[str, dict[str, Any]]
    calibration: dict[str, Any]
    crop: dict[str, int]
    codec: str
    split: Split
    normals_chosen: dict[str, Any] | None = None
    fixed_splits: dict[SplitName, list[str]] = field(default_factory=dict)
    references: list[dict[str, str]] = field(default_factory=list)
    frame_metadata: dict[str, dict[str, list[Any]]] = field(default_factory=dict)
    skipped: list[dict[str, str]] = field(default_factory=list)
    doubts: list[dict[str, Any]] = field(default_factory=list)
    findings: list[dict[str, Any]] = field(default_factory=list)
    normal_noise: dict[str, float] | None = None
    depth_lost: DepthLost | None = None
    depth_percentiles_m: dict[str, float] | None
    source: Source
    complete: bool
    tables: dict[str, int] | None = None
    digest: str | None = None
    split_before: PastSplit | None = None
    document: Mapping[str, Any] = field(default_factory=dict, repr=False, compare=False)

    def gravity_from(self, index: int) -> GravitySource | None:
        """Return where a frame's direction of gravity comes from; None = nothing is said of it."""
        column = self.frame_metadata.get(GRAVITY_FROM)
        said = None if column is None else column["values"][column["of_frame"][index]]
        return said if said in GRAVITY_SOURCES else None

    @property
    def has_gravity(self) -> bool:
        """Whether gravity was given for some frame."""
        return "given" in self.frame_metadata.get(GRAVITY_FROM, {}).get("values", ())

    @property
    def class_ids(self) -> list[int]:
        """The classes' ids, in order."""
        return [entry["id"] for entry in self.classes]

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> StoreAttributes:
        """Return what an object says that fits the schema."""
        known = {name: document[name] for name in _DEFAULTS if name in document}
        return cls(**known, document=document)

    def to_json(self) -> dict[str, Any]:
        """Return the object; what has its default is left out unless it was there."""
        found = dict(self.document)
        for name, default in _DEFAULTS.items():
            value = getattr(self, name)
            if value != default:
                found[name] = value
            elif found.get(name) != default:
                found.pop(name, None)
        return found


_DEFAULTS = {
    f.name: f.default if f.default_factory is MISSING else f.default_factory()
    for f in fields(StoreAttributes)
    if f.name != "document"
}
"""Of each field, in the order of a new object; MISSING where there must be a value."""
