"""All that a run is at a step, in one file, from which it goes on as if nothing had happened."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from nimprep.errors import ArrayError, LayoutError
from nimprep.networks.checkpoint import save_whole
from nimprep.networks.weights import read_weights
from nimprep.store.reader import Store

LAST = "last.pt"
"""The file within a run's folder."""

_MARK = "nimprep_run"
_FORMAT = "1.0"


@dataclass
class RunState:
    """Hold where a run stands.

    What chance gives is no part of it: the order of an epoch, its augmentation and what dropout
    drops depend on the seed, the epoch and the step alone.

    Attributes
    ----------
    options : dict
        As `plain_options` gives them.
    store : str
        The digest of what it is trained on.
    processes : int
        That train together.
    step : int
        Steps that are done.
    ended : int
        Epochs whose end, with the scores and all, is done.
    loss : float
        The sum over the epoch's steps so far.
    log : int
        Bytes of the log.
    best : dict
        The figures of the best checkpoint; empty where there is none yet.
    network, optimizer, schedule, precision : dict
        Their `state_dict`.
    """

    options: dict[str, Any]
    store: str
    processes: int
    step: int = 0
    ended: int = 0
    loss: float = 0.0
    log: int = 0
    best: dict[str, Any] = field(default_factory=dict)
    network: dict[str, Any] = field(default_factory=dict)
    optimizer: dict[str, Any] = field(default_factory=dict)
    schedule: dict[str, Any] = field(default_factory=dict)
    precision: dict[str, Any] = field(default_factory=dict)


def save_state(state: RunState, folder: Path) -> None:
    """Write a run's state, whole or not at all, over the one before.

    Raises
    ------
    LayoutError
        It cannot be written.
    """
    save_whole({_MARK: _FORMAT, **vars(state)}, folder / LAST, LayoutError)


def read_state(folder: Path) -> RunState | None:
    """Return a run's state; None = it has none yet.

    Raises
    ------
    LayoutError
        The file is damaged, or of another version.
    """
    path = folder / LAST
    if not path.exists():
        return None
    try:
        found = read_weights(path)
    except ArrayError as error:
        raise LayoutError(f"{error}; --overwrite begins anew") from error
    form = str(found.get(_MARK, "none"))
    known = {name: found[name] for name in RunState.__dataclass_fields__ if name in found}
    if form.partition(".")[0] != "1" or known.keys() != RunState.__dataclass_fields__.keys():
        raise LayoutError(
            f"{path}: expected a run's state of format {_FORMAT}, found {form}; go on with the "
            "nimprep that began it, or --overwrite"
        )
    return RunState(**known)


def store_digest(store: Store) -> str:
    """Return what tells a store from one that would train otherwise.

    That it lies elsewhere is no matter; frames, splits, classes and pixels are.
    """
    tables = store.tables
    said = hashlib.sha256()
    said.update(json.dumps([*store.ids], ensure_ascii=True).encode())
    said.update(tables.split.tobytes())
    said.update(json.dumps([[c.id, c.name] for c in store.classes]).encode())
    if tables.chunk_crc32c is not None:
        said.update(tables.chunk_crc32c.tobytes())
    return f"sha256:{said.hexdigest()}"
