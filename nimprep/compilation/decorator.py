"""The one decorator of every kernel."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any, cast

from numba import njit
from numba.extending import is_jitted

from nimprep.compilation.cache import KernelCache

KERNELS: dict[str, KernelCache] = {}
"""The kernels that were imported, by module and name."""


def kernel(
    signatures: Any = None, *, fastmath: Collection[str] = (), inline: bool = False
) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function when it is defined, or load what an earlier run compiled.

    It runs without the GIL, and divides as NumPy does.

    Parameters
    ----------
    signatures : signature or list of them, optional
        The types it takes, as `numba.njit` does; no others are compiled later. None = a part of the
        kernels that call it: compiled into them, and not to be called from Python.
    fastmath : collection of str
        LLVM's flags; only such as keep NaN and infinity right.
    inline : bool
        Always compile it into its callers' own code.
    """
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
    if fastmath:
        options["fastmath"] = set(fastmath)
    if inline:
        options["forceinline"] = True

    def decorate(function: Callable[..., Any]) -> Any:
        compiled: Any = njit(**options)(function)
        # With NUMBA_DISABLE_JIT it is the function itself.
        if signatures is None or not is_jitted(compiled):
            return compiled
        cache = KernelCache(function, repr((sorted(fastmath), inline)))
        KERNELS[cache.name] = cache
        # What njit(cache=True) does too, with a cache that asks for no place to write.
        cast(Any, compiled)._cache = cache
        for signature in signatures if isinstance(signatures, list) else [signatures]:
            compiled.compile(signature)
        compiled.disable_compile()
        return compiled

    return decorate
