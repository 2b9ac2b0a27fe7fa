"""Train the networks on a store, and predict with them: what the commands of these names do.

The public names are imported on first use, so that ``import nimprep.training`` stays quick.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nimprep.training.options import TrainOptions as TrainOptions
    from nimprep.training.predict_options import PredictOptions as PredictOptions
    from nimprep.training.prediction import Predicted as Predicted
    from nimprep.training.prediction import predict as predict
    from nimprep.training.recipes import RECIPES as RECIPES
    from nimprep.training.run import Trained as Trained
    from nimprep.training.run import train as train

_HOME = {
    "PredictOptions": "nimprep.training.predict_options",
    "Predicted": "nimprep.training.prediction",
    "RECIPES": "nimprep.training.recipes",
    "TrainOptions": "nimprep.training.options",
    "Trained": "nimprep.training.run",
    "predict": "nimprep.training.prediction",
    "train": "nimprep.training.run",
}

__all__ = [*_HOME]


if not TYPE_CHECKING:
    # A type checker knows the names above, and that there are no others.
    def __getattr__(name: str) -> Any:
        if name not in _HOME:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        if _HOME[name].endswith((".run", ".prediction")):
            # Says which extra it comes with, where PyTorch is not installed.
            import_module("nimprep.torch")
        return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
