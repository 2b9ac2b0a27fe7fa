"""The description of a dataset as data: which files make a frame, and what their numbers mean.

schemas/folder.schema.json says the same of a JSON file, name by name, with what each means.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from nimprep.derive.methods import Ground
from nimprep.frame import LabelClass
from nimprep.images import Layout, OrientationRule, Raw
from nimprep.readers.reference import Reference
from nimprep.splits import SplitName

MOST_SCALE_M = 1000
"""The largest scale_m of the schema: metres of numbers from 0 to 1, to the far plane."""

Missing = Literal["error", "skip", "none", "split"]
"""What a frame is that lacks a file: bad, left out, or one that has none; split: one that has none
where its whole split lacks it, and bad otherwise."""

DistortionRule = Literal["undistort", "refuse", "rectified"]
"""What to do about distortion coefficients that are not 0; rectified: the images have none left."""

SizeOf = Literal["rgb", "depth"]
Size = SizeOf | tuple[int, int]
"""To which registered images of different size are brought: colour's, depth's, (width, height)."""

Color = tuple[int, int, int]
Invalid = float | tuple[float | None, float | None]
"""A raw value, or the first and the last of a range; None = no bound."""


@dataclass(frozen=True, kw_only=True)
class PlaneSource:
    """Say which files hold one kind of image, and how one of them is read.

    Attributes
    ----------
    files : str
        Pattern below the dataset's folder.
    key, axes : str, optional
        Of an array in a container, and what its axes are.
    raw : Raw, optional
        None = the file says what it holds.
    channel : "R", "G", "B", "A" or int, optional
        The one that counts; None = all.
    byte_order : {"little", "big", "swapped"}, optional
    missing : {"error", "skip", "none", "split"}
    orientation : {"apply", "ignore", "refuse"}
        What to do with an EXIF orientation.
    """

    files: str
    key: str | None = None
    axes: str | None = None
    raw: Raw | None = None
    channel: str | int | None = None
    byte_order: Literal["little", "big", "swapped"] | None = None
    missing: Missing = "error"
    orientation: OrientationRule = "apply"

    @property
    def layout(self) -> Layout:
        """How such a file is read."""
        return Layout(
            key=self.key,
            axes=self.axes,
            raw=self.raw,
            channel=self.channel,
            byte_order=self.byte_order,
            orientation=self.orientation,
        )


@dataclass(frozen=True, kw_only=True)
class ColorSource(PlaneSource):
    """Say where colour is; `range` = what becomes 0 and 255, where there are more than 8 bits."""

    range: tuple[float, float] | None = None
    channels: Literal["RGB", "BGR"] = "RGB"


@dataclass(frozen=True, kw_only=True)
class TransformSource:
    """Say which file has a rigid transform, under which key, and whether it is the other way."""

    files: str
    key: str | None = None
    invert: bool = False


@dataclass(frozen=True, kw_only=True)
class DepthSource(PlaneSource):
    """Say where depth is and what its numbers mean.

    Attributes
    ----------
    values : {"depth", "distance", "disparity", "inverse", "points"}
        What `scale * raw + offset` is: metres along the optical axis or along the ray, pixels of
        disparity, or 1/metre; or the file is no image but a laser scanner's points.
    scale, offset : float
    baseline_m, fx : float, optional
        Of disparity; None = the camera's.
    invalid : tuple
        Raw values and ranges that mean no depth.
    range_m : (least, most), metres; None = no bound
        What lies outside is none.
    clip_m : float, metres, optional
        What lies beyond is set to this.
    rotate_right : int
        Bits by which 16-bit values are rotated first.
    bytes : str, optional
        Channels whose bytes make a value, the lowest first.
    bytes_as : {"unsigned", "float32"}
    confidence : PlaneSource, optional
        Depth is none where it is below `least_confidence`.
    camera : CameraSource, optional
        Of depth, where it is another than colour's.
    depth_to_rgb : 4 rows of 4, metres, optional
        From the depth camera's frame to the colour camera's.
    columns : int
        Numbers of a point.
    to_camera : TransformSource, optional
        From the scanner's frame to the colour camera's.
    """

    values: Literal["depth", "distance", "disparity", "inverse", "points"] = "depth"
    scale: float = 0.001
    offset: float = 0.0
    baseline_m: float | None = None
    fx: float | None = None
    invalid: tuple[Invalid, ...] = (0,)
    range_m: tuple[float | None, float | None] = (None, None)
    clip_m: float | None = None
    rotate_right: int = 0
    bytes: str | None = None
    bytes_as: Literal["unsigned", "float32"] = "unsigned"
    confidence: PlaneSource | None = None
    least_confidence: float = 1.0
    camera: CameraSource | None = None
    depth_to_rgb: tuple[tuple[float, ...], ...] | None = None
    columns: int = 4
    to_camera: TransformSource | None = None

    @property
    def of_points(self) -> bool:
        """Tell whether its files are a scanner's points, which are projected into colour."""
        return self.values == "points"

    @property
    def in_metres(self) -> bool:
        """Tell whether its scaled values are metres, not their inverse."""
        return self.values in _METRES

    @property
    def along_axis(self) -> bool:
        """Tell whether its scaled values are depth as it is."""
        return self.values in _ALONG_AXIS


