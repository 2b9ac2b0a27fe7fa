"""Somebody's transforms as they are given: in a row, another library's, or of their own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch.utils._pytree import register_pytree_node

from nimprep.errors import ArrayError
from nimprep.torch.transforms.foreign import Albumentations, Torchvision
from nimprep.torch.transforms.geometry import Sample


def adapted(transform: Callable[[Any], Any]) -> Callable[[Sample], Sample]:
    """Return a transform that takes samples: one of ours as it is, or what makes one of another.

    Raises
    ------
    ArrayError
        It cannot be called, or is one of torchvision's first version, which knows one image only.
    """
    name = type(transform).__name__
    for kind in type(transform).__mro__:
        library = kind.__module__
        if library.startswith("torchvision.transforms.v2"):
            return Torchvision(transform)
        if library.startswith("albumentations."):
            return Albumentations(transform)
        if library.startswith("torchvision.transforms"):
            raise ArrayError(
                f"{name}: expected a transform of torchvision.transforms.v2, which moves labels "
                "and depth with their image, found one of torchvision.transforms; import it from "
                "there"
            )
    if isinstance(transform, torch.nn.Sequential):
        return Compose(tuple(transform))
    if not callable(transform):
        raise ArrayError(
            f"transform: expected a callable, found {name}; several make one by Compose([...])"
        )
    own = type(transform).__module__.startswith("nimprep.torch.transforms")
    return transform if own else _Own(transform)


@dataclass(frozen=True)
class Compose:
    """Apply transforms one after the other.

    Parameters
    ----------
    transforms : sequence of callables
        Each takes a sample and returns one, or is of `torchvision.transforms.v2` or albumentations.
    """

    transforms: Sequence[Callable[[Sample], Sample]]

    def __call__(self, sample: Sample) -> Sample:
        """Return the sample after the last transform."""
        for transform in self.transforms:
            sample = adapted(transform)(sample)
        return sample


class _Given(dict[str, Any]):
    """Be a sample in somebody's own function."""


def _refuse(sample: _Given) -> Any:
    raise ArrayError(
        f"frame {sample.get('id')!r}: expected torchvision's transform to be given as transform=, "
        "or to be called as Torchvision(it)(sample), found it called with a sample, of which it "
        "would move and change rgb alone; nimprep.torch.transforms has Torchvision"
    )


# By which torchvision takes a dict apart, to move the first plain tensor in it and no other.
register_pytree_node(_Given, _refuse, lambda values, context: values)


@dataclass(frozen=True)
class _Own:
    """Apply somebody's function, in which torchvision's transforms are to know what they move."""

    transform: Callable[[Sample], Sample]

    def __call__(self, sample: Sample) -> Sample:
        changed = self.transform(_Given(sample))
        return dict(changed) if isinstance(changed, _Given) else changed
