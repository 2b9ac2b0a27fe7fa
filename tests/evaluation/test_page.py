"""The page of an evaluation: self-contained, escaped, and its pictures show what was counted."""

from __future__ import annotations

import base64
import importlib.util
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner, Result

import nimprep
from nimprep.cli import main
from nimprep.evaluation import Comparison, compare_predictions
from nimprep.evaluation.overlays import draw_frames, worst_frames
from nimprep.evaluation.page import write_page
from nimprep.frame import LabelClass
from nimprep.store.reader import Store
from tests.fakes import SIZE, write_gmrp, write_nyu_like, write_png

pytest.importorskip("jinja2")
pytest.importorskip("plotly")


def run(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["evaluate", *map(str, arguments)])


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a store (s.zarr) and two methods' predictions of all frames (a, b)."""
    root = tmp_path_factory.mktemp("page")
    raw = write_gmrp(root / "raw", frames=4)
    options = {"camera": (30, 30, 15, 11), "modalities": ["rgb", "label"]}
    store = nimprep.convert(raw, root / "s.zarr", **options)
    for number, frame in enumerate(store):
        for shift, name in enumerate("ab"):
            guess = np.roll(frame.label, (number + 1) * shift, axis=0)
            write_png(root / name / f"{frame.id}.png", guess)
    return root


def compared(folders: Path) -> tuple[Store, Comparison]:
    store = nimprep.open_store(folders / "s.zarr")
    return store, compare_predictions(store, [folders / "a", folders / "b"])


def decoded(uri: str) -> np.ndarray:
    kind, data = uri.split(",")
    assert kind == "data:image/webp;base64"
    image = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR_RGB)
    return image.astype(int)


def test_the_worst_frame_is_the_one_that_methods_get_wrong_on_average(folders: Path) -> None:
    store, found = compared(folders)
    # Each frame of b is shifted by one row more than the frame before.
    assert worst_frames(found) == list(store.ids)[::-1]


def test_hits_are_green_misses_red_and_inventions_blue(tmp_path: Path) -> None:
    raw = write_gmrp(tmp_path / "raw", frames=1, size=(96, 128))
    write_png(raw / "rgb" / "000000.png", np.full((96, 128, 3), 128, np.uint8))
    label = np.zeros((96, 128), np.uint8)
    label[:48, :64] = 1
    label[80:] = 255
    write_png(raw / "label" / "000000.png", label)
    store = nimprep.convert(raw, tmp_path / "s.zarr", camera=(90, 90, 63, 47))
    guess = np.zeros_like(label)
    guess[:48, 32:96] = 1
    guess[80:] = 1
    write_png(tmp_path / "a" / "000000.png", guess)
    found = compare_predictions(store, [tmp_path / "a"])
    drawn = draw_frames(store, found, ["000000"], None)["000000"]
    (overlay,) = drawn.overlays
    assert (overlay.method, overlay.class_name) == ("a", "drivable area")
    assert overlay.iou == 32 / 96
    # Four times as large as the frame, so that stripes have room.
    assert decoded(overlay.uri).shape == (384, 512, 3)
    picture = decoded(overlay.uri).reshape(96, 4, 128, 4, 3).mean(axis=(1, 3))
    strongest = {"missed": (24, 16, 0), "hit": (24, 48, 1), "made up": (24, 80, 2)}
    for what, (v, u, channel) in strongest.items():
        red_green_blue = picture[v - 8 : v + 8, u - 8 : u + 8].mean(axis=(0, 1))
        others = np.delete(red_green_blue, channel)
        assert red_green_blue[channel] > others.max() + 80, what
    # The photograph is as it was, the label in its class's colour on grey.
    np.testing.assert_allclose(decoded(drawn.photograph), 128, atol=12)
    label = decoded(drawn.label).reshape(96, 4, 128, 4, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(
        label[20, 20], np.mean([store.classes[1].color, 3 * [118]], 0), atol=12
    )
    for v, u in ((60, 40), (90, 40)):  # right, and ignored: as photographed
        np.testing.assert_allclose(picture[v - 6 : v + 6, u - 8 : u + 8], 128, atol=12)


def test_the_page_stands_alone_and_says_what_was_scored(folders: Path, tmp_path: Path) -> None:
    out = tmp_path / "page.html"
    result = run(folders / "s.zarr", folders / "a", folders / "b", "--html", out, "--worst", "2")
    assert result.exit_code == 0
    assert re.search(r"^a +100\.00\* ", result.stdout, re.MULTILINE)
    page = out.read_text(encoding="utf-8")
    assert not re.findall(r"(?:src|href)=\"(?!data:|#)", page)
    assert "://" not in re.sub(r"data:image/webp;base64,[^\"]*", "", page)
    # Two frames: photograph, label, and two classes by two methods.
    assert page.count('src="data:image/webp') == 2 * (2 + 4)
    # And a sample of each outcome in the legend.
    assert page.count("<img") == 2 * (2 + 4) + 3
    for said in ("missed: red, striped", "made up: blue, dotted", "Photograph", "Label"):
        assert said in page
    assert page.count("<article") == 2
    assert 'class="number best">100.00<' in page
    found = compare_predictions(folders / "s.zarr", [folders / "a", folders / "b"])
    assert f"{100 * found.values(None, 'iou')[1]:.2f}" in page
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]


