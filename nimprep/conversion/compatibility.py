"""Whether frames, or stores, are of one kind: what may stand in one store together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple
from typing import Any

from nimprep.conversion.options import ConvertOptions
from nimprep.conversion.plan import describe_modalities
from nimprep.depth_unit import MILLIMETRE, ChosenUnit, counts_in, unit_words
from nimprep.derive.recipe import DERIVED, Recipe, RecipeOptions, recipe_from
from nimprep.errors import DecodeError, LayoutError, StoreError
from nimprep.frame import LabelClass
from nimprep.modality import MODALITIES
from nimprep.options import options_of
from nimprep.plane import definition_of
from nimprep.readers import Reader
from nimprep.readers.crop import Margins
from nimprep.splits import SPLIT_RULES
from nimprep.store.reader import Store
from nimprep.store.spec import check_changeable


def options_like(store: Store, **reading: Any) -> ConvertOptions:
    """Return the options by which frames become what a store's frames are.

    Parameters
    ----------
    **reading
        Fields of `ConvertOptions` that say how frames are read; no store tells.

    Raises
    ------
    StoreError
        The store is of a format or a making that this version has not.
    """
    about = store.about
    check_changeable(about.format_version, str(store.path))
    recipe = recipe_from(about.modalities)
    margins = astuple(Margins(**about.crop))
    rule = about.split["rule"]
    making = {
        **{name: getattr(recipe, name) for name in options_of(RecipeOptions)},
        "labels": "label" in store.modalities,
        "crop": margins if any(margins) else None,
        "modalities": store.modalities,
        "normal_dtype": normal_dtype(store),
        "codec": about.codec,
        "shard_length": shard_length(store),
        # Where the split was not the authors', it stays so.
        "split_by": None if about.fixed_splits or rule not in SPLIT_RULES else rule,
    }
    options = ConvertOptions(**reading, **making)
    held = (array.modality for array in store.arrays.values())
    described = describe_modalities(held, recipe)
    found = {name: as_said_now(about.modalities[name]) for name in store.modalities}
    for name in store.modalities:
        if described[name] != found[name]:
            raise StoreError(
                f"{store.path}: expected {name} {described[name]}, as this version makes it, "
                f"found {found[name]}; convert everything anew"
            )
    return options


_SAID_BEFORE = {
    "gravity": "from cam_to_road where a frame has it, else estimated",
    "plane": "the road frame's y = 0 where a frame has cam_to_road, else fitted to the depth",
}
"""Of parameters, what was said before gravity could be given: true of frames that have none."""


def as_said_now(made: Any) -> Any:
    """Return what a store's attributes say of a modality in today's words, as it was made alike."""
    if made is None:
        return None
    every = (Recipe().describe(name)["parameters"] for name in DERIVED)
    now = {name: said for one in every for name, said in one.items() if name in _SAID_BEFORE}
    parameters = {
        name: now[name] if said == _SAID_BEFORE.get(name) else said
        for name, said in made["parameters"].items()
    }
    return {**made, "parameters": parameters}


def normal_dtype(store: Store) -> str:
    """Return the data type of a store's normals; that of others where it has none."""
    held = store.arrays["normal"].modality if "normal" in store.arrays else MODALITIES["normal"]
    return held.dtype


def depth_unit(store: Store) -> ChosenUnit:
    """Return the unit of a store's depth; a millimetre where it has none."""
    held = store.stored.get("depth", MODALITIES["depth"])
    return ChosenUnit(held.step, held.rounded)


def shard_length(store: Store) -> int:
    """Return a store's frames per shard.

    Raises
    ------
    StoreError
        Its arrays differ in it.
    """
    lengths = {array.shard_length for array in store.arrays.values()}
    if len(lengths) > 1:
        raise StoreError(
            f"{store.path}: expected arrays of one shard length, found {sorted(lengths)}; "
            "convert it again with one"
        )
    return lengths.pop()


def padded_size(store: Store) -> tuple[int, int]:
    """Return the height and width of a store's padded images."""
    height, width = next(iter(store.arrays.values())).shape[1:3]
    return height, width


