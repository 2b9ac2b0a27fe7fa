"""The page of a store: saved as one file, or served."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from nimprep import __version__
from nimprep.errors import StoreError
from nimprep.files import check_file, write_whole
from nimprep.parallel import Progress
from nimprep.report.artist import Artist
from nimprep.report.charts import make_charts
from nimprep.report.collect import Collected, collect
from nimprep.report.contents import describe, gallery_data, legends
from nimprep.report.figures import Chart
from nimprep.report.findings import Finding, find
from nimprep.report.gallery import Gallery, order_of_interest, paint_gallery
from nimprep.report.page import check_libraries, render_page
from nimprep.report.separation import Separation, measure_separation
from nimprep.report.separation_table import separation_table
from nimprep.store.reader import Store, open_store

MEGABYTES = 20.0
"""A saved page is smaller than this."""

_RESERVE = 100_000


@dataclass(frozen=True)
class Report:
    """Tell what was written.

    Attributes
    ----------
    path : Path
    bytes : int
    frames, shown : int
        Of the store, and of those whose pictures are on the page.
    findings : tuple of Finding
    separation : Separation
        What tells the road from other classes.
    """

    path: Path
    bytes: int
    frames: int
    shown: int
    findings: tuple[Finding, ...]
    separation: Separation


@dataclass(frozen=True)
class Examined:
    """Hold a store with what was found out about it, ready to be shown."""

    store: Store
    facts: Collected
    findings: tuple[Finding, ...]
    charts: dict[str, Chart]
    artist: Artist
    separation: Separation


def examine(
    store: Store | Path | str, progress: Progress | None = None, road: str | None = None
) -> Examined:
    """Collect what a store's page shows.

    Parameters
    ----------
    road : str, optional
        The class that is told from the others; see `measure_separation`.

    Raises
    ------
    ArrayError
        The store has no class of this name.
    NimprepError
        The extra `report` is not installed.
    StoreError
        There is no store, or it is damaged.
    """
    check_libraries()
    store = store if isinstance(store, Store) else open_store(store)
    facts = collect(store, progress)
    separation = measure_separation(store, facts.classes, road, progress)
    findings = tuple(find(store, facts))
    charts, artist = make_charts(store, facts), Artist(store, facts)
    return Examined(store, facts, findings, charts, artist, separation)


def page_of(seen: Examined, gallery: Gallery | None) -> str:
    """Return a store's page as HTML.

    With a gallery its pictures are in the page, which then needs nothing else; with None every
    frame's are loaded from where the page came from, ``/frame/<number>/<modality>/<size>``.
    """
    shown: Sequence[int] | None = None if gallery is None else tuple(gallery.frames)
    context = {
        **describe(seen.store, seen.facts, seen.findings, seen.charts),
        "separation": separation_table(seen.separation),
        "gallery": gallery_data(seen.store, seen.facts, seen.findings, seen.artist, shown),
        "legends": legends(seen.store, seen.artist),
        "pictures": {} if gallery is None else gallery.frames,
        "gallery_note": _note(len(seen.store), gallery),
        "version": __version__,
    }
    figures = {name: chart.figure for name, chart in seen.charts.items()}
    return render_page(
        "store.html.j2", context, ["gallery.js"], figures=figures, served=gallery is None
    )


def _note(frames: int, gallery: Gallery | None) -> str:
    if gallery is None or len(gallery.frames) == frames:
        return "Every frame. A click on a picture shows it large, beside another of the same frame."
    return (
        f"Pictures of {len(gallery.frames)} of {frames} frames, so that the page stays small: "
        "some of each finding, and an even sample of every split and group. "
        "nimprep view shows every frame."
    )


def write_report(
    store: Store | Path | str,
    out: Path | str,
    overwrite: bool = False,
    megabytes: float = MEGABYTES,
    progress: Progress | None = None,
    road: str | None = None,
) -> Report:
    """Write a store's page as one file of HTML that needs no network.

    Parameters
    ----------
    store : Store, path or URL
    out : path
        The file.
    overwrite : bool
        Replace a file that is there.
    megabytes : float
        The file stays below this; fewer frames are shown, and smaller, where all are too many.
    progress : callable, optional
        Called with the step and its frames; gives what is called after each.
    road : str, optional
        As `examine` takes it.

    Raises
    ------
    ArrayError
        The store has no class of the name `road`.
    NimprepError
        The extra `report` is not installed.
    StoreError
        There is no store, it is damaged, or not even the page without pictures is small enough.
    LayoutError
        `out` is there already, lies in the store, or cannot be written.
    """
    out = Path(out)
    place = Path(store.path if isinstance(store, Store) else store)
    check_file(out, place, overwrite=overwrite)
    seen = examine(store, progress, road)
    bare = page_of(seen, Gallery(0, {}))
    room = int(megabytes * 1e6) - len(bare.encode()) - _RESERVE
    if room < 0:
        raise StoreError(
            f"{out}: expected room for {len(bare) / 1e6:.1f} MB without any picture, "
            f"found a limit of {megabytes:g} MB; raise it"
        )
    order = order_of_interest(seen.store, seen.findings)
    gallery = paint_gallery(seen.artist, order, room, progress)
    html = page_of(seen, gallery)
    data = html.encode()
    write_whole(out, data, place, overwrite=overwrite)
    return Report(
        out, len(data), len(seen.store), len(gallery.frames), seen.findings, seen.separation
    )
