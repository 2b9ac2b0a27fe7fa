"""A trained network, ready for a robot: colour, depth and a camera in, labels out."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, overload

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nimprep.arrays import without_mask
from nimprep.camera import Camera
from nimprep.errors import ArrayError
from nimprep.frame import Frame, LabelClass
from nimprep.networks.beside import whole_logits
from nimprep.networks.checkpoint import Checkpoint, read_checkpoint
from nimprep.networks.frames import FrameInputs
from nimprep.networks.network import Network

_WHERE = "frame"
"""What messages call what a robot gives."""


class RunModel:
    """Predict with a trained network, from what a robot has.

    Attributes
    ----------
    checkpoint : Checkpoint
    network : Network
        In evaluation mode.
    inputs : FrameInputs
        What makes the network's images of a frame.
    device : torch.device
    classes : tuple of LabelClass
        What labels and the planes of scores stand for, in the planes' order.
    needs : tuple of str
        The modalities that a frame must have: rgb, depth, planes by name.

    Raises
    ------
    ArrayError
        The checkpoint's fields do not go together.
    """

    def __init__(self, checkpoint: Checkpoint, device: torch.device | str = "cpu") -> None:
        self.checkpoint = checkpoint
        self.network: Network = checkpoint.build()
        self.inputs = FrameInputs(checkpoint)
        self.classes: tuple[LabelClass, ...] = checkpoint.classes
        self.needs = tuple(sorted(self.inputs.sources(depth=self.network.wants_depth)))
        self._ids = np.array([entry.id for entry in self.classes], np.uint8)
        self.to(device)

    def __repr__(self) -> str:
        """Say what it is, in one line."""
        found = self.checkpoint
        names = ", ".join(entry.name for entry in self.classes)
        return f"<{found.network} of {found.setup}: {names}; on {self.device}>"

    def to(self, device: torch.device | str) -> RunModel:
        """Move the network to a device: cpu, cuda or cuda:1.

        Raises
        ------
        ArrayError
            There is no such device here.
        """
        try:
            self.device = torch.device(device)
            self.network.to(self.device)
        # What PyTorch raises where it was built without CUDA is an AssertionError.
        except (RuntimeError, AssertionError) as error:
            found = str(error).partition("\n")[0]
            raise ArrayError(
                f"device: expected one that is here, found {device}: {found}; give cpu"
            ) from error
        return self

    @overload
    def predict(
        self,
        rgb: npt.ArrayLike | None = ...,
        depth_m: npt.ArrayLike | None = ...,
        camera: Camera | None = ...,
        *,
        scores: Literal[False] = ...,
        baseline_m: float = ...,
        cam_to_road: npt.ArrayLike | None = ...,
        planes: Mapping[str, npt.ArrayLike] | None = ...,
    ) -> npt.NDArray[np.uint8]: ...
    @overload
    def predict(
        self,
        rgb: npt.ArrayLike | None = ...,
        depth_m: npt.ArrayLike | None = ...,
        camera: Camera | None = ...,
        *,
        scores: Literal[True],
        baseline_m: float = ...,
        cam_to_road: npt.ArrayLike | None = ...,
        planes: Mapping[str, npt.ArrayLike] | None = ...,
    ) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32]]: ...
    def predict(
        self,
        rgb: npt.ArrayLike | None = None,
        depth_m: npt.ArrayLike | None = None,
        camera: Camera | None = None,
        *,
        scores: bool = False,
        baseline_m: float = math.nan,
        cam_to_road: npt.ArrayLike | None = None,
        planes: Mapping[str, npt.ArrayLike] | None = None,
    ) -> npt.NDArray[np.uint8] | tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32]]:
        """Return the class of each pixel of a frame, of any size.

        The network sees what it would see of the same frame in a store of its training's kind:
        depth rounded to the store's unit, normals, HHA and the like derived by the same method and
        options, and rounded as there. So labels are those of `nimprep predict`.

        Parameters
        ----------
        rgb : (H, W, 3) uint8, optional
            Channels R, G, B (OpenCV has them the other way round). What the setup has no use for
            may be None.
        depth_m : (H, W) floating, metres, optional
            Along the optical axis; 0, NaN, infinity and what is masked = none. All may be none.
        camera : Camera, optional
            Of the images' size; needed where something is derived from depth.
        scores : bool
            Return the scores too.
        baseline_m : float, optional
            The stereo pair's, metres, where disparity is derived; NaN = the training's virtual one.
        cam_to_road : (3, 4) array_like, optional
            Transform to the road frame, metres, where elevation is derived and the training had it.
        planes : mapping of str to (H, W) array, optional
            Further images, by name: numbers in the plane's unit, NaN = none.

        Returns
        -------
        labels : (H, W) uint8
            Class ids.
        scores : (C, H, W) float32, with ``scores=True``
            A plane for each of `classes`, 0 to 1; they add up to 1.

        Raises
        ------
        ArrayError
            Something that the setup needs is missing, or of another shape or type.
        CameraError
            The camera is of another size.
        """
        frame = self._frame(rgb, depth_m, camera, baseline_m, cam_to_road, planes or {})
        basis = self.inputs.as_stored(frame)
        images = self.inputs.tensors(self.inputs.images(basis))
        beside = None
        if self.network.wants_depth:
            beside = self.inputs.depth_beside(basis.images["depth"])[None]
        found = self.scores([image[None] for image in images], beside)[0].cpu().numpy()
        labels = self._ids[found.argmax(axis=0)]
        return (labels, found) if scores else labels

    def scores(self, images: Sequence[Tensor], depth: Tensor | None = None) -> Tensor:
        """Return scores of a batch that `inputs` made, (B, C, H, W) float32, on the device.

        Parameters
        ----------
        images : sequence of (B, N, H, W) float32
            One, or two where the network fuses.
        depth : (B, 1, H, W) float32, optional
            As `FrameInputs.depth_beside` makes it, where ``network.wants_depth``.

        Raises
        ------
        ArrayError
            No memory is left on the device.
        """
        height, width = images[0].shape[-2:]
        with torch.inference_mode(), _memory(self.device, len(images[0]), height, width):
            moved = tuple(image.to(self.device) for image in images)
            beside = None if depth is None else depth.to(self.device)
            found = self.inputs
            logits = whole_logits(self.network, moved, found.selection, found.scaling, beside)
            return logits.to(torch.float32).softmax(dim=1)

    def _frame(
        self,
        rgb: Any,
        depth_m: Any,
        camera: Camera | None,
        baseline_m: float,
        cam_to_road: Any,
        planes: Mapping[str, Any],
    ) -> Frame:
        """Return what a robot gave as a frame; what the setup has no use for is left out."""
        given: dict[str, Any] = {"rgb": rgb, "depth": depth_m, **planes}
        unknown = sorted(planes.keys() - {*self.needs})
        if unknown:
            raise ArrayError(
                f"planes: expected some of {', '.join(self.needs)}, found {unknown[0]!r}; leave "
                "it out"
            )
        for name in self.needs:
            if given.get(name) is None:
                raise ArrayError(
                    f"{name}: expected it for a network of {self.checkpoint.setup!r}, found none; "
                    f"give {', '.join(self.needs)}"
                )
        used = {name: given[name] for name in self.needs}
        size = _size(used)
        derives = set(self.inputs.modalities) - {*self.needs}
        if camera is None:
            if derives:
                raise ArrayError(
                    f"camera: expected it, from which {', '.join(sorted(derives))} is derived, "
                    "found none; give a nimprep.Camera"
                )
            # Nothing asks for its numbers.
            camera = Camera(1.0, 1.0, 0.0, 0.0, size[1], size[0])
        if camera.shape != size:
            raise ArrayError(
                f"camera: expected one of the images' {size[1]}x{size[0]} pixels, found "
                f"{camera.width}x{camera.height}; crop or resize it along with them"
            )
        return Frame(
            _WHERE,
            camera,
            rgb=_colors(used["rgb"]) if "rgb" in used else None,
            depth_m=used.get("depth"),
            baseline_m=baseline_m,
            cam_to_road=None if cam_to_road is None else np.asarray(cam_to_road, np.float64),
            others={name: _plane(name, used[name]) for name in planes},
        )


def load_run(run: Path | str, device: torch.device | str = "cpu") -> RunModel:
    """Load a trained network, ready to predict; nothing in the file is run.

    Parameters
    ----------
    run : path
        The folder of a run of `nimprep train`, or its best.pt.
    device : str or torch.device
        cpu, cuda or cuda:1.

    Raises
    ------
    ArrayError
        It is not there, is damaged, no checkpoint or one of another version; or there is no such
        device.

    Examples
    --------
    ::

        model = load_run("run")
        labels = model.predict(rgb, depth_m, camera)  # (H, W) uint8
    """
    checkpoint = read_checkpoint(run)
    try:
        return RunModel(checkpoint, device)
    except ArrayError as error:
        if str(error).startswith("device:"):
            raise
        raise ArrayError(f"{run}: {error}") from error


def _colors(rgb: Any) -> npt.NDArray[np.uint8]:
    image = without_mask(rgb, "rgb")
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise ArrayError(
            f"rgb: expected (H, W, 3) uint8, found {image.shape} {image.dtype}; give 8-bit "
            "colour, R, G, B"
        )
    return image


def _plane(name: str, plane: Any) -> npt.NDArray[Any]:
    if isinstance(plane, np.ma.MaskedArray):
        plane = np.ma.filled(plane.astype(np.float32), np.nan)
    image = np.asarray(plane)
    if image.dtype != np.uint8:
        image = image.astype(np.float32)
    if image.ndim != 2:
        raise ArrayError(f"{name}: expected (H, W) numbers, found shape {image.shape}; give one")
    return image


def _size(images: Mapping[str, Any]) -> tuple[int, int]:
    """Return the one size of some images."""
    sizes = {name: np.shape(image)[:2] for name, image in images.items()}
    if len(set(sizes.values())) != 1 or min(map(len, sizes.values())) < 2:
        found = ", ".join(f"{name} {size}" for name, size in sizes.items())
        raise ArrayError(f"{_WHERE}: expected images of one size, found {found}; crop or resize")
    height, width = next(iter(sizes.values()))
    if min(height, width) < 1:
        raise ArrayError(f"{_WHERE}: expected images of at least one pixel, found {sizes}")
    return int(height), int(width)


@contextmanager
def _memory(device: torch.device, count: int, height: int, width: int) -> Iterator[None]:
    """Let it be an `ArrayError` where a device's memory is used up."""
    try:
        yield
    except torch.OutOfMemoryError as error:
        raise ArrayError(
            f"{device}: expected memory for {count} frames of {width}x{height} pixels, found none "
            "left; give a smaller batch, or another device"
        ) from error
