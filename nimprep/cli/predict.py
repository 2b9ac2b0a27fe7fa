"""nimprep predict."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from nimprep.cli.echo import echo
from nimprep.cli.options import options_alone, progress_bars, usage_error
from nimprep.errors import ArrayError
from nimprep.text import printable
from nimprep.training.predict_options import PredictOptions


@click.command()
@click.argument("store", type=click.Path())
@click.argument("run", type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="PREDICTIONS",
    help="A new or empty folder; default: RUN-SPLIT, beside RUN.",
)
@options_alone(PredictOptions)
def predict(store: str, run: Path, out: Path | None, quiet: bool, **given: Any) -> None:
    """Predict frames of STORE by RUN, a folder that nimprep train made, or its best.pt.

    PREDICTIONS gets FRAME_ID.png of each frame: class ids of STORE, 8-bit grey, of the frame's own
    size; with --save-scores scores/FRAME_ID.npy too, (C, H, W) float32. nimprep evaluate and
    nimprep kitti take both folders, PREDICTIONS and PREDICTIONS/scores. All of it is there at the
    end, or nothing.

    The run's classes are found in STORE by their names. What the setup has of derived modalities
    is taken from STORE where it was made there as in training, and else derived from its depth.
    """
    try:
        options = PredictOptions(**given)
    except ArrayError as error:
        raise usage_error(error, PredictOptions) from error
    import nimprep.training

    done = nimprep.training.predict(store, run, out, options, progress=progress_bars(quiet))
    echo(f"{printable(str(done.folder))}: {len(done.ids)} frames")
    if done.scores is not None:
        echo(f"{printable(str(done.scores))}: {len(done.ids)} frames' scores")
