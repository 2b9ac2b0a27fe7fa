"""What is wrong with a store, as far as it was looked for."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from nimprep.errors import StoreError
from nimprep.store.connection import RequestError

MAX_PROBLEMS = 100
"""A report stops after as many problems; a damaged store would otherwise list every pixel."""

_LONGEST = 1000


@dataclass
class Report:
    """Gather what is wrong with a store.

    Attributes
    ----------
    path : str
    deep : bool
        Whether pixels were looked at.
    frames : int
        Frames the store says it has; 0 where that cannot be told.
    problems : list of str
        One line each, naming array and frame; empty = the store is valid.
    checks : dict of str to int
        What was checked, and how many of it.
    extras : list of str
        What lies in the store, or stands in its documents, that is somebody's own; not checked.
    """

    path: str
    deep: bool
    frames: int = 0
    problems: list[str] = field(default_factory=list)
    checks: dict[str, int] = field(default_factory=dict)
    extras: list[str] = field(default_factory=list)

    @property
    def valid(self) -> bool:
        """Whether nothing is wrong."""
        return not self.problems

    def add(self, problem: str) -> None:
        """Note a problem, in one line."""
        if not self.full:
            line = " ".join(problem.split())
            self.problems.append(line if len(line) <= _LONGEST else line[: _LONGEST - 3] + "...")

    @property
    def full(self) -> bool:
        """Whether no more problems are noted, so that none need be looked for."""
        return len(self.problems) >= MAX_PROBLEMS

    def count(self, what: str, number: int = 1) -> None:
        """Note that something was checked."""
        self.checks[what] = self.checks.get(what, 0) + number

    def to_dict(self) -> dict[str, Any]:
        """Return the report as JSON holds it (schemas/validation.schema.json)."""
        return {
            "path": self.path,
            "valid": self.valid,
            "deep": self.deep,
            "frames": self.frames,
            "checks": self.checks,
            "problems": self.problems,
            "extras": self.extras,
        }


def fault_of(error: StoreError) -> str:
    """Return what is wrong with a store; raise where only its place was out of reach."""
    if isinstance(error, RequestError) and not isinstance(error.__cause__, FileNotFoundError):
        raise error
    return str(error)
