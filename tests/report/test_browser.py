"""The page in a real browser: it loads, filters, opens frames, obeys keys, and can be looked at."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from nimprep.report.server import make_server
from nimprep.report.store_page import examine, write_report

from .driving import by_id, choose, press, run, show, wait
from .stores import EVIL_CLASS, EVIL_ID, HEIGHT, WIDTH, Folder


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return 30 frames of three splits, with a class only some have, holes, and evil names."""
    folder = Folder(tmp_path_factory.mktemp("browser") / "raw", ("other", EVIL_CLASS, "cone"))
    plain = np.zeros((HEIGHT, WIDTH), np.uint8)
    plain[12:] = 1
    for number in range(28):
        split = ("train", "train", "val", "test")[number % 4]
        folder.add(split, label=plain if number % 7 == 0 else None)
    folder.add("test", EVIL_ID)
    holes = np.full((HEIGHT, WIDTH), 2000, np.uint16) + np.arange(WIDTH, dtype=np.uint16)
    holes[:14] = 0
    folder.add("train", depth_mm=holes)
    return folder.store()


@pytest.fixture(scope="module")
def page(store: Path) -> str:
    out = store.parent / "page.html"
    write_report(store, out)
    return out.as_uri()


def cards(browser: Any) -> list[str]:
    found: list[str] = run(
        browser, "return [...document.querySelectorAll('#frames h3')].map((h) => h.textContent)"
    )
    return found


@contextmanager
def served(store: Path) -> Iterator[str]:
    with make_server(examine(store), 0) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        try:
            yield server.address
        finally:
            server.shutdown()
            thread.join()


def draw_everything(browser: Any) -> None:
    """Scroll through the page, so that every chart is drawn and every picture decoded."""
    run(browser, "document.querySelectorAll('.plot').forEach((p) => p.scrollIntoView())")
    for place in range(run(browser, "return document.querySelectorAll('.plot').length")):
        run(browser, "document.querySelectorAll('.plot')[arguments[0]].scrollIntoView()", place)
        wait(
            browser,
            f"return !!document.querySelectorAll('.plot')[{place}].querySelector('.main-svg')",
        )
    run(browser, "document.querySelector('#frames').scrollIntoView()")
    wait(browser, "const i = document.querySelector('#frames img'); return i.naturalWidth > 0")


def test_the_page_loads_without_a_word_on_the_console(browser: Any, page: str) -> None:
    show(browser, page)
    draw_everything(browser)
    assert browser.get_log("browser") == []
    assert len(cards(browser)) == 24
    loaded = "return performance.getEntriesByType('resource').map((e) => e.name)"
    assert [a for a in run(browser, loaded) if not a.startswith("data:")] == []


def test_hostile_names_stay_text(browser: Any, page: str) -> None:
    show(browser, page)
    draw_everything(browser)
    by_id(browser, "filter-id").send_keys("onerror")
    assert cards(browser) == [EVIL_ID]
    choose(browser, "filter-class", f"with {EVIL_CLASS}")
    browser.find_element("css selector", "#frames .shot").click()
    assert by_id(browser, "large-title").text == EVIL_ID
    assert run(browser, "return window.hacked === undefined")
    assert run(browser, "return document.querySelectorAll('b, [onerror], [onclick]').length") == 0
    # Nor would markup that got past the escaping do anything.
    run(browser, "document.body.insertAdjacentHTML('beforeend', '<img src=x onerror=hacked=1>')")
    wait(browser, "return document.body.lastElementChild.complete")
    assert run(browser, "return window.hacked === undefined")


def test_filters_hide_frames_and_say_how_many_are_left(browser: Any, page: str) -> None:
    show(browser, page)
    choose(browser, "filter-split", "val")
    assert len(cards(browser)) == 7
    assert by_id(browser, "count").text == "7 frames match."
    assert all(name.startswith("val scene/") for name in cards(browser))
    choose(browser, "filter-class", "without cone")
    assert len(cards(browser)) == 1
    choose(browser, "filter-split", "all")
    assert len(cards(browser)) == 4
    choose(browser, "filter-class", "any")
    choose(browser, "filter-group", "test scene")
    assert len(cards(browser)) == 7
    choose(browser, "filter-group", "all")
    choose(browser, "filter-order", "most holes first")
    assert cards(browser)[0] == "train scene/029"
    by_id(browser, "filter-id").send_keys("nothing is called so")
    assert cards(browser) == []
    assert by_id(browser, "count").text == "0 frames match."


