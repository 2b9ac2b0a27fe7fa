"""What a conversion will write, decided before it writes anything."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from nimprep import __version__
from nimprep.conversion.doubted import doubts_of, findings_of
from nimprep.conversion.journal import Journal, option_values, units_of
from nimprep.conversion.options import ConvertOptions
from nimprep.conversion.records import Records, depth_percentiles, source_digest
from nimprep.conversion.sources import FileState
from nimprep.depth_unit import MILLIMETRES, ChosenUnit, chosen_unit, depth_unit_from
from nimprep.derive.recipe import Recipe
from nimprep.doubts.surfaces import noise_of
from nimprep.errors import ArrayError, LayoutError, OptionError, StoreError
from nimprep.modality import MODALITIES, Modality, given_for
from nimprep.plane import by_name, definition_of
from nimprep.readers import Reader
from nimprep.readers.crop import CroppedReader, Margins, frame_shapes
from nimprep.readers.given_splits import files_of_frames, given_splits
from nimprep.schema import load_schema, schema_problems
from nimprep.splits import SPLITS, SplitName, SplitRule, assign_splits, check_scenes
from nimprep.store.attributes import GRAVITY_FROM, StoreAttributes
from nimprep.store.depth_loss import joined_loss
from nimprep.store.spec import format_of
from nimprep.store.storage import Storage
from nimprep.store.writer import StoreLayout, StoreWriter


@dataclass(frozen=True)
class Base:
    """Name the store that frames are appended to, as far as encoding them depends on it.

    Attributes
    ----------
    frames : int
        So many it has: the first unit is to fill its last shard.
    height, width : int
        Of its padded images.
    digest : str
        Of its sources.
    depth_unit : ChosenUnit
        In which it has its depth.
    """

    frames: int
    height: int
    width: int
    digest: str
    depth_unit: ChosenUnit = MILLIMETRES


@dataclass(frozen=True)
class Job:
    """Describe a conversion to whoever encodes a part of it; other processes get it as it is.

    Attributes
    ----------
    source : Path
    options : ConvertOptions
    recipe : Recipe
        The options', its method of normals chosen; or that of the store to append to.
    chosen : mapping, optional
        How that method was chosen, as `choose_normals` returns it.
    margins : Margins, optional
        Cut off every frame.
    layout : StoreLayout
        Its number of frames is that of the source; fewer are stored where some are skipped.
    states : mapping of frame id to file states
        In the reader's order.
    storage : Storage
        Where the store is written.
    base : Base, optional
        The store that the frames will be appended to.
    """

    source: Path
    options: ConvertOptions
    recipe: Recipe
    margins: Margins | None
    layout: StoreLayout
    states: Mapping[str, tuple[FileState, ...]]
    storage: Storage
    base: Base | None = None
    chosen: Mapping[str, Any] | None = None

    def open_reader(self) -> Reader:
        """Open the source as the plan did."""
        reader = self.options.open_reader(self.source)
        return reader if self.margins is None else CroppedReader(reader, self.margins)

    def units(self) -> list[list[str]]:
        """Return each unit's frame ids: see `units_of`."""
        frames = self.base.frames if self.base else 0
        return units_of(list(self.states), self.layout.shard_length, frames)

    def document(self) -> dict[str, Any]:
        """Return what is kept of it, so that it can be told whether another is the same."""
        return {
            "options": option_values(self.options),
            "margins": None if self.margins is None else asdict(self.margins),
            "files": self.states,
            "base": None if self.base is None else asdict(self.base),
            "normals_chosen": self.chosen,
            "planes": {plane.name: definition_of(plane) for plane in self.layout.planes},
            "depth_unit": asdict(self.layout.depth_unit),
        }


@dataclass(frozen=True)
class Plan:
    """Hold all that is known of a conversion before it encodes the first frame.

    Attributes
    ----------
    job : Job
    reader : Reader
        Of the frames, the margins cut off.
    journal : Journal
        Keeps what is done.
    """

    job: Job
    reader: Reader
    journal: Journal

    def writer(self) -> StoreWriter:
        """Return what writes the store."""
        return StoreWriter(self.job.storage, self.job.layout)


def plan_modalities(reader: Reader, options: ConvertOptions) -> tuple[str, ...]:
    """Choose what to store, in the order in which it is listed everywhere: planes last.

    Raises
    ------
    LayoutError
        A modality is asked for that the dataset has not; or two planes have one name.
    OptionError
        There is none of that name.
    StoreError
        The store could not be opened: its attributes' schema does not know a modality.
    """
    given = {"rgb"}
    given |= {"depth"} if reader.info.has_depth else set()
    given |= {"label"} if reader.info.classes else set()
    planes = _planes(reader)
    every = MODALITIES | planes
    available = [name for name in MODALITIES if given_for([name]) <= given] + list(planes)
    asked = options.modalities or tuple(n for n in available if not every[n].on_request)
    for name in asked:
        if name not in available:
            if name not in every:
                raise OptionError(
                    f"--modalities: expected some of {', '.join(every).replace('_', '-')}, "
                    f"found {name!r}; choose among those"
                )
            lost = [
                f"no {what}"
                for what, there in (
                    ("depth", reader.info.has_depth),
                    ("labels", reader.info.classes),
                )
                if not there
            ]
            hint = f" where there is {' and '.join(lost)}" if lost else ""
            raise LayoutError(
                f"--modalities: expected some of {', '.join(available)}, found {name!r}{hint}; "
                "choose among those"
            )
    chosen = {n: m.as_dtype(options.normal_dtype) for n, m in every.items() if n in asked}
    _check_described(chosen, options.recipe)
    return tuple(chosen)


