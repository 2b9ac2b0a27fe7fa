"""The saved page: whole by itself, well-formed, harmless whatever names say, within its size."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner, Result

import nimprep
from nimprep.cli import main
from nimprep.errors import LayoutError, NimprepError, StoreError
from nimprep.modality import Modality
from nimprep.report import gallery as gallery_module
from nimprep.report import page as page_module
from nimprep.report.artist import Artist
from nimprep.report.charts import make_charts
from nimprep.report.collect import collect
from nimprep.report.gallery import Gallery, order_of_interest, paint_gallery
from nimprep.report.page import asset, percent, render_page
from nimprep.report.pictures import NO_VALUE, viridis
from nimprep.report.store_page import write_report
from nimprep.store.resplit import resplit
from nimprep.store.spec import ArraySpec
from tests.fakes import write_gmrp

from .stores import (
    EVIL_CLASS,
    EVIL_ID,
    HEIGHT,
    WIDTH,
    Folder,
    convert,
    gmrp_store,
    mixed_store,
)

VOID = {"meta", "link", "img", "input", "br", "path", "circle", "rect"}


class Checked(HTMLParser):
    """Read a page; keep its elements, and complain of what does not nest."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text: dict[str, str] = {}
        self.scripts: list[str] = []
        self.feed(html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "script":
            attributes = next(a for t, a in reversed(self.elements) if t == "script")
            if attributes.get("type") == "application/json":
                self.text[str(attributes["id"])] = self.text.get(str(attributes["id"]), "") + data
            else:
                self.scripts.append(data)

    def data(self, name: str) -> object:
        return json.loads(self.text[name])


def report(store: Path, out: Path, **options: object) -> str:
    write_report(store, out, **options)  # type: ignore[arg-type]
    return out.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def evil(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a store whose ids, scenes and classes are what an attacker would call them."""
    folder = Folder(tmp_path_factory.mktemp("evil") / "raw", ("other", EVIL_CLASS, "{{ 7 * 7 }}"))
    folder.add("train", EVIL_ID)
    folder.add("test", "<!--/%{x}&quot;'`${1}")
    folder.add("test", '" onload="window.hacked=1/0')
    return folder.store()


@pytest.fixture(scope="module")
def page(evil: Path) -> str:
    return report(evil, evil.parent / "page.html")


def test_the_page_is_well_formed_and_names_each_control(page: str) -> None:
    checked = Checked(page)
    ids = [a["id"] for _, a in checked.elements if "id" in a]
    assert len(ids) == len(set(ids))
    for tag, attributes in checked.elements:
        if tag == "img":
            assert "alt" in attributes
        if tag == "label":
            assert attributes["for"] in ids
        if "aria-labelledby" in attributes:
            assert attributes["aria-labelledby"] in ids
        if tag == "a":
            assert str(attributes["href"])[1:] in ids
    tags = [tag for tag, _ in checked.elements]
    for landmark in ("header", "nav", "main", "footer", "dialog"):
        assert tags.count(landmark) == 1
    labelled = {a["for"] for t, a in checked.elements if t == "label"}
    controls = [a for t, a in checked.elements if t in ("select", "input")]
    assert {a["id"] for a in controls} == labelled


def test_the_page_loads_nothing_from_anywhere(page: str) -> None:
    checked = Checked(page)
    for tag, attributes in checked.elements:
        for name in ("src", "href", "action", "data", "poster", "srcset"):
            address = attributes.get(name) or ""
            assert not address or address.startswith(("data:", "#")), (tag, name, address)
    assert "@import" not in asset("style.css")
    assert "url(" not in asset("style.css")
    assert not re.search(
        r"https?://|fetch\(|XMLHttpRequest", asset("base.js") + asset("gallery.js")
    )


def test_the_policy_lets_only_the_pages_own_scripts_run(page: str) -> None:
    checked = Checked(page)
    policy = next(a for t, a in checked.elements if t == "meta" and "http-equiv" in a)["content"]
    assert policy is not None
    assert "default-src 'none'" in policy
    assert "unsafe-eval" not in policy
    allowed = re.findall(r"'sha256-([^']+)'", policy)
    digests = [
        base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        for text in checked.scripts
    ]
    assert digests == allowed
    assert len(digests) == 3
    assert "script-src 'unsafe" not in policy


def test_hostile_names_are_text_and_nothing_else(page: str, evil: Path) -> None:
    checked = Checked(page)
    tags = [tag for tag, _ in checked.elements]
    assert "b" not in tags
    names = {name for _, attributes in checked.elements for name in attributes}
    assert not {name for name in names if name.startswith("on")}
    data = checked.data("gallery-data")
    assert isinstance(data, dict)
    assert data["ids"] == list(nimprep.open_store(evil).ids)
    assert EVIL_ID in data["ids"]
    assert data["classes"][1]["name"] == EVIL_CLASS
    assert "49" not in [c["name"] for c in data["classes"]]


def test_charts_show_hostile_names_as_text(page: str) -> None:
    figures = Checked(page).data("figures")
    assert isinstance(figures, dict)
    assert figures["chart-classes"]["data"][1]["name"] == (
        "&lt;b onclick=window.hacked=1&gt;road&lt;/b&gt;"
    )
    hovers = [t for trace in figures["chart-holes"]["data"] for t in trace["text"]]
    assert not [t for t in hovers if "<" in t or "%{" in t]


def test_pictures_are_in_the_page_by_frame_and_modality(page: str, evil: Path) -> None:
    checked, store = Checked(page), nimprep.open_store(evil)
    data = checked.data("gallery-data")
    assert isinstance(data, dict)
    assert data["shown"] == [0, 1, 2]
    for frame in range(3):
        pictures = checked.data(f"pictures-{frame}")
        assert isinstance(pictures, dict)
        assert set(pictures) == set(store.modalities)
        packed = np.frombuffer(base64.b64decode(pictures["rgb"]), np.uint8)
        decoded = cv2.imdecode(packed, cv2.IMREAD_COLOR_RGB)
        assert np.abs(decoded.astype(int) - store[frame].rgb).mean() < 16


def test_the_same_store_gives_the_same_page(evil: Path, page: str) -> None:
    assert report(evil, evil.parent / "again.html") == page


def test_a_page_stays_below_its_limit_and_says_how_much_it_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = gmrp_store(tmp_path, 30)
    whole = report(store, tmp_path / "whole.html")
    bare = len(whole) - sum(len(t) for n, t in Checked(whole).text.items() if "pictures" in n)
    monkeypatch.setattr("nimprep.report.store_page._RESERVE", 5000)
    limit = (bare + 45_000) / 1e6
    made = write_report(store, tmp_path / "small.html", megabytes=limit)
    assert (tmp_path / "small.html").stat().st_size == made.bytes < limit * 1e6
    assert 2 < made.shown < 30
    page = (tmp_path / "small.html").read_text()
    assert f"Pictures of {made.shown} of 30 frames" in page
    data = Checked(page).data("gallery-data")
    assert isinstance(data, dict)
    assert len(data["shown"]) == made.shown
    assert len(data["ids"]) == 30
    with pytest.raises(StoreError, match="without any picture"):
        write_report(store, tmp_path / "none.html", megabytes=1)
    assert not (tmp_path / "none.html").exists()


def test_pictures_are_as_large_as_lets_all_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gallery_module, "SIZES", ((32, 90), (16, 60), (8, 60)))
    store = nimprep.open_store(gmrp_store(tmp_path, 6))
    artist, order = Artist(store, collect(store)), order_of_interest(store, [])
    large = paint_gallery(artist, order, 10**6)
    size = sum(len(d) for p in large.frames.values() for d in p.values())
    assert large.width == 32
    assert list(large.frames) == list(range(6))
    smaller = paint_gallery(artist, order, size // 2)
    assert smaller.width < 32
    assert paint_gallery(artist, order, 0).frames == {}


@pytest.mark.parametrize(
    ("modalities", "labels", "absent"),
    [
        (("rgb",), False, ("depth", "normals", "hha", "classes")),
        (("depth",), False, ("classes", "normals", "hha")),
        (("rgb", "depth", "label"), True, ("normals", "hha")),
    ],
)
def test_stores_without_some_modalities_have_a_page_without_them(
    tmp_path: Path, modalities: tuple[str, ...], labels: bool, absent: tuple[str, ...]
) -> None:
    store = gmrp_store(tmp_path, 3, modalities=modalities, labels=labels)
    checked = Checked(report(store, tmp_path / "page.html"))
    sections = {a.get("id") for t, a in checked.elements if t == "section"}
    assert sections.isdisjoint(absent)
    assert {"overview", "findings", "camera", "gallery"} <= sections
    pictures = checked.data("pictures-0")
    assert isinstance(pictures, dict)
    assert set(pictures) == set(modalities)


def test_one_frame_without_a_split_and_padded_frames_have_a_page(tmp_path: Path) -> None:
    store = mixed_store(tmp_path / "mixed")
    split = {"train": ["000003"], "val": [], "test": []}
    split |= {"format": "nimprep-split", "version": "1.0"}
    (tmp_path / "s.json").write_text(json.dumps(split))
    resplit(store, split_file=tmp_path / "s.json")
    checked = Checked(report(store, tmp_path / "mixed.html"))
    data = checked.data("gallery-data")
    assert isinstance(data, dict)
    assert data["split"] == [3, 3, 3, 0]
    assert list(zip(data["width"], data["height"], strict=True)) == [(32, 24)] * 2 + [(28, 20)] * 2
    pictures = checked.data("pictures-3")
    assert isinstance(pictures, dict)
    packed = np.frombuffer(base64.b64decode(pictures["label"]), np.uint8)
    assert cv2.imdecode(packed, cv2.IMREAD_COLOR).shape == (20, 28, 3)
    report(gmrp_store(tmp_path / "one", 1), tmp_path / "one.html")


def test_the_artist_draws_each_modality_without_its_padding(tmp_path: Path) -> None:
    store = nimprep.open_store(mixed_store(tmp_path))
    artist = Artist(store, collect(store))
    for name in store.modalities:
        assert artist.draw(0, name).shape == (24, 32, 3)
        assert artist.draw(2, name).shape == (20, 28, 3)
    frame = store[2]
    assert np.array_equal(artist.draw(2, "rgb"), frame.rgb)
    assert np.array_equal(artist.draw(2, "hha"), frame.hha)
    depth = artist.draw(2, "depth")
    assert (depth[frame.depth_m == 0] == NO_VALUE).all()
    scale = artist.looks["depth"].scale
    assert scale is not None
    place = int(np.rint(scale.place(frame.depth_m[10, 10]) * 255))
    assert depth[10, 10].tolist() == viridis()[255 - place].tolist()
    normal = frame.normal[10, 10] * (1, -1, -1)
    assert np.abs(artist.draw(2, "normal")[10, 10] - (normal + 1) * 127.5).max() <= 1
    with pytest.raises(KeyError):
        artist.draw(0, "../rgb")
    assert artist.draw(0, "rgb", 32).shape == (24, 32, 3)
    assert artist.draw(0, "label", 8).shape == (6, 8, 3)


class Plane:
    """Stand in for the array of a modality that nobody here has heard of."""

    def __init__(self, dtype: str, unit: str, values: tuple[int, ...] = (24, 32)) -> None:
        self.dtype, self.shape, self.shard_length = np.dtype(dtype), (3, *values), 32
        self.modality = Modality("surface_warmth", "numbers", "warmth", unit, dtype=dtype, fill=-9)
        attributes = {"units": unit, "scale_factor": 0.5, "_FillValue": -9, "long_name": "warmth"}
        self.spec = ArraySpec(("frame", "y", "x"), dtype, 0, attributes)

    def read(self, frame: int) -> np.ndarray:
        image = np.arange(np.prod(self.shape[1:])).reshape(self.shape[1:]).astype(self.dtype)
        image[0, 0] = -9
        return image

    def shard_path(self, _: int) -> Path:
        return Path("nowhere")


def test_a_modality_nobody_has_heard_of_is_shown_with_a_scale_of_its_own(tmp_path: Path) -> None:
    store = nimprep.open_store(gmrp_store(tmp_path, 3, modalities=("rgb",), labels=False))
    store.modalities = ("rgb", "surface_warmth")
    store.arrays["surface_warmth"] = Plane("int16", "K")  # type: ignore[assignment]
    facts = collect(store)
    assert np.nanmin(facts.pooled["surface_warmth"]) >= 0.5
    assert np.isnan(facts.pooled["surface_warmth"][0, 0])
    artist = Artist(store, facts)
    look = artist.looks["surface_warmth"]
    assert look.title == "Surface warmth"
    assert look.scale is not None
    assert look.scale.unit == "K"
    assert 0 < look.scale.low < 10 < 370 < look.scale.high < 384
    drawn = artist.draw(0, "surface_warmth")
    assert drawn[0, 0].tolist() == list(NO_VALUE)
    assert drawn[-1, -1].tolist() == viridis()[255].tolist()
    charts = make_charts(store, facts)
    assert charts["chart-other-0"].gist.startswith("surface_warmth: median 19")


def test_shares_are_written_for_people() -> None:
    values = (0.0, 0.00001, 0.005, 0.25, 1.0, float("nan"))
    written = [percent(v).replace("\u202f", " ") for v in values]
    assert written == ["0 %", "< 0.01 %", "0.50 %", "25.0 %", "100.0 %", "–"]


def test_a_script_that_would_end_its_element_is_no_asset() -> None:
    with pytest.raises(ValueError, match="would end it"):
        page_module._trusted("x = '</script>'")


def test_what_a_template_prints_is_escaped() -> None:
    assert page_module.environment().from_string("{{ x }}").render(x="<b>") == "&lt;b&gt;"


def test_missing_libraries_are_told_with_what_to_install(
    evil: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page_module, "LIBRARIES", ("jinja2", "no_such_plotly"))
    with pytest.raises(NimprepError, match=r"found no no_such_plotly; pip install 'nimprep\[rep"):
        write_report(evil, evil.parent / "x.html")
    with pytest.raises(NimprepError):
        render_page("store.html.j2", {})


def test_a_report_never_replaces_a_file_unasked_and_never_lies_in_the_store(
    evil: Path, tmp_path: Path
) -> None:
    out = tmp_path / "page.html"
    out.write_text("mine")
    with pytest.raises(LayoutError, match="--overwrite"):
        write_report(evil, out)
    assert out.read_text() == "mine"
    write_report(evil, out, overwrite=True)
    assert out.read_text().startswith("<!doctype html>")
    assert [p.name for p in tmp_path.iterdir()] == ["page.html"]
    with pytest.raises(LayoutError, match="outside the source"):
        write_report(evil, evil / "page.html")
    with pytest.raises(LayoutError, match="found a folder"):
        write_report(evil, tmp_path, overwrite=True)


def test_an_old_page_stays_where_the_new_one_fails(
    evil: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "page.html"
    out.write_text("mine")

    def broken(*_: object) -> Gallery:
        raise StoreError("damaged")

    monkeypatch.setattr("nimprep.report.store_page.paint_gallery", broken)
    with pytest.raises(StoreError):
        write_report(evil, out, overwrite=True)
    assert out.read_text() == "mine"


def run(*arguments: object) -> Result:
    return CliRunner().invoke(main, [str(a) for a in arguments])


def test_the_command_prints_what_looks_wrong_and_what_it_wrote(evil: Path, tmp_path: Path) -> None:
    result = run("report", evil, tmp_path / "page.html")
    assert result.exit_code == 0
    assert result.stderr == ""
    assert result.stdout.splitlines()[-1].startswith(f"{tmp_path / 'page.html'}: 3 frames, 3 of")
    again = run("report", evil, tmp_path / "page.html")
    assert again.exit_code == 1
    assert again.stderr.startswith("error: ")
    assert again.stderr.count("\n") == 1
    assert run("report", evil, tmp_path / "page.html", "--overwrite").exit_code == 0


@pytest.mark.parametrize(
    ("arguments", "code"), [(("report", "nowhere", "page.html"), 1), (("report", "x"), 2)]
)
def test_wrong_stores_and_wrong_calls_have_their_exit_codes(
    arguments: tuple[str, ...], code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(*arguments).exit_code == code


def test_a_damaged_store_is_one_line(tmp_path: Path) -> None:
    store = gmrp_store(tmp_path, 3)
    shard = next((store / "hha" / "c").rglob("0"))
    while shard.is_dir():
        shard = next(shard.iterdir())
    data = bytearray(shard.read_bytes())
    data[40] ^= 1
    shard.write_bytes(data)
    result = run("report", store, tmp_path / "page.html")
    assert result.exit_code == 1
    assert "wrong checksum" in result.stderr
    assert not (tmp_path / "page.html").exists()


def test_sizes_are_as_in_the_fakes() -> None:
    assert (HEIGHT, WIDTH) == (24, 32)


def test_numbers_that_tensors_cut_are_drawn_within_that_range(tmp_path: Path) -> None:
    names = ("rgb", "depth", "elevation", "transformed_disparity")
    store = nimprep.open_store(gmrp_store(tmp_path, frames=2, modalities=names))
    facts = collect(store)
    facts.pooled["elevation"][:] = np.linspace(-20, 50, facts.pooled["elevation"].shape[1])
    facts.pooled["transformed_disparity"][:] = np.linspace(-1, 3, 256)
    looks = Artist(store, facts).looks
    scale, narrow = looks["elevation"].scale, looks["transformed_disparity"].scale
    assert scale is not None
    assert narrow is not None
    assert (scale.low, scale.high, scale.unit) == (-4, 4, "m")
    assert (narrow.low, narrow.high) == pytest.approx((-0.96, 2.96), abs=0.01)
    assert narrow.unit == "pixel"


def test_whose_a_dataset_is_stands_on_the_page(tmp_path: Path) -> None:
    write_gmrp(tmp_path / "raw", frames=3)
    description = {
        "format": "nimprep-folder",
        "version": "1.1",
        "name": "made",
        "rgb": "rgb/{id}.png",
        "depth": {"files": "depth_u16/{id}.png", "scale_m": 0.001},
        "camera": {"fx": 30, "fy": 30, "cx": 15.5, "cy": 11.5},
        "reference": {"title": "A <b>set</b>", "licence": "CC BY & more", "url": "nowhere.org/a"},
    }
    (tmp_path / "d.json").write_text(json.dumps(description))
    store = convert(tmp_path / "raw", tmp_path / "s.zarr", description=tmp_path / "d.json")
    html = report(store, tmp_path / "page.html")
    Checked(html)
    rows = re.findall(r"<dt>(\w+)</dt><dd>([^<]*)</dd>", html.split('class="facts reference"')[1])
    assert rows[:3] == [
        ("Dataset", "A &lt;b&gt;set&lt;/b&gt;"),
        ("Licence", "CC BY &amp; more"),
        ("From", "nowhere.org/a"),
    ]
    plain = gmrp_store(tmp_path / "other", frames=3)
    assert 'class="facts reference"' not in report(plain, tmp_path / "plain.html")
