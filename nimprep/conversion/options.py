"""How a dataset is to become a store."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from nimprep.derive.modalities import Recipe
from nimprep.errors import ArrayError
from nimprep.readers import ReaderOptions
from nimprep.readers.crop import Margins
from nimprep.splits import SPLIT_RULES
from nimprep.store.spec import NORMAL_SCALES, PRESETS, SHARD_LENGTH


@dataclass(frozen=True)
class ConvertOptions:
    """Say how a dataset becomes a store.

    Attributes
    ----------
    reader : str
        A name in `nimprep.readers.READERS`; "auto" = by the folder's layout.
    source : ReaderOptions
        What the reader should do differently.
    crop : "auto", Margins or None
        Cut the sides that have depth in no frame, or these margins, or nothing.
    modalities : tuple of str, optional
        What to store; None = all that can be had.
    recipe : Recipe
        How derived modalities are made.
    normal_dtype : {"int8", "int16"}
    codec : str
        "fast" to read, or "small" to keep.
    split_by : {"frame", "group", "stratified"}, optional
        None = "stratified" where the dataset's authors fixed some frames' split, else "frame".
    split_file : Path, optional
        In place of a rule.
    seed : int
    shard_length : int
        Frames per shard.
    workers : int, optional
        Threads; None = the cores this process may use. The bytes do not depend on it.
    overwrite : bool
        Replace a complete store.
    """

    reader: str = "auto"
    source: ReaderOptions = field(default_factory=ReaderOptions)
    crop: Literal["auto"] | Margins | None = None
    modalities: tuple[str, ...] | None = None
    recipe: Recipe = field(default_factory=Recipe)
    normal_dtype: Literal["int8", "int16"] = "int8"
    codec: str = "fast"
    split_by: str | None = None
    split_file: Path | None = None
    seed: int = 0
    shard_length: int = SHARD_LENGTH
    workers: int | None = None
    overwrite: bool = False

    def __post_init__(self) -> None:
        for name, value, allowed in (
            ("codec", self.codec, tuple(PRESETS)),
            ("normal_dtype", self.normal_dtype, tuple(NORMAL_SCALES)),
            ("split_by", self.split_by, (None, *SPLIT_RULES)),
        ):
            if value not in allowed:
                raise ArrayError(f"{name}: expected one of {allowed}, found {value!r}")
        for name, number in (("shard_length", self.shard_length), ("workers", self.workers)):
            if number is not None and number < 1:
                raise ArrayError(f"{name}: expected 1 or more, found {number}")
