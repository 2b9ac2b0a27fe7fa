"""Weights for classes and frames that are not alike in number, from counted pixels."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from nimprep.errors import ArrayError, StoreError
from nimprep.frame import IGNORE_LABEL
from nimprep.store.reader import Store
from nimprep.store.statistics import class_pixels_of

Weighting = Literal["inverse", "median", "effective", "enet", "espnet"]
"""How rare classes are to count for more; see `class_weights`."""

Counts = npt.NDArray[np.int64]
Weights = npt.NDArray[np.float64]


def label_pixels(
    store: Store, indices: npt.NDArray[np.int64], merged: npt.NDArray[np.uint8]
) -> Counts:
    """Return the pixels of each label in each of these frames, (N, K); ignored ones left out.

    Parameters
    ----------
    merged : (256,) uint8
        The label that each stored one becomes.

    Raises
    ------
    StoreError
        The store has no labels, or one is damaged.
    """
    labels = _labels(store, merged)
    stored = class_pixels_of(store)[indices, :-1].astype(np.int64)
    pixels = np.zeros((len(indices), class_count(store, merged)), np.int64)
    for column, label in enumerate(labels):
        if label != IGNORE_LABEL:
            pixels[:, label] += stored[:, column]
    return pixels


def class_count(store: Store, merged: npt.NDArray[np.uint8]) -> int:
    """Return how many classes a network is to tell apart: the largest label that counts, plus 1.

    Raises
    ------
    StoreError
        The store has no labels.
    """
    return max((i for i in _labels(store, merged) if i != IGNORE_LABEL), default=-1) + 1


def _labels(store: Store, merged: npt.NDArray[np.uint8]) -> list[int]:
    """Return the label that each of the store's classes becomes."""
    ids = store.about.class_ids
    if not ids:
        raise StoreError(
            f"{store.path}: expected labels, found none; convert a dataset with labels"
        )
    labels: list[int] = merged[ids].tolist()
    return labels


def class_weights(pixels: Counts, method: Weighting) -> Weights:
    """Return a weight per class, 0 where it has no pixel.

    Parameters
    ----------
    pixels : (N, K) int64
        Pixels of each class in each frame.
    method : {"inverse", "median", "effective", "enet", "espnet"}
        With n_c the pixels of class c, p_c their share of all classes' and K the classes that have
        any:

        inverse    1 / (K p_c), so that every class counts alike
        median     median(f) / f_c with f_c the share of c in the frames that have it
                   (Eigen and Fergus, ICCV 2015, section 6.3.2)
        effective  proportional to (1 - b) / (1 - b^n_c), mean 1, with b = 1 - 1 / sum of n_c
                   (Cui et al., CVPR 2019, equations 2 and 11)
        enet       1 / ln(1.02 + p_c) (Paszke et al., arXiv:1606.02147, section 5.1)
        espnet     1 / ln(1.10 + p_c), as ESPNet's authors train

    Raises
    ------
    ArrayError
        There is no such method, or no pixel of any class.
    """
    if method not in _METHODS:
        known = ", ".join(get_args(Weighting))
        raise ArrayError(f"class weights: expected one of {known}, found {method!r}")
    total = pixels.sum(axis=0)
    there = total > 0
    if not there.any():
        raise ArrayError("class weights: expected labelled pixels, found none in these frames")
    weights = np.zeros(len(total))
    weights[there] = _METHODS[method](pixels[:, there].astype(np.float64))
    return weights


def _inverse(pixels: Weights) -> Weights:
    total = pixels.sum(axis=0)
    return np.asarray(total.sum() / (len(total) * total))


def _median(pixels: Weights) -> Weights:
    all_of_frame = pixels.sum(axis=1, keepdims=True)
    share = pixels.sum(axis=0) / np.where(pixels > 0, all_of_frame, 0).sum(axis=0)
    return np.asarray(np.median(share) / share)


def _effective(pixels: Weights) -> Weights:
    total = pixels.sum(axis=0)
    # 1 - b^n by way of logarithms: of some million pixels b is 1 but for its last digits.
    log_b = math.log1p(-1 / total.sum()) if total.sum() > 1 else -math.inf
    weights = -1 / np.expm1(total * log_b)
    return np.asarray(weights / weights.mean())


def _enet(pixels: Weights) -> Weights:
    total = pixels.sum(axis=0)
    return np.asarray(1 / np.log(1.02 + total / total.sum()))


def _espnet(pixels: Weights) -> Weights:
    total = pixels.sum(axis=0)
    return np.asarray(1 / np.log(1.10 + total / total.sum()))


_METHODS: dict[str, Callable[[Weights], Weights]] = {
    "inverse": _inverse,
    "median": _median,
    "effective": _effective,
    "enet": _enet,
    "espnet": _espnet,
}


def frame_weights(pixels: Counts, weights: Weights) -> Weights:
    """Return a weight per frame: the mean weight of its labelled pixels; 0 where it has none."""
    labelled = pixels.sum(axis=1)
    return np.asarray(pixels @ weights / np.maximum(labelled, 1))
