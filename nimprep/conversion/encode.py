"""From frames to shards: each frame is checked, derived from, quantised, padded and compressed."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from nimprep.conversion.doubted import derived_signs, frame_signs, shows_road
from nimprep.conversion.plan import Job
from nimprep.conversion.records import DEPTHS, FrameFacts, SkippedFrame, UnitRecord
from nimprep.conversion.sources import changed_files, frame_digest, frame_state
from nimprep.derive.modalities import derive, fill_frame
from nimprep.derive.recipe import Recipe
from nimprep.doubts.depth import staircase_signs
from nimprep.doubts.surfaces import cut_signs, depth_counts_sign
from nimprep.errors import ArrayError, DecodeError, NimprepError
from nimprep.frame import Frame
from nimprep.modality import MODALITIES, Modality, given_for
from nimprep.parallel import available_cores, in_order
from nimprep.readers.base import Reader
from nimprep.store.attributes import GravitySource
from nimprep.store.checksums import chunk_checksum
from nimprep.store.depth_loss import lost_depth
from nimprep.store.frames import depth_to_integers, from_integers, to_integers
from nimprep.store.shards import encode_chunk
from nimprep.store.statistics import channel_sums, class_pixels
from nimprep.store.writer import StoreLayout, StoreWriter


@dataclass(frozen=True)
class EncodedFrame:
    """Hold what a frame adds to a store.

    Attributes
    ----------
    facts : FrameFacts
    chunks : dict of modality to bytes
    depth_counts : (65536,) int64
        Pixels per depth in the store's unit.
    """

    facts: FrameFacts
    chunks: dict[str, bytes]
    depth_counts: npt.NDArray[np.int64]


def encode_units(
    job: Job, reader: Reader, todo: Sequence[int], done: Callable[[], None]
) -> Generator[UnitRecord]:
    """Encode and write units, in order; yield each one's record once its shards are written.

    Threads share the work frame by frame: decoding, the kernels and compression release the GIL;
    one more writes. Held in memory: the compressed chunks of two units, and two frames per worker.

    Parameters
    ----------
    todo : sequence of int
        Units' numbers.
    done : callable
        Called after each frame.

    Raises
    ------
    NimprepError
        A frame is bad or the disk full; the units before it have been yielded.
    """
    units, workers = job.units(), job.options.workers or available_cores()
    ids = [frame_id for number in todo for frame_id in units[number]]
    writing: deque[Future[UnitRecord]] = deque()
    with (
        ThreadPoolExecutor(workers, thread_name_prefix="nimprep") as pool,
        ThreadPoolExecutor(1, thread_name_prefix="nimprep-writer") as writer,
    ):
        encoded = in_order(lambda i: pool.submit(_encode_or_skip, job, reader, i), ids, 2 * workers)
        try:
            for number in todo:
                frames = []
                for _ in units[number]:
                    frames.append(next(encoded).result())
                    done()
                writing.append(writer.submit(_write_unit, job, number, frames))
                if len(writing) > 1:
                    yield writing.popleft().result()
        except NimprepError:
            # What is whole already must not be made again.
            while writing:
                yield writing.popleft().result()
            raise
        finally:
            encoded.close()
        while writing:
            yield writing.popleft().result()


def encode_unit(
    job: Job, reader: Reader, number: int, before_writing: Callable[[], None] = lambda: None
) -> UnitRecord:
    """Encode and write one unit on the calling thread alone."""
    frames = [_encode_or_skip(job, reader, frame_id) for frame_id in job.units()[number]]
    before_writing()
    return _write_unit(job, number, frames)


def _write_unit(job: Job, number: int, frames: Sequence[EncodedFrame | SkippedFrame]) -> UnitRecord:
    """Write the unit's shard of every modality and return what is to be kept of it."""
    good = [frame for frame in frames if isinstance(frame, EncodedFrame)]
    writer = StoreWriter(job.storage, job.layout)
    counts = np.zeros(DEPTHS, dtype=np.int64)
    for frame in good:
        counts += frame.depth_counts
    indices = {
        modality: writer.write_shard(modality, number, [frame.chunks[modality] for frame in good])
        for modality in (job.layout.modalities if good else ())
    }
    skipped = tuple(frame for frame in frames if isinstance(frame, SkippedFrame))
    return UnitRecord(number, tuple(frame.facts for frame in good), skipped, counts, indices)