def test_a_finding_shows_its_frames(browser: Any, page: str) -> None:
    show(browser, page)
    button = next(
        item.find_element("css selector", "button")
        for item in browser.find_elements("css selector", ".findings li")
        if "Few pixels with depth" in item.text
    )
    button.click()
    assert cards(browser) == ["train scene/029"]


def test_more_frames_come_when_asked_for(browser: Any, page: str) -> None:
    show(browser, page)
    assert len(cards(browser)) == 24
    by_id(browser, "more").click()
    assert len(cards(browser)) == 30
    assert not by_id(browser, "more").is_displayed()
    focused = "return document.activeElement.closest('li').querySelector('h3').textContent"
    assert run(browser, focused) == cards(browser)[24]


def test_a_frame_opens_large_and_keys_walk_compare_and_close(browser: Any, page: str) -> None:
    from selenium.webdriver.common.keys import Keys

    show(browser, page)
    names = cards(browser)
    run(browser, "document.querySelector('#frames li:nth-child(2) .shot:nth-child(2)').focus()")
    press(browser, Keys.ENTER)
    assert run(browser, "return document.querySelector('#large').open")
    assert by_id(browser, "large-title").text == names[1]
    assert "depth" in by_id(browser, "over").get_attribute("alt")
    press(browser, Keys.ARROW_RIGHT)
    assert by_id(browser, "large-title").text == names[2]
    press(browser, Keys.ARROW_LEFT, Keys.ARROW_LEFT, Keys.ARROW_LEFT)
    assert by_id(browser, "large-title").text == names[0]
    assert not by_id(browser, "previous").is_enabled()
    clip = "return getComputedStyle(document.querySelector('#over')).clipPath"
    assert run(browser, clip) == "inset(0px 50% 0px 0px)"
    run(browser, "document.querySelector('#slide').focus()")
    press(browser, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT)
    assert run(browser, clip) == "inset(0px 48% 0px 0px)"
    assert by_id(browser, "large-title").text == names[0]
    choose(browser, "right", "Labels")
    assert "label" in by_id(browser, "under").get_attribute("alt")
    press(browser, Keys.ESCAPE)
    wait(browser, "return !document.querySelector('#large').open")
    # Back where it came from, to the frame that was shown last.
    first = "document.querySelector('#frames li')"
    wait(browser, f"return document.activeElement.closest('li') === {first}")