_METRES = frozenset({"depth", "distance"})
_ALONG_AXIS = frozenset({"depth"})


@dataclass(frozen=True, kw_only=True)
class LabelSource(PlaneSource):
    """Say where labels are and what their values are.

    Attributes
    ----------
    ranges : tuple of (first, last, class id), optional
        Raw values; None with no `colors` = they are class ids.
    colors : mapping of (r, g, b) to class id, optional
    default : int, optional
        Class of what neither names; None = that is an error.
    names : str, optional
        Pattern of text files that name colours, a line each; their classes go before `colors`.
    named : mapping of such a name to class id
    """

    ranges: tuple[tuple[int, int, int], ...] | None = None
    colors: Mapping[Color, int] | None = None
    default: int | None = None
    names: str | None = None
    named: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class ExtraSource(PlaneSource):
    """Say where a further kind of image is, what a store holds of it, and what its numbers mean."""

    dtype: str
    scale: float = 1.0
    offset: float = 0.0
    units: str = ""
    long_name: str = ""
    fill: int | None = None
    source_scale: float | None = None
    source_offset: float | None = None
    resize: Literal["nearest", "linear"] = "nearest"


@dataclass(frozen=True, kw_only=True)
class CameraSource:
    """Say where cameras are: numbers of a camera file as they are, or files.

    Attributes
    ----------
    numbers : dict, optional
        As schemas/camera.schema.json has them.
    files : str, optional
        Pattern of camera files; without placeholders one for all.
    keys : mapping of number to its place in JSON
    key : str, optional
        Which matrix of several.
    columns : tuple of str
        Of a table with a row per frame.
    for_size : (width, height), optional
        What the numbers hold for; images of another size have them scaled.
    pixel_origin : {0, 1}
    baseline_m : float, optional
    distortion : {"undistort", "refuse", "rectified"}
    coefficients : tuple of float
        Of the lens, in OpenCV's order, where the file does not say them.
    unknown : bool
        The dataset has none: it must be given.
    fov_deg : float, optional
        How wide the images' view is, in place of numbers: square pixels, the centre in the middle.
    nominal : str, optional
        Whose numbers they are where nobody calibrated the camera.
    folders : tuple of (pattern, CameraSource)
        Cameras by a folder of the colour image, the dataset's own among them; the first that fits.
    by, table, table_file : optional
        A placeholder, the numbers by what it stands for (or what is wrong with them), and the file
        that says them, where code knows them.
    """

    numbers: dict[str, Any] | None = None
    files: str | None = None
    keys: Mapping[str, str] = field(default_factory=dict)
    key: str | None = None
    columns: tuple[str, ...] = ()
    for_size: tuple[int, int] | None = None
    pixel_origin: int = 0
    baseline_m: float | None = None
    distortion: DistortionRule = "undistort"
    coefficients: tuple[float, ...] = ()
    unknown: bool = False
    fov_deg: float | None = None
    nominal: str | None = None
    folders: tuple[tuple[str, CameraSource], ...] = ()
    by: str = ""
    table: Mapping[str, Mapping[str, Any] | str] | None = None
    table_file: Path | None = None


