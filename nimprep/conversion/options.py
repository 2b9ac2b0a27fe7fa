"""How a dataset is to become a store."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from numbers import Integral
from pathlib import Path
from typing import Any, Literal, TypedDict

from nimprep.derive.methods import ElevationRoad, Fill, Ground, Method
from nimprep.derive.recipe import Recipe, RecipeOptions
from nimprep.errors import ArrayError
from nimprep.modality import MODALITIES, given_for, modality_name
from nimprep.options import Options, documented, option
from nimprep.readers import Reader, ReaderKeywords, ReaderOptions, open_reader
from nimprep.splits import SplitRule
from nimprep.store.spec import SHARD_LENGTH, Codec


def _listed(*, on_request: bool) -> str:
    names = (name for name, m in MODALITIES.items() if m.on_request == on_request)
    return ",".join(names).replace("_", "-")


@dataclass(frozen=True, kw_only=True)
class RunOptions(Options):
    """Say how the work is done; bytes do not depend on it."""

    workers: int | None = option(None, "Threads; default: all cores.", least=1, counts=False)
    restart: bool = option(False, "Begin anew where an earlier run was cut short.", counts=False)
    on_error: Literal["stop", "skip"] = option(
        "stop", "What a bad frame does: end it all, or be left out.", counts=False
    )


@documented
@dataclass(frozen=True, kw_only=True)
class ConvertOptions(RunOptions, RecipeOptions, ReaderOptions):
    """Say how the dataset SRC becomes the store OUT.

    In Python `camera` may also be (fx, fy, cx, cy), in pixels, `crop` is (top, bottom, left, right)
    and `modalities` a sequence.
    """

    crop: Literal["auto"] | tuple[int, int, int, int] | None = option(
        None,
        "Cut sides that have depth in no frame, or so many pixels: top,bottom,left,right.",
        metavar="auto|T,B,L,R",
    )
    labels: bool = option(True, "Convert without.")
    modalities: Sequence[str] | None = option(
        None,
        f"Comma-separated; default: {_listed(on_request=False)} as far as there are; by name "
        f"only: {_listed(on_request=True)}. SRC's own planes by their names, or all by default.",
    )
    normal_dtype: Literal["int8", "int16"] = option("int8")
    codec: Codec = option("fast", "fast to read, or small for archives.")
    split_by: SplitRule | None = option(
        None,
        "Split frames, whole scenes, frames within each scene (15 % each for val and test), or an "
        "eighth of each scene for val and none for test; default: frame, KITTI road: eighth.",
    )
    split_file: Path | str | None = option(
        None,
        "Split by this JSON file, or by lists: train.txt beside val.txt and test.txt, or their "
        "folder.",
    )
    seed: int = option(0, "Of the split.")
    shard_length: int = option(SHARD_LENGTH, "Frames per shard.", least=1, most=4096)
    scheduler: str | None = option(
        None,
        "Encode on this Dask cluster; every worker must reach SRC and OUT under the same paths.",
        metavar="tcp://HOST:8786",
        counts=False,
    )
    overwrite: bool = option(False, "Replace a complete store.", counts=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "crop", _checked_crop(self.crop))
        if self.split_file is not None and self.split_by is not None:
            raise ArrayError("split_file: expected it or split_by, found both; leave one out")
        if isinstance(self.modalities, str):
            raise ArrayError(
                f"modalities: expected a sequence of names, found {self.modalities!r}; put them "
                "into a list"
            )
        if self.modalities is not None:
            names = tuple(modality_name(name) for name in self.modalities)
            object.__setattr__(self, "modalities", names)

    def open_reader(self, source: Path) -> Reader:
        """Open the dataset; what is not to be stored need not be there."""
        return open_reader(
            source,
            self,
            labels=self.labels,
            depth=self.needs_depth,
            official=self.split_by is None and self.split_file is None,
        )

    def resolved(self, reader: Reader) -> ConvertOptions:
        """Return the options with what the dataset says where the user did not."""
        return replace(self, hha_ground=self.hha_ground or reader.info.hha_ground or "floor")

    @property
    def needs_depth(self) -> bool:
        """Whether depth, or what is made from it, is to be stored, or tells what to cut off."""
        cut = self.crop == "auto"
        return cut or self.modalities is None or "depth" in given_for(self.modalities)

    @property
    def recipe(self) -> Recipe:
        """How derived modalities are made."""
        return Recipe(**{f.name: getattr(self, f.name) for f in fields(RecipeOptions)})


@documented
@dataclass(frozen=True, kw_only=True)
class AppendOptions(RunOptions, ReaderOptions):
    """Say how the frames of SRC are read that join STORE; what is made of them, the store says.

    How they are read is to be said as it was for the store.
    """

    skip_existing: bool = option(False, "Leave out frames that STORE has; else they are an error.")


def _checked_crop(crop: Any) -> Any:
    """Return what is to be cut off, the numbers as Python has them.

    Raises
    ------
    ArrayError
        It is neither "auto" nor four whole numbers from 0.
    """
    if crop is None or (isinstance(crop, str) and crop == "auto"):
        return crop
    numbers = () if isinstance(crop, str) else tuple(crop)
    if len(numbers) != 4 or not all(isinstance(n, Integral) and int(n) >= 0 for n in numbers):
        raise ArrayError(
            f"crop: expected 'auto' or four whole numbers from 0, found {crop!r}; give the pixels "
            "to cut off as (top, bottom, left, right)"
        )
    return tuple(int(n) for n in numbers)


# Keyword arguments by the names of the fields, for type checkers; a test compares them.
class RunKeywords(TypedDict, total=False):
    workers: int | None
    restart: bool
    on_error: Literal["stop", "skip"]


class ConvertKeywords(RunKeywords, ReaderKeywords, total=False):
    normals: Method
    sign_filter: bool
    noise: float | None
    hha_ground: Ground | None
    elevation_road: ElevationRoad
    fill: Fill
    store_filled: bool
    depth_unit: float | str
    crop: Literal["auto"] | tuple[int, int, int, int] | None
    labels: bool
    modalities: Sequence[str] | None
    normal_dtype: Literal["int8", "int16"]
    codec: Codec
    split_by: SplitRule | None
    split_file: Path | str | None
    seed: int
    shard_length: int
    scheduler: str | None
    overwrite: bool


class AppendKeywords(RunKeywords, ReaderKeywords, total=False):
    skip_existing: bool