def test_dragging_over_the_picture_moves_the_slider(browser: Any, page: str) -> None:
    from selenium.webdriver.common.action_chains import ActionChains

    show(browser, page)
    browser.find_element("css selector", ".shot").click()
    place = by_id(browser, "compare")
    width = place.size["width"]
    chain = ActionChains(browser, 0).move_to_element_with_offset(place, 0, 0).click_and_hold()
    chain.move_by_offset(width // 4, 0).release().perform()
    wait(browser, "return Math.abs(document.querySelector('#slide').value - 75) <= 1")


def test_a_click_on_a_point_opens_its_frame(browser: Any, page: str) -> None:
    from selenium.webdriver.common.action_chains import ActionChains

    show(browser, page)
    draw_everything(browser)  # what is drawn later could move it away
    run(browser, "document.querySelector('#chart-holes').scrollIntoView({block: 'center'})")
    places = run(
        browser,
        "return [...document.querySelectorAll('#chart-holes .points path')].map((p) => {"
        "const b = p.getBoundingClientRect(); return [b.x + b.width / 2, b.y + b.height / 2]; })",
    )
    # The frame with most holes is the highest point.
    x, y = min(places, key=lambda place: place[1])
    chain = ActionChains(browser)
    chain.w3c_actions.pointer_action.move_to_location(round(x), round(y))
    chain.perform()
    # A click is on a point once the chart has noticed what lies below the mouse.
    wait(browser, "return !!document.querySelector('#chart-holes .hoverlayer .hovertext')")
    ActionChains(browser).click().perform()
    wait(browser, "return document.querySelector('#large').open")
    assert by_id(browser, "large-title").text == "train scene/029"
    assert by_id(browser, "left").get_property("value") == "1"


def test_the_first_tab_skips_to_the_content(browser: Any, page: str) -> None:
    from selenium.webdriver.common.keys import Keys

    show(browser, page)
    press(browser, Keys.TAB)
    assert run(browser, "return document.activeElement.className") == "skip"
    assert run(browser, "return document.activeElement.getBoundingClientRect().left") >= 0
    press(browser, Keys.ENTER)
    assert run(browser, "return document.activeElement.id") == "main"


def test_everything_a_mouse_reaches_has_a_name(browser: Any, page: str) -> None:
    show(browser, page)
    browser.execute_cdp_cmd("Accessibility.enable", {})
    nodes = browser.execute_cdp_cmd("Accessibility.getFullAXTree", {})["nodes"]
    nameless = [
        node["role"]["value"]
        for node in nodes
        if not node["ignored"]
        and node["role"]["value"] in ("button", "combobox", "slider", "searchbox", "link", "image")
        and not node.get("name", {}).get("value")
    ]
    browser.execute_cdp_cmd("Accessibility.disable", {})
    assert nameless == []


def background(browser: Any) -> list[int]:
    color = run(browser, "return getComputedStyle(document.body).backgroundColor")
    return [int(n) for n in color[4:-1].split(",")]


def test_light_and_dark_follow_the_system_and_the_button(browser: Any, page: str) -> None:
    show(browser, page)
    run(browser, "localStorage.clear()")
    show(browser, page)
    assert min(background(browser)) > 200
    show(browser, page, dark=True)
    assert max(background(browser)) < 60
    by_id(browser, "theme").click()
    assert min(background(browser)) > 200
    show(browser, page, dark=True)
    assert min(background(browser)) > 200
    run(browser, "localStorage.clear()")


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [390, 1280])
def test_nothing_sticks_out_at_any_width(
    browser: Any, page: str, width: int, dark: bool, tmp_path: Path
) -> None:
    show(browser, page, width, dark)
    draw_everything(browser)
    assert run(browser, "return document.documentElement.scrollWidth") == width
    browser.save_screenshot(str(tmp_path / f"gallery-{width}.png"))
    run(browser, "window.scrollTo(0, 0)")
    browser.save_screenshot(str(tmp_path / f"top-{width}.png"))
    run(browser, "document.querySelector('.shot').click()")
    wait(browser, "return document.querySelector('#over').complete")
    browser.save_screenshot(str(tmp_path / f"large-{width}.png"))
    for picture in tmp_path.glob("*.png"):
        image = cv2.imread(str(picture))
        assert image.shape[:2] == (900, width)
        # A page that shows nothing has one colour.
        assert image.std() > 10
    box = by_id(browser, "large").rect
    assert box["x"] >= 0
    assert box["x"] + box["width"] <= width


def test_the_served_page_shows_every_frame_and_loads_pictures_as_they_are_seen(
    browser: Any, store: Path
) -> None:
    with served(store) as address:
        show(browser, address)
        draw_everything(browser)
        assert browser.get_log("browser") == []
        loaded = run(
            browser,
            "return performance.getEntriesByType('resource').map((e) => new URL(e.name).pathname)",
        )
        frames = {path.split("/")[2] for path in loaded if path.startswith("/frame/")}
        assert 0 < len(frames) < 30
        browser.find_element("css selector", ".shot").click()
        wait(browser, "return document.querySelector('#over').naturalWidth > 0")
        assert by_id(browser, "over").get_attribute("src") == f"{address}frame/0/rgb/full"
        browser.get("about:blank")
