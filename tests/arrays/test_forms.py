"""Arrays of any form: every public function takes them, with the same result, or says why not."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from inspect import signature
from pathlib import Path
from pkgutil import iter_modules, resolve_name
from typing import Any

import numpy as np
import pytest

import nimprep.kernels
from nimprep.compilation.decorator import KERNELS
from nimprep.errors import NimprepError
from tests.arrays.names import NO_ARRAYS, TENSORS, functions_elsewhere, public_names
from tests.arrays.takers import REFUSED, TAKERS, Argument, Array, Taker, leaves
from tests.derive.roads import CAMERA


def read_only(array: Array) -> Array:
    copy = array.copy()
    copy.flags.writeable = False
    return copy


def mapped(array: Array, folder: Path) -> Array:
    np.save(folder / "array.npy", array)
    found: Array = np.load(folder / "array.npy", mmap_mode="r")
    return found


def strided(array: Array) -> Array:
    wide = np.zeros(tuple(2 * n for n in array.shape), array.dtype)
    part = wide[tuple(slice(1, None, 2) for _ in array.shape)]
    part[...] = array
    return part


def backwards(array: Array) -> Array:
    turned = tuple(slice(None, None, -1) for _ in array.shape)
    return array[turned].copy()[turned]


def unaligned(array: Array) -> Array:
    memory = np.zeros(array.nbytes + 1, np.uint8)
    copy = memory[1:].view(array.dtype).reshape(array.shape)
    copy[...] = array
    return copy


FORMS: dict[str, Callable[[Array, Path], Array]] = {
    "read-only": lambda array, _: read_only(array),
    "mapped read-only": mapped,
    "Fortran": lambda array, _: np.asfortranarray(array),
    "read-only Fortran": lambda array, _: read_only(np.asfortranarray(array)),
    "strided": lambda array, _: strided(array),
    "backwards": lambda array, _: backwards(array),
    "unaligned": lambda array, _: unaligned(array),
    "masked nowhere": lambda array, _: np.ma.array(array, mask=False),
}


EACH_ARGUMENT = [
    pytest.param(taker, name, argument, id=f"{taker.name}-{name}")
    for taker in TAKERS
    for name, argument in taker.arguments.items()
]


def called(taker: Taker, **changes: Any) -> list[Array]:
    arrays = {name: a.array for name, a in taker.arguments.items()} | changes
    return leaves(taker.call(CAMERA, **arrays))


def check_same(found: list[Array], expected: list[Array]) -> None:
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        assert type(one) is np.ndarray
        assert np.array_equal(one, other, equal_nan=other.dtype.kind == "f")


def test_every_public_function_is_told_to_take_arrays_or_none() -> None:
    takers = {taker.function for taker in TAKERS}
    told = takers | TENSORS | NO_ARRAYS
    unknown = public_names() - told
    assert not unknown, f"say in tests/arrays which arrays these take: {sorted(unknown)}"
    assert told == public_names()
    assert not takers & TENSORS | takers & NO_ARRAYS | TENSORS & NO_ARRAYS


def test_the_other_rooms_public_functions_take_no_arrays() -> None:
    functions = functions_elsewhere()
    assert len(functions) > 10
    for name, function in functions.items():
        taken = [str(p.annotation) for p in signature(function).parameters.values()]
        assert not any("Array" in t for t in taken), f"{name}: add it to tests/arrays/takers.py"


@pytest.mark.parametrize("form", list(FORMS))
@pytest.mark.parametrize(("taker", "name", "argument"), EACH_ARGUMENT)
def test_the_form_of_an_array_changes_nothing(
    taker: Taker, name: str, argument: Argument, form: str, tmp_path: Path
) -> None:
    odd = FORMS[form](argument.array, tmp_path)
    before = odd.tobytes()
    check_same(called(taker, **{name: odd}), called(taker))
    assert odd.tobytes() == before


@pytest.mark.parametrize(("taker", "name", "argument"), EACH_ARGUMENT)
def test_the_type_of_an_array_changes_nothing_where_it_holds_the_same_numbers(
    taker: Taker, name: str, argument: Argument
) -> None:
    expected = called(taker)
    for dtype in argument.dtypes:
        other = argument.array.astype(dtype)
        assert np.array_equal(other, argument.array, equal_nan=other.dtype.kind == "f")
        check_same(called(taker, **{name: other}), expected)
        check_same(called(taker, **{name: read_only(np.asfortranarray(other))}), expected)


def hidden(array: Array) -> tuple[Array, Array]:
    """Return a mask of a few elements, and the array with other numbers beneath it."""
    mask = np.zeros(array.shape, bool)
    mask.reshape(-1)[[1, array.size // 2, array.size - 2]] = True
    beneath = np.where(mask, -5 if array.dtype.kind == "f" else 1 - (array > 0), array)
    return mask, beneath.astype(array.dtype)


@pytest.mark.parametrize(("taker", "name", "argument"), EACH_ARGUMENT)
def test_what_is_masked_is_none_or_refused(taker: Taker, name: str, argument: Argument) -> None:
    mask, beneath = hidden(argument.array)
    masked = np.ma.array(beneath, mask=mask)
    if argument.masked == REFUSED:
        with pytest.raises(NimprepError, match=r"masked|nan|finite"):
            called(taker, **{name: masked})
        return
    none = argument.array.copy()
    if argument.masked is None:
        # Of two arrays that go together, the other says where none is.
        others = {"evaluated": np.where(mask, False, taker.arguments["evaluated"].array)}
        check_same(called(taker, **{name: masked}), called(taker, **others))
        return
    none[mask] = argument.masked
    check_same(called(taker, **{name: masked}), called(taker, **{name: none}))
    # Functions such as np.asfortranarray would drop the mask.
    big = masked.astype(masked.dtype.newbyteorder(">")).copy(order="F")
    check_same(called(taker, **{name: big}), called(taker, **{name: none}))


def kernels() -> dict[str, Any]:
    """Return every compiled function that Python calls, by name."""
    for module in iter_modules(nimprep.kernels.__path__, "nimprep.kernels."):
        import_module(module.name)
    return {name: resolve_name(name) for name in KERNELS}


def test_each_kernel_has_one_signature_for_arrays_of_any_form() -> None:
    before = {name: list(kernel.signatures) for name, kernel in kernels().items()}
    for taker in TAKERS:
        called(taker)
        called(taker, **{name: read_only(a.array) for name, a in taker.arguments.items()})
    assert {name: list(kernel.signatures) for name, kernel in kernels().items()} == before
    assert len(before) > 20
    for name, signatures in before.items():
        numbers = [[getattr(t, "dtype", t) for t in types] for types in signatures]
        # Several only where the numbers in the arrays are of several types.
        assert len({str(types) for types in numbers}) == len(signatures), name
