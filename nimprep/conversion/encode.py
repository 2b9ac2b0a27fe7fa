"""From frames to shards: each frame is checked, derived from, quantised, padded and compressed."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.conversion.doubted import derived_signs, frame_signs, shows_road
from nimprep.conversion.plan import Job
from nimprep.conversion.records import DEPTHS, FrameFacts, SkippedFrame, UnitRecord
from nimprep.conversion.sources import changed_files, frame_digest, frame_state
from nimprep.derive.modalities import derive, fill_frame
from nimprep.derive.recipe import Recipe
from nimprep.doubts.surfaces import depth_counts_sign
from nimprep.errors import ArrayError, DecodeError, NimprepError
from nimprep.frame import Frame
from nimprep.modality import MODALITIES, given_for
from nimprep.parallel import available_cores, in_order
from nimprep.readers.base import Reader
from nimprep.store.checksums import chunk_checksum
from nimprep.store.frames import depth_from_millimetres, depth_to_millimetres, to_integers
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
        Pixels per depth in millimetres.
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
    layout, recipe = job.layout, job.options.recipe
    wanted = given_for(layout.modalities)
    if recipe.fill == "colorization":
        wanted.add("rgb")
    frame = reader.read(frame_id, wanted)
    try:
        road = shows_road(frame_id, len(job.states))
        stored, gravity, signs = _stored_images(frame, layout, recipe, road=road)
        chunks = _chunks(frame, stored, layout)
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
    if "depth" in stored:
        count_values(stored["depth"], counts)
    signs |= frame_signs(frame, job.margins, road=road) | depth_counts_sign(counts)
    frame = replace(frame, signs=signs)
    sums = channel_sums({n: stored[n] for n in layout.modalities}, layout.planes)
    pixels = class_pixels(stored.get("label"), [entry.id for entry in layout.classes])
    return EncodedFrame(_facts(frame, gravity, sums, pixels, chunks, digest), chunks, counts)


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
        channel_sums=sums.tolist(),
        class_pixels=pixels.tolist(),
        chunk_crc32c={name: chunk_checksum(chunk) for name, chunk in chunks.items()},
        digest=digest,
        signs=dict(frame.signs),
    )


def _stored_images(
    frame: Frame, layout: StoreLayout, recipe: Recipe, *, road: bool
) -> tuple[dict[str, npt.NDArray[Any]], npt.NDArray[np.float64], dict[str, float]]:
    """Return the frame's images as the store holds them, the direction of gravity, and signs.

    Parameters
    ----------
    road : bool
        Whether to look for the road, and how noisy its normals are.
    """
    given = {n: frame.image(n) for n, m in MODALITIES.items() if m.derived is None}
    stored = {n: to_integers(layout.modality(n), i) for n, i in given.items() if i is not None}
    stored |= _stored_planes(frame, layout)
    missing = None
    if "depth" in stored:
        # From here on depth is what the store says it is: what is derived can be made again.
        frame, missing = fill_frame(_with_depth(frame, stored["depth"]), recipe)
        if recipe.store_filled and frame.depth_m is not None:
            stored["depth"] = depth_to_millimetres(frame.depth_m)
            frame = _with_depth(frame, stored["depth"])
    derived = derive(frame, missing, layout.modalities, recipe)
    stored |= {n: to_integers(layout.modality(n), i) for n, i in derived.images.items()}
    signs = derived_signs(frame, stored, derived.signs, recipe, road=road)
    return stored, derived.gravity, signs


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


def _with_depth(frame: Frame, millimetres: npt.NDArray[np.uint16]) -> Frame:
    """Return the frame with its depth as the store holds it: some, unless the dataset has none."""
    if not millimetres.any() and "depth" not in frame.absent:
        raise ArrayError(
            "expected depth of 0.5 mm to 65.535 m somewhere, found none; check --depth-scale"
        )
    return replace(frame, depth_m=depth_from_millimetres(millimetres))


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
