from pathlib import Path

import numpy as np
import pytest

from nimprep.errors import StoreError
from nimprep.store.shards import decode_chunk, encode_chunk, encode_shard, read_chunk, read_index
from nimprep.store.spec import PRESETS, chunk_codec
from nimprep.store.storage import LocalStorage


def shard_file(folder: Path, images: list[np.ndarray], capacity: int) -> Path:
    codec = chunk_codec("fast", str(images[0].dtype))
    path = folder / "shard"
    path.write_bytes(b"".join(encode_shard([encode_chunk(i, codec) for i in images], capacity)))
    return path


def read_all(tmp_path: Path) -> None:
    index = read_index(LocalStorage(tmp_path), "shard", 4)
    for position in range(3):
        read_chunk(LocalStorage(tmp_path), "shard", index, position)


def images(dtype: str) -> list[np.ndarray]:
    rng = np.random.default_rng(1)
    return [rng.integers(0, 100, (9, 11), dtype=dtype) for _ in range(3)]


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("dtype", ["uint8", "int8", "uint16", "int16"])
def test_a_chunk_decodes_to_the_image_it_was(preset: str, dtype: str) -> None:
    image = images(dtype)[0]
    out = np.empty_like(image)
    decode_chunk(encode_chunk(image, chunk_codec(preset, dtype)), out, "here")
    assert np.array_equal(out, image)


def test_every_chunk_of_a_shard_is_found_and_the_rest_is_missing(tmp_path: Path) -> None:
    shard_file(tmp_path, images("uint16"), capacity=5)
    index = read_index(LocalStorage(tmp_path), "shard", 5)
    for position, image in enumerate(images("uint16")):
        packed = read_chunk(LocalStorage(tmp_path), "shard", index, position)
        assert packed is not None
        out = np.empty_like(image)
        decode_chunk(packed, out, "here")
        assert np.array_equal(out, image)
    assert read_chunk(LocalStorage(tmp_path), "shard", index, 3) is None


def test_every_single_flipped_byte_of_a_shard_is_an_error(tmp_path: Path) -> None:
    path = shard_file(tmp_path, images("uint8"), capacity=4)
    whole = path.read_bytes()
    for place in range(len(whole)):
        damaged = bytearray(whole)
        damaged[place] ^= 0x10
        path.write_bytes(damaged)
        with pytest.raises(StoreError, match="found a wrong checksum"):
            read_all(tmp_path)


@pytest.mark.parametrize("keep", [0, 10, 60])
def test_a_shard_cut_short_is_an_error(tmp_path: Path, keep: int) -> None:
    path = shard_file(tmp_path, images("uint8"), capacity=4)
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(StoreError):
        read_index(LocalStorage(tmp_path), "shard", 4)


def test_a_missing_shard_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="No such file"):
        read_index(LocalStorage(tmp_path), "none", 4)


def test_a_chunk_of_another_size_never_reaches_the_decoder() -> None:
    packed = encode_chunk(np.zeros((4, 4), np.uint8), chunk_codec("fast", "uint8"))
    with pytest.raises(StoreError, match="become 25, found 32 that become 16"):
        decode_chunk(packed, np.empty((5, 5), np.uint8), "here")


def test_the_same_image_gives_the_same_bytes_on_any_thread() -> None:
    from concurrent.futures import ThreadPoolExecutor

    image = np.random.default_rng(0).integers(0, 20, (700, 900), dtype=np.uint8)
    codec = chunk_codec("fast", "uint8")
    here = encode_chunk(image, codec)
    with ThreadPoolExecutor(3) as pool:
        assert set(pool.map(lambda _: encode_chunk(image, codec), range(6))) == {here}
