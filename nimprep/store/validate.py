"""Check a store: its structure, and with `deep` every pixel of it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from contextlib import closing
from functools import partial
from typing import Any

import numpy as np

from nimprep.camera import MAX_BASELINE_M, Camera
from nimprep.depth_unit import MILLIMETRE
from nimprep.derive.recipe import recipe_from
from nimprep.errors import ArrayError, CameraError, StoreError
from nimprep.modality import MODALITIES
from nimprep.parallel import Progress, map_in_order
from nimprep.schema import MAX_BYTES, schema_problems
from nimprep.splits import SPLIT_CODES
from nimprep.store.access import storage_from
from nimprep.store.extras import extra_attributes, extra_paths, own_arrays
from nimprep.store.image_layout import layout_problems
from nimprep.store.images import ImageArray
from nimprep.store.location import Place
from nimprep.store.memory import MemoryFiles
from nimprep.store.metadata import ROOT, consolidated, read_attributes, read_document
from nimprep.store.problems import Report, fault_of
from nimprep.store.reader import Store
from nimprep.store.spec import KNOWN_VERSIONS, ArraySpec
from nimprep.store.storage import Storage
from nimprep.store.table_specs import table_specs
from nimprep.store.tables import TableError, check_table

_PLAIN_NAME = re.compile(r"[A-Za-z0-9_-]{1,64}")

_NO_NAME = re.compile(r"\.*|__.*", re.DOTALL)
"""What the Zarr v3 specification lets no node be called; with a slash it is several names."""

_AT_ONCE = 8
"""Shards whose indices are asked for at once: each takes its time over a network."""


def validate_store(
    path: Place | Storage,
    *,
    deep: bool = False,
    progress: Progress | None = None,
) -> Report:
    """Check a store against the format.

    Parameters
    ----------
    path : path or URL
    deep : bool
        Decode every chunk, check every checksum, labels, normals, padding, and on a sample of
        frames that derived modalities agree with a recomputation.
    progress : callable, optional
        As for `convert`.

    Returns
    -------
    Report
        Damage is reported, not raised.

    Raises
    ------
    StoreError
        There is nothing to check: no store, or one of a newer format.
    """
    storage = storage_from(path)
    report = Report(str(storage), deep)
    attributes = read_attributes(storage, complete=False)
    for problem in schema_problems(attributes, "store"):
        report.add(f"attributes: {problem}")
    report.count("documents")
    if attributes.get("complete") is not True:
        report.add("attributes: expected complete, found a store whose conversion was cut short")
    if not report.valid:
        return report
    try:
        store = Store(storage)
    except StoreError as error:
        report.add(fault_of(error))
        return report
    report.frames = len(store)
    check_tables(store, report)
    _check_recipe(store, report)
    try:
        check_arrays(store, report)
    except StoreError as error:
        report.add(f"arrays: expected them readable, found {fault_of(error)}")
    try:
        check_consolidated(store, report)
    except StoreError as error:
        report.add(fault_of(error))
    if deep and report.valid:
        from nimprep.store.validate_deep import check_pixels

        check_pixels(store, report, progress)
    return report


# What the values of a document cause where it is taken apart. No wider than around that: a fault of
# the program, or a lack of memory, is no fault of the store.
_MALFORMED = (ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError)


def _check_recipe(store: Store, report: Report) -> None:
    try:
        recipe_from(store.about.modalities)
    except ArrayError as error:
        if store.about.format_version not in KNOWN_VERSIONS:
            raise StoreError(
                f"{store.path}: expected modalities made as this version knows, found {error}; "
                "validate it with the version that wrote it"
            ) from error
        report.add(f"attributes: modalities: {error}")


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def check_consolidated(store: Store, report: Report) -> None:
    """Check that the root's copy of the arrays' metadata, which xarray reads, says the same.

    What others put into the store is theirs, and named; no array must be gone, nor one there of
    nimprep's that the root does not speak of.
    """
    root = read_document(store.storage, ROOT)
    copies = consolidated(root)
    if root.get("node_type") != "group":
        report.add(f"{ROOT}: expected node_type 'group', found {root.get('node_type')!r}")
    expected = {*store.modalities, *_tables(store)}
    # Where folders cannot be listed, what the copies name is asked for.
    plain = {name for name in copies if _PLAIN_NAME.fullmatch(name)}
    folders = store.storage.folders()
    names = sorted({*expected, *plain, *folders})
    if any(_NO_NAME.fullmatch(part) for name in copies for part in name.split("/")):
        report.add(f"{ROOT}: expected metadata of arrays, found a name that can be none's")
    found = store.storage.read_many([f"{name}/{ROOT}" for name in names], MAX_BYTES)
    there = {name for name in names if found[f"{name}/{ROOT}"] is not None}
    newer = store.about.format_version not in KNOWN_VERSIONS
    alien = set() if newer else there & {*MODALITIES, *table_specs()} - expected
    if expected - there or alien:
        report.add(f"arrays: expected {sorted(expected)}, found {sorted(there)}")
    documents = {n: read_document(store.storage, f"{n}/{ROOT}") for n in sorted(there)}
    for name in sorted(there & expected):
        if copies.get(name) != documents[name]:
            report.add(f"{ROOT}: expected the metadata of {name!r} as in its own file, found other")
    if not newer:
        _check_extras(store, documents, expected, report)
        report.extras += _extras(store, {*folders, *there} - expected)


def _extras(store: Store, folders: Iterable[str]) -> list[str]:
    """Return what lies in a store, or stands in its documents, that is somebody's own."""
    keys = sorted(folders)
    if root := store.storage.root:
        keys = extra_paths(root, own_arrays(store.attributes))
    return [*map(repr, keys), *extra_attributes(store.storage)]


