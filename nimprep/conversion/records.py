"""What is kept of frames once their images are written: facts per frame, records per unit."""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import google_crc32c
import numpy as np
import numpy.typing as npt

from nimprep.modality import Modality
from nimprep.splits import SPLIT_CODES
from nimprep.store.attributes import GravitySource

DEPTHS = 1 << 16
"""Values a stored depth can have."""


def seal(document: dict[str, Any]) -> bytes:
    """Return a JSON document that tells whether it is whole and as it was written."""
    crc = google_crc32c.value(json.dumps(document).encode())
    return json.dumps({**document, "crc32c": crc}).encode()


def unseal(data: bytes) -> dict[str, Any]:
    """Return the document that was sealed.

    Raises
    ------
    ValueError
        It is not whole, not as it was written, or was never sealed.
    """
    document = json.loads(data)
    if not isinstance(document, dict):
        raise ValueError(f"expected an object, found {type(document).__name__}")
    crc = document.pop("crc32c", None)
    if crc != google_crc32c.value(json.dumps(document).encode()):
        raise ValueError("expected a document as it was written, found a wrong checksum")
    return document


@dataclass(frozen=True)
class FrameFacts:
    """Hold what a store's tables say of a frame; lists as JSON has them.

    Attributes
    ----------
    id, group : str
    image_size : [height, width]
    intrinsics : 3 x 3
        K, pixels.
    baseline_m : float
    cam_to_road : 3 x 4
        NaN where there is none.
    gravity : 3
        Direction as given, or as HHA was made with; NaN without either.
    gravity_from : str
        Where it comes from: see `nimprep.store.attributes.GRAVITY_SOURCES`.
    channel_sums : 7 x 3
        See `nimprep.store.statistics.channel_sums`.
    class_pixels : K + 1
        See `nimprep.store.statistics.class_pixels`.
    chunk_crc32c : dict of modality to int
        What the frame's chunks end with.
    digest : str
        SHA-256 of the frame's source files.
    signs : dict of str to float
        What may tell that it was read wrongly: see `nimprep.doubts`.
    depth_lost : dict of str to float, optional
        What the store has not of its depth: see `nimprep.store.depth_loss`, without the share.
    """

    id: str
    group: str
    image_size: list[int]
    intrinsics: list[list[float]]
    baseline_m: float
    cam_to_road: list[list[float]]
    gravity: list[float]
    gravity_from: GravitySource
    channel_sums: list[list[int]]
    class_pixels: list[int]
    chunk_crc32c: dict[str, int]
    digest: str
    signs: dict[str, float]
    depth_lost: dict[str, float] | None = None


@dataclass(frozen=True)
class SkippedFrame:
    """Name a frame that was left out, and why."""

    id: str
    reason: str


@dataclass(frozen=True)
class UnitRecord:
    """Hold what is known of a unit, one shard of every array, once its shards are written.

    Attributes
    ----------
    number : int
    frames : tuple of FrameFacts
        Those in the shards, in order.
    skipped : tuple of SkippedFrame
    depth_counts : (65536,) int64
        Pixels per depth in the store's unit.
    indices : dict of modality to int
        What each shard's index, and so the shard, ends with.
    """

    number: int
    frames: tuple[FrameFacts, ...]
    skipped: tuple[SkippedFrame, ...]
    depth_counts: npt.NDArray[np.int64]
    indices: dict[str, int]

    def to_json(self, plan: str = "") -> bytes:
        """Return the record as a sealed JSON document; floats keep every digit.

        Parameters
        ----------
        plan : str
            What the record belongs to.
        """
        counts = zlib.compress(self.depth_counts.astype("<i8").tobytes(), 1)
        document = {
            "plan": plan,
            "number": self.number,
            "frames": [asdict(frame) for frame in self.frames],
            "skipped": [asdict(frame) for frame in self.skipped],
            "depth_counts": base64.b64encode(counts).decode(),
            "indices": self.indices,
        }
        return seal(document)

    @classmethod
    def from_json(cls, data: bytes, plan: str = "") -> UnitRecord:
        """Return the record that `to_json` wrote.

        Raises
        ------
        ValueError
            It is not whole, or belongs to something else.
        """
        document = unseal(data)
        if document.get("plan") != plan:
            raise ValueError(
                f"expected a record of {plan!r}, found one of {document.get('plan')!r}"
            )
        counts = zlib.decompress(base64.b64decode(document["depth_counts"]))
        return cls(
            number=document["number"],
            frames=tuple(FrameFacts(**frame) for frame in document["frames"]),
            skipped=tuple(SkippedFrame(**frame) for frame in document["skipped"]),
            depth_counts=np.frombuffer(counts, dtype="<i8").astype(np.int64),
            indices=document["indices"],
        )

    def without_counts(self) -> UnitRecord:
        """Return the record without its histogram, which outweighs all the rest."""
        return replace(self, depth_counts=self.depth_counts[:0].copy())


