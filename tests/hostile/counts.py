"""A plugin of the tests: how much hostile input was tried, in all processes that ran tests."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest

from tests.hostile.fuzzing import TRIED, report


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Let a process of several hand on what it counted."""
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["tried"] = {kind: dict(TRIED[kind]) for kind in TRIED}


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Add what another process counted; one that died has said nothing."""
    for kind, counts in getattr(node, "workeroutput", {}).get("tried", {}).items():
        TRIED.setdefault(kind, Counter()).update(counts)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say how much was tried."""
    lines = report()
    if lines:
        terminalreporter.section("hostile input")
        for line in lines:
            terminalreporter.line(line)
