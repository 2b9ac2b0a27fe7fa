"""Options in a TOML file: read where they are given, written where a run used them."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from nimprep.errors import ArrayError, LayoutError, NimprepError
from nimprep.files import read_file
from nimprep.options import options_of
from nimprep.training.options import TrainOptions

CONFIG = "config.toml"
"""The file within a run's folder."""

_LIMIT = 1 << 20

_NOT_IN_FILES = ("overwrite",)
"""Never asked for by a file: it is meant once."""

KEPT = tuple(name for name in options_of(TrainOptions) if name not in _NOT_IN_FILES)
COUNTED = tuple(name for name in KEPT if options_of(TrainOptions)[name].counts)
"""Options that tell in the weights; those of one run do not change."""


def read_config(path: Path | str) -> dict[str, Any]:
    """Return the options that a TOML file gives.

    Each is a key, named as the option with "_" or "-": ``lr = 0.01``, ``crop = [384, 1248]``. A
    relative path of weights starts at the file's folder.

    Raises
    ------
    LayoutError
        It cannot be read, is no TOML, or has a key that is no option or a value that none can be.
    """
    path = Path(path)
    data = read_file(path, _LIMIT, "a readable TOML file", LayoutError, pipes=True)
    try:
        found = tomllib.loads(data.decode("utf-8-sig"))
    except ValueError as error:
        raise LayoutError(f"{path}: expected TOML, found {error}; see docs/training.md") from error
    values = {name.replace("-", "_"): _given(value) for name, value in found.items()}
    if unknown := sorted(values.keys() - {*KEPT}):
        raise LayoutError(
            f"{path}: expected some of {', '.join(KEPT)}, found {unknown[0]!r}; leave it out"
        )
    if isinstance(values.get("weights"), str):
        values["weights"] = str(path.parent / values["weights"])
    try:
        TrainOptions(**values)
    except ArrayError as error:
        raise LayoutError(f"{path}: {error}") from error
    return values


def _given(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def config_text(options: TrainOptions, heading: str) -> str:
    """Return a file that gives all of these options; `heading` is a comment above them."""
    said = options_of(TrainOptions)
    lines = [f"# {heading}", ""]
    for name, value in plain_options(options).items():
        note = said[name].help.partition("; default:")[0].rstrip(".")
        comment = f"  # {note}" if len(note) < 60 and not note.startswith("default:") else ""
        comment = comment if note else ""
        lines.append(f"# {name}: none" if value is None else f"{name} = {_toml(value)}{comment}")
    return "\n".join([*lines, ""])


def plain_options(options: TrainOptions) -> dict[str, Any]:
    """Return options as plain values, by their names."""
    values = {f.name: getattr(options, f.name) for f in fields(options) if f.name in KEPT}
    return {
        name: str(Path(value).absolute()) if name == "weights" and value is not None else value
        for name, value in values.items()
    }


def _toml(value: Any) -> str:
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, str):
        # A string of JSON is one of TOML, which has no code for it but the long one.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return json.dumps(value)


def differences(before: Mapping[str, Any], options: TrainOptions) -> list[str]:
    """Return what is another now than in a run, a phrase for each option that tells."""
    now = plain_options(options)
    lines = []
    for name in COUNTED:
        # What an older run did not know of is as it was then.
        old = _plain(before[name]) if name in before else options_of(TrainOptions)[name].default
        if old != _plain(now[name]):
            lines.append(f"{name} {_shown(old)}, not {_shown(now[name])}")
    return lines


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, (tuple, list)) else value


def _shown(value: Any) -> str:
    if isinstance(value, (tuple, list)):
        return ",".join(map(_shown, value))
    return f"{value:g}" if isinstance(value, float) else str(value).lower()


def options_for(
    options: TrainOptions | None,
    config: Path | str | None,
    changes: Mapping[str, Any],
    error: type[NimprepError] = ArrayError,
) -> TrainOptions:
    """Return the options of a call: those of a file, and over them what else is given.

    Raises
    ------
    NimprepError
        Both options and others are given, or one is none that can be.
    """
    if options is not None:
        if changes or config is not None:
            raise error(
                "options: expected them or others by name, found both; dataclasses.replace makes "
                "others of them"
            )
        return options
    given = {} if config is None else read_config(config)
    return TrainOptions(**{**given, **changes})
