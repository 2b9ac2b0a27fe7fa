"""nimprep evaluate."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from nimprep.cli.echo import echo
from nimprep.cli.options import json_option, progress_bars, quiet_option

if TYPE_CHECKING:
    from nimprep.evaluation import Comparison
    from nimprep.evaluation.comparison import Unit

FORMATS = ("text", "json", "markdown", "latex")
METRICS = ("f_score", "iou", "precision", "recall")


def _metrics(ctx: click.Context, param: click.Parameter, value: str) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(name.strip() for name in value.split(",")))
    for name in names:
        if name not in METRICS:
            raise click.BadParameter(f"expected some of {', '.join(METRICS)}, found {name!r}")
    return names


def _folders(
    ctx: click.Context, param: click.Parameter, values: tuple[str, ...]
) -> list[Path] | dict[str, Path]:
    """Return the folders, by name where each has one: NAME=FOLDER, unless a folder is so called."""
    pairs = [_pair(value) for value in values]
    names = [name for name, _ in pairs]
    if not any(names):
        return [Path(folder) for _, folder in pairs]
    if not all(names) or len(set(names)) < len(names):
        raise click.BadParameter("expected a name of its own for each folder, or for none")
    return {name: Path(folder) for name, (_, folder) in zip(names, pairs, strict=True)}


def _pair(value: str) -> tuple[str, str]:
    name, equals, folder = value.partition("=")
    if not equals or "/" in name or Path(value).exists():
        return "", value
    return name.strip(), folder


@click.command()
@click.argument("store", type=click.Path())
@click.argument(
    "predictions", nargs=-1, required=True, callback=_folders, metavar="[NAME=]PREDICTIONS..."
)
@click.option(
    "--split",
    type=click.Choice(["train", "val", "test"]),
    help="Whose frames are predicted; default: the split that all predictions are of, "
    "or the whole store where they are of several.",
)
@click.option(
    "--format",
    "style",
    type=click.Choice(FORMATS),
    help="How scores are printed; markdown and latex give the table of methods. Default: text.",
)
@json_option
@click.option(
    "--metrics",
    callback=_metrics,
    default=",".join(METRICS),
    show_default=True,
    help="Columns of the tables; JSON has them all.",
)
@click.option(
    "--percent/--fraction",
    default=True,
    show_default=True,
    help="What the tables show scores in; JSON has fractions, 0 to 1.",
)
@click.option("--html", type=click.Path(path_type=Path), help="Write a page with overlays too.")
@click.option("--overwrite", is_flag=True, help="Replace the page where it is there already.")
@click.option(
    "--worst",
    type=click.IntRange(0),
    default=10,
    show_default=True,
    help="How many of the worst frames are listed, and drawn on the page.",
)
@quiet_option
def evaluate(
    store: str,
    predictions: list[Path] | dict[str, Path],
    split: str | None,
    style: str | None,
    as_json: bool,
    metrics: tuple[str, ...],
    percent: bool,
    html: Path | None,
    overwrite: bool,
    worst: int,
    quiet: bool,
) -> None:
    """Score folders of PREDICTIONS against the labels of STORE.

    A prediction is FRAME_ID.png (class ids, 8-bit grey) or FRAME_ID.npy (floating scores,
    (C, H, W), a plane for each of the store's classes; the highest wins). Each frame of the split
    needs one, and no other frame may have one. Pixels labelled 255 are left out; the mean is over
    the classes that are not background (0).

    Several folders give one table of methods, the best of each column marked (* in text, bold
    elsewhere; none where it is 0). "–" is undefined: the precision of a class that was never
    predicted, the recall of one that no pixel has, and a mean over it. A method is called by its
    folder; NAME=FOLDER gives it another name.
    """
    if as_json and style not in (None, "json"):
        raise click.UsageError(f"expected --json or --format, found both (--format {style})")
    from nimprep.evaluation import compare_predictions

    if html is not None:
        from nimprep.files import check_file
        from nimprep.report.page import check_libraries

        check_libraries()
        folders = predictions.values() if isinstance(predictions, dict) else predictions
        check_file(html, Path(store), *folders, overwrite=overwrite)
    progress = progress_bars(quiet)
    found = compare_predictions(store, predictions, split, progress=progress)
    if html is not None:
        from nimprep.evaluation.page import write_page

        write_page(html, store, found, worst, progress, overwrite=overwrite)
    style = "json" if as_json else style or "text"
    unit: Unit = "percent" if percent else "fraction"
    echo(_written(found, style, metrics, worst, unit), lines=True, bold=True)


def _written(
    found: Comparison, style: str, metrics: tuple[str, ...], worst: int, unit: Unit
) -> str:
    from nimprep.evaluation.markup import comparison_latex, comparison_markdown
    from nimprep.evaluation.text import comparison_text, evaluation_text

    alone = len(found.methods) == 1
    if style == "json":
        return json.dumps(found.first.to_dict() if alone else found.to_dict(), indent=2)
    if style == "markdown":
        return comparison_markdown(found.table(metrics, unit))
    if style == "latex":
        return comparison_latex(found.table(metrics, unit))
    if alone:
        return evaluation_text(found.first, metrics, worst, unit)
    return comparison_text(found, metrics, unit)
