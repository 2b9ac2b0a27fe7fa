"""nimprep split."""

from __future__ import annotations

from pathlib import Path

import click

from nimprep.cli.echo import echo
from nimprep.splits import SPLIT_RULES, SplitRule


@click.command()
@click.argument("store", type=click.Path())
@click.option(
    "--export", "export_file", type=click.Path(path_type=Path), help="Write a split file."
)
@click.option("--overwrite", is_flag=True, help="Replace the split file where it is there already.")
@click.option(
    "--import",
    "import_file",
    type=click.Path(path_type=Path),
    help="Split by this file, or by a list such as train.txt and those beside it.",
)
@click.option(
    "--split-by",
    type=click.Choice(SPLIT_RULES),
    help="Split anew: frames, whole scenes, frames within each scene, or an eighth of each scene "
    "for val and none for test.",
)
@click.option("--seed", type=int, help="Split anew with another order.")
def split(
    store: str,
    export_file: Path | None,
    overwrite: bool,
    import_file: Path | None,
    split_by: SplitRule | None,
    seed: int | None,
) -> None:
    """Show how many frames of STORE are train, val and test; or split them anew, in place.

    Images are never touched. A split file names each split's frame ids
    (schemas/split.schema.json).
    """
    anew = split_by is not None or seed is not None
    if import_file is not None and anew:
        raise click.UsageError("expected --import or --split-by/--seed, found both")
    from nimprep.errors import SplitError
    from nimprep.files import check_file
    from nimprep.splits import count_splits, write_split_file
    from nimprep.store.reader import open_store
    from nimprep.store.resplit import resplit

    if export_file is not None:
        check_file(export_file, Path(store), overwrite=overwrite, error=SplitError)
    if import_file is not None:
        splits = resplit(store, split_file=import_file)
    elif anew:
        splits = resplit(store, rule=split_by, seed=seed or 0)
        chosen = open_store(store).about.fixed_splits
        if chosen:
            told = ", ".join(f"{name} {len(ids)}" for name, ids in chosen.items())
            text = (
                f"frames whose split the dataset's authors chose keep it ({told}); --import moves"
            )
            echo(f"note: {text} them", err=True)
    else:
        splits = open_store(store).splits
    for name, count in count_splits(splits.values()).items():
        echo(f"{name:<6}{count:>8}{count / len(splits):>8.1%}")
    if export_file is not None:
        write_split_file(export_file, splits, Path(store), overwrite=overwrite)
