"""Compile every kernel at once, so that no later run has to: when an image is built, say."""

from __future__ import annotations

import importlib
import pkgutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from nimprep.errors import CacheError


@dataclass(frozen=True)
class WarmUp:
    """Tell what a warm-up did.

    Attributes
    ----------
    kernels : int
        All that nimprep has, each counted once for every type of array that it takes.
    compiled : int
        Those of them that were not there yet.
    folders : tuple of Path
        Where they are kept: one folder, or more where those of another cannot be added to.
    seconds : float
        How long it took.
    """

    kernels: int
    compiled: int
    folders: tuple[Path, ...]
    seconds: float


def warm_up() -> WarmUp:
    """Compile every kernel that is not kept yet, for this machine's kind of CPU.

    They are kept in NUMBA_CACHE_DIR where it is set, else beside the package, else in the user's
    cache. Whoever may read that folder later need not be able to write to it.

    Raises
    ------
    CacheError
        There is no folder to keep them in, or NUMBA_CACHE_DIR cannot be written to.
    """
    start = time.perf_counter()
    import nimprep
    from nimprep.compilation.decorator import KERNELS
    from nimprep.compilation.folders import FOLDERS

    before = sum(cache.compiled for cache in KERNELS.values())
    for module in kernel_modules(nimprep.__path__):
        importlib.import_module(module)
    kept = [folder for cache in KERNELS.values() for folder in cache.folders]
    lost = sum(folder is None for folder in kept)
    if FOLDERS.wished is not None:
        lost = sum(folder != FOLDERS.wished for folder in kept)
    if lost:
        place = FOLDERS.wished or "compiled kernels"
        raise CacheError(
            f"{place}: expected to keep {len(kept)} compiled kernels there, found {lost} not "
            "kept; set NUMBA_CACHE_DIR to a folder that can be written to"
        )
    return WarmUp(
        kernels=len(kept),
        compiled=sum(cache.compiled for cache in KERNELS.values()) - before,
        folders=tuple(sorted({folder for folder in kept if folder is not None})),
        seconds=time.perf_counter() - start,
    )


def kernel_modules(path: Sequence[str], package: str = "nimprep") -> Iterator[str]:
    """Yield the modules within packages called kernels, none of them imported."""
    for _, name, is_package in pkgutil.iter_modules(path):
        if is_package:
            yield from kernel_modules([str(Path(p) / name) for p in path], f"{package}.{name}")
        elif package.endswith(".kernels"):
            yield f"{package}.{name}"