@dataclass(frozen=True)
class Records:
    """Hold what is known of all of a plan's units once they are written.

    Attributes
    ----------
    units : tuple of UnitRecord
        In order, without their histograms.
    depth_counts : (65536,) int64
        Pixels per depth in the store's unit, of all units of work.
    """

    units: tuple[UnitRecord, ...]
    depth_counts: npt.NDArray[np.int64]

    @property
    def facts(self) -> list[FrameFacts]:
        """What is known of every frame that is stored, in order."""
        return [frame for unit in self.units for frame in unit.frames]

    @property
    def skipped(self) -> list[SkippedFrame]:
        """The frames that were left out, in order."""
        return [frame for unit in self.units for frame in unit.skipped]


def tables(
    facts: Sequence[FrameFacts], splits: Sequence[str], modalities: Sequence[str]
) -> dict[str, npt.NDArray[Any]]:
    """Return the per-frame arrays, by the names of `nimprep.store.table_specs.table_specs`."""
    return {
        "frame_id": np.array([f.id for f in facts], dtype="T"),
        "split": np.array([SPLIT_CODES[s] for s in splits], dtype=np.uint8),
        "group": np.array([f.group for f in facts], dtype="T"),
        "image_size": np.array([f.image_size for f in facts], dtype=np.int32),
        "intrinsics": np.array([f.intrinsics for f in facts]),
        "baseline": np.array([f.baseline_m for f in facts]),
        "cam_to_road": np.array([f.cam_to_road for f in facts]),
        "gravity": np.array([f.gravity for f in facts]),
        "channel_sums": np.array([f.channel_sums for f in facts], dtype=np.int64),
        "class_pixels": np.array([f.class_pixels for f in facts], dtype=np.uint32),
        "chunk_crc32c": np.array(
            [[f.chunk_crc32c[m] for m in modalities] for f in facts], dtype=np.uint32
        ),
    }


def source_digest(facts: Iterable[FrameFacts]) -> str:
    """Return the digest of all frames' sources, as the root's attributes have it."""
    digest = hashlib.sha256()
    for frame in facts:
        digest.update(f"{frame.id}\0{frame.digest}\n".encode())
    return f"sha256:{digest.hexdigest()}"


def depth_percentiles(counts: npt.NDArray[np.int64], depth: Modality) -> dict[str, float] | None:
    """Return the 5th, 50th and 95th percentile, metres, of a histogram over a store's integers.

    Each is the smallest depth that this share of the pixels with depth does not exceed.
    """
    below = np.cumsum(counts[1:])
    if below[-1] == 0:
        return None
    ranks = {str(p): -(-p * int(below[-1]) // 100) for p in (5, 50, 95)}
    integers = {p: int(np.searchsorted(below, rank)) + 1 for p, rank in ranks.items()}
    return {p: depth.number_of(integer) for p, integer in integers.items()}
