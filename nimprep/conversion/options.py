"""How a dataset is to become a store."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from nimprep.derive.recipe import Recipe
from nimprep.errors import ArrayError
from nimprep.modality import MODALITIES, given_for, modality_name
from nimprep.readers import ReaderOptions
from nimprep.readers.cameras import CameraSource, camera_from_file, camera_from_intrinsics
from nimprep.splits import SPLIT_RULES
from nimprep.store.spec import PRESETS, SHARD_LENGTH


@dataclass(frozen=True)
class ConvertOptions:
    """Say how a dataset becomes a store.

    Attributes
    ----------
    reader : str
        A name in `nimprep.readers.READERS`; "auto" = by the folder's layout.
    description : path, optional
        The JSON description of a folder dataset.
    labels : bool
        Whether labels are read.
    camera : path or (fx, fy, cx, cy), optional
        A camera file, or the numbers in pixels; None = the dataset's own.
    depth_scale : float, optional
        Metres per raw depth unit; None = the layout's, and implausible depth is refused.
    target : {"road", "lane"}
        Which of KITTI road's ground truths.
    depth_from : {"auto", "lidar", "stereo"}
        Where KITTI road's depth comes from; "auto" = the best that each frame has.
    sparse : bool
        Leave KITTI road's LiDAR or stereo depth as measured.
    crop : "auto", (top, bottom, left, right) or None
        Cut the sides that have depth in no frame, or so many pixels, or nothing.
    modalities : sequence of str, optional
        What to store; None = all that can be had but disparity, transformed_disparity and
        elevation, which are stored where they are named.
    normals : str
        Method of `estimate_normals`.
    sign_filter : bool
        Its option of that name, for "nim".
    noise : float, optional
        Its option of that name, for "nim-edge": standard deviation of inverse depth, 1/m; None =
        estimated from each frame.
    fill : {"none", "nearest", "linear", "colorization"}
        How holes in depth are filled for normals and HHA.
    store_filled : bool
        Store the filled depth in place of the raw one.
    normal_dtype : {"int8", "int16"}
    codec : {"fast", "small"}
    split_by : {"frame", "group", "stratified"}, optional
        None = "stratified" where the dataset's authors fixed some frames' split, else "frame".
    split_file : path, optional
        In place of a rule.
    seed : int
        Of the split.
    shard_length : int
        Frames per shard.
    workers : int, optional
        Threads; None = the cores this process may use. The bytes do not depend on it.
    overwrite : bool
        Replace a complete store.
    restart : bool
        Begin anew where an earlier conversion into the target was cut short; else go on there.
    on_error : {"stop", "skip"}
        What a bad frame does: end the conversion, or be left out and listed in the metadata.
    scheduler : str, optional
        Address of a Dask scheduler, tcp://host:8786, on whose workers units are encoded; source,
        target and files named here must be in their reach under the same paths. None = here.
    """

    reader: str = "auto"
    description: Path | str | None = None
    labels: bool = True
    camera: Path | str | tuple[float, float, float, float] | None = None
    depth_scale: float | None = None
    target: Literal["road", "lane"] = "road"
    depth_from: Literal["auto", "lidar", "stereo"] = "auto"
    sparse: bool = False
    crop: Literal["auto"] | tuple[int, int, int, int] | None = None
    modalities: Sequence[str] | None = None
    normals: str = "nim"
    sign_filter: bool = False
    noise: float | None = None
    fill: str = "none"
    store_filled: bool = False
    normal_dtype: str = "int8"
    codec: str = "fast"
    split_by: str | None = None
    split_file: Path | str | None = None
    seed: int = 0
    shard_length: int = SHARD_LENGTH
    workers: int | None = None
    overwrite: bool = False
    restart: bool = False
    on_error: Literal["stop", "skip"] = "stop"
    scheduler: str | None = None

    def __post_init__(self) -> None:
        for name, value, allowed in (
            ("codec", self.codec, tuple(PRESETS)),
            ("normal_dtype", self.normal_dtype, MODALITIES["normal"].dtypes),
            ("target", self.target, ("road", "lane")),
            ("depth_from", self.depth_from, ("auto", "lidar", "stereo")),
            ("on_error", self.on_error, ("stop", "skip")),
            ("split_by", self.split_by, (None, *SPLIT_RULES)),
        ):
            if value not in allowed:
                raise ArrayError(f"{name}: expected one of {allowed}, found {value!r}")
        for name, number in (
            ("shard_length", self.shard_length),
            ("workers", self.workers),
        ):
            if number is not None and not number > 0:
                raise ArrayError(f"{name}: expected a positive number, found {number}")
        if self.depth_scale is not None and not 1e-9 <= self.depth_scale <= 1000:
            raise ArrayError(
                f"depth_scale: expected 1e-9 to 1000 metres per unit, found {self.depth_scale}"
            )
        _ = self.recipe  # checks what it is made of
        if self.modalities is not None:
            names = tuple(modality_name(name) for name in self.modalities)
            object.__setattr__(self, "modalities", names)
        for name in self.modalities or ():
            if name not in MODALITIES:
                known = ", ".join(MODALITIES)
                raise ArrayError(f"modalities: expected some of {known}, found {name!r}")

    @property
    def reading(self) -> ReaderOptions:
        """What the reader is to do differently from its layout's defaults.

        Raises
        ------
        CameraError
            The camera's file or numbers make no camera.
        """
        camera: CameraSource | None = None
        if isinstance(self.camera, (str, Path)):
            camera = camera_from_file(Path(self.camera))
        elif self.camera is not None:
            camera = camera_from_intrinsics(self.camera)
        return ReaderOptions(
            labels=self.labels,
            camera=camera,
            depth_scale=self.depth_scale,
            description=None if self.description is None else Path(self.description),
            target=self.target,
            depth_from=self.depth_from if self.needs_depth else "none",
            sparse=self.sparse,
        )

    @property
    def needs_depth(self) -> bool:
        """Whether any modality to be stored is depth or made from it."""
        return self.modalities is None or "depth" in given_for(self.modalities)

    @property
    def recipe(self) -> Recipe:
        """How derived modalities are made."""
        return Recipe(
            self.normals, self.sign_filter, self.fill, self.store_filled, noise=self.noise
        )
