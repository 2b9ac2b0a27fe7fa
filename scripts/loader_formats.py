"""The same frames in other formats, read the way each format's documentation shows.

Every `make_x(frames, folder)` writes the frames and returns a `Format`: how to iterate over them in
shuffled batches in one process or with workers. What is not installed raises ImportError.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

Arrays = dict[str, np.ndarray]
BATCH = 4


@dataclass
class Format:
    """Say how to iterate: `batches(workers)` gives shuffled epochs; 0 = in this process.

    `isolated`: time it in a process of its own. FFCV alters types that numba shares with others.
    """

    batches: Callable[[int], Iterable[Any]]
    isolated: bool = False


def finished(image: Tensor, name: str) -> Tensor:
    """Return one stored image, or a batch of them, as a network takes it."""
    if name == "label":
        return image.to(torch.int64)
    if name == "depth":
        return image.to(torch.float32).div_(1e4).unsqueeze(-3)
    scale = 127 if name == "normal" else 255
    return (
        image.movedim(-1, -3).to(torch.float32, memory_format=torch.contiguous_format).div_(scale)
    )


class Finish:
    """Turn stored arrays into tensors, float or as they are."""

    def __init__(self, names: Sequence[str], dtype: str) -> None:
        self.names = names
        self.dtype = dtype

    def __call__(self, arrays: Arrays) -> dict[str, Tensor]:
        tensors = {name: torch.as_tensor(arrays[name]) for name in self.names}
        if self.dtype == "stored":
            return tensors
        return {name: finished(tensor, name) for name, tensor in tensors.items()}


class Frames(Dataset[dict[str, Tensor]]):
    """A map-style dataset over a function that reads one frame's arrays."""

    def __init__(self, count: int, read: Callable[[int], Arrays], finish: Finish) -> None:
        self.count, self.read, self.finish = count, read, finish

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> dict[str, Tensor]:
        return self.finish(self.read(index))


def loader(dataset: Any, workers: int, **options: Any) -> DataLoader[Any]:
    """Return torch's DataLoader over it."""
    keep = {"persistent_workers": True} if workers else {}
    return DataLoader(dataset, BATCH, num_workers=workers, **keep, **options)


def mapped(count: int, read: Callable[[int], Arrays], finish: Finish) -> Format:
    """Return the format of a map-style dataset."""
    return Format(lambda workers: loader(Frames(count, read, finish), workers, shuffle=True))


def encoded(image: np.ndarray) -> bytes:
    """Return an image as a PNG; normals with 128 added, as is done for want of a sign."""
    if image.dtype == np.int8:
        image = (image.astype(np.int16) + 128).astype(np.uint8)
    return bytes(cv2.imencode(".png", image)[1])


def decoded(data: bytes, name: str) -> np.ndarray:
    """Return a PNG's image as it was stored."""
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if name == "normal":
        return (image.astype(np.int16) - 128).astype(np.int8)
    return image


def make_png(frames: Sequence[Arrays], folder: Path, finish: Finish) -> Format:
    """Write a folder of PNGs per modality."""
    for number, frame in enumerate(frames):
        for name in finish.names:
            (folder / name).mkdir(exist_ok=True)
            (folder / name / f"{number}.png").write_bytes(encoded(frame[name]))

    def read(index: int) -> Arrays:
        paths = {name: folder / name / f"{index}.png" for name in finish.names}
        return {name: decoded(path.read_bytes(), name) for name, path in paths.items()}

    return mapped(len(frames), read, finish)


def make_memmap(frames: Sequence[Arrays], folder: Path, finish: Finish) -> Format:
    """Write one raw .npy per modality."""
    for name in finish.names:
        np.save(folder / f"{name}.npy", np.stack([frame[name] for frame in frames]))
    maps = {name: np.load(folder / f"{name}.npy", mmap_mode="r") for name in finish.names}

    def read(index: int) -> Arrays:
        return {name: np.array(values[index]) for name, values in maps.items()}

    return mapped(len(frames), read, finish)


def _make_hdf5(codec: str, frames: Sequence[Arrays], folder: Path, finish: Finish) -> Format:
    import h5py
    import hdf5plugin

    options = hdf5plugin.LZ4() if codec == "lz4" else hdf5plugin.Zstd(clevel=3)
    path = folder / "frames.h5"
    with h5py.File(path, "w") as file:
        for name in finish.names:
            values = np.stack([frame[name] for frame in frames])
            file.create_dataset(name, data=values, chunks=(1, *values.shape[1:]), **options)
    opened: dict[str, Any] = {}

    def read(index: int) -> Arrays:
        if not opened:
            opened["file"] = h5py.File(path)
        return {name: opened["file"][name][index] for name in finish.names}

    def batches(workers: int) -> Iterable[Any]:
        opened.clear()
        return loader(Frames(len(frames), read, finish), workers, shuffle=True)

    return Format(batches)


def make_hdf5_lz4(frames: Sequence[Arrays], folder: Path, finish: Finish) -> Format:
    """Write HDF5 with LZ4, a chunk per frame."""
    return _make_hdf5("lz4", frames, folder, finish)


def make_hdf5_zstd(frames: Sequence[Arrays], folder: Path, finish: Finish) -> Format:
    """Write HDF5 with Zstd, a chunk per frame."""
    return _make_hdf5("zstd", frames, folder, finish)