def test_the_page_of_one_method_has_its_groups(tmp_path: Path) -> None:
    raw, description = write_nyu_like(tmp_path / "nyu")
    options = {"description": description, "modalities": ["label"], "split_by": "frame"}
    store = nimprep.convert(raw, tmp_path / "s.zarr", **options)
    for frame in store:
        write_png(tmp_path / "a" / f"{frame.id}.png", np.ones(SIZE, np.uint8))
    result = run(store.path, tmp_path / "a", "--html", tmp_path / "page.html")
    assert re.search(r"^kitchen +2 +94\.74 ", result.stdout, re.MULTILINE)
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert '<th scope="row">kitchen</th>' in page
    # The store has no photographs: pictures are drawn on grey, beside the label alone.
    assert page.count("<img") == 4 * 2 + 3
    assert "Photograph of" not in page
    assert "methods" not in page[page.index("<main") :]


def test_names_are_escaped(folders: Path, tmp_path: Path) -> None:
    store, found = compared(folders)
    evil = "<script>alert(1)</script>\"'&"
    classes = (LabelClass(0, evil, (0, 0, 0)), *store.classes[1:2], LabelClass(2, evil, (0, 0, 0)))
    groups = dict.fromkeys(store.ids, evil)
    methods = tuple(
        replace(
            m, name=f"{evil}{n}", evaluation=replace(m.evaluation, classes=classes, groups=groups)
        )
        for n, m in enumerate(found.methods)
    )
    store.attributes["dataset"] = evil
    store.classes = classes
    write_page(tmp_path / "page.html", store, Comparison(methods))
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "alert(1)" in page
    assert "<script>alert" not in page
    assert page.count("<script") == page.count("</script>") == 2
    assert not re.search(r"<[a-z][^>]*alert\(1\)</script>[^>]*>", page)


def test_a_page_is_replaced_only_when_asked(folders: Path, tmp_path: Path) -> None:
    out = tmp_path / "page.html"
    out.write_text("mine")
    refused = run(folders / "s.zarr", folders / "a", "--html", out)
    assert refused.exit_code == 1
    assert refused.stdout == ""
    assert refused.stderr.startswith(f"error: {out}: expected a new file")
    assert out.read_text() == "mine"
    assert run(folders / "s.zarr", folders / "a", "--html", out, "--overwrite").exit_code == 0
    assert out.read_text() != "mine"
    inside = run(folders / "s.zarr", folders / "a", "--html", folders / "s.zarr" / "page.html")
    assert inside.exit_code == 1


def test_without_the_extra_one_line_says_how_to_get_it(
    folders: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    there = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *rest: None if name == "jinja2" else there(name)
    )
    result = run(folders / "s.zarr", folders / "a", "--html", tmp_path / "page.html")
    assert result.exit_code == 1
    assert result.stderr.count("\n") == 1
    assert "pip install 'nimprep[report]'" in result.stderr
    # Scores need nothing of it.
    assert run(folders / "s.zarr", folders / "a").exit_code == 0
