"""What comes first, what it looks like, and tables that are wider than a telephone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nimprep
from nimprep.evaluation import compare_predictions
from nimprep.evaluation.page import write_page
from nimprep.report.store_page import write_report
from tests.fakes import write_png

from .driving import run, show, wait
from .stores import HEIGHT, WIDTH, Folder, photograph


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a store with a problem, something to look at, and a scene of a long name."""
    folder = Folder(
        tmp_path_factory.mktemp("narrow") / "raw",
        ("other", "drivable area of the road", "anomaly: cone, box, animal or person"),
    )
    for number in range(9):
        split, name = (("train", "a"), ("val", "b"), ("test", "c"))[number % 3]
        # The same picture in train and val is to be looked at.
        rgb = photograph(0 if number < 2 else number)
        folder.add(split, rgb=rgb, scene=f"{name} campus north, rain, evening, second camera")
    folder.add("train", rgb=np.full((HEIGHT, WIDTH, 3), 9, np.uint8))
    return folder.store()


@pytest.fixture(scope="module")
def report(store: Path) -> str:
    out = store.parent / "report.html"
    write_report(store, out)
    return out.as_uri()


@pytest.fixture(scope="module")
def evaluation(store: Path) -> str:
    opened = nimprep.open_store(store)
    for name in ("NIM-RGB+D", "RGB"):
        for frame in opened:
            assert frame.label is not None
            write_png(store.parent / name / f"{frame.id}.png", np.minimum(frame.label, 1))
    folders = [store.parent / "NIM-RGB+D", store.parent / "RGB"]
    out = store.parent / "evaluation.html"
    write_page(out, opened, compare_predictions(opened, folders), worst=1)
    return out.as_uri()


def _rgb(browser: Any, selector: str, part: str) -> tuple[int, ...]:
    """Return a colour as it is drawn, whatever notation the browser has for it."""
    drawn = run(
        browser,
        "const c = document.createElement('canvas').getContext('2d');"
        "c.fillStyle = getComputedStyle(document.querySelector(arguments[0]))[arguments[1]];"
        "c.fillRect(0, 0, 1, 1); return [...c.getImageData(0, 0, 1, 1).data].slice(0, 3)",
        selector,
        part,
    )
    return tuple(drawn)


def _contrast(one: tuple[int, ...], other: tuple[int, ...]) -> float:
    """Return WCAG's contrast ratio of two colours, 1 to 21."""
    luminances = []
    for color in (one, other):
        value = np.array(color) / 255
        linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
        luminances.append(float(linear @ np.array([0.2126, 0.7152, 0.0722])))
    low, high = sorted(luminances)
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("width", [390, 1280])
def test_findings_come_first(browser: Any, report: str, width: int) -> None:
    show(browser, report, width)
    ids = run(browser, "return [...document.querySelectorAll('main section')].map((s) => s.id)")
    assert ids[:2] == ["findings", "overview"]
    links = run(browser, "return [...document.querySelectorAll('.contents a')].map((a) => a.hash)")
    assert links[:2] == ["#findings", "#overview"]
    # Seen without scrolling.
    top = "return document.querySelector('.findings li').getBoundingClientRect().top"
    assert run(browser, top) < 450


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_problems_are_red_what_deserves_a_look_is_amber_and_both_are_legible(
    browser: Any, report: str, dark: bool
) -> None:
    show(browser, report, dark=dark)
    found = {
        severity: _rgb(browser, f".findings .{severity}", "borderInlineStartColor")
        for severity in ("problem", "look")
    }
    for red, green, blue in found.values():
        assert red > green > blue or (red > 150 and green - blue < 25)
    # Amber has more green in it than red has.
    assert found["look"][1] - found["look"][2] > found["problem"][1] - found["problem"][2] + 40
    text = _rgb(browser, "body", "color")
    for severity in found:
        ground = _rgb(browser, f".findings .{severity}", "backgroundColor")
        assert ground != _rgb(browser, "#overview .card", "backgroundColor")
        assert _contrast(text, ground) > 7
        tag = f".findings .{severity} .tag"
        tag_ground = _rgb(browser, tag, "backgroundColor")
        assert _contrast(_rgb(browser, tag, "color"), tag_ground) > 4.5
    # And in words.
    words = run(browser, "return document.querySelector('.verdict').textContent")
    assert "1 problem" in words
    assert "to have a look at" in words


@pytest.mark.parametrize("page", ["report", "evaluation"])
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_wide_tables_scroll_by_themselves_and_keep_their_rows_names(
    browser: Any, request: pytest.FixtureRequest, page: str, dark: bool
) -> None:
    address = request.getfixturevalue(page)
    if page == "report":
        show(browser, address, 390, dark)
    else:
        # It has no gallery to wait for.
        show(browser, request.getfixturevalue("report"), 390, dark)
        browser.get(address)
        wait(browser, "return document.querySelectorAll('table').length > 0")
        run(browser, "document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    assert run(browser, "return document.documentElement.scrollWidth") == 390
    tables = run(
        browser,
        "return [...document.querySelectorAll('main table')].map((t) => {"
        "const p = t.parentElement; p.scrollLeft = 1e4; const b = p.getBoundingClientRect();"
        "const row = t.querySelector('tbody th').getBoundingClientRect();"
        "const last = t.rows[t.rows.length - 1].lastElementChild.getBoundingClientRect();"
        "return {wide: p.scrollWidth > p.clientWidth, scrolled: p.scrollLeft > 0,"
        "name: row.left - b.left, row: row.width, end: last.right - b.right,"
        "keys: p.tabIndex, called: p.getAttribute('aria-label'), right: b.right}; })",
    )
    assert any(table["wide"] for table in tables)
    for table in tables:
        assert table["scrolled"] == table["wide"], table
        # The name stays at the left, leaves room for numbers, and the last column can be reached.
        assert abs(table["name"]) <= 1, table
        assert 100 < table["row"] < 200, table
        assert abs(table["end"]) <= 1, table
        assert table["keys"] == 0, table
        assert table["called"], table
        assert table["right"] <= 390, table
    assert run(browser, "return document.documentElement.scrollWidth") == 390
