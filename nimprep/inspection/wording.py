"""An inspection for people, on one screen."""

from __future__ import annotations

from typing import Any

from nimprep.inspection.encodings import UNLIKELY
from nimprep.inspection.kinds import Kind
from nimprep.text import printable

_MOST_ROWS = 12
_MOST_LINES = 5


def inspection_text(found: dict[str, Any]) -> str:
    """Return what `Inspection.to_dict` holds as lines."""
    lines = [f"{found['source']}: {found['what']}"]
    if found["files"]:
        cut = ", the first of more" if found["sampled"] else ""
        many = "s" if found["files"] > 1 else ""
        lines.append(f"{found['files']} file{many}{cut}")
    lines += _rows(found["patterns"])
    for number, depth in enumerate(found["depth"][:3]):
        lines += _depth(depth, whole=number == 0)
    if not found["depth"] and any(p["kind"] == Kind.DEPTH_PICTURE for p in found["patterns"]):
        lines.append("depth: only pictures of it, whose values are no metres; use the raw depth")
    lines += _cameras(found["cameras"])
    if found["splits"]:
        counts = ", ".join(f"{name} {count}" for name, count in found["splits"].items())
        lines.append(f"splits by folder: {counts}")
    lines += _holdings(found["holdings"])
    for name in ("notes", "problems"):
        lines += [f"{name.removesuffix('s')}: {line}" for line in found[name][:_MOST_LINES]]
        if len(found[name]) > _MOST_LINES:
            lines.append(f"{name}: {len(found[name]) - _MOST_LINES} more")
    lines += [f"next: {step}" for step in found["next"]]
    return "\n".join(printable(line) for line in lines)


def _rows(patterns: list[dict[str, Any]]) -> list[str]:
    lines = []
    for row in patterns[:_MOST_ROWS]:
        what = [row["kind"]]
        if "size" in row:
            width, height = row["size"]
            many = f" x{row['channels']}" if row["channels"] > 1 else ""
            what.append(f"{width}x{height} {row['dtype']}{many}")
        if row.get("range"):
            what.append("{:g} to {:g}".format(*row["range"]))
        what += row["evidence"]
        key = f" [{row['key']}]" if "key" in row else ""
        lines.append(f"  {row['count']:>7} {_size(row['bytes']):>8}  {row['files']}{key}")
        lines.append(f"{'':>19} {', '.join(what)}")
    if len(patterns) > _MOST_ROWS:
        lines.append(f"  and {len(patterns) - _MOST_ROWS} patterns more; --json lists them")
    return lines


def _size(count: int) -> str:
    size = float(count)
    for unit in ("B", "kB", "MB", "GB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.4g} TB"


def _depth(depth: dict[str, Any], *, whole: bool) -> list[str]:
    encodings = depth["encodings"]
    if not encodings:
        return [f"depth in {depth['files']}: no value that could be depth"]
    best = encodings[0]
    values = best["depth"].get("values", "depth")
    close = len(encodings) > 1 and encodings[1]["score"] > best["score"] - 2
    sure = "perhaps" if close or best["score"] < UNLIKELY else "likely"
    said = {k: v for k, v in best["depth"].items() if k not in ("files", "values")}
    rest = ", ".join(f"{name} {value}" for name, value in said.items())
    lines = [f"{values} in {depth['files']}: {sure} {best['name']} ({rest})"]
    if whole:
        lines += [f"    {reason}" for reason in best["reasons"]]
        lines += [
            f"    else {other['name']}: {other['reasons'][0]}"
            for other in encodings[1:]
            if other["score"] > best["score"] - 2
        ]
    return lines


def _cameras(cameras: list[dict[str, Any]]) -> list[str]:
    lines = []
    for camera in cameras[:_MOST_LINES]:
        numbers = ", ".join(f"{name} {value:g}" for name, value in camera["numbers"].items())
        key = f" ({camera['key']})" if camera["key"] else ""
        scale = camera["depth_scale"]
        stated = "" if scale is None else f"; depth scale {scale:g}"
        lines.append(f"camera in {camera['files']}{key}: {numbers}{stated}")
    return lines


def _holdings(holdings: list[dict[str, Any]]) -> list[str]:
    lines = []
    for holding in holdings[:_MOST_LINES]:
        names = ", ".join(holding["names"][:8])
        more = len(holding["names"]) > 8
        inner = f": {names}{', ...' if more else ''}" if names else ""
        lines.append(f"{holding['path']} is {holding['what']}{inner}")
    if len(holdings) > _MOST_LINES:
        lines.append(f"and {len(holdings) - _MOST_LINES} more such")
    return lines