def _check_described(chosen: Mapping[str, Modality], recipe: Recipe) -> None:
    """Raise where the store's schema does not know what would be written."""
    named = load_schema("store")["properties"]["modalities"]["properties"]
    if unnamed := [name for name in chosen if name in MODALITIES and name not in named]:
        raise StoreError(
            f"schemas/store.schema.json: expected it to describe {unnamed[0]}, found only "
            f"{', '.join(named)}; describe it there, as docs/add-a-modality.md says"
        )
    described = describe_modalities(chosen.values(), recipe)
    if problems := schema_problems(described, "store", "modalities"):
        raise StoreError(
            "schemas/store.schema.json: expected it to describe the modalities of the store, "
            f"found {problems[0]}; describe them there"
        )


def _planes(reader: Reader) -> dict[str, Modality]:
    try:
        return by_name(reader.info.planes)
    except ArrayError as error:
        raise LayoutError(f"{reader.root}: {error}") from error


WASTE = 2
"""Times the pixels that frames have which a store may hold before that is said."""


def warn_of_padding(shapes: Mapping[tuple[int, int], Sequence[str]], where: object) -> None:
    """Warn where some large frames have all others padded to a multiple of what they are.

    Parameters
    ----------
    shapes : mapping of (height, width) to frame ids
    where : object
        What has them, for the message.
    """
    height, width = max(h for h, _ in shapes), max(w for _, w in shapes)
    frames = sum(len(ids) for ids in shapes.values())
    own = sum(h * w * len(ids) for (h, w), ids in shapes.items())
    padded = height * width * frames
    if padded <= WASTE * own:
        return
    usual = max(shapes, key=lambda shape: len(shapes[shape]))
    large = [i for (h, w), ids in shapes.items() if h == height or w == width for i in ids]
    warnings.warn(
        f"{where}: every frame is padded to the largest, {width}x{height} pixels (of {len(large)} "
        f"of {frames} frames, first {large[0]!r}), while most are {usual[1]}x{usual[0]}: the store "
        f"holds {padded / 1e6:.1f} million pixels for {own / 1e6:.1f}, and converting and reading "
        f"take about {padded / own:.0f} times as long; convert those frames into a store of their "
        "own",
        stacklevel=2,
    )


def plan_layout(reader: Reader, options: ConvertOptions, *, alone: bool = True) -> StoreLayout:
    """Fix the store's shape from the frames' headers and the options.

    Parameters
    ----------
    alone : bool
        Whether these are all the frames: then it is said where they are padded to a multiple.

    Raises
    ------
    LayoutError, StoreError
        As `plan_modalities`.
    """
    modalities = plan_modalities(reader, options)
    shapes = frame_shapes(reader, skip_bad=options.on_error == "skip")
    if alone:
        warn_of_padding(shapes, reader.root)
    return StoreLayout(
        frames=len(reader.ids),
        height=max(height for height, _ in shapes),
        width=max(width for _, width in shapes),
        modalities=modalities,
        classes=reader.info.classes if "label" in modalities else (),
        normal_dtype=options.normal_dtype,
        codec=options.codec,
        shard_length=options.shard_length,
        planes=tuple(plane for name, plane in _planes(reader).items() if name in modalities),
        depth_unit=chosen_unit(depth_unit_from(options.depth_unit), reader.info.depth),
    )


def fixed_splits(reader: Reader, ids: Iterable[str]) -> dict[str, SplitName]:
    """Return the frames that the dataset's authors put into a split."""
    chosen = {i: SPLITS.get(reader.fixed_split(i) or "") for i in ids}
    return {i: split for i, split in chosen.items() if split is not None}


def of_no_split(reader: Reader, ids: Iterable[str]) -> dict[str, str]:
    """Return the frames that the dataset's authors put into none, with the name of that."""
    return {i: "none" for i in ids if reader.fixed_split(i) == "none"}


def fixed_by_split(reader: Reader, ids: Iterable[str]) -> dict[str, list[str]]:
    """Return the frames that the dataset's authors put into each split."""
    fixed: dict[str, list[str]] = {}
    for frame_id, split in fixed_splits(reader, ids).items():
        fixed.setdefault(split, []).append(frame_id)
    return fixed