def _check_extras(
    store: Store, documents: dict[str, dict[str, Any]], own: set[str], report: Report
) -> None:
    """Check that somebody's arrays let xarray open the store: a dimension has one length."""
    lengths: dict[str, int] = {}
    for name in sorted(documents, key=lambda n: n not in own):
        dims, shape = (documents[name].get(key) for key in ("dimension_names", "shape"))
        if not (isinstance(dims, list) and isinstance(shape, list)):
            continue
        for dim, length in zip(dims, shape, strict=False):
            if (
                isinstance(dim, str)
                and lengths.setdefault(dim, length) != length
                and name not in own
            ):
                report.add(
                    f"{name}: expected {lengths[dim]} along {dim!r} as in {store.storage}, found "
                    f"{length}: xarray would refuse the store; move that array elsewhere"
                )


def check_tables(store: Store, report: Report) -> None:
    """Check ids, splits, groups, sizes and cameras of every frame."""
    tables = store.tables
    if len(store) == 0:
        report.add("frame_id: expected at least one frame, found none")
    if len(set(store.ids)) != len(store.ids) or "" in store.ids:
        report.add("frame_id: expected ids that are unique and not empty, found others")
    unknown = set(tables.split.tolist()) - set(SPLIT_CODES.values())
    if unknown:
        report.add(f"split: expected {sorted(SPLIT_CODES.values())}, found {sorted(unknown)}")
    if store.about.split["rule"] == "group":
        seen: dict[str, int] = {}
        for group, split in zip(tables.group, tables.split.tolist(), strict=True):
            if seen.setdefault(group, split) != split:
                report.add(f"group: expected one split per group, found {group!r} in two")
                break
    for name, column in store.about.frame_metadata.items():
        places, count = column["of_frame"], len(column["values"])
        if len(places) != len(store) or max(places) >= count:
            report.add(f"attributes: expected one value of {name!r} per frame, found others")
    for number in range(len(store)):
        if report.full:
            break
        _check_camera(store, number, report)
    report.count("tables", len(_tables(store)))


def _tables(store: Store) -> dict[str, ArraySpec]:
    about = store.about
    unit_m = about.modalities.get("depth", {}).get("unit_m", MILLIMETRE)
    return table_specs(store.modalities, about.format_version, about.class_ids, unit_m)


def _check_camera(store: Store, index: int, report: Report) -> None:
    name = f"frame {index} ({store.ids[index]!r})"
    try:
        camera: Camera = store.camera(index)
    except (CameraError, StoreError) as error:
        report.add(f"{name}: {error}")
        return
    # A principal point can lie outside a cropped image, but not many images away.
    far = 10 * max(camera.shape)
    if abs(camera.cx) > far or abs(camera.cy) > far or max(camera.fx, camera.fy) > 100 * far:
        report.add(f"{name}: expected a camera of its image's scale, found {camera}")
    baseline = float(store.tables.baseline[index])
    if not (np.isnan(baseline) or 0 < baseline <= MAX_BASELINE_M):
        report.add(f"{name}: expected a positive baseline or NaN, found {baseline}")
    road = store.tables.cam_to_road[index]
    rotation = road[:, :3]
    if np.isnan(road).all():
        return
    sane = np.isfinite(road).all() and np.abs(rotation).max() < 2
    if not sane or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3):
        report.add(f"{name}: expected a rotation in cam_to_road, found {rotation.tolist()}")


def check_arrays(store: Store, report: Report) -> None:
    """Check every array's dimensions, codecs and attributes, and whose chunks each shard holds."""
    tables = _tables(store)
    specs = {name: array.spec for name, array in store.arrays.items()} | tables
    for name in specs:
        found = _attributes(store.storage, name, specs[name], table=name in tables)
        for key, value in specs[name].attributes.items():
            # Comments are for people; earlier versions had others.
            if key != "comment" and found.get(key) != value:
                report.add(
                    f"{name}: expected attribute {key} = {value!r}, found {found.get(key)!r}"
                )
    shapes = {array.shape[1:3] for array in store.arrays.values()}
    if len(shapes) > 1:
        report.add(f"arrays: expected images of one size, found {sorted(shapes)}")
    for name, array in store.arrays.items():
        look = partial(_shard_problem, array)
        with closing(map_in_order(look, array.shards, _AT_ONCE)) as problems:
            for problem in problems:
                if problem:
                    report.add(f"{name}: {problem}")
                report.count("shards")
                if report.full:
                    return
    if store.tables.chunk_crc32c is not None:
        report.count("checksums", store.tables.chunk_crc32c.size)


def _attributes(storage: Storage, name: str, spec: ArraySpec, *, table: bool) -> dict[str, Any]:
    """Return the attributes in an array's own document, after zarr-python has taken it.

    zarr-python gets nothing else of the store, and that only where it is laid out as it should be:
    it looks up and runs whatever codecs a document names.
    """
    import zarr

    document = read_document(storage, f"{name}/{ROOT}")
    if table:
        try:
            check_table(document, spec)
        except TableError as error:
            raise StoreError(f"{name}: {error}") from error
    elif problems := layout_problems(document, spec):
        raise StoreError(f"{name}: {problems[0]}")
    files = MemoryFiles({f"{name}/{ROOT}": json.dumps(document).encode()}).zarr
    try:
        return dict(zarr.open_array(files, path=name, mode="r", zarr_format=3).attrs)
    except _MALFORMED as error:
        raise StoreError(f"{name}: {_first_line(error)}") from error


def _shard_problem(array: ImageArray, shard: int) -> str:
    try:
        array.check_shard(shard)
    except StoreError as error:
        return fault_of(error)
    return ""