def check_frames(store: Store, reader: Reader, ids: Sequence[str]) -> None:
    """Make sure that frames of a dataset may join a store.

    Raises
    ------
    LayoutError
        The dataset, its classes or its planes are not the store's.
    StoreError
        A frame is larger than the store's images.
    """
    name = store.about.dataset
    if reader.info.name != name:
        raise LayoutError(
            f"{reader.root}: expected frames of the dataset {name!r}, which the store's are, "
            f"found {reader.info.name!r}; convert them into a store of their own"
        )
    if store.classes and reader.info.classes != store.classes:
        raise LayoutError(
            f"{reader.root}: expected the store's classes {named(store.classes)}, found "
            f"{named(reader.info.classes)}; convert them into a store of their own"
        )
    _check_planes(store, reader)
    _check_steps(store, reader)
    crop = Margins(**store.about.crop)
    height, width = padded_size(store)
    for frame_id in ids:
        try:
            shape = crop.window(*reader.shape(frame_id))
        except DecodeError:
            # Encoding it says so, and knows whether it may be left out.
            continue
        if shape[0] > height or shape[1] > width:
            raise StoreError(
                f"{store.path}: expected frames of at most {width}x{height} pixels, found "
                f"{shape[1]}x{shape[0]} in frame {frame_id!r}; convert everything anew, or into a "
                "store of its own and merge the two"
            )


def _check_steps(store: Store, reader: Reader) -> None:
    """Raise `LayoutError` where a dataset's depth is finer than that of a store that is exact."""
    unit = depth_unit(store)
    exact = unit.unit_m <= MILLIMETRE or unit.rounded or counts_in(reader.info.depth, unit.unit_m)
    if exact or not reader.info.has_depth:
        return
    step_m = reader.info.depth.step_m
    found = "finer ones" if step_m is None else unit_words(step_m)
    raise LayoutError(
        f"{reader.root}: expected depth in steps of {unit_words(unit.unit_m)}, which the store's "
        f"depth counts in, found {found}; convert it into a store of its own"
    )


def _check_planes(store: Store, reader: Reader) -> None:
    """Raise `LayoutError` where a dataset's planes are not those that a store has of it."""
    there = {plane.name: definition_of(plane) for plane in reader.info.planes}
    for plane in store.planes:
        wanted, found = definition_of(plane), there.get(plane.name)
        if found != wanted:
            raise LayoutError(
                f"{reader.root}: expected the plane {plane.name!r} {wanted}, which the store has, "
                f"found {found or 'none of that name'}; describe it so, or convert into a store of "
                "its own"
            )


def named(classes: Sequence[LabelClass]) -> str:
    """Return classes as a message says them."""
    return ", ".join(f"{c.id} {c.name}" for c in classes) or "none"


def check_alike(stores: Sequence[Store]) -> None:
    """Make sure that stores hold the same things, made in the same way.

    Their frames' size, codec and shards may differ.

    Raises
    ------
    StoreError
        One differs from the first; it is said in what.
    """
    first = stores[0]
    for store in stores:
        check_changeable(store.about.format_version, str(store.path))
        a, b = first.about, store.about
        modalities = a.modalities.keys() | b.modalities.keys()
        units = [unit_words(depth_unit(one).unit_m) for one in (first, store)]
        found: list[tuple[str, Any, Any]] = [
            ("a depth unit of", units[0], units[1]),
            ("modalities", ", ".join(first.modalities), ", ".join(store.modalities)),
            ("classes", named(first.classes), named(store.classes)),
            ("colours", [c.color for c in first.classes], [c.color for c in store.classes]),
            ("crop", Margins(**a.crop), Margins(**b.crop)),
            *(
                (m, as_said_now(a.modalities.get(m)), as_said_now(b.modalities.get(m)))
                for m in sorted(modalities)
            ),
        ]
        for what, wanted, there in found:
            if wanted != there:
                anew = f" with --depth-unit {depth_unit(first).unit_m:.10g}"
                raise StoreError(
                    f"{store.path}: expected {what} {wanted} as in {first.path}, found {there}; "
                    f"convert one of the two anew{anew if units[0] != units[1] else ''}"
                )
