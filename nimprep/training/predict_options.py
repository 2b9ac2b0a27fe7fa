"""How a trained network predicts a store's frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypedDict

from nimprep.options import Options, documented, option

PredictedSplit = Literal["test", "val", "train", "none", "all"]


@documented
@dataclass(frozen=True, kw_only=True)
class PredictOptions(Options):
    """Say which frames are predicted, and what is written of them."""

    split: PredictedSplit = option("test", "Of which frames.")
    save_scores: bool = option(
        False, "Write scores/ too: a plane for each of the store's classes, 0 to 1, float32."
    )
    batch: int = option(1, "Frames that the network gets at once.", least=1)
    device: str = option("auto", "auto, cpu, cuda or cuda:1.", counts=False)
    overwrite: bool = option(False, "Replace predictions that are there.", counts=False)


# Keyword arguments by the names of the fields, for type checkers; a test compares them.
class PredictKeywords(TypedDict, total=False):
    split: PredictedSplit
    save_scores: bool
    batch: int
    device: str
    overwrite: bool
