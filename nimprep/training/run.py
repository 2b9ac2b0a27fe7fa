"""Train a network on a store."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Unpack

import torch

from nimprep.errors import ArrayError, LayoutError
from nimprep.networks import Network, build_network
from nimprep.networks.network import SMALLEST
from nimprep.store.lock import locked_folder
from nimprep.store.reader import Store, open_store
from nimprep.torch.ranks import ranks
from nimprep.training.config import options_for
from nimprep.training.data import Feed, frame_size, without_pixels
from nimprep.training.distributed import device_from, is_first, process_group, shared
from nimprep.training.folder import enter
from nimprep.training.log import Silence, Watcher, check_tensorboard
from nimprep.training.loop import Loop
from nimprep.training.options import TrainKeywords, TrainOptions
from nimprep.training.precision import Precision
from nimprep.training.recipes import RECIPES, completed
from nimprep.training.state import LAST, RunState
from nimprep.training.stopping import stopping


@dataclass(frozen=True)
class Trained:
    """Say what came of a training.

    Attributes
    ----------
    folder : Path
        The run's: `nimprep.networks.read_checkpoint` reads it.
    options : TrainOptions
        Those it used, completed by the recipe.
    steps : int
    best : dict
        Of the weights in best.pt: epoch, step, loss, learning rate; f_score, iou, precision and
        recall on val, 0 to 1, None where undefined or without val, and f_score and iou by class.
    """

    folder: Path
    options: TrainOptions
    steps: int
    best: dict[str, Any]


def train(
    store: Store | Path | str,
    out: Path | str,
    options: TrainOptions | None = None,
    *,
    config: Path | str | None = None,
    watcher: Watcher | None = None,
    **changes: Unpack[TrainKeywords],
) -> Trained:
    """Train a network on a store's train split; the best on its val split is kept.

    The same call again goes on where the run was cut short: on the same CPU and as many threads to
    the same weights, whenever it was killed. One that is complete stays as it is.

    Parameters
    ----------
    store : Store, path or URL
        Without a val split the last epoch's weights are kept as the best.
    out : path
        The run's folder, new, empty, or of this run: see `nimprep.training.folder`.
    options : TrainOptions, optional
        Or by name, one by one.
    config : path, optional
        A TOML file of options; those given by name win.
    watcher : Watcher, optional
        Is told how it goes on.
    **changes
        Options by name.

    Raises
    ------
    StoreError
        The store has no labels, no train split, or not what the setup needs.
    ArrayError
        Options are wrong, or do not go together.
    LayoutError
        The folder is not this run's, or cannot be written.
    TrainingError
        No memory is left, or the loss is no number.
    """
    given = options_for(options, config, changes)
    _check(given)
    device = device_from(given.device)
    opened = store if isinstance(store, Store) else open_store(store)
    watched = watcher if watcher is not None else Silence()
    with process_group(device), _own_chance(device):
        watched = watched if is_first() else Silence()
        options = completed(given, frame_size(opened))
        _check_crop(options)
        feed, precision = Feed(opened, options), Precision(options, device)
        # What a run has learned takes the place of what it began with.
        begun = (Path(out) / LAST).exists() and not options.overwrite
        network = _network(feed, replace(options, weights=None) if begun else options, device)
        feed.fit(network)
        with stopping() as stop:
            loop = Loop(Path(out), options, feed, network, precision, watched, stop)
            with _held(Path(out)):
                state = _entered(Path(out), options, opened)
                _say(watched, loop, state, network)
                if state.ended < options.epochs:
                    loop.run(state)
        return Trained(Path(out), options, state.step, dict(state.best))


def _check(options: TrainOptions) -> None:
    for name in ("network", "setup"):
        if getattr(options, name) is None:
            known = f"one of {', '.join(RECIPES)}" if name == "network" else "one, rgb+d say"
            raise ArrayError(f"{name}: expected {known}, found none; give --{name}")
    check_tensorboard(options.tensorboard)


def _check_crop(options: TrainOptions) -> None:
    if isinstance(options.crop, tuple):
        if min(options.crop) < SMALLEST:
            found = ",".join(map(str, options.crop))
            raise ArrayError(
                f"crop: expected {SMALLEST},{SMALLEST} or more, found {found}; networks take no "
                "smaller images"
            )
    elif options.scale is not None:
        raise ArrayError(
            "scale: expected it with a crop, to which frames are cut, found crop 'none'; give one"
        )


def _network(feed: Feed, options: TrainOptions, device: torch.device) -> Network:
    """Build the network: the seed decides its first weights."""
    assert options.network is not None
    torch.manual_seed(options.seed)
    network = build_network(
        options.network,
        feed.channels,
        feed.classes,
        options.width,
        options.weights,
        options.stages,
    )
    if ranks()[1] > 1 and device.type == "cuda":
        # Batches are small here: their statistics are taken over all processes.
        network = torch.nn.SyncBatchNorm.convert_sync_batchnorm(network)  # type: ignore[no-untyped-call]
    return network.to(device)


@contextmanager
def _own_chance(device: torch.device) -> Iterator[None]:
    """Leave the generator of whoever calls as it was."""
    devices = [device] if device.type == "cuda" else []
    with torch.random.fork_rng(devices):
        yield


def _held(out: Path) -> Any:
    """Return the context in which nobody else trains in a folder."""
    return locked_folder(out) if is_first() else nullcontext()


def _entered(out: Path, options: TrainOptions, store: Store) -> RunState:
    """Enter the folder in the first process, and tell the others where the run stands."""
    processes = ranks()[1]
    found: RunState | LayoutError | None = None
    if is_first():
        try:
            found = enter(out, options, store, processes)
        except LayoutError as error:
            # The others wait to hear of it.
            found = error
    found = shared(found)
    if isinstance(found, LayoutError):
        raise found
    assert found is not None
    return found


def _say(watcher: Watcher, loop: Loop, state: RunState, network: Network) -> None:
    """Say what is begun, and what a person might take for granted and is not."""
    options, path = loop.options, loop.feed.store.path
    if network.loaded is not None and not state.step:
        watcher.say(f"{options.weights}: {network.loaded}")
    if lacking := without_pixels(loop.data):
        watcher.say(f"{path}: no pixels of {lacking} in train; nothing of it is learned")
    if loop.val is None:
        watcher.say(f"{path}: no frames in val; best.pt has the last epoch's weights")
    elif lacking := without_pixels(loop.val):
        watcher.say(f"{path}: no pixels of {lacking} in val; no score says what is learned of it")
    if state.ended == options.epochs:
        watcher.say("the run is complete; --epochs and another --out make a longer one")
    elif state.step:
        watcher.say(f"going on at step {state.step + 1}, in epoch {state.ended + 1}")