def _encode_or_skip(job: Job, reader: Reader, frame_id: str) -> EncodedFrame | SkippedFrame:
    """Encode one frame; where bad frames are to be skipped, say why it was.

    Raises
    ------
    NimprepError
        The frame is bad, and none may be; its id is the error's `frame_id`.
    """
    try:
        return encode_frame(job, reader, frame_id)
    except NimprepError as error:
        if job.options.on_error == "skip":
            reason = " ".join(str(error).split()).replace(f"{reader.root}/", "")
            return SkippedFrame(frame_id, reason)
        error.frame_id = frame_id
        raise


def encode_frame(job: Job, reader: Reader, frame_id: str) -> EncodedFrame:
    """Read one frame and make everything a store holds of it, on the calling thread alone.

    Raises
    ------
    DecodeError
        A file is damaged, holds what cannot be, or changed since the conversion began; it is named.
    """
    layout, recipe = job.layout, job.recipe
    wanted = given_for(layout.modalities)
    if recipe.fill == "colorization":
        wanted.add("rgb")
    frame = reader.read(frame_id, wanted)
    try:
        road = shows_road(frame_id, len(job.states))
        stored = _stored_images(frame, layout, recipe, road=road)
        chunks = _chunks(frame, stored.images, layout)
    except ArrayError as error:
        raise DecodeError(f"frame {frame_id!r}: {error}") from error
    digest = frame_digest(reader, frame_id)
    # Asked last: then what was decoded and what was hashed are one and the same.
    changed = changed_files(job.states[frame_id], frame_state(reader, frame_id))
    if changed:
        raise DecodeError(
            f"{reader.root / changed[0]}: expected a file that stays as it is, found it changed "
            "during the conversion; give the same command again when nobody writes there"
        )
    from nimprep.kernels.sums import count_values

    counts = np.zeros(DEPTHS, dtype=np.int64)
    if "depth" in stored.images:
        count_values(stored.images["depth"], counts)
    most_m = math.inf if reader.info.depth.certain else layout.modality("depth").most
    signs = stored.signs | frame_signs(frame, job.margins, road=road, most_m=most_m)
    frame = replace(frame, signs=signs | depth_counts_sign(counts))
    sums = channel_sums({n: stored.images[n] for n in layout.modalities}, layout.planes)
    pixels = class_pixels(stored.images.get("label"), [entry.id for entry in layout.classes])
    facts = _facts(frame, stored.gravity, sums, pixels, chunks, digest)
    return EncodedFrame(replace(facts, depth_lost=stored.depth_lost), chunks, counts)


def _facts(
    frame: Frame,
    gravity: npt.NDArray[np.float64],
    sums: npt.NDArray[np.int64],
    pixels: npt.NDArray[np.uint32],
    chunks: dict[str, bytes],
    digest: str,
) -> FrameFacts:
    transform = np.full((3, 4), np.nan) if frame.cam_to_road is None else frame.cam_to_road
    return FrameFacts(
        id=frame.id,
        group=frame.group,
        image_size=list(frame.camera.shape),
        intrinsics=frame.camera.matrix.tolist(),
        baseline_m=float(frame.baseline_m),
        cam_to_road=np.asarray(transform, dtype=np.float64).tolist(),
        gravity=gravity.tolist(),
        gravity_from=_gravity_source(frame, gravity),
        channel_sums=sums.tolist(),
        class_pixels=pixels.tolist(),
        chunk_crc32c={name: chunk_checksum(chunk) for name, chunk in chunks.items()},
        digest=digest,
        signs=dict(frame.signs),
    )


def _gravity_source(frame: Frame, gravity: npt.NDArray[np.float64]) -> GravitySource:
    if frame.gravity is not None:
        return "given"
    if np.isnan(gravity).any():
        return "none"
    return "estimated" if frame.cam_to_road is None else "cam_to_road"


class _Stored(NamedTuple):
    """What a store holds of a frame.

    Attributes
    ----------
    images : dict of modality to array
    gravity : (3,) float64
        Its direction.
    signs : dict of str to float
        Of what was derived and filled in.
    depth_lost : dict of str to float, optional
        See `FrameFacts`.
    """

    images: dict[str, npt.NDArray[Any]]
    gravity: npt.NDArray[np.float64]
    signs: dict[str, float]
    depth_lost: dict[str, float] | None


