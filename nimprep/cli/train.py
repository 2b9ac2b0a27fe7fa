"""nimprep train."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import click

from nimprep.cli.echo import echo
from nimprep.cli.options import options_alone, said_by, usage_error
from nimprep.cli.training_watcher import watcher_for
from nimprep.errors import ArrayError
from nimprep.options import options_of
from nimprep.text import printable
from nimprep.training.config import read_config
from nimprep.training.options import TrainOptions


@click.command()
@click.argument("store", type=click.Path())
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    required=True,
    help="The run's folder: new, or the run's that goes on.",
)
@click.option(
    "--config",
    type=click.Path(path_type=Path),
    help="TOML file of options, as OUT/config.toml of another run; those given here win.",
)
@options_alone(TrainOptions)
@click.pass_context
def train(
    ctx: click.Context, /, store: str, out: Path, config: Path | None, quiet: bool, **given: Any
) -> None:
    """Train a network on STORE's train split; OUT keeps the best on its val split.

    Options that are not given are those of the network's authors. The same command again goes on
    where the run was cut short. OUT gets best.pt, the weights and all that is needed to use them;
    config.toml, the options as used; log.jsonl; and last.pt, from which the run goes on.
    """
    said = said_by(ctx, given)
    before = {} if config is None else read_config(config)
    try:
        options = TrainOptions(**{**before, **said})
        for name in ("network", "setup"):
            if getattr(options, name) is None:
                raise ArrayError(f"{name}: expected one, found none; give it, or --config with one")
    except ArrayError as error:
        raise usage_error(error, TrainOptions) from error
    import nimprep.training

    try:
        done = nimprep.training.train(store, out, options, watcher=watcher_for(quiet))
    except ArrayError as error:
        if str(error).partition(": ")[0] in options_of(TrainOptions):
            # What only the store and the machine show to be wrong is a wrong call as well.
            raise usage_error(error, TrainOptions) from error
        raise
    if os.environ.get("RANK", "0") != "0":
        # Of several processes the first speaks.
        return
    best = done.best
    scores = ", ".join(
        f"{said} {100 * best[name]:.2f}"
        for name, said in (("f_score", "F-score"), ("iou", "IoU"))
        if best.get(name) is not None
    )
    echo(f"{printable(str(out))}: {done.steps} steps, {done.options.epochs} epochs")
    echo(
        f"best.pt: epoch {best['epoch']}, loss {best['loss']:.4f}"
        + (f", on val {scores} % (mean without background)" if scores else "")
    )
