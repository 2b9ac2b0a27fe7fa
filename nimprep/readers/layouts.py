"""The readers by name, and what tells that a folder is theirs."""

from __future__ import annotations

from collections.abc import Mapping
from inspect import Parameter, signature
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from nimprep.readers.datasets import DATASETS, Dataset
from nimprep.readers.signs import Sign


class Layout(NamedTuple):
    """Describe what a reader is for.

    Attributes
    ----------
    about : str
        What is where, for people.
    open : str
        "module:function", called with the dataset's folder and, by their names, with the options
        of `ReaderOptions` that it takes; with `labels`, `depth` and `official` of `open_reader`.
    marks : tuple of str
        Folders, any of which tells that a dataset has this layout, if it is no other.
    signs, not_signs : tuple of Sign
        Files that are there, and files that are not, where a dataset surely has this layout.
    each : bool
        The signs are those of one sequence: they lie in the dataset, or in one folder of it.
    parts : tuple of str
        Further patterns of files that such a dataset is made of, where no description says them.
    over : tuple of str
        Readers whose signs such a dataset has too.
    roots : tuple of str
        Folders in which the dataset may lie.
    dataset : Dataset, optional
        Given to what opens it, as a keyword.
    """

    about: str
    open: str
    marks: tuple[str, ...] = ()
    signs: tuple[Sign, ...] = ()
    not_signs: tuple[Sign, ...] = ()
    over: tuple[str, ...] = ()
    roots: tuple[str, ...] = ("",)
    dataset: Dataset | None = None
    each: bool = False
    parts: tuple[str, ...] = ()

    def parameters(self) -> Mapping[str, Parameter]:
        """Return what it is opened with, options that this dataset has not left out."""
        found = signature(resolve_name(self.open)).parameters
        if self.dataset is None:
            return found
        own = {"label_set", "variations", "camera_index", "lists"} - self.dataset.options.keys()
        return {name: each for name, each in found.items() if name not in own}

    def keywords(self) -> dict[str, Any]:
        """Return what it is opened with whatever the options are."""
        return {} if self.dataset is None else {"dataset": self.dataset}


def _named(dataset: Dataset) -> Layout:
    return Layout(
        dataset.about,
        "nimprep.readers.named:open_named",
        signs=dataset.signs,
        not_signs=dataset.not_signs,
        over=dataset.over,
        roots=dataset.roots,
        dataset=dataset,
        each=dataset.each,
    )


if TYPE_CHECKING:
    ReaderName = str
else:
    ReaderName = Literal["auto", "gmrp", "kitti-road", "folder", *DATASETS]

READERS: dict[ReaderName, Layout] = {
    "kitti-road": Layout(
        "training/ and testing/ with image_2/, calib/ and gt_image_2/",
        "nimprep.readers.kitti_road:KittiRoadReader",
        ("training/image_2", "testing/image_2"),
        ("{training,testing,validation,validating}/image_2/{um,umm,uu}_*.*",),
        parts=("{training,testing,validation,validating}/*/{um,umm,uu}_*.*",),
    ),
    "gmrp": Layout(
        "rgb/, depth_u16/ and label/ with equal file names",
        "nimprep.readers.gmrp:open_gmrp",
        ("depth_u16", "rgb"),
        ("rgb/**/*.*", "depth_u16/**/*.*"),
        parts=("{label,depth_u8}/**/*.*",),
    ),
    **{name: _named(dataset) for name, dataset in DATASETS.items()},
    "folder": Layout(
        "anything a --description FILE.json describes", "nimprep.readers.folder:FolderReader"
    ),
}
"""The readers, in the order in which messages name them."""
