"""The steps and epochs of a training."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn
from torch.nn.parallel import DistributedDataParallel

from nimprep.errors import LayoutError
from nimprep.networks import Network
from nimprep.networks.checkpoint import BEST, Checkpoint, save_checkpoint
from nimprep.torch import StoreDataset, StoreLoader
from nimprep.torch.ranks import ranks
from nimprep.training.criterion import Criterion
from nimprep.training.data import DEPTH, Feed, frame_size
from nimprep.training.distributed import is_first, summed
from nimprep.training.faults import check_loss, check_weights, memory
from nimprep.training.log import Log, Watcher
from nimprep.training.optimization import optimizer_for, set_rate
from nimprep.training.options import TrainOptions
from nimprep.training.precision import Precision
from nimprep.training.schedule import Schedule
from nimprep.training.scoring import figures, score_split
from nimprep.training.state import RunState, save_state
from nimprep.training.stopping import Asked, Stop


class Loop:
    """Train a network from where a run stands to its end.

    Parameters
    ----------
    out : Path
        The run's folder.
    options : TrainOptions
        Completed by a recipe.
    feed : Feed
    network : Network
        On the device.
    precision : Precision
    watcher : Watcher
    stop : Stop
    """

    def __init__(
        self,
        out: Path,
        options: TrainOptions,
        feed: Feed,
        network: Network,
        precision: Precision,
        watcher: Watcher,
        stop: Stop,
    ) -> None:
        self.out, self.options, self.feed = out, options, feed
        self.network, self.precision, self.watcher, self.stop = network, precision, watcher, stop
        self.data = feed.open("train", augmented=True)
        self.val = feed.open("val") if feed.has("val") else None
        self.loader = _loader(self.data, options)
        self.steps = len(self.loader)
        self.schedule = Schedule(options, self.steps)
        self.optimizer = optimizer_for(network, options)
        self.criterion = Criterion(network, self.data, options, precision.device)
        self.rate = options.lr or 0.0
        self.log: Log | None = None

    @property
    def total(self) -> int:
        """Steps of the whole training."""
        return self.steps * self.options.epochs

    def run(self, state: RunState) -> None:
        """Train to the end, or to where somebody asks to stop; what is done is kept.

        `state` says where the run stands, and is kept up to date.
        """
        self.state = state
        self._restore()
        self.model = _distributed(self.network, self.precision.device)
        self._began = self._kept = time.monotonic()
        self._first = state.step
        self.log = self._opened_log()
        self.watcher.begin(state.step, self.total)
        try:
            while self.state.ended < self.options.epochs:
                self._epoch()
        except Asked as error:
            self._keep()
            error.add_note(f"{self.out} holds step {self.state.step}; the same command goes on")
            raise
        except KeyboardInterrupt as error:
            error.add_note(f"the same command goes on at the last checkpoint of {self.out}")
            raise
        finally:
            self.watcher.end()
            if self.log is not None:
                self.log.close()

    def _epoch(self) -> None:
        """Go through the rest of an epoch, and end it."""
        epoch, batch = self.state.ended, self.state.step - self.state.ended * self.steps
        if batch < self.steps:
            self.loader.load_state_dict({"epoch": epoch, "batch": batch, "seed": self.options.seed})
            for found in self.loader:
                with memory(self.options, self.precision.device, training=True):
                    self._step(found)
                if self.state.step < (epoch + 1) * self.steps:
                    self._keep_now_and_then()
                self.stop.check()
        self._end_epoch()

    def _step(self, batch: dict[str, Any]) -> None:
        state, options = self.state, self.options
        # Dropout draws the same, whatever came before in this process.
        torch.manual_seed(_mixed(options.seed, state.step, ranks()[0]))
        self.rate = set_rate(self.optimizer, self.schedule.factor(state.step))
        self.model.train()
        fed = self.feed.fed(batch, self.data, self.network, self.precision.device)
        with self.precision.autocast():
            outputs = self.model(*fed.images)
        loss = self.criterion.loss(outputs, fed.label)
        number = float(summed(loss.detach().clone())) / ranks()[1]
        check_loss(number, state.step + 1, self.rate, options)
        self.precision.step(loss, self.optimizer, self.network, options.clip)
        state.step += 1
        state.loss += number
        self.watcher.step(state.step, number)
        if state.step % options.log_steps == 0:
            self._write({"step": state.step, "loss": number, "lr": self.rate})

    def _end_epoch(self) -> None:
        """Score, keep the best, and a checkpoint."""
        state, began = self.state, time.monotonic()
        check_weights(self.network, state.step, self.rate, self.options)
        loss = state.loss / self.steps
        found = self._scores()
        score = found.get(self.options.metric)
        worth = math.nan if score is None else score
        if self.val is None:
            worth = -loss
        self.schedule.end_epoch(worth)
        line: dict[str, Any] = {
            "epoch": state.ended + 1,
            "step": state.step,
            "loss": loss,
            "lr": self.rate,
        }
        best = self.val is None or _better(score, state.best, self.options.metric)
        if best:
            state.best = {**line, "metric": self.options.metric, **found}
            self._save_best()
        seconds = {"seconds": round(time.monotonic() - self._began, 1)}
        seconds["of_val"] = round(time.monotonic() - began, 1)
        line |= {"val": found or None, "best": best, "time": seconds}
        self._write(line)
        state.ended, state.loss = state.ended + 1, 0.0
        self._keep()
        self.watcher.epoch(line, self._seconds_left())

    def _scores(self) -> dict[str, Any]:
        if self.val is None:
            return {}
        with memory(self.options, self.precision.device, training=False):
            found = score_split(
                self.network, self.feed, self.val, self.options, self.precision, self.stop.check
            )
        return figures(found)

    def _seconds_left(self) -> float:
        done = self.state.step - self._first
        return (time.monotonic() - self._began) / max(done, 1) * (self.total - self.state.step)

    def _keep_now_and_then(self) -> None:
        options, steps = self.options, self.options.checkpoint_steps
        # Of several processes only the first looks at its clock: nobody waits for it.
        late = time.monotonic() - self._kept >= 60 * options.checkpoint_minutes
        if (steps and self.state.step % steps == 0) or late:
            self._keep()

    def _keep(self) -> None:
        """Write a checkpoint of this step."""
        if not is_first():
            return
        check_weights(self.network, self.state.step, self.rate, self.options)
        assert self.log is not None
        self.state.log = self.log.length
        self.state.network = self.network.state_dict()
        self.state.optimizer = self.optimizer.state_dict()
        self.state.schedule = self.schedule.state_dict()
        self.state.precision = self.precision.state_dict()
        save_state(self.state, self.out)
        self._kept = time.monotonic()

    def _restore(self) -> None:
        """Bring the network and all that trains it to where the run stands."""
        if not self.state.network:
            return
        self.network.load_state_dict(self.state.network)
        self.optimizer.load_state_dict(self.state.optimizer)
        self.schedule.load_state_dict(self.state.schedule)
        self.precision.load_state_dict(self.state.precision)

    def _save_best(self) -> None:
        if is_first():
            weights = {name: tensor.cpu() for name, tensor in self.network.state_dict().items()}
            wants_depth = self.network.wants_depth
            found = described(self.feed, self.options, self.data, wants_depth=wants_depth)
            checkpoint = replace(found, state=weights)
            figures = dict(self.state.best)
            save_checkpoint(replace(checkpoint, figures=figures), self.out / BEST, LayoutError)

    def _opened_log(self) -> Log | None:
        if not is_first():
            return None
        return Log(self.out, self.state.log, self.options.tensorboard, self.state.step)

    def _write(self, line: Mapping[str, Any]) -> None:
        if self.log is not None:
            self.log.write(line)


def described(
    feed: Feed, options: TrainOptions, data: StoreDataset, *, wants_depth: bool
) -> Checkpoint:
    """Return the checkpoint of a run, without weights and figures.

    `wants_depth` says whether the network takes depth beside its images.
    """
    assert options.network is not None
    assert options.setup is not None
    named = {*feed.selection.modalities} | ({DEPTH} if wants_depth else set())
    return Checkpoint(
        network=options.network,
        width=options.width,
        stages=options.stages,
        setup=options.setup,
        groups=feed.selection.groups,
        channels=feed.selection.channels,
        classes=feed.store.classes,
        scale={n: row for n, row in data.scaling.scale.items() if n in named},
        offset={n: row for n, row in data.scaling.offset.items() if n in named},
        cut={n: ends for n, ends in data.scaling.cut.items() if n in named},
        recipe=feed.recipe,
        size=frame_size(feed.store),
        normal_dtype=feed.normal_dtype,
    )


def _better(score: float | None, best: Mapping[str, Any], metric: str) -> bool:
    """Tell whether weights of such a score are kept: of none that has one, the last."""
    before = best.get(metric)
    if score is None or before is None:
        return before is None
    return score > float(before)


def _loader(data: StoreDataset, options: TrainOptions) -> StoreLoader:
    assert options.batch is not None
    part = -(-len(data) // ranks()[1])
    return StoreLoader(
        data,
        options.batch,
        shuffle=True,
        num_threads=options.threads,
        drop_last=part > options.batch,
        seed=options.seed,
    )


def _distributed(network: Network, device: torch.device) -> nn.Module:
    """Return what averages gradients over all processes, where there are several."""
    if ranks()[1] == 1:
        return network
    return DistributedDataParallel(network, [device] if device.type == "cuda" else None)


def _mixed(*numbers: int) -> int:
    """Mix numbers into a seed: neighbouring steps draw unlike numbers."""
    return int(np.random.SeedSequence(numbers).generate_state(1, np.uint64)[0])
