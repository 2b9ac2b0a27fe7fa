"""Absurd numbers end no process: they are tried in one of their own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[2]


def test_no_depth_whatever_crashes_a_function_or_gives_what_is_no_number() -> None:
    command = [sys.executable, "-m", "tests.arrays.attack"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(PROJECT), *sys.path])}
    done = subprocess.run(
        command, cwd=PROJECT, env=environment, capture_output=True, text=True, check=False
    )
    trying = [line for line in done.stderr.splitlines() if line.startswith("trying ")]
    assert done.returncode == 0, (
        f"{trying[-1:]} ended with {done.returncode}: {done.stderr[-2000:]}"
    )
    problems, (last,) = done.stdout.splitlines()[:-1], done.stdout.splitlines()[-1:]
    assert not problems, problems[:20]
    assert int(last.split()[0]) > 10_000
