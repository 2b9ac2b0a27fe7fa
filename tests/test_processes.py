"""No test leaves anything behind, and one that would is named: shown by tests that would."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.processes import same_code

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are found in /proc")

SLEEP = [sys.executable, "-c", "import signal; signal.pause()"]

TESTS = f"""
import os, subprocess, sys
import pytest
from tests import leftovers

SLEEP = {SLEEP!r}
ORPHAN = "import subprocess; print(subprocess.Popen({SLEEP!r}, stdout=-3).pid)"

kept = []


def start(command):
    kept.append(subprocess.Popen(command))
    print("started", kept[-1].pid)
    return kept[-1]


@pytest.fixture(scope="session")
def shared():
    process = start(SLEEP)
    yield process
    process.kill()
    process.wait()


@pytest.fixture(scope="session")
def shared_and_left():
    start(SLEEP)


@pytest.fixture(scope="module")
def shared_in_a_module():
    process = start(SLEEP)
    yield
    process.kill()
    process.wait()


def test_leaves_one_that_ends():
    kept.append(subprocess.Popen(["cat"], stdin=-1))
    kept[-1].stdin.close()


def test_uses_a_shared_process(shared):
    leftovers.GRACE_S = 0
    assert shared.poll() is None


def test_uses_it_still(shared, shared_in_a_module):
    assert shared.poll() is None


def test_leaves_a_process():
    start(SLEEP)


def test_leaves_a_variable():
    os.environ["NIMPREP_X"] = "1"


def test_leaves_its_folder(tmp_path):
    os.chdir(tmp_path)


def test_leaves_a_childs_child():
    done = subprocess.run([sys.executable, "-c", ORPHAN], stdout=-1, text=True, check=True)
    print("started", done.stdout)


def test_fails_and_has_its_process_ended(processes):
    process = processes.start([*SLEEP])
    print("started", process.pid)
    assert process.poll() is not None


def test_starts_what_hears_ctrl_c():
    interrupt = "import os, signal; os.kill(os.getpid(), signal.SIGINT)"
    assert subprocess.run([sys.executable, "-c", interrupt], stderr=-3).returncode == -2


def test_uses_a_fixture_that_leaves_a_process(shared_and_left):
    pass
"""


def alive(number: int) -> bool:
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.parametrize("way", [("-s",), ("-n", "1")], ids=["here", "in another process"])
def test_what_a_test_leaves_is_ended_and_its_test_named(
    tmp_path: Path, way: tuple[str, ...]
) -> None:
    (tmp_path / "test_these.py").write_text(TESTS)
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    options = ["-p", "no:randomly", "-p", "tests.conftest", "-rA", *way]
    # As a shell starts what it is to run in the background.
    deaf = "import os, signal, sys; signal.signal(signal.SIGINT, signal.SIG_IGN); "
    deaf += "os.execv(sys.executable, [sys.executable, *sys.argv[1:]])"
    done = subprocess.run(
        [sys.executable, "-c", deaf, "-m", "pytest", *options, "test_these.py"],
        cwd=tmp_path,
        env=same_code(),
        capture_output=True,
        text=True,
        check=False,
    )
    said = done.stdout
    assert re.search("1 failed, 9 passed, 5 errors", said)
    for name in ("leaves_a_process", "leaves_a_childs_child"):
        assert f"test_these.py::test_{name} left process " in said
    for name in ("leaves_a_variable", "leaves_its_folder"):
        assert f"ERROR test_these.py::test_{name} - " in said
    assert "the tests left process" in said
    assert "fixture shared_and_left of " in said
    started = set(re.findall(r"started (\d+)", said))
    assert len(started) == 6
    assert not any(alive(int(number)) for number in started)
