import os
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from nimprep.errors import ArrayError, CameraError, DecodeError, LayoutError, NimprepError
from nimprep.readers import ReaderOptions, open_reader
from nimprep.readers.crop import CroppedReader, Margins, find_invalid_sides
from tests.fakes import SIZE, depth_image, write_gmrp, write_png


@pytest.fixture
def gmrp(tmp_path: Path) -> Path:
    return write_gmrp(tmp_path / "gmrp")


def test_a_frame_holds_the_values_of_its_images(gmrp: Path) -> None:
    frame = open_reader(gmrp).read("000003")
    rgb = cv2.imread(str(gmrp / "rgb" / "000003.png"))
    assert frame.rgb is not None
    assert np.array_equal(frame.rgb, rgb[..., ::-1])
    raw = depth_image(3)
    expected = np.where(raw == 65535, 0, raw) / np.float32(1000)
    assert frame.depth_m is not None
    assert frame.depth_m.dtype == np.float32
    assert np.array_equal(frame.depth_m, expected)
    assert frame.label is not None
    assert np.unique(frame.label).tolist() == [0, 1, 2]


def test_both_raw_values_for_no_depth_become_zero(gmrp: Path) -> None:
    depth_m = open_reader(gmrp).read("000000").depth_m
    assert depth_m is not None
    assert depth_m[0, 5] == 0
    assert depth_m[-1, -1] == 0


def test_frames_come_sorted_by_name_and_depth_u8_is_ignored(gmrp: Path) -> None:
    (gmrp / "depth_u8" / "000000.png").unlink()
    assert open_reader(gmrp).ids == tuple(f"{n:06d}" for n in range(5))


def test_without_calibration_the_nominal_camera_is_taken_and_said(gmrp: Path) -> None:
    reader = open_reader(gmrp)
    camera = reader.read("000000").camera
    assert reader.info.calibration == "nominal"
    assert "nominal" in reader.info.notes[0]
    assert np.isclose(2 * np.degrees(np.arctan(16 / camera.fx)), 69.4)
    assert (camera.cx, camera.cy) == (15.5, 11.5)


def test_given_intrinsics_are_the_users(gmrp: Path) -> None:
    options = ReaderOptions(camera=(30, 31, 15, 11))
    reader = open_reader(gmrp, options=options)
    assert reader.info.calibration == "user"
    assert reader.read("000000").camera.fy == 31


def test_a_camera_file_beside_the_folders_is_found(gmrp: Path) -> None:
    (gmrp / "camera.json").write_text('{"fx": 30, "fy": 30, "cx": 15, "cy": 11}')
    reader = open_reader(gmrp)
    assert reader.info.calibration == "file"
    assert reader.read("000000").camera.cx == 15


def test_reading_only_depth_leaves_the_rest_undecoded(gmrp: Path) -> None:
    (gmrp / "rgb" / "000000.png").write_bytes(b"broken")
    frame = open_reader(gmrp).read("000000", ("depth",))
    assert frame.rgb is None
    assert frame.depth_m is not None


def test_the_real_frame_reads(reference_data: Path) -> None:
    reader = open_reader(reference_data / "gmrp")
    frame = reader.read("000001")
    raw = cv2.imread(str(reference_data / "gmrp/depth_u16/000001.png"), cv2.IMREAD_UNCHANGED)
    assert frame.depth_m is not None
    assert np.array_equal(frame.depth_m == 0, (raw == 0) | (raw == 65535))
    assert reader.shape("000001") == (720, 1280)


