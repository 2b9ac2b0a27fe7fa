"""Score predictions against a store's labels, compare methods, and show both."""

from nimprep.evaluation.comparison import Comparison, Method
from nimprep.evaluation.run import compare_predictions, evaluate_predictions
from nimprep.evaluation.scores import BACKGROUND, MEASURES, Evaluation

__all__ = [
    "BACKGROUND",
    "MEASURES",
    "Comparison",
    "Evaluation",
    "Method",
    "compare_predictions",
    "evaluate_predictions",
]
