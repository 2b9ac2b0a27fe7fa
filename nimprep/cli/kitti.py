"""`nimprep kitti`: from the benchmark's folders to the uploaded zip."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args

import click

from nimprep.cli.echo import echo
from nimprep.cli.options import json_option, progress_bars, quiet_option
from nimprep.kitti.names import TARGETS, DepthFrom, Target

if TYPE_CHECKING:
    from nimprep.kitti.evaluation import Evaluation, View

Command = TypeVar("Command", bound=Callable[..., Any])

_FOLDER = click.Path(path_type=Path)

_calib = click.option(
    "--calib",
    type=_FOLDER,
    metavar="DIR",
    help="The dataset's calib folder; needed for images that are still in perspective.",
)


_overwrite = click.option(
    "--overwrite", is_flag=True, help="Replace files in OUT that are there already."
)


_type = click.option(
    "--type",
    "target",
    type=click.Choice(TARGETS),
    default="road",
    show_default=True,
    help="What predictions named by frame id (um_000000) are of.",
)


def _fraction(ctx: click.Context, param: click.Parameter, value: str) -> float:
    text = value.strip()
    try:
        fraction = float(text[:-1]) / 100 if text.endswith("%") else float(text)
    except ValueError:
        fraction = -1.0
    if not 0 <= fraction <= 1:
        raise click.BadParameter(f"expected 0 to 1 or 0% to 100%, found {value!r}")
    return fraction


def _view_option(default: str) -> Callable[[Command], Command]:
    return click.option(
        "--view",
        type=click.Choice(["bev", "perspective"]),
        default=default,
        show_default=True,
        help="Bird's-eye view or the camera's.",
    )


@click.group()
def kitti() -> None:
    """KITTI road: depth, bird's-eye view, scores, submission, pictures."""


@kitti.command()
@click.argument("src", type=_FOLDER)
@click.argument("out", type=_FOLDER)
@click.option(
    "--from",
    "wanted",
    type=click.Choice(get_args(DepthFrom)),
    default="auto",
    show_default=True,
    help="auto: depth_u16 where it is there, else LiDAR, else stereo.",
)
@click.option("--sparse", is_flag=True, help="Leave LiDAR and stereo as measured, not filled.")
@_overwrite
@quiet_option
def depth(
    src: Path, out: Path, wanted: DepthFrom, sparse: bool, overwrite: bool, quiet: bool
) -> None:
    """Write dense depth of the road folder SRC to OUT, 16-bit millimetres.

    OUT/depth.json records which source each frame's depth came from.
    """
    from collections import Counter

    from nimprep.kitti.depth import RECORD, write_depth

    chosen = write_depth(src, out, wanted, sparse, progress_bars(quiet), overwrite=overwrite)
    counts = ", ".join(
        f"{n} from {source}" for source, n in sorted(Counter(chosen.values()).items())
    )
    echo(f"{len(chosen)} frames: {counts}; recorded in {out / RECORD}")


@kitti.command()
@click.argument("predictions", type=_FOLDER)
@click.argument("out", type=_FOLDER)
@_calib
@_type
@_overwrite
@quiet_option
def bev(
    predictions: Path, out: Path, calib: Path | None, target: Target, overwrite: bool, quiet: bool
) -> None:
    """Transform PREDICTIONS (or ground truths) to the bird's-eye view, into OUT."""
    from nimprep.kitti.transform import transform_folder

    progress = progress_bars(quiet)
    written = transform_folder(
        predictions, out, calib, progress, target=target, overwrite=overwrite
    )
    echo(f"{len(written)} images written to {out}")


