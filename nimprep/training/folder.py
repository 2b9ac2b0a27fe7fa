"""A run's folder: whose it is, and what may be done with it.

RUN/config.toml    the options it was begun with, complete: `--config` takes them
RUN/best.pt        the best weights so far and what they are (`nimprep.networks.Checkpoint`)
RUN/last.pt        where it stands, for the same command to go on (`RunState`)
RUN/log.jsonl      a line of JSON for each so many steps, and for each epoch
RUN/tensorboard/   the same for TensorBoard, where that is asked for
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from nimprep.errors import LayoutError
from nimprep.files import replace_file
from nimprep.folders import PARTIAL, refuse_inside, told
from nimprep.networks.checkpoint import BEST
from nimprep.store.reader import Store
from nimprep.text import printable
from nimprep.training.config import CONFIG, config_text, differences, plain_options, read_config
from nimprep.training.log import LOG, TENSORBOARD
from nimprep.training.options import TrainOptions
from nimprep.training.state import LAST, RunState, read_state, store_digest

OWN = (CONFIG, BEST, LAST, LOG, TENSORBOARD)
"""The names that a run gives."""


def enter(out: Path, options: TrainOptions, store: Store, processes: int) -> RunState:
    """Return where a run stands: at its beginning in a new folder, or where it was left.

    Called by whoever holds the folder's lock.

    Parameters
    ----------
    options : TrainOptions
        Completed by a recipe.

    Raises
    ------
    LayoutError
        The folder lies in a store, or holds what is no run, or a run of other options, another
        store or another number of processes.
    """
    local = [store.storage.root] if store.storage.root is not None else []
    with told(out, LayoutError):
        refuse_inside(out / LAST, *local)
        names = {path.name for path in out.iterdir()} if out.exists() else set()
    # What a kill left that is not whole is no run.
    names = {name for name in names if not name.endswith(PARTIAL)}
    digest = store_digest(store)
    if options.overwrite:
        if others := names - {*OWN}:
            raise _foreign(out, min(others))
        _clear(out)
        names = set()
    state = None
    if names:
        if CONFIG not in names:
            raise _foreign(out, min(names))
        state = read_state(out)
        before = read_config(out / CONFIG) if state is None else state.options
        _check_same(out, before, options)
    if state is not None:
        _check_state(out, state, digest, processes)
        return state
    heading = f"nimprep train {store.path} --config {CONFIG} --out ANOTHER"
    replace_file(out / CONFIG, config_text(options, printable(heading)).encode())
    return RunState(plain_options(options), digest, processes)


def _foreign(out: Path, name: str) -> LayoutError:
    """Return what is said of a folder with something in it that no run gave it."""
    return LayoutError(
        f"{out}: expected a new or empty folder, or a run of nimprep train, found {name!r} in it; "
        "choose another --out"
    )


def _check_same(out: Path, before: dict[str, Any], options: TrainOptions) -> None:
    if changed := differences(before, options):
        raise LayoutError(
            f"{out}: expected the options that its run was begun with, found others: "
            f"{'; '.join(changed)}; give the same to go on with it, another --out, or --overwrite"
        )


def _check_state(out: Path, state: RunState, digest: str, processes: int) -> None:
    if state.store != digest:
        raise LayoutError(
            f"{out}: expected the store that its run was begun with, found one of other frames, "
            "splits or pixels; give that one, another --out, or --overwrite"
        )
    if state.best and not (out / BEST).exists():
        raise LayoutError(
            f"{out / BEST}: expected the best weights so far of the run that goes on, found none; "
            "put them back, or give another --out or --overwrite"
        )
    if state.processes != processes:
        raise LayoutError(
            f"{out}: expected {state.processes} processes, with which its run was begun, found "
            f"{processes}; start as many, or give another --out or --overwrite"
        )


def _clear(out: Path) -> None:
    """Take away a run; what else is in its folder stays. What it can be gone on from goes first."""
    with told(out, LayoutError):
        for name in (LAST, BEST, LOG, CONFIG):
            (out / name).unlink(missing_ok=True)
        if (out / TENSORBOARD).is_symlink():
            (out / TENSORBOARD).unlink()
        elif (out / TENSORBOARD).exists():
            shutil.rmtree(out / TENSORBOARD)