def test_invalid_sides_are_those_without_depth_in_any_frame(tmp_path: Path) -> None:
    root = write_gmrp(tmp_path / "gmrp", frames=2)
    for number, left in ((0, 4), (1, 6)):
        depth = depth_image(number)
        depth[:, :left] = 0
        depth[-2:] = 0
        write_png(root / "depth_u16" / f"{number:06d}.png", depth)
    reader = open_reader(root)
    margins = find_invalid_sides(reader, workers=2)
    assert margins == Margins(top=0, bottom=2, left=4, right=0)
    whole, cropped = reader.read("000001"), CroppedReader(reader, margins).read("000001")
    assert cropped.camera.cx == whole.camera.cx - 4
    assert cropped.camera.cy == whole.camera.cy
    assert whole.rgb is not None
    assert cropped.rgb is not None
    assert np.array_equal(cropped.rgb, whole.rgb[:-2, 4:])


def test_a_crop_that_leaves_nothing_is_refused(gmrp: Path) -> None:
    reader = CroppedReader(open_reader(gmrp), Margins(12, 12, 0, 0))
    with pytest.raises(LayoutError, match="leave something of 32x24"):
        reader.shape("000001")


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(LayoutError, match=r"nowhere: expected a dataset's folder"):
        open_reader(tmp_path / "nowhere")


def test_an_empty_folder_is_said_to_be_empty(tmp_path: Path) -> None:
    with pytest.raises(LayoutError, match="found an empty folder"):
        open_reader(tmp_path)


def test_an_unknown_reader_is_refused_with_those_there_are(gmrp: Path) -> None:
    with pytest.raises(ArrayError, match="gmrp"):
        ReaderOptions(reader="kitty")  # type: ignore[arg-type]


@pytest.mark.parametrize("folder", ["rgb", "depth_u16", "label"])
def test_a_frame_that_lacks_a_modality_is_named(gmrp: Path, folder: str) -> None:
    (gmrp / folder / "000002.png").unlink()
    reader = open_reader(gmrp)
    name = {"depth_u16": "depth"}.get(folder, folder)
    said = rf"{folder}/000002\.png: expected {name} of frame '000002', found none$"
    for ask in (reader.read, reader.sources, reader.shape):
        with pytest.raises(DecodeError, match=said):
            ask("000002")
    assert reader.read("000001").label is not None


def test_labels_need_not_be_there_when_not_asked_for(tmp_path: Path) -> None:
    root = write_gmrp(tmp_path / "gmrp", labels=False)
    with pytest.raises(LayoutError, match="--no-labels"):
        open_reader(root)
    reader = open_reader(root, labels=False)
    assert reader.read("000000").label is None
    assert reader.info.classes == ()


GREY8 = np.full(SIZE, 9, np.uint8)
GREY16 = np.full(SIZE, 2000, np.uint16)
COLOR8 = np.full((*SIZE, 3), 9, np.uint8)


