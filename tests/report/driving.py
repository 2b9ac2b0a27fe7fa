"""Drive the browser: load pages, wait, choose, press keys."""

from __future__ import annotations

from typing import Any

from tests.processes import PATIENCE_S


def show(browser: Any, address: str, width: int = 1280, dark: bool = False) -> None:
    """Load a page at a width, and wait until its first chart and cards are there."""
    browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 500},
    )
    # Without motion, a click goes where the element is and not where it glides from.
    features = [
        {"name": "prefers-color-scheme", "value": "dark" if dark else "light"},
        {"name": "prefers-reduced-motion", "value": "reduce"},
    ]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
    browser.get_log("browser")
    browser.get("about:blank")
    browser.get(address)
    wait(browser, "return document.querySelectorAll('#frames > li').length > 0")


def wait(browser: Any, script: str) -> None:
    from selenium.webdriver.support.ui import WebDriverWait

    WebDriverWait(browser, PATIENCE_S, 0.05).until(lambda b: b.execute_script(script))


def run(browser: Any, script: str, *arguments: object) -> Any:
    return browser.execute_script(script, *arguments)


def by_id(browser: Any, name: str) -> Any:
    return browser.find_element("id", name)


def choose(browser: Any, name: str, text: str) -> None:
    from selenium.webdriver.support.ui import Select

    Select(by_id(browser, name)).select_by_visible_text(text)


def press(browser: Any, *keys: str) -> None:
    from selenium.webdriver.common.action_chains import ActionChains

    ActionChains(browser).send_keys(*keys).perform()