@kitti.command()
@click.argument("predictions", type=_FOLDER)
@click.argument("gt", type=_FOLDER)
@_calib
@_view_option("bev")
@_type
@click.option(
    "--partial", is_flag=True, help="Score the frames that have a prediction, not all of GT."
)
@json_option
@quiet_option
def evaluate(
    predictions: Path,
    gt: Path,
    calib: Path | None,
    view: View,
    target: Target,
    partial: bool,
    as_json: bool,
    quiet: bool,
) -> None:
    """Score PREDICTIONS against the ground truths GT as the benchmark does.

    The table is in percent, the confidence's threshold for the highest F-score among it.

    PREDICTIONS holds confidence maps named by frame id (um_000000 or training/um_000000) or as the
    benchmark does (um_road_000000): .png of 8 or 16 bits, or .npy of probabilities, (H, W), 0 to
    1. Where all are 0 and 1, they are masks.
    """
    from nimprep.kitti.evaluation import evaluate_predictions

    evaluation = evaluate_predictions(
        predictions, gt, calib, view, progress_bars(quiet), target=target, partial=partial
    )
    text = json.dumps(evaluation.to_dict(), indent=2) if as_json else _score_table(evaluation)
    echo(text, lines=True)


def _score_table(evaluation: Evaluation) -> str:
    measures = ("MaxF", "AP", "PRE", "REC", "FPR", "FNR")
    lines = [
        f"{'in %':10}"
        + "".join(f"{name:>8}" for name in measures)
        + f"{'threshold':>11}{'frames':>8}"
    ]
    for table, score in evaluation.scores.items():
        values = "".join(f"{getattr(score, name):8.2f}" for name in measures)
        lines.append(
            f"{table:10}{values}{score.best_threshold_percent:11.2f}{evaluation.frames[table]:8}"
        )
    return "\n".join(lines)


@kitti.command()
@click.argument("predictions", type=_FOLDER)
@click.argument("out", type=_FOLDER, metavar="OUT.zip")
@_calib
@click.option(
    "--type",
    "target",
    type=click.Choice(TARGETS),
    default="road",
    show_default=True,
    help="All 290 test frames, or the 96 of category um.",
)
@click.option("--partial", is_flag=True, help="Pack what is there, for a trial.")
@click.option("--overwrite", is_flag=True, help="Replace an existing zip.")
@quiet_option
def pack(
    predictions: Path,
    out: Path,
    calib: Path | None,
    target: Target,
    partial: bool,
    overwrite: bool,
    quiet: bool,
) -> None:
    """Check PREDICTIONS and pack them into the zip that the benchmark takes.

    PREDICTIONS holds confidence maps named by frame id (um_000000 or testing/um_000000) or as the
    benchmark does (um_road_000000): .png of 8 or 16 bits, or .npy of probabilities, (H, W), 0 to
    1. Where all are 0 and 1, they are masks.
    """
    from nimprep.kitti.submission import pack_submission

    packed = pack_submission(
        predictions,
        out,
        calib,
        target=target,
        partial=partial,
        overwrite=overwrite,
        progress=progress_bars(quiet),
    )
    echo(
        f"{packed.path}: {len(packed.names)} predictions, {packed.transformed} of them transformed"
    )


@kitti.command()
@click.argument("predictions", type=_FOLDER)
@click.argument("gt", type=_FOLDER)
@click.argument("images", type=_FOLDER)
@click.argument("out", type=_FOLDER)
@_calib
@_view_option("perspective")
@_type
@click.option(
    "--threshold",
    callback=_fraction,
    default="50%",
    show_default=True,
    help="Confidence at or above which a pixel counts as road: 0.52 or 52%, as evaluate prints it.",
)
@_overwrite
@quiet_option
def overlay(
    predictions: Path,
    gt: Path,
    images: Path,
    out: Path,
    calib: Path | None,
    view: View,
    target: Target,
    threshold: float,
    overwrite: bool,
    quiet: bool,
) -> None:
    """Draw PREDICTIONS against GT over IMAGES: hits green, misses red, false alarms blue.

    These are the benchmark's and the paper's plain colours, for figures. The pages of
    nimprep evaluate --html outline and hatch what they draw, for eyes that red and green are
    alike to.
    """
    from nimprep.kitti.overlay import OverlayFolders, write_overlays

    folders = OverlayFolders(predictions, gt, images, calib, target)
    progress = progress_bars(quiet)
    written = write_overlays(folders, out, view, threshold, progress, overwrite=overwrite)
    echo(f"{len(written)} pictures written to {out}")