def make_webdataset(frames: Sequence[Arrays], folder: Path, finish: Finish) -> Format:
    """Write a tar of PNGs."""
    import webdataset

    with webdataset.TarWriter(str(folder / "frames-0.tar")) as tar:
        for number, frame in enumerate(frames):
            pngs = {f"{name}.png": encoded(frame[name]) for name in finish.names}
            tar.write({"__key__": f"{number:06d}", **pngs})
    with webdataset.TarWriter(str(folder / "frames-1.tar")):
        pass

    def read(sample: dict[str, Any]) -> dict[str, Tensor]:
        return finish({name: decoded(sample[f"{name}.png"], name) for name in finish.names})

    def batches(workers: int) -> Iterable[Any]:
        urls = [str(folder / "frames-0.tar")]
        data = webdataset.WebDataset(urls, shardshuffle=False, empty_check=False)
        return loader(data.shuffle(len(frames)).map(read), workers)

    return Format(batches)


def _make_litdata(
    compression: str | None, frames: Sequence[Arrays], folder: Path, finish: Finish
) -> Format:
    import litdata
    from litdata.streaming.writer import BinaryWriter

    writer = BinaryWriter(str(folder), chunk_bytes="64MB", compression=compression)
    for number, frame in enumerate(frames):
        writer[number] = {name: np.ascontiguousarray(frame[name]) for name in finish.names}
    writer.done()
    writer.merge()

    class Streamed(litdata.StreamingDataset):  # type: ignore[misc]
        def __getitem__(self, index: Any) -> dict[str, Tensor]:
            return finish(super().__getitem__(index))

    def batches(workers: int) -> Iterable[Any]:
        data = Streamed(str(folder), shuffle=True)
        return litdata.StreamingDataLoader(data, batch_size=BATCH, num_workers=workers)

    return Format(batches)


def make_litdata_raw(frames: Sequence[Arrays], folder: Path, finish: Finish) -> Format:
    """Write litdata chunks of raw arrays."""
    return _make_litdata(None, frames, folder, finish)


def make_litdata_zstd(frames: Sequence[Arrays], folder: Path, finish: Finish) -> Format:
    """Write litdata chunks compressed by Zstd."""
    return _make_litdata("zstd", frames, folder, finish)


def make_mds(frames: Sequence[Arrays], folder: Path, finish: Finish) -> Format:
    """Write MosaicML's MDS shards of raw arrays."""
    from streaming import MDSWriter, StreamingDataset
    from streaming.base.util import clean_stale_shared_memory

    columns = {
        name: f"ndarray:{frames[0][name].dtype}:{','.join(map(str, frames[0][name].shape))}"
        for name in finish.names
    }
    with MDSWriter(out=str(folder), columns=columns) as writer:
        for frame in frames:
            writer.write({name: frame[name] for name in finish.names})

    class Streamed(StreamingDataset):  # type: ignore[misc]
        def __getitem__(self, index: Any) -> dict[str, Tensor]:
            return finish(super().__getitem__(index))

    def batches(workers: int) -> Iterable[Any]:
        clean_stale_shared_memory()
        return loader(Streamed(local=str(folder), shuffle=True, batch_size=BATCH), workers)

    return Format(batches)


def make_ffcv(frames: Sequence[Arrays], folder: Path, finish: Finish) -> Format:
    """Write FFCV's raw arrays; its own threads read, 1 or `workers` of them."""
    from ffcv.fields import NDArrayField
    from ffcv.writer import DatasetWriter

    # Signed and 16-bit arrays as bytes: its tensors know uint8 of any shape.
    def as_bytes(image: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(image).view(np.uint8).reshape(image.shape[0], -1)

    shown = {name: as_bytes(frames[0][name]) for name in finish.names}
    fields = {name: NDArrayField(np.dtype(np.uint8), shown[name].shape) for name in shown}

    class Indexed:
        def __len__(self) -> int:
            return len(frames)

        def __getitem__(self, index: int) -> tuple[np.ndarray, ...]:
            return tuple(as_bytes(frames[index][name]) for name in finish.names)

    path = str(folder / "frames.beton")
    DatasetWriter(path, fields, num_workers=1).from_indexed_dataset(Indexed())
    example = {name: frames[0][name][:0] for name in finish.names}
    shapes = {name: frames[0][name].shape for name in finish.names}
    return Format(partial(ffcv_batches, path, example, shapes, finish), isolated=True)


def ffcv_batches(
    path: str, example: Arrays, shapes: dict[str, tuple[int, ...]], finish: Finish, workers: int
) -> Iterable[Any]:
    """Iterate over FFCV's file, giving its bytes their types back."""
    from ffcv.fields.decoders import NDArrayDecoder
    from ffcv.loader import Loader, OrderOption
    from ffcv.transforms import ToTensor

    data = Loader(
        path,
        batch_size=BATCH,
        num_workers=max(workers, 1),
        order=OrderOption.RANDOM,
        pipelines={name: [NDArrayDecoder(), ToTensor()] for name in shapes},
        drop_last=False,
    )
    return _Refined(data, example, shapes, finish)


class _Refined:
    """Give FFCV's batches of bytes their types back, and finish them as batches."""

    def __init__(self, data: Iterable[Any], example: Arrays, shapes: Any, finish: Finish) -> None:
        self.data, self.finish = data, finish
        self.types = {n: (torch.as_tensor(example[n]).dtype, shapes[n]) for n in shapes}

    def __iter__(self) -> Any:
        for batch in self.data:
            tensors = {}
            for (name, (dtype, shape)), values in zip(self.types.items(), batch, strict=True):
                tensors[name] = values.view(dtype).reshape(len(values), *shape)
            yield self.finish(tensors)  # type: ignore[arg-type]


def quiet() -> None:
    """Silence what the other libraries warn of."""
    warnings.simplefilter("ignore")