def split_rule(reader: Reader, options: ConvertOptions) -> SplitRule:
    """Return the rule to split by where no file does."""
    default: SplitRule = "stratified" if fixed_splits(reader, reader.ids) else "frame"
    return options.split_by or reader.info.split_by or default


def plan_splits(reader: Reader, options: ConvertOptions, ids: Sequence[str]) -> list[str]:
    """Return the split of each of these frames of the reader's."""
    if options.split_file is not None:
        splits = given_splits(options.split_file, files_of_frames(reader))
        return [splits[i] for i in ids]
    none = of_no_split(reader, ids)
    groups = {i: reader.group(i) for i in ids if i not in none}
    rule = split_rule(reader, options)
    check_scenes(reader.info.name, rule, groups.values())
    assigned = none | assign_splits(groups, rule, options.seed, fixed_splits(reader, ids))
    return [assigned[i] for i in ids]


def metadata_column(values: Sequence[Any]) -> dict[str, list[Any]]:
    """Return a column of `frame_metadata`: distinct values, and each frame's index among them."""
    distinct = list(dict.fromkeys(values))
    return {"values": distinct, "of_frame": [distinct.index(value) for value in values]}


def frame_metadata(reader: Reader, ids: Sequence[str]) -> dict[str, Any]:
    """Return what the dataset says of frames beside images: distinct values, and whose.

    KITTI's calibrations are few and its frames many, hence each value once and an index per frame.
    """
    columns: dict[str, dict[str, Any]] = {}
    for frame_id in ids:
        for name, value in reader.metadata(frame_id).items():
            column = columns.setdefault(name, {"values": [], "of_frame": []})
            if value not in column["values"]:
                column["values"].append(value)
            column["of_frame"].append(column["values"].index(value))
    return columns


def describe_modalities(modalities: Iterable[Modality], recipe: Recipe) -> dict[str, Any]:
    """Return what a store's attributes say of its modalities, as it holds them."""
    return {
        m.name: {"method": "source", "parameters": {}, "kind": "plane", **definition_of(m)}
        if m.values == "measures"
        else {**recipe.describe(m.name), **_as_held(m)}
        for m in modalities
    }


def _as_held(modality: Modality) -> dict[str, Any]:
    """Return what is said of how a store holds a modality, where it can be otherwise."""
    unit = {"unit_m": modality.step} if modality.has_other_unit else {}
    rounded = {"rounded": True} if modality.rounded else {}
    return {**({"dtype": modality.dtype} if modality.dtypes else {}), **unit, **rounded}


def describe(plan: Plan, ids: Sequence[str]) -> dict[str, Any]:
    """Return the `nimprep` object of the store's root, as far as it is known beforehand.

    Parameters
    ----------
    ids : sequence of str
        The frames that are stored, in order.
    """
    reader, layout, options = plan.reader, plan.job.layout, plan.job.options
    rule = {"rule": split_rule(reader, options), "seed": options.seed}
    fixed = fixed_by_split(reader, ids)
    margins = reader.margins if isinstance(reader, CroppedReader) else Margins(0, 0, 0, 0)
    return {
        "format_version": format_of(map(layout.modality, layout.modalities)),
        "tool_version": __version__,
        "dataset": reader.info.name,
        **({"references": [reader.info.reference.to_json()]} if reader.info.reference else {}),
        "classes": [{"id": c.id, "name": c.name, "color": list(c.color)} for c in layout.classes],
        "modalities": describe_modalities(map(layout.modality, layout.modalities), plan.job.recipe),
        **({"normals_chosen": dict(plan.job.chosen)} if plan.job.chosen else {}),
        "calibration": {"origin": reader.info.calibration},
        "crop": asdict(margins),
        "codec": layout.codec,
        "split": {"rule": "file"} if options.split_file else rule,
        **({"fixed_splits": fixed} if fixed else {}),
        **({"frame_metadata": metadata} if (metadata := frame_metadata(reader, ids)) else {}),
    }


def described(plan: Plan, records: Records) -> StoreAttributes:
    """Return what the root says of a store of the plan's frames."""
    facts = records.facts
    about = describe(plan, [frame.id for frame in facts])
    filled, fixed = plan.job.options.fill != "none", about.get("fixed_splits", {})
    if any(frame.gravity_from == "given" for frame in facts):
        column = metadata_column([frame.gravity_from for frame in facts])
        about["frame_metadata"] = {**about.get("frame_metadata", {}), GRAVITY_FROM: column}
    depth, counts = plan.job.layout.modality("depth"), records.depth_counts
    return StoreAttributes(
        **about,
        skipped=[asdict(frame) for frame in records.skipped],
        doubts=doubts_of(facts, plan.job.layout.classes, fixed, filled=filled, most_m=depth.most),
        findings=findings_of(facts),
        normal_noise=noise_of([frame.signs for frame in facts]),
        depth_lost=joined_loss((frame.depth_lost for frame in facts), int(counts[1:].sum())),
        depth_percentiles_m=depth_percentiles(counts, depth),
        source={"digest": source_digest(facts)},
        complete=True,
    )