@pytest.mark.parametrize(
    ("folder", "image", "words"),
    [
        ("depth_u16", GREY8, "16-bit or floating-point depth, found 8-bit"),
        ("depth_u16", COLOR8, "one channel, found 3 channels"),
        ("depth_u16", GREY16 * 0, "no pixel that has any"),
        ("depth_u16", GREY16 // 1000, "median depth of 0.05 to 100 m, found 0.002 m"),
        ("depth_u16", np.full((24, 33), 2000, np.uint16), "expected 32x24 pixels"),
        ("rgb", np.full((25, 32, 3), 9, np.uint8), "found 32x24"),
        ("rgb", np.full((*SIZE, 3), 9, np.uint16), "8-bit colour image, found 32x24 uint16"),
        ("label", GREY8, r"expected labels \[0, 1, 2, 255\], found 9"),
        ("label", COLOR8 * np.array([0, 1, 2], np.uint8), "found a colour image"),
    ],
)
def test_an_image_that_cannot_be_right_is_named(
    gmrp: Path, folder: str, image: np.ndarray, words: str
) -> None:
    write_png(gmrp / folder / "000001.png", image)
    with pytest.raises(DecodeError, match=words) as caught:
        open_reader(gmrp).read("000001")
    assert "000001.png" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("folder", ["rgb", "depth_u16", "label"])
@pytest.mark.parametrize("damage", ["empty", "cut", "flipped", "text", "huge"])
def test_a_damaged_file_is_named_and_nothing_is_printed(
    gmrp: Path, folder: str, damage: str, capfd: pytest.CaptureFixture[str]
) -> None:
    path = gmrp / folder / "000001.png"
    data = bytearray(path.read_bytes())
    if damage == "cut":
        data = data[:-20]
    elif damage == "flipped":
        data[60] ^= 1
    elif damage == "huge":
        data[16:24] = (100_000).to_bytes(4, "big") * 2
    else:
        data = bytearray(b"" if damage == "empty" else b"not an image at all, sorry")
    path.write_bytes(data)
    with pytest.raises(DecodeError, match=r"000001\.png"):
        open_reader(gmrp).read("000001")
    assert capfd.readouterr() == ("", "")


def test_depth_scale_is_believed_where_it_is_given(gmrp: Path) -> None:
    write_png(gmrp / "depth_u16" / "000001.png", np.full(SIZE, 3, np.uint16))
    frame = open_reader(gmrp, options=ReaderOptions(depth_scale=1.0)).read("000001")
    assert frame.depth_m is not None
    assert (frame.depth_m == 3).all()


def test_an_image_of_another_size_than_the_camera_is_refused(gmrp: Path) -> None:
    (gmrp / "camera.json").write_text(
        '{"fx": 30, "fy": 30, "cx": 15, "cy": 11, "width": 64, "height": 48}'
    )
    with pytest.raises(CameraError, match="64x48"):
        open_reader(gmrp).read("000000")


def test_every_error_is_a_nimprep_error() -> None:
    assert issubclass(LayoutError, NimprepError)
    assert issubclass(LayoutError, FileNotFoundError)
    assert issubclass(DecodeError, ValueError)


@pytest.mark.parametrize("bits", [1, 2, 4])
def test_a_label_of_few_bits_keeps_its_values(gmrp: Path, bits: int) -> None:
    values = np.arange(SIZE[0] * SIZE[1]).reshape(SIZE) % min(3, 1 << bits)
    (gmrp / "label" / "000001.png").write_bytes(grey_png(values, bits))
    label = open_reader(gmrp).read("000001").label
    assert np.array_equal(label, values)


def grey_png(values: np.ndarray, bits: int) -> bytes:
    """Pack a grey PNG of less than 8 bits, which OpenCV does not write."""
    digits = ((values[..., None] >> np.arange(bits)[::-1]) & 1).reshape(len(values), -1)
    rows = b"".join(b"\0" + np.packbits(row).tobytes() for row in digits)
    header = struct.pack(">IIBBBBB", values.shape[1], len(values), bits, 0, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )


def test_names_in_capitals_and_linked_folders_are_read_too(tmp_path: Path) -> None:
    root = write_gmrp(tmp_path / "gmrp", frames=2)
    for folder in ("rgb", "depth_u16", "label"):
        (root / folder / "000001.png").rename(root / folder / "000001.PNG")
        (tmp_path / "more" / folder).mkdir(parents=True)
        (root / folder / "000000.png").rename(tmp_path / "more" / folder / "7.png")
        (root / folder / "linked").symlink_to(tmp_path / "more" / folder)
        (root / folder / "linked" / "again").symlink_to(root / folder / "linked")
    reader = open_reader(root)
    assert reader.ids == ("000001", "linked/7")
    assert reader.read("linked/7").rgb is not None


def test_a_pipe_is_no_image(gmrp: Path) -> None:
    os.mkfifo(gmrp / "rgb" / "pipe.png")
    assert len(open_reader(gmrp).ids) == 5


def test_a_name_that_cannot_be_written_down_is_refused(gmrp: Path) -> None:
    for folder in ("rgb", "depth_u16", "label"):
        path = os.fsencode(gmrp / folder) + b"/\xff.png"
        with open(path, "wb") as file:  # noqa: PTH123
            file.write((gmrp / folder / "000000.png").read_bytes())
    with pytest.raises(LayoutError, match="printable"):
        open_reader(gmrp)
