"""What every network here is: any size in, the same size out, logits alone where nothing trains."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from nimprep.errors import ArrayError
from nimprep.networks.cost import count_flops
from nimprep.networks.losses import IGNORE, cross_entropy

SMALLEST = 64
"""Height and width, pixels, that every network takes at least."""


class Logits(NamedTuple):
    """Hold what a network without auxiliary outputs gives: (B, C, H, W)."""

    logits: Tensor


@dataclass(frozen=True)
class Loaded:
    """List what came of a file of weights.

    Attributes
    ----------
    loaded : tuple of str
        The network's tensors that are the file's.
    adapted : tuple of str
        Those among them whose input channels are others than the file's: each is the mean over the
        file's channels.
    initial : tuple of str
        The network's tensors that are as they were.
    unused : tuple of str
        The file's tensors that have no place in the network.
    """

    loaded: tuple[str, ...]
    adapted: tuple[str, ...]
    initial: tuple[str, ...]
    unused: tuple[str, ...]

    def __str__(self) -> str:
        adapted = f" ({len(self.adapted)} adapted to other channels)" if self.adapted else ""
        return (
            f"loaded {len(self.loaded)} tensors{adapted}, {len(self.initial)} of the network are "
            f"initial, {len(self.unused)} of the file unused"
        )


class Network(nn.Module, ABC):
    """Map images to logits per class and pixel.

    A subclass says its numbers and computes in `_outputs`, whose tensors are of its inputs' size;
    those are padded with zeros, at the bottom and right, to a multiple of `divisor`, and what
    comes out is cropped.

    Attributes
    ----------
    inputs : int or (int, int)
        Channels of the image, or of both images.
    classes : int
    divisor : int
        What height and width are padded to a multiple of; 1 = any size as it is.
    auxiliary : bool
        Whether `forward` gives more than logits in training.
    classifier : dict of str to str
        Convolutions that torchvision has as layers of its classifier, by their names there.
    wants_canny : bool
        Whether `forward` takes a Canny map of the raw image after the images.
    loaded : Loaded, optional
        What came of the file of weights it was built with.
    """

    divisor: ClassVar[int] = 1
    auxiliary: ClassVar[bool] = False
    wants_canny: ClassVar[bool] = False
    classifier: ClassVar[dict[str, str]] = {}
    loaded: Loaded | None = None

    def __init__(self, inputs: int | tuple[int, int], classes: int) -> None:
        super().__init__()
        self.inputs = inputs
        self.classes = classes

    @property
    def wants_depth(self) -> bool:
        """Whether `forward` takes depth after the images, (B, 1, H, W), that likeness is of."""
        return False

    @abstractmethod
    def _outputs(self, *images: Tensor, auxiliary: bool) -> Any:
        """Return a named tuple, logits first; others are None where `auxiliary` is False."""

    def outputs(self, *images: Tensor) -> Any:
        """Return every output as a named tuple, the logits first, in training and evaluation."""
        return self._sized(images, auxiliary=True)

    def forward(self, *images: Tensor) -> Any:
        """Return logits, (B, C, H, W) of the input's size.

        In training a network with auxiliary outputs returns a named tuple, the logits first.

        Parameters
        ----------
        *images : (B, N, H, W) floating
            One, or two where the network fuses; N as `inputs` says, H and W 64 or more.

        Raises
        ------
        ArrayError
            The number of images, their channels or sizes are others.
        """
        if self.auxiliary and self.training:
            return self._sized(images, auxiliary=True)
        return self._sized(images, auxiliary=False).logits

    def loss(
        self,
        outputs: Any,
        labels: Tensor,
        class_weights: Tensor | None = None,
        ignore_index: int = IGNORE,
    ) -> Tensor:
        """Return what training is to lower, a number: the sum of `losses`.

        Parameters
        ----------
        outputs : Tensor or named tuple
            What `forward` or `outputs` gave; logits alone are taken without auxiliary losses.
        labels : (B, H, W) integer
            0 to C - 1, or `ignore_index`. Where no pixel has a label the loss is 0.
        class_weights : (C,) floating, optional
        ignore_index : int
            The label of pixels that do not count.

        Raises
        ------
        ArrayError
            Labels are not of the logits' size, or none of the classes.
        """
        parts = self.losses(outputs, labels, class_weights, ignore_index)
        return torch.stack([*parts.values()]).sum()

    def losses(
        self,
        outputs: Any,
        labels: Tensor,
        class_weights: Tensor | None = None,
        ignore_index: int = IGNORE,
    ) -> dict[str, Tensor]:
        """Return the parts of `loss` by name, each as it counts; parameters as there."""
        logits = outputs if isinstance(outputs, Tensor) else outputs.logits
        return {"segmentation": cross_entropy(logits, labels, class_weights, ignore_index)}

    def flops(self, height: int, width: int) -> int:
        """Return the floating-point operations of one image of this size, in evaluation.

        Two for each multiply-add of a convolution; normalisation, activations, pooling, resizing
        and edge maps are left out, as is usual. Nothing is computed.

        Raises
        ------
        ArrayError
            The size is below 64.
        """
        channels = (self.inputs,) if isinstance(self.inputs, int) else self.inputs
        dtype = next(self.parameters()).dtype
        given = (*channels, 1) if self.wants_depth else channels
        images = [torch.empty(1, n, height, width, dtype=dtype, device="meta") for n in given]
        return count_flops(self, images)

    def _sized(self, images: tuple[Tensor, ...], *, auxiliary: bool) -> Any:
        self._check(images)
        height, width = images[0].shape[2:]
        down, right = -height % self.divisor, -width % self.divisor
        if not (down or right):
            return self._outputs(*images, auxiliary=auxiliary)
        padded = [functional.pad(image, (0, right, 0, down)) for image in images]
        found = self._outputs(*padded, auxiliary=auxiliary)
        return type(found)(
            *(None if value is None else value[..., :height, :width] for value in found)
        )

    def _channels(self, count: int) -> tuple[int, ...]:
        """Return the channels of each image that `_outputs` takes, where it gets so many."""
        return (self.inputs,) if isinstance(self.inputs, int) else self.inputs

    def _check(self, images: tuple[Tensor, ...]) -> None:
        channels = self._channels(len(images))
        expected = " and ".join(f"(B, {n}, H, W)" for n in channels)
        found = " and ".join(str(tuple(image.shape)) for image in images)
        sizes = {(len(image), *image.shape[2:]) for image in images}
        fits = len(images) == len(channels) and all(
            image.ndim == 4 and image.shape[1] == n
            for image, n in zip(images, channels, strict=True)
        )
        if not fits or len(sizes) != 1 or min(images[0].shape[2:]) < SMALLEST:
            raise ArrayError(
                f"{type(self).__name__}: expected images of {expected}, H and W alike and "
                f"{SMALLEST} or more, found {found}"
            )
