"""The methods of making normals and filling depth, and the options that each takes."""

from __future__ import annotations

import math
from typing import Literal, get_args

from nimprep.errors import ArrayError

Method = Literal["nim", "nim-edge", "auto"]

METHODS: tuple[Method, ...] = get_args(Method)
"""What `nimprep.derive.normals.estimate_normals` takes as `method`."""

FixedMethod = Literal["nim", "nim-edge"]

FIXED_METHODS: tuple[FixedMethod, ...] = get_args(FixedMethod)
"""Those that are the same for every image, and so what a store's normals are made by."""

FillMethod = Literal["nearest", "linear", "colorization"]

FILL_METHODS: tuple[FillMethod, ...] = get_args(FillMethod)
"""Every method of `nimprep.derive.completion.fill_depth`."""

Ground = Literal["lowest", "floor"]
"""Where heights of HHA are counted from."""

GROUNDS: tuple[Ground, ...] = get_args(Ground)

ElevationRoad = Literal["calibrated", "fitted"]
"""Which road elevation is counted from, where a frame has both."""

ELEVATION_ROADS: tuple[ElevationRoad, ...] = get_args(ElevationRoad)

Fill = Literal["none", FillMethod]

FILLS: tuple[Fill, ...] = get_args(Fill)
"""How holes in depth can be filled before anything is derived from it."""


def check_method(method: str, sign_filter: bool = False, noise: float | None = None) -> None:
    """Check that a method exists and has the options given, and load what only it needs.

    Loading compiles kernels when they are first used on a machine. That takes seconds, and should
    be done before processes start that would all do it.

    Raises
    ------
    ArrayError
        As `estimate_normals` does.
    """
    if method not in METHODS:
        known = ", ".join(repr(name) for name in METHODS)
        raise ArrayError(f"method: expected one of {known}, found {method!r}")
    if method != "nim":
        import nimprep.derive.normals_edge  # noqa: F401
    if method != "nim" and sign_filter:
        raise ArrayError(f"sign_filter: expected False with {method!r}, found True; 'nim' has it")
    if noise is None:
        return
    if method != "nim-edge":
        raise ArrayError(f"noise: expected None with {method!r}, found {noise}; 'nim-edge' has it")
    if not 0 <= noise < math.inf:
        raise ArrayError(f"noise: expected a finite number >= 0, 1/m, found {noise!r}")
