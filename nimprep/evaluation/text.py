"""Scores as plain text for a terminal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from nimprep.evaluation.comparison import (
    CORNER,
    DIGITS,
    HEADS,
    MEAN,
    UNDEFINED,
    Comparison,
    Table,
    Unit,
    shown,
)
from nimprep.evaluation.scores import MEASURES, Evaluation
from nimprep.text import printable

BEST = "*"
"""Follows the best score of a column, and is explained below the table."""


WHY_UNDEFINED = (
    f"{UNDEFINED} undefined: precision where nothing was predicted to be of the class, recall "
    "where nothing is; and the mean of which it would be a part"
)
"""Explains the dash below a table that has one."""


def evaluation_text(
    found: Evaluation,
    measures: Sequence[str] = tuple(MEASURES),
    worst: int = 10,
    unit: Unit = "percent",
) -> str:
    """Return a row per class and their mean, the confusion matrix, the groups and worst frames."""
    rows = [
        (c.name, [float(found.scores[m][i]) for m in measures]) for i, c in enumerate(found.classes)
    ]
    rows.append(("mean, no background", [found.mean[m] for m in measures]))
    heads = [HEADS[m] for m in measures]
    parts = [_what(found), _scores(CORNER[unit], heads, rows, unit), _confusion(found)]
    if found.by_group:
        groups = {g or "(no group)": part for g, part in found.by_group.items()}
        parts.append(
            _scores("mean by group", ["frames", *heads], _means(groups, measures, count=True), unit)
        )
    if worst and len(found.frames) > 1:
        frames = dict(list(found.by_frame.items())[:worst])
        parts.append(_scores("mean, worst frames first", heads, _means(frames, measures), unit))
    if any(UNDEFINED in part for part in parts):
        parts.append(WHY_UNDEFINED)
    return "\n\n".join(parts)


def _what(found: Evaluation) -> str:
    of = f"split {found.split}" if found.split else "the whole store"
    return f"{len(found.frames)} frames of {of}, {found.confusion.sum()} pixels counted"


def _means(
    parts: dict[str, Evaluation], measures: Sequence[str], count: bool = False
) -> list[tuple[str, list[float]]]:
    return [
        (name, [*([len(part.frames)] if count else []), *(part.mean[m] for m in measures)])
        for name, part in parts.items()
    ]


def _scores(
    title: str, heads: Sequence[str], rows: Sequence[tuple[str, list[float]]], unit: Unit
) -> str:
    """Return a line per row of numbers; whole ones are counts, NaN is a dash."""
    names = [printable(name) for name, _ in rows]
    wide = _widest([title, *names])
    lines = [f"{title:<{wide}}" + "".join(f"{head:>11}" for head in heads)]
    for name, (_, values) in zip(names, rows, strict=True):
        texts = (str(v) if isinstance(v, int) else shown(v, unit) for v in values)
        lines.append(f"{name:<{wide}}" + "".join(f"{text:>11}" for text in texts))
    return "\n".join(lines)


def _widest(texts: Iterable[str]) -> int:
    return max(map(len, texts))


def _confusion(found: Evaluation) -> str:
    corner = "label \\ prediction"
    names = [printable(c.name) for c in found.classes]
    wide = _widest([corner, *names])
    widths = [max(len(name), 12) for name in names]
    cells = zip(names, widths, strict=True)
    lines = [f"{corner:<{wide}}" + "".join(f"  {name:>{w}}" for name, w in cells)]
    for name, counts in zip(names, found.confusion.tolist(), strict=True):
        numbers = "".join(f"  {n:>{w}}" for n, w in zip(counts, widths, strict=True))
        lines.append(f"{name:<{wide}}{numbers}")
    return "\n".join(lines)


def comparison_text(
    found: Comparison, measures: Sequence[str] = tuple(MEASURES), unit: Unit = "percent"
) -> str:
    """Return the table of methods and measures; the best have a star and are bold by ANSI codes.

    A printer to anything but a terminal should strip the codes, as `click.echo` does.
    """
    table = found.table(measures, unit)
    legend = f"{BEST} best, by {DIGITS[unit]} decimals"
    if MEAN in table.blocks:
        legend += "; mean: over the classes that are not background"
    undefined = any(not cell.text for _, cells in table.rows for cell in cells)
    why = [WHY_UNDEFINED] if undefined else []
    return "\n".join([_what(found.first), "", *_table_lines(table), "", legend, *why])


def _table_lines(table: Table) -> list[str]:
    names = [printable(name) for name, _ in table.rows]
    wide = _widest(["method", *names])
    number = len(table.heads)
    # A block is as wide as its title needs: its columns share what is missing.
    widths = [max(10, -(-(_widest([printable(b)]) + 2) // number)) for b in table.blocks]
    each = [width for width in widths for _ in range(number)]
    titles = (f"{printable(b):^{w * number}}" for b, w in zip(table.blocks, widths, strict=True))
    heads = (f"{h:>{w - 1}} " for w, h in zip(each, table.heads * len(widths), strict=True))
    lines = [
        (f"{CORNER[table.unit]:<{wide}}" + "".join(titles)).rstrip(),
        (f"{'method':<{wide}}" + "".join(heads)).rstrip(),
    ]
    for name, (_, cells) in zip(names, table.rows, strict=True):
        texts = (
            _cell(cell.text or UNDEFINED, cell.best, width)
            for cell, width in zip(cells, each, strict=True)
        )
        lines.append((f"{name:<{wide}}" + "".join(texts)).rstrip())
    return lines


def _cell(text: str, best: bool, width: int) -> str:
    filled = f"{text:>{width - 1}}"
    if not best:
        return f"{filled} "
    # The blanks stay outside, so that the line's width is the same with and without the codes.
    return f"{filled[: width - 1 - len(text)]}\x1b[1m{text}{BEST}\x1b[0m"
