"""Options, each said once, by a field: checks, documentation and command line are made of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import cache
from math import isfinite
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from nimprep.errors import ArrayError

Made = TypeVar("Made", bound=type)

_SAID: dict[Any, str] = {
    bool: "True or False",
    int: "a whole number",
    float: "a finite number",
    Path: "a file",
    str: "a name",
}


@dataclass(frozen=True)
class Option:
    """Describe an option: what a field says, and how a command's help writes a value of it."""

    name: str
    default: Any
    types: tuple[Any, ...]
    help: str = ""
    least: float | None = None
    most: float | None = None
    # What to do where a value is more than the most, of the value.
    beyond: Callable[[float], str] | None = None
    metavar: str | None = None
    # Whether it tells in the bytes of a store.
    counts: bool = True
    # What the command line calls it, where that is not its name.
    flag: str | None = None

    @property
    def choices(self) -> tuple[str, ...]:
        """What there is to choose from; () = it is no choice."""
        kinds = [t for t in self.types if t is not NoneType]
        literal = all(get_origin(t) is Literal for t in kinds)
        return tuple(c for t in kinds for c in get_args(t)) if literal else ()

    def checked(self, value: Any) -> Any:
        """Return a value as Python has it, where it comes from NumPy, say.

        Raises
        ------
        ArrayError
            It is of another type, no choice, or out of bounds.
        """
        if value is None and NoneType in self.types:
            return None
        made = self._made(value)
        if made is None:
            raise self._wrong(self._kind(), value)
        if self.least is not None and not made >= self.least:
            raise self._wrong(f"{self.least:g} or more", made)
        if self.most is not None and not made <= self.most:
            raise self._wrong(f"{self.most:g} or less", made, self.step_beyond(made))
        return made

    def _made(self, value: Any) -> Any:
        """Return a value of one of the option's types; None = it is of none of them."""
        if self.choices:
            return value if isinstance(value, str) and value in self.choices else None
        if bool in self.types:
            return bool(value) if type(value).__name__ in ("bool", "bool_") else None
        if type(value).__name__ in ("bool", "bool_"):
            return None
        if int in self.types:
            return int(value) if isinstance(value, Integral) else None
        if str in self.types and isinstance(value, str):
            return value or None
        if float in self.types:
            finite = isinstance(value, Real) and isfinite(value)
            return float(value) if finite else None
        if {Path, str} & {*self.types} and isinstance(value, (str, PathLike)):
            return value or None
        # Of another kind: whose option it is says what it can be.
        return value if any(get_origin(kind) for kind in self.types) else None

    def _kind(self) -> str:
        """Return what values it can have, for messages."""
        if self.choices:
            return f"one of {', '.join(self.choices)}"
        return next((said for kind, said in _SAID.items() if kind in self.types), "a value")

    def step_beyond(self, value: float) -> str:
        """Return what to do where a value is more than the most, as the end of a message."""
        return f"; {self.beyond(value)}" if self.beyond is not None else ""

    def _wrong(self, expected: str, found: Any, step: str = "") -> ArrayError:
        return ArrayError(f"{self.name}: expected {expected}, found {found!r}{step}")


def option(default: Any, help: str = "", **said: Any) -> Any:  # noqa: A002
    """Return a dataclass's field that is an option: what it says is as for `Option`."""
    return field(default=default, metadata={"help": help, **said})


@cache
def options_of(made: type) -> dict[str, Option]:
    """Return the options of a dataclass, by their names."""
    hints = get_type_hints(made)
    unions = {name: get_origin(hint) in (Union, UnionType) for name, hint in hints.items()}
    types = {n: get_args(hint) if unions[n] else (hint,) for n, hint in hints.items()}
    return {
        f.name: Option(f.name, f.default, types[f.name], **f.metadata)
        for f in fields(made)
        if f.metadata
    }


class Options:
    """Check the options of a dataclass when one is made."""

    def __post_init__(self) -> None:
        for name, found in options_of(type(self)).items():  # type: ignore[arg-type]
            object.__setattr__(self, name, found.checked(getattr(self, name)))


def documented(made: Made) -> Made:
    """Add its options to the documentation of a dataclass."""
    lines = [(made.__doc__ or "").rstrip(), "", "    Attributes", "    ----------"]
    for each in fields(made):
        found = options_of(made)[each.name]
        choices = f"{{{', '.join(map(repr, found.choices))}}}"
        lines.append(f"    {each.name} : {choices if found.choices else each.type}")
        said = [f"False: {found.help}" if found.default is True else found.help]
        said += [] if "default:" in found.help else [f"Default: {found.default!r}."]
        lines.append(f"        {' '.join(filter(None, said))}")
    made.__doc__ = "\n".join([*lines, "    "])
    return made
