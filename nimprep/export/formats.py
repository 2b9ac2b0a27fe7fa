"""Export: which frames, in which form, to where; all of it or nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path, PurePosixPath
from pkgutil import resolve_name
from typing import Literal, get_args

from nimprep.errors import ArrayError, StoreError
from nimprep.export.layout import Layout, export_layout
from nimprep.export.places import files_of, write_new
from nimprep.export.selection import select_frames
from nimprep.files import check_file, whole_file
from nimprep.folders import check_folder, whole_folder
from nimprep.modality import modality_name
from nimprep.parallel import Progress, map_frames
from nimprep.store.reader import Store, open_store

Format = Literal["png", "rerun", "npz", "rgbx", "roadformer", "voc", "coco"]
FORMATS: tuple[str, ...] = get_args(Format)

LAYOUTS = {
    "rgbx": "nimprep.export.rgbx:RGBX",
    "roadformer": "nimprep.export.roadformer:ROADFORMER",
    "voc": "nimprep.export.voc:VOC",
    "coco": "nimprep.export.coco:COCO",
}
"""Where the layouts of networks are described (`nimprep.export.layout`)."""

FrameWriter = tuple[Callable[[int, PurePosixPath], set[str]], Callable[[set[str]], None]]
"""Write the frame of a number under a name, and return what of it has no file; then, given all that
frames have no file of, the rest."""


def export_frames(
    store: Store | Path | str,
    out: Path | str,
    form: Format = "png",
    frames: Iterable[str] | None = None,
    progress: Progress | None = None,
    *,
    modalities: Sequence[str] | None = None,
    overwrite: bool = False,
) -> list[str]:
    """Write frames of a store out as files that other programs read.

    Parameters
    ----------
    store : Store or path
    out : path
        A new or empty folder; with "rerun", a new file. It is there whole or not at all, and
        nothing is written outside it.
    form : {"png", "rerun", "npz", "rgbx", "roadformer", "voc", "coco"}
        GMRP's raw layout (`nimprep.export.png`), one recording (`nimprep.export.rerun`), one
        archive per frame (`nimprep.export.npz`), the folders of CMX, DFormer and Sigma
        (`nimprep.export.rgbx`) or RoadFormer (`nimprep.export.roadformer`), PASCAL VOC's
        (`nimprep.export.voc`) or COCO's JSON (`nimprep.export.coco`); all from "rgbx" on leave out
        frames without a split, which is said.
    frames : str or iterable of str, optional
        Ids, splits and ranges START:END, as `nimprep.export.selection` reads them; None = all.
    progress : callable, optional
        Called with the step and its frames; gives what is called after each.
    modalities : sequence of str, optional
        Which to write, with all but "rerun"; None = those of GMRP's raw layout with "png", all
        with "npz", what the networks read with the others, made from depth where the store lacks
        it. With "png", encodings.json then says how each folder's numbers are to be read
        (`nimprep.export.encoding`); with the others it always does.
    overwrite : bool
        With "rerun", replace a file that is there. A folder's files are never replaced.

    Returns
    -------
    list of str
        The ids of the frames written, in the store's order.

    Raises
    ------
    StoreError
        There is no store, it is damaged, or `frames` or `modalities` name what it does not have.
    LayoutError
        `out` is taken, inside the store or cannot be written, or a frame's id can be no file name.
    """
    if form not in FORMATS:
        raise ArrayError(f"form: expected one of {', '.join(FORMATS)}, found {form!r}")
    out = Path(out)
    if not isinstance(store, Store):
        store = open_store(store)
    if overwrite and form != "rerun":
        raise ArrayError(f"overwrite: expected form 'rerun' with it, found {form!r}")
    if modalities is not None and form == "rerun":
        raise ArrayError(
            f"modalities: expected form {', '.join(map(repr, LAYOUTS))}, 'png' or 'npz' with them, "
            "found 'rerun'"
        )
    place = Path(store.path)
    check_file(out, place, overwrite=overwrite) if form == "rerun" else check_folder(out, place)
    numbers = select_frames(store, [frames] if isinstance(frames, str) else frames)
    asked = None if modalities is None else _names(modalities)
    if form in LAYOUTS:
        layout: Layout = resolve_name(LAYOUTS[form])
        return export_layout(layout, store, numbers, out, asked, progress)
    chosen = None if asked is None else _chosen(store, asked)
    ids = [store.ids[i] for i in numbers]
    if form == "rerun":
        _export_recording(store, numbers, out, overwrite, progress)
    else:
        writer = _png_writer if form == "png" else _npz_writer
        files = files_of(ids, f".{form}")
        with whole_folder(out, place) as partial:
            write, finish = writer(store, numbers, partial, chosen)
            done = map_frames("export", lambda i: write(i, files[store.ids[i]]), numbers, progress)
            finish(set().union(*done))
    return ids


def _export_recording(
    store: Store, numbers: Sequence[int], out: Path, overwrite: bool, progress: Progress | None
) -> None:
    from nimprep.export.rerun import check_library, write_recording

    check_library()
    with whole_file(out, Path(store.path), overwrite=overwrite) as partial:
        write_recording(store, numbers, partial, progress)


def _names(modalities: Sequence[str]) -> list[str]:
    if isinstance(modalities, str):
        raise ArrayError(
            f"modalities: expected a sequence of names, found {modalities!r}; put them in a list"
        )
    return [modality_name(name) for name in modalities]


def _chosen(store: Store, names: Sequence[str]) -> list[str]:
    """Return the modalities that names mean, each once, in the store's order."""
    for name in names or [""]:
        if name not in store.modalities:
            raise StoreError(
                f"{store.path}: expected modalities of {', '.join(store.modalities)}, "
                f"found {name!r}; convert with it to have it"
            )
    return [name for name in store.modalities if name in names]


def _png_writer(
    store: Store, numbers: Sequence[int], folder: Path, chosen: Sequence[str] | None
) -> FrameWriter:
    from nimprep.export.png import raw_modalities, write_encodings, write_frame, write_records

    modalities = raw_modalities(store) if chosen is None else chosen

    def finish(blank: set[str]) -> None:
        write_records(store, numbers, folder, modalities, blank)
        if chosen is not None:
            write_encodings(store, folder, chosen)

    return lambda index, name: write_frame(store, index, folder, name, modalities), finish


def _npz_writer(
    store: Store, numbers: Sequence[int], folder: Path, chosen: Sequence[str] | None
) -> FrameWriter:
    from nimprep.export.npz import frame_arrays, npz_bytes

    def write(index: int, name: PurePosixPath) -> set[str]:
        write_new(folder / name, npz_bytes(frame_arrays(store, index, chosen)))
        return set()

    return write, lambda blank: None
