"""Pairs by time: against every pair looked at, as TUM's own tool does."""

from __future__ import annotations

from fractions import Fraction

from hypothesis import given
from hypothesis import strategies as st

from nimprep.readers.nearest import exact, nearest_pairs, time_from

TIMES = st.lists(st.integers(0, 40), max_size=8, unique=True)


@given(first=TIMES, second=TIMES, tolerance=st.integers(0, 10))
def test_the_closest_pairs_are_taken_first(
    first: list[int], second: list[int], tolerance: int
) -> None:
    # Halves, thirds and so on make every gap another: then there is one answer.
    a = [Fraction(t) + Fraction(1, 1000 + 7 * t) for t in first]
    b = [Fraction(t) - Fraction(1, 2000 + 13 * t) for t in second]
    left, right, expected = set(range(len(a))), set(range(len(b))), {}
    for gap, i, j in sorted((abs(x - y), i, j) for i, x in enumerate(a) for j, y in enumerate(b)):
        if gap <= tolerance and i in left and j in right:
            left.remove(i)
            right.remove(j)
            expected[i] = j
    assert nearest_pairs(a, b, Fraction(tolerance)) == expected


def test_no_digit_of_a_time_stamp_is_lost() -> None:
    times = [time_from(f"162373281957935716{digit}") for digit in range(10)]
    assert None not in times
    nanoseconds = [time for time in times if time is not None]
    assert nearest_pairs(nanoseconds, nanoseconds[::-1], Fraction(0)) == {
        i: 9 - i for i in range(10)
    }
    assert exact(0.02) / exact(1e-9) == 20_000_000
    assert time_from("1305031102.160407") == Fraction(1305031102160407, 10**6)
    assert [time_from(text) for text in ("1e5", "", "a", "1_0", "1.")] == [None] * 5