@dataclass(frozen=True, kw_only=True)
class GravitySource:
    """Say where frames' directions of gravity are: in lists or tables of text, a row for each.

    Attributes
    ----------
    files : str
        Pattern of the lists; without placeholders one for all frames.
    columns : tuple of str
        What each column holds: time, x, y, z, or qx, qy, qz, qw; placeholders that tell the row; ""
        for what is passed over.
    values : {"gravity", "acceleration", "camera_to_world", "world_to_camera"}
        What x, y and z are: a vector that points down, or what an accelerometer measures, which at
        rest points up; or which rotation the quaternion is.
    down : (3,), optional
        Gravity's direction in the world of such a rotation.
    sensor_to_camera : 3 rows of 3, optional
        Rotation from the axes of x, y and z to the camera's; None = they are the same.
    by : str, optional
        The placeholder that is a frame's time stamp; None = that of `Match`.
    unit_s : float
        Seconds per unit of the list's time stamps.
    tolerance_s : float
        Frames without a row so near in time have none.
    """

    files: str
    columns: tuple[str, ...]
    values: Literal["gravity", "acceleration", "camera_to_world", "world_to_camera"]
    down: tuple[float, float, float] | None = None
    sensor_to_camera: tuple[tuple[float, ...], ...] | None = None
    by: str | None = None
    unit_s: float = 1.0
    tolerance_s: float = 0.02


@dataclass(frozen=True, kw_only=True)
class SplitSource:
    """Say whose split the dataset's authors chose: by a template and names, or by list files.

    The lists' patterns are below `folder`; None = the dataset's. A frame in lists of two splits is
    an error, or in the last of train, val and test. What neither can say, code does: `frames` by
    id, the others being in no split.
    """

    of: str | None = None
    names: Mapping[str, SplitName | Literal["skip"]] | None = None
    lists: Mapping[SplitName, str] = field(default_factory=dict)
    rest: SplitName | Literal["error", "skip", "none"] = "error"
    twice: Literal["error", "last"] = "error"
    folder: Path | None = None
    frames: Mapping[str, SplitName] | None = None


@dataclass(frozen=True, kw_only=True)
class Match:
    """Say how files are paired that share no name: by time, or by a list of pairs."""

    by: str | None = None
    unit_s: float = 1.0
    tolerance_s: float = 0.02
    lists: Mapping[str, str] = field(default_factory=dict)
    pairs: str | None = None
    columns: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Description:
    """Describe a dataset.

    Attributes
    ----------
    name : str
        What the store calls the dataset.
    rgb, depth, label : sources, or None where there are none
    planes : mapping of name to ExtraSource
    id : str, optional
        Template of placeholders; None = "{id}".
    classes : tuple of LabelClass
        What the labels mean, once they are mapped.
    camera : CameraSource, optional
        None = the nominal RealSense D415.
    gravity : (3,) or GravitySource, optional
        Of all frames, or of each; None = the camera's, if that has one.
    group : str, optional
        Template of placeholders, or pattern over ids with ``{group}``.
    groups : mapping of frame id to group, optional
        In place of it, where code knows them.
    split : SplitSource, optional
        None = as folders and lists named train, val and test say; `no_split` = free.
    match : Match, optional
        None = files of equal placeholders belong together.
    size : {"rgb", "depth"} or (width, height), optional
        To which registered images of different size are brought.
    split_by : {"frame", "group"}, optional
        The rule that is usual where its authors chose no split.
    only : mapping of placeholder to values
        Frames whose placeholders stand for others are passed over.
    hha_ground : {"floor", "lowest"}, optional
        Where HHA's heights are counted from, unless the user says so.
    reference : Reference, optional
        Whose it is.
    notes : tuple of str
        One line each: what is to be said of how it was described.
    """

    name: str
    rgb: ColorSource
    depth: DepthSource | None = None
    label: LabelSource | None = None
    planes: Mapping[str, ExtraSource] = field(default_factory=dict)
    id: str | None = None
    classes: tuple[LabelClass, ...] = ()
    camera: CameraSource | None = None
    gravity: tuple[float, ...] | GravitySource | None = None
    group: str | None = None
    groups: Mapping[str, str] | None = None
    split: SplitSource | None = None
    no_split: bool = False
    match: Match | None = None
    size: Size | None = None
    split_by: Literal["frame", "group"] | None = None
    only: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    hha_ground: Ground | None = None
    reference: Reference | None = None
    notes: tuple[str, ...] = ()

    def sources(self) -> Iterator[tuple[str, PlaneSource]]:
        """Yield every kind of image that a frame has, by name: planes under their own."""
        yield "rgb", self.rgb
        if self.depth is not None:
            yield "depth", self.depth
            if self.depth.confidence is not None:
                yield CONFIDENCE, self.depth.confidence
        if self.label is not None:
            yield "label", self.label
        yield from self.planes.items()


def metres_per_unit(scale: float) -> str:
    """Return what to do where a scale counts units per metre, as other programs have it."""
    return f"give metres per unit: {1 / scale:g}, not {scale:g}"


CONFIDENCE = "depth confidence"
"""What depth's confidence is called among a frame's files."""