def _stored_images(frame: Frame, layout: StoreLayout, recipe: Recipe, *, road: bool) -> _Stored:
    """Return what a store holds of a frame.

    Parameters
    ----------
    road : bool
        Whether to look for the road, and how noisy its normals are.
    """
    given = {n: frame.image(n) for n, m in MODALITIES.items() if m.derived is None}
    missing, lost, depth = None, None, layout.modality("depth")
    measured = given.pop("depth")
    stored = {n: to_integers(layout.modality(n), i) for n, i in given.items() if i is not None}
    stored |= _stored_planes(frame, layout)
    signs: dict[str, float] = {}
    if measured is not None:
        stored["depth"], pixels = depth_to_integers(depth, measured)
        lost = None if pixels == 0 else lost_depth(depth, measured, stored["depth"])
        frame, missing = frame_to_derive_from(frame, depth, stored["depth"], recipe)
        if frame.depth_m is not None:
            signs = staircase_signs(frame.depth_m, missing)
        if recipe.store_filled and frame.depth_m is not None:
            stored["depth"] = depth_to_integers(depth, frame.depth_m)[0]
            frame = _with_depth(frame, depth, stored["depth"])
    derived = derive(frame, missing, layout.modalities, recipe)
    stored |= {n: to_integers(layout.modality(n), i) for n, i in derived.images.items()}
    signs |= derived_signs(frame, stored, derived.signs, recipe, road=road)
    signs |= cut_signs(derived.images, stored)
    return _Stored(stored, derived.gravity, signs, lost)


def _stored_planes(frame: Frame, layout: StoreLayout) -> dict[str, npt.NDArray[Any]]:
    stored = {}
    for plane in layout.planes:
        image = frame.others.get(plane.name)
        if image is None:
            continue
        if image.shape != frame.camera.shape:
            raise ArrayError(
                f"{plane.name}: expected a number per pixel, {frame.camera.shape} as the frame's "
                f"camera has, found {image.shape}; give it the frame's size"
            )
        stored[plane.name] = to_integers(plane, image)
    return stored


def frame_to_derive_from(
    frame: Frame, depth: Modality, stored: npt.NDArray[np.uint16], recipe: Recipe
) -> tuple[Frame, npt.NDArray[np.bool_] | None]:
    """Return the frame with the depth that is derived from, filled by the recipe: `fill_frame`."""
    return fill_frame(_with_depth(frame, depth, stored), recipe)


def _with_depth(frame: Frame, depth: Modality, stored: npt.NDArray[np.uint16]) -> Frame:
    """Return the frame with the depth that is derived from: some, unless the dataset has none.

    It is what the store says, so that what is derived can be made again. Where the store's unit
    is coarser than the source's numbers, that would spoil it: there it is depth as it was read,
    where the store has some.
    """
    if not stored.any() and "depth" not in frame.absent:
        raise ArrayError(
            f"expected depth of {1000 * depth.step / 2:g} mm to {depth.most:.6g} m somewhere, "
            "found none; check --depth-scale and --depth-unit"
        )
    if depth.rounded and frame.depth_m is not None:
        return replace(frame, depth_m=np.where(stored > 0, frame.depth_m, np.float32(0)))
    return replace(frame, depth_m=from_integers(depth, stored))


def _chunks(
    frame: Frame, stored: dict[str, npt.NDArray[Any]], layout: StoreLayout
) -> dict[str, bytes]:
    chunks = {}
    for name in layout.modalities:
        if name not in stored:
            raise DecodeError(f"frame {frame.id!r}: expected {name}, found none")
        image = _padded(stored[name], layout.image_shape(name), int(layout.spec(name).fill))
        chunks[name] = encode_chunk(image, layout.chunk_codec(name))
    return chunks


def _padded(image: npt.NDArray[Any], shape: tuple[int, ...], fill: int) -> npt.NDArray[Any]:
    if image.shape == shape:
        return image
    if image.shape[0] > shape[0] or image.shape[1] > shape[1]:
        raise ArrayError(
            f"expected at most {shape[1]}x{shape[0]} pixels like the dataset's depth, "
            f"found {image.shape[1]}x{image.shape[0]}"
        )
    padded = np.full(shape, fill, dtype=image.dtype)
    padded[: image.shape[0], : image.shape[1]] = image
    return padded
