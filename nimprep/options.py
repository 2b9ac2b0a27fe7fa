"""Options, each said once, by a field: checks, documentation and command line are made of it."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cache
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from nimprep.errors import ArrayError

Made = TypeVar("Made", bound=type)


@dataclass(frozen=True)
class Option:
    """Describe an option: what a field says, and how a command's help writes a value of it."""

    name: str
    default: Any
    types: tuple[Any, ...]
    help: str = ""
    least: float | None = None
    most: float | None = None
    metavar: str | None = None
    # Whether it tells in the bytes of a store.
    counts: bool = True

    @property
    def choices(self) -> tuple[str, ...]:
        """What there is to choose from; () = it is no choice."""
        kinds = [t for t in self.types if t is not NoneType]
        literal = all(get_origin(t) is Literal for t in kinds)
        return tuple(c for t in kinds for c in get_args(t)) if literal else ()

    def check(self, value: Any) -> None:
        """Raise `ArrayError` where a value is no choice, or out of bounds."""
        expected = None
        if value is None and NoneType in self.types:
            return
        if self.choices and value not in self.choices:
            expected = f"one of {', '.join(self.choices)}"
        elif self.least is not None and not value >= self.least:
            expected = f"{self.least:g} or more"
        elif self.most is not None and not value <= self.most:
            expected = f"{self.most:g} or less"
        if expected is not None:
            raise ArrayError(f"{self.name}: expected {expected}, found {value!r}")


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
            found.check(getattr(self, name))


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
