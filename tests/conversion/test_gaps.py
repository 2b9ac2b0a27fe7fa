"""Gaps of skipped frames are closed right, wherever it was cut short, whatever is spoilt then."""

import shutil
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import nimprep
from nimprep.conversion import run
from nimprep.conversion.plan import Plan
from nimprep.conversion.records import Records
from nimprep.errors import StoreError
from nimprep.store.storage import LocalStorage
from tests.conversion.test_records import DAMAGES
from tests.fakes import contents, write_gmrp

pytestmark = pytest.mark.filterwarnings("ignore:.*nominal:UserWarning")

OPTIONS: dict[str, Any] = {"shard_length": 4, "modalities": ("depth", "label"), "workers": 1}
FRAMES, BAD = 10, ("000001", "000005")
SHARDS = ("depth/c/1/0/0", "label/c/1/0/0")


class Disk:
    """Let a conversion be cut short before its so-manieth change of the disk while it packs."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self._left = -1
        for name in ("write", "move", "remove"):
            patch.setattr(LocalStorage, name, self._dying(getattr(LocalStorage, name)))
        close = run._close_gaps

        def closing(plan: Plan, records: Records) -> None:
            self._left = self.steps
            close(plan, records)
            self._left = -1

        patch.setattr(run, "_close_gaps", closing)
        self.steps = -1

    def _dying(self, change: Callable[..., None]) -> Callable[..., None]:
        def run(*arguments: Any) -> None:
            self._left -= 1
            if self._left == -1:
                raise KeyboardInterrupt
            change(*arguments)

        return run


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return frames of which two are bad."""
    source = write_gmrp(tmp_path_factory.mktemp("raw") / "gmrp", FRAMES)
    for number in BAD:
        path = source / "label" / f"{number}.png"
        path.write_bytes(path.read_bytes()[:-30])
    return source


def converted(source: Path, target: Path, **options: Any) -> dict[str, bytes]:
    nimprep.convert(source, target, on_error="skip", **OPTIONS, **options)
    found = contents(target)
    shutil.rmtree(target)
    return found


@pytest.fixture(scope="module")
def cut_short(raw: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Return what conversions left that were cut short at each change while they packed."""
    found: list[Path] = []
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*nominal")
        disk = Disk(patch)
        while len(found) < 50:
            folder = tmp_path_factory.mktemp("cut")
            disk.steps = len(found)
            try:
                nimprep.convert(raw, folder / "s.zarr", on_error="skip", **OPTIONS)
            except KeyboardInterrupt:
                found.append(folder / ".s.zarr.partial")
            else:
                break
    # The root; of either modality two shards beside their places, and then in them; what is left
    # over; what waited.
    assert len(found) == 1 + 2 * 2 + 2 * 2 + 2 * 2 + 1
    return found


def every(cut_short: list[Path], folder: Path) -> Iterator[Path]:
    """Put each of what was left beside a target, which is given."""
    for number, left in enumerate(cut_short):
        target = folder / str(number) / "s.zarr"
        shutil.copytree(left, target.with_name(left.name))
        yield target


def store_of(target: Path) -> Path:
    return target.with_name(f".{target.name}.partial") / "store"


def test_it_goes_on_from_every_change(raw: Path, cut_short: list[Path], tmp_path: Path) -> None:
    whole = converted(raw, tmp_path / "whole.zarr")
    for target in every(cut_short, tmp_path):
        assert converted(raw, target) == whole
        assert list(target.parent.iterdir()) == []


def test_frames_that_were_mended_meanwhile_are_taken_in(
    raw: Path, cut_short: list[Path], tmp_path: Path
) -> None:
    for number in range(1, len(BAD) + 1):
        source = shutil.copytree(raw, tmp_path / f"mended{number}")
        good = write_gmrp(tmp_path / f"good{number}", FRAMES)
        for name in BAD[:number]:
            shutil.copy(good / "label" / f"{name}.png", source / "label" / f"{name}.png")
        whole = converted(source, tmp_path / "whole.zarr")
        for target in every(cut_short, tmp_path / f"cut{number}"):
            # The folder's own name is no part of a plan, its files' sizes and times are.
            assert converted(source, target) == whole


@pytest.mark.parametrize("number", range(3))
@pytest.mark.parametrize("kind", ["cut short", "gone", "exchanged"])
def test_a_record_that_is_spoilt_meanwhile_costs_no_frame(
    kind: str, number: int, raw: Path, cut_short: list[Path], tmp_path: Path
) -> None:
    whole = converted(raw, tmp_path / "whole.zarr")
    for target in every(cut_short, tmp_path):
        units = store_of(target).with_name("journal") / "units"
        DAMAGES[kind](units / f"{number}.json", units / f"{(number + 1) % 3}.json")
        assert converted(raw, target) == whole


@pytest.mark.parametrize("number", range(3))
@pytest.mark.parametrize("kind", ["cut short", "empty", "no JSON", "gone", "another unit's"])
def test_a_shard_that_is_spoilt_meanwhile_is_made_again(
    kind: str, number: int, raw: Path, cut_short: list[Path], tmp_path: Path
) -> None:
    whole, spoilt = converted(raw, tmp_path / "whole.zarr"), 0
    for target in every(cut_short, tmp_path):
        for place in ("depth", "packed/depth"):
            shard = store_of(target) / place / "c" / str(number) / "0" / "0"
            other = store_of(target) / "depth" / "c" / str((number + 1) % 2) / "0" / "0"
            if shard.exists() and other.exists():
                DAMAGES[kind](shard, other)
                spoilt += 1
        assert converted(raw, target) == whole
    assert spoilt > len(cut_short) // 2


def test_no_listing_has_to_be_right(
    raw: Path, cut_short: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = converted(raw, tmp_path / "whole.zarr")
    monkeypatch.setattr(LocalStorage, "keys", lambda self, prefix="": [])
    assert converted(raw, tmp_path / "fresh.zarr") == whole
    for target in every(cut_short, tmp_path):
        assert converted(raw, target) == whole


@pytest.mark.parametrize("key", SHARDS)
def test_a_shard_that_somebody_else_writes_while_it_packs_ends_it_in_one_line(
    key: str, raw: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = converted(raw, tmp_path / "whole.zarr")
    target, move = tmp_path / "s.zarr", LocalStorage.move

    def moving(self: LocalStorage, source: str, place: str) -> None:
        unit = (self.root / place).read_bytes() if place == key else None
        move(self, source, place)
        if unit is not None:
            # As a worker that was thought lost, and now writes its unit's shard.
            (self.root / place).write_bytes(unit)

    with monkeypatch.context() as patch:
        patch.setattr(LocalStorage, "move", moving)
        with pytest.raises(StoreError, match=f"{key}: expected a shard of the frames that were en"):
            nimprep.convert(raw, target, on_error="skip", **OPTIONS)
    assert not target.exists()
    assert converted(raw, target) == whole
