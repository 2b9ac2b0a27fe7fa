"""Pairs of what is nearest in time, each once, every digit of a time stamp counted."""

from __future__ import annotations

import heapq
import re
from collections.abc import Iterable, Sequence
from decimal import Decimal
from fractions import Fraction

_TIME = re.compile(r"-?[0-9]{1,30}(\.[0-9]{1,30})?")


def time_from(text: str) -> Fraction | None:
    """Return a time stamp, exactly; None = it is none."""
    return Fraction(text) if _TIME.fullmatch(text) else None


def exact(number: float) -> Fraction:
    """Return a number as it is written: 0.02 is 1/50."""
    return Fraction(Decimal(str(number)))


def nearest_pairs(
    first: Sequence[Fraction], second: Sequence[Fraction], tolerance: Fraction
) -> dict[int, int]:
    """Pair times with those nearest to them: the closest two of all first, each in one pair.

    That is what TUM's associate.py does, which looks at every pair; here it takes n log n steps:
    the closest two, one of each kind, always follow one another in time.

    Returns
    -------
    dict of index in `first` to index in `second`
        Of pairs no further apart than the tolerance.
    """
    merged = sorted(
        [(t, 0, i) for i, t in enumerate(first)] + [(t, 1, i) for i, t in enumerate(second)]
    )
    after = list(range(1, len(merged) + 1))
    before = list(range(-1, len(merged) - 1))
    taken = [False] * len(merged)
    apart: list[tuple[Fraction, int, int]] = []

    def consider(a: int, b: int) -> None:
        if a >= 0 and b < len(merged) and merged[a][1] != merged[b][1]:
            gap = merged[b][0] - merged[a][0]
            if gap <= tolerance:
                heapq.heappush(apart, (gap, a, b))

    for place in range(len(merged) - 1):
        consider(place, place + 1)
    pairs: dict[int, int] = {}
    while apart:
        _, a, b = heapq.heappop(apart)
        if taken[a] or taken[b]:
            continue
        taken[a] = taken[b] = True
        one, other = sorted((merged[a][1:], merged[b][1:]))
        pairs[one[1]] = other[1]
        left, right = before[a], after[b]
        if left >= 0:
            after[left] = right
        if right < len(merged):
            before[right] = left
        consider(left, right)
    return pairs


def rows_of(lines: Iterable[str]) -> list[list[str]]:
    """Return the columns of lines that are neither empty nor a comment."""
    plain = (line.strip() for line in lines)
    return [re.split(r"[\s,;]+", line) for line in plain if line and not line.startswith("#")]
