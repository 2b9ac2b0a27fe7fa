"""A store's split as a PyTorch dataset."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, SupportsIndex

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.utils.data import Dataset

from nimprep.errors import ArrayError, StoreError
from nimprep.splits import SPLIT_CODES, SplitName
from nimprep.store.reader import Store, open_store
from nimprep.store.storage import Storage
from nimprep.torch.balance import Weighting, class_count, class_weights, frame_weights, label_pixels
from nimprep.torch.batches import BatchMaker, joined
from nimprep.torch.collation import Batch, Sample, collate
from nimprep.torch.scaling import Normalization, Scaling, scaling_from, with_cut
from nimprep.torch.setups import Setup, check_dtype, select
from nimprep.torch.stored_images import NormalsFrom, StoredImages, merged_classes
from nimprep.torch.transforms.composition import adapted
from nimprep.torch.transforms.geometry import check_returned

Transform = Callable[[dict[str, Any]], dict[str, Any]]
"""From a sample to a sample; see `StoreDataset`."""

_NOT_SAID = -(2**63)
"""The epoch, before anybody said which it is."""


class StoreDataset(Dataset[dict[str, Any]]):
    """Serve the frames of a store's split as tensors.

    For `torch.utils.data.DataLoader` with any of its options, or for `StoreLoader`, which is
    faster. Nothing is held open, so that it may be forked, pickled and shared between threads.

    What a transform draws is new every time that a sample is read: its generator is seeded from
    torch's own in the process that reads, which a ``DataLoader`` seeds anew for each pass and
    worker, and ``torch.manual_seed`` for a run. Once `set_epoch` was called it depends on (seed,
    epoch, item) instead, alike for any number of workers, and the same in every pass until the
    next call. `StoreLoader` always says the epoch itself.

    Parameters
    ----------
    path : path, URL or storage
        What `nimprep convert` wrote; see `nimprep.open_store`.
    split : str, optional
        "train", "val" or "test"; None = all frames.
    setup : str or tuple of str, optional
        One of `SETUPS`: rgb, depth, hha, rgb+d, rgb+hha, nim-depth, nim-rgb+d; disparity,
        t-disparity, elevation, rgb+disparity, rgb+t-disparity, rgb+elevation, where the store has
        what they need; depth3, depth+mask, depth-minmax, tdisp, rgb+depth3, rgb+depth-minmax,
        rgb+tdisp: see `nimprep.torch.views`. Or any mix of modalities, of their views, and of
        planes that the store has of its own: ("elevation", "normal"), ("rgb", "d", "thermal"), or
        as one text rgb+normal+elevation, which type checkers do not know.
    fusion : bool
        Keep what the setup is made of apart, for a network with two encoders or more: a tensor per
        modality, or per entry of a mix, ("rgb", "normal+elevation") giving 3 and 4 channels.
    modalities : sequence of str, optional
        In place of a setup: a tensor per name, or with `fusion` all of them as "inputs"; "label"
        only if named.
    transform : callable, optional
        Called with each sample before it is normalised: a dict of "rgb" (3, H, W) uint8, "depth"
        (1, H, W) float32 metres, "normal" (3, H, W) float32, "hha" (3, H, W) uint8, "disparity",
        "transformed_disparity", "elevation" (1, H, W) float32 as a `Frame` has them, as far as they
        are used; planes (1, H, W) float32 in their units, NaN = none, or uint8, and under "planes"
        their records, to be handed on; "label" (H, W) int64; "intrinsics" (3, 3) float64;
        "gravity" (3,) float64, pointing down, NaN = none, if the store was given any; "id";
        "size" (height, width) without padding; "generator", a `torch.Generator` to draw from,
        seeded as said above. Returns such a dict. One of `torchvision.transforms.v2` or
        albumentations 2 is applied to all planes alike; see `nimprep.torch.transforms.Torchvision`.
    normals : str
        "cached" = as stored; "nim", "nim-edge" = computed by that method of `estimate_normals`
        from the stored depth as a frame is read.
    normalize : str or Scaling, optional
        None or "constants": rgb and hha divided by 255, depth by 10 m, disparity by 64 pixels,
        transformed disparity by 16, elevation by 2 m, both cut to twice that (see `cut`), planes
        by the largest number, by its size, that their integers say. "train": mean 0 and standard
        deviation 1 by the train split's statistics for rgb, depth, hha and planes, the constants
        for the others.
        "imagenet": rgb by the mean and deviation that encoders trained on ImageNet expect, the
        constants for the others. "none":
        rgb and hha in 0-255, the others in metres and pixels. Where there is none of them it is 0,
        which is also the road's transformed disparity and elevation; normals stay as they are.
    cut : mapping of str to (float, float), optional
        The range that a modality's numbers are cut to before they are scaled, in its unit, as
        {"elevation": (-1, 3)}; None for a name = uncut. What is not named keeps its own: -4 to 4 m
        of elevation and -32 to 32 pixels of transformed disparity, unless `normalize` is "none" or
        a `Scaling`, which says it itself; all others are uncut. `scaling.cut` is what applies.
    classes : mapping of str to int, optional
        The label that each of the store's classes, by its name, becomes: 0 to 254, or 255 to be
        ignored; "*" stands for all that are not named. None = the labels as they are stored.
    dtype : {"float32", "stored"}
        "stored": images as the store holds them, one tensor per name, for `Normalize` to do the
        float work on the device: rgb and hha (3, H, W) uint8, normal (3, H, W) int8 or int16,
        depth (1, H, W) uint16, in steps of ``store.modality("depth").step`` metres, disparity
        (1, H, W) uint16, transformed disparity and elevation (1, H, W) int16,
        planes (1, H, W) of their own dtype,
        label (H, W) uint8; see `nimprep.modality` for their steps.
    seed : int
        Of the generators that transforms draw from.

    Attributes
    ----------
    store : Store
    indices : (N,) int64
        The split's frames, by their numbers in the store.
    ids : tuple of str
    selection : Selection
    scaling : Scaling

    Raises
    ------
    StoreError
        There is no such store or split, the split is empty, or a modality is missing.
    ArrayError
        An option is not one of those it can be.
    """

    def __init__(
        self,
        path: Path | str | Storage,
        split: SplitName | Literal["none"] | None = "train",
        setup: Setup | tuple[str, ...] | None = None,
        fusion: bool = False,
        transform: Transform | None = None,
        *,
        modalities: Sequence[str] | None = None,
        normals: NormalsFrom = "cached",
        normalize: Normalization | Scaling | None = None,
        cut: Mapping[str, tuple[float, float] | None] | None = None,
        classes: Mapping[str, int] | None = None,
        dtype: Literal["float32", "stored"] = "float32",
        seed: int = 0,
    ) -> None:
        self.store = open_store(path)
        planes = [plane.name for plane in self.store.planes]
        self.selection = select(setup, fusion=fusion, modalities=modalities, planes=planes)
        check_dtype(dtype, self.selection, transform)
        merged = None if classes is None else merged_classes(self.store, classes)
        self.images = StoredImages(self.store, self.selection, normals, merged)
        self._planes = {
            plane.name: plane
            for plane in self.store.planes
            if plane.name in self.selection.modalities
        }
        self.split = split
        self.indices = _frames(self.store, split)
        self.ids = tuple(self.store.ids[i] for i in self.indices)
        used = self.selection.modalities
        self.scaling = with_cut(scaling_from(normalize, self.store, used), cut or {}, used)
        self.transform = None if transform is None else adapted(transform)
        self._checked_bytes = normalize != "none"
        self.dtype = dtype
        self.seed = seed
        # In shared memory, so that workers that persist see what set_epoch says later.
        self._epoch = torch.full((), _NOT_SAID, dtype=torch.int64)
        self._epoch.share_memory_()  # type: ignore[no-untyped-call]

    def __len__(self) -> int:
        return len(self.indices)

    def __repr__(self) -> str:
        """Say what a sample has and where it is from, in one line."""
        sizes = zip(self.selection.groups, self.selection.channels, strict=True)
        tensors = " and ".join(f"{'+'.join(group)} ({count}, H, W)" for group, count in sizes)
        height, width = self.images.size
        label = ", label" if self.selection.label else ""
        return (
            f"<StoreDataset {self.store.path}: {len(self)} frames of {self.split or 'all splits'}, "
            f"{tensors}{label}, {width}x{height}{self._cut_in_words()}>"
        )

    def _cut_in_words(self) -> str:
        """Say which numbers are cut to which range, in their units."""
        words = ""
        for name in self.selection.modalities:
            if name in self.scaling.cut:
                low, high = self.scaling.cut[name]
                words += f"; {name} cut to {low:g} to {high:g} {self.images.modality(name).units}"
        return words.rstrip()

    @property
    def epoch(self) -> int | None:
        """The epoch that transforms draw for, as `set_epoch` said; None = it was not called."""
        epoch = int(self._epoch)
        return None if epoch == _NOT_SAID else epoch

    def set_epoch(self, epoch: int | None) -> None:
        """Say which epoch comes next, before its iteration starts; workers see it too.

        None = transforms draw anew whenever a sample is read, as before the first call.
        """
        self._epoch.fill_(_NOT_SAID if epoch is None else epoch)

    @property
    def num_classes(self) -> int:
        """How many classes a network is to tell apart: the largest label, as merged, plus 1."""
        return class_count(self.store, self.images.merged)

    def class_pixels(self) -> Tensor:
        """Return how many pixels of these frames each label has, (K,) int64.

        Label i stands at place i, K - 1 being the largest; those to be ignored are left out. From a
        table that the store has; of stores of format 1.0 the labels are read.

        Raises
        ------
        StoreError
            The store has no labels, or one is damaged.
        """
        return torch.from_numpy(self._pixels().sum(axis=0))

    def class_weights(self, method: Weighting = "inverse") -> Tensor:
        """Return a weight per label, (K,) float32, for ``CrossEntropyLoss(weight=...)``.

        See `nimprep.torch.balance.class_weights` for the methods; 0 where a label has no pixel.

        Raises
        ------
        ArrayError
            There is no such method, or no labelled pixel.
        StoreError
            As `class_pixels`.
        """
        return torch.from_numpy(class_weights(self._pixels(), method)).to(torch.float32)

    def frame_weights(self, method: Weighting = "inverse") -> Tensor:
        """Return a weight per frame, (N,) float64, for ``WeightedRandomSampler``.

        The mean of its labelled pixels' class weights: frames with rare classes are drawn more
        often; one without any label never is.

        Raises
        ------
        ArrayError, StoreError
            As `class_weights`.
        """
        pixels = self._pixels()
        return torch.from_numpy(frame_weights(pixels, class_weights(pixels, method)))

    def _pixels(self) -> npt.NDArray[np.int64]:
        return label_pixels(self.store, self.indices, self.images.merged)

    def __getitem__(self, item: SupportsIndex) -> Sample:
        return self.sample(item, self.epoch)

    def __getitems__(self, items: Sequence[SupportsIndex]) -> Batch:
        """Return several frames as one batch, decoded straight into its tensors."""
        epoch = self.epoch
        if self.transform is not None:
            return Batch(collate([self.sample(item, epoch) for item in items]))
        batch = self.allocate(len(items))
        for position, item in enumerate(items):
            self.fill(batch, position, self._checked(item))
        return batch

    def sample(self, item: SupportsIndex, epoch: int | None) -> Sample:
        """Return the sample of an item in an epoch; None = as torch's generator draws.

        Raises
        ------
        IndexError
            The split has fewer frames.
        StoreError
            A chunk is damaged or gone.
        """
        number = self._checked(item)
        if self.transform is None:
            batch = self.allocate(1)
            self.fill(batch, 0, number)
            return Sample({name: _only(value) for name, value in batch.items()})
        raw = self._raw(number)
        drawn = int(torch.randint(2**63 - 1, ())) if epoch is None else epoch
        raw["generator"] = torch.Generator().manual_seed(_seed(self.seed, drawn, number))
        given = tuple(raw)
        changed = self.transform(raw)
        check_returned(changed, raw["id"], given)
        if self._checked_bytes:
            self._check_bytes(changed, int(self.indices[number]))
        return self._assembled(changed)

    def _check_bytes(self, changed: Mapping[str, Any], index: int) -> None:
        """Raise where a transform has divided colours by 255 itself: they would be again."""
        for name in self.selection.modalities:
            if (
                self.images.modality(name).values in ("colors", "levels")
                and changed[name].is_floating_point()
            ):
                low, high = float(changed[name].min()), float(changed[name].max())
                scaled = 0 < high <= 1 < self.images.image(name, index).max()
                if low < 0 or scaled:
                    raise ArrayError(
                        f"frame {self.store.ids[index]!r}: expected {name} from 0 to 255 from the "
                        f"transform, found {low:g} to {high:g}; leave scaling to normalize=, or "
                        "turn that off with normalize='none'"
                    )

    def allocate(self, count: int, *, pinned: bool = False) -> Batch:
        """Return a batch of so many frames for `fill`; without a transform only."""
        return self._maker.allocate(count, pinned=pinned)

    def fill(self, batch: Batch, position: int, item: int) -> None:
        """Decode the sample of an item into its place in a batch, as `BatchMaker.fill` does."""
        self._maker.fill(batch, position, int(self.indices[item]))

    @property
    def _maker(self) -> BatchMaker:
        return BatchMaker(self.images, self.selection, self.scaling, self.dtype)

    def _checked(self, item: SupportsIndex) -> int:
        number = operator.index(item)
        if not -len(self) <= number < len(self):
            raise IndexError(f"{self.store.path}: expected below {len(self)}, found {number}")
        return number % len(self)

    def _raw(self, item: int) -> dict[str, Any]:
        """Return a frame as transforms take it, but for the generator."""
        index = int(self.indices[item])
        named = (*self.selection.modalities, *(["label"] if self.selection.label else []))
        height, width = (int(n) for n in self.store.tables.image_size[index])
        return {
            **{name: self.images.image(name, index) for name in named},
            "intrinsics": torch.from_numpy(self.store.tables.intrinsics[index].copy()),
            **({"gravity": self._gravity(index)} if self.store.about.has_gravity else {}),
            "id": self.ids[item],
            "size": (height, width),
            **({"planes": self._planes} if self._planes else {}),
        }

    def _gravity(self, index: int) -> Tensor:
        return torch.from_numpy(self.store.tables.gravity[index].copy())

    def _assembled(self, raw: dict[str, Any]) -> Sample:
        """Normalise what a transform returned and put it together."""
        sample = Sample()
        tensors = [joined(group, raw, self.scaling) for group in self.selection.groups]
        if not self.selection.inputs:
            sample.update(zip(self.selection.images, tensors, strict=True))
        else:
            sample["inputs"] = tensors[0] if len(tensors) == 1 else tuple(tensors)
        if self.selection.label:
            sample["label"] = raw["label"].to(torch.int64)
        sample["id"] = raw["id"]
        sample["intrinsics"] = torch.as_tensor(raw["intrinsics"]).to(torch.float32)
        if "gravity" in raw:
            sample["gravity"] = torch.as_tensor(raw["gravity"]).to(torch.float32)
        sample["size"] = torch.as_tensor(raw["size"], dtype=torch.int64)
        return sample


def _only(value: Any) -> Any:
    """Return the one sample's part of a batch's value."""
    return tuple(part[0] for part in value) if isinstance(value, tuple) else value[0]


def _seed(*numbers: int) -> int:
    """Mix numbers into a seed: neighbouring epochs and indices draw unlike numbers."""
    return int(np.random.SeedSequence(numbers).generate_state(1, np.uint64)[0])


def _frames(store: Store, split: str | None) -> Any:
    frames = store.indices(split)
    if len(frames) == 0:
        counts = {
            name: int((store.tables.split == code).sum()) for name, code in SPLIT_CODES.items()
        }
        there = ", ".join(f"{count} in {name}" for name, count in counts.items() if count)
        raise StoreError(
            f"{store.path}: expected frames in split {split!r}, found {there or 'none at all'}; "
            "split the store anew with nimprep split"
        )
    return frames
