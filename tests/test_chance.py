"""What every test keeps to, so that it ends the same way every time."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

TESTS = Path(__file__).resolve().parent
FILES = sorted(TESTS.rglob("*.py"))

TIME = (
    "time passes as the machine likes: wait for an event, with PATIENCE_S where it might not come"
)
CHANCE = "what chance gives once it does not give again: use a generator with a seed"
LEFT = "a process must end with its test: start it by the fixture `processes`"

FORBIDDEN = {
    r"time\.(sleep|time|monotonic|perf_counter|process_time)(_ns)?": TIME,
    r"(threading\.)?Timer": TIME,
    r"(os\.urandom|secrets\..*|uuid\.uuid[14])": CHANCE,
    r"random\.(?!Random$)\w+": CHANCE,
    r"np\.random\.(?!default_rng$|Generator$|PCG64$)\w+": CHANCE,
    r"(subprocess\.Popen|os\.fork|multiprocessing\..*|(\w+\.)?Process)": LEFT,
}

EXCEPT = {
    ("cloud/clock.py", "time.time"): "where the clock starts that tests set forward",
    ("cloud/test_objects.py", "time.time"): "compared with what a server says, to the minute",
    ("cloud/test_objects.py", "threading.Timer"): "ends a forked process that would hang",
    ("cloud/test_objects.py", "os.fork"): "forked from this very process, and waited for",
    ("torch/test_loader.py", "os.fork"): "forked from this very process, and waited for",
    ("test_parallel.py", "os.fork"): "forked from this very process, and waited for",
    ("conftest.py", "random.seed"): "makes all chance the same",
    ("conftest.py", "np.random.seed"): "makes all chance the same",
    ("conversion/cluster.py", "time.monotonic"): "how long to look for what comes surely",
    ("conversion/cluster.py", "time.sleep"): "between two looks for what comes surely",
    ("conversion/mortal.py", "os.fork"): "ended by the fixture `mortals`",
    ("hostile/fuzzing.py", "time.monotonic"): "ends a hunt, whose length is asked for",
    ("training/killed.py", "os.fork"): "forked from this very process, and waited for",
    ("processes.py", "subprocess.Popen"): "here they are started and ended",
}
"""Calls that stand where they must, with the reason."""


def calls(path: Path) -> Iterator[tuple[str, ast.Call]]:
    """Yield each call with the dotted name of what is called."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call):
            yield ast.unparse(node.func), node


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(TESTS)))
def test_no_test_depends_on_luck(path: Path) -> None:
    name = str(path.relative_to(TESTS))
    for called, call in calls(path):
        where = f"{name}:{call.lineno}: {called}"
        for pattern, reason in FORBIDDEN.items():
            if re.fullmatch(pattern, called):
                assert (name, called) in EXCEPT, f"{where}: {reason}"
        if called.endswith("default_rng"):
            assert call.args, f"{where}: {CHANCE}"
        for keyword in call.keywords:
            # A figure of its own is what some machine needed once.
            number = isinstance(keyword.value, ast.Constant)
            assert keyword.arg != "timeout" or not number, f"{where}: {TIME}"


def test_what_is_excepted_is_there() -> None:
    there = {(str(path.relative_to(TESTS)), called) for path in FILES for called, _ in calls(path)}
    assert EXCEPT.keys() <= there


def test_examples_are_the_same_everywhere_and_take_as_long_as_they_take() -> None:
    tried: list[int] = []

    @given(st.integers())
    def example(number: int) -> None:
        tried.append(number)

    example()
    first = tried.copy()
    tried.clear()
    example()
    assert tried == first
    assert settings().deadline is None
    assert HealthCheck.too_slow in settings().suppress_health_check
