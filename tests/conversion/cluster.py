"""A real Dask cluster on loopback; its workers stand still at a unit until a test opens a gate."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import distributed

from tests.processes import PATIENCE_S, Processes, same_code


class Cluster:
    """A scheduler and its workers, each a process with one thread.

    Parameters
    ----------
    processes : Processes
        End with the cluster.
    """

    def __init__(self, folder: Path, processes: Processes) -> None:
        self._folder = folder
        self._processes = processes
        self.scheduler = self._start(processes, "scheduler", "--port", "0", "--no-show")
        file = folder / "scheduler.json"
        wait_until(lambda: file.exists() and bool(file.read_bytes().strip().endswith(b"}")))
        self.address: str = json.loads(file.read_text())["address"]

    def _start(self, processes: Processes, what: str, *arguments: str) -> subprocess.Popen[bytes]:
        file = str(self._folder / "scheduler.json")
        command = [sys.executable, "-m", "dask", what, "--scheduler-file", file, *arguments]
        with (self._folder / f"{what}s.log").open("ab") as log:
            return processes.start(
                [*command, "--no-dashboard", "--host", "127.0.0.1"],
                stdout=log,
                stderr=log,
                cwd=self._folder,
                env=same_code(),
            )

    def start_worker(self, processes: Processes | None = None) -> subprocess.Popen[bytes]:
        """Start a worker that ends with the cluster or with other processes."""
        return self._start(processes or self._processes, "worker", "--nthreads", "1", "--no-nanny")

    @contextmanager
    def client(self, workers: int = 0) -> Iterator[distributed.Client]:
        """Connect; wait for so many workers."""
        with distributed.Client(self.address, set_as_default=False) as client:
            if workers:
                client.wait_for_workers(workers, timeout=PATIENCE_S)
            yield client

    def tasks(self) -> int:
        """Return how many tasks the scheduler has."""
        with self.client() as client:
            return int(client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks)))

    @contextmanager
    def gate(self) -> Iterator[Gate]:
        """Let whoever begins a unit stand still until the gate opens, as it does at the end."""
        gate = Gate(Path(tempfile.mkdtemp(dir=self._folder)))

        def shut(arrived: str, gate: str) -> None:
            from nimprep.conversion import worker as module

            encode = module.encode_unit

            def waiting(*arguments: Any) -> Any:
                with open(arrived, "w") as said:  # noqa: PTH123
                    said.write(f"{distributed.get_worker().address}\n")
                os.close(os.open(gate, os.O_RDONLY))
                return encode(*arguments)

            waiting.encode = encode  # type: ignore[attr-defined]
            module.encode_unit = waiting

        def remove() -> None:
            from nimprep.conversion import worker as module

            module.encode_unit = getattr(module.encode_unit, "encode", module.encode_unit)

        with self.client() as client:
            client.run(shut, str(gate.arrived), str(gate.gate))
            try:
                yield gate
            finally:
                client.run(remove)
                gate.close()


class Gate:
    """Two named pipes: through one workers say that they stand, the other they wait for.

    Opening a pipe for reading waits until somebody has it open for writing.
    """

    def __init__(self, folder: Path) -> None:
        self.arrived, self.gate = folder / "arrived", folder / "gate"
        os.mkfifo(self.arrived)
        os.mkfifo(self.gate)
        # For writing too: then opening it waits for nobody, and it never seems at its end.
        self._arrivals = os.open(self.arrived, os.O_RDWR)
        self._open: int | None = None

    def wait_for(self, addresses: Iterable[str]) -> None:
        """Return once these workers all stand before the gate."""
        missing, text = set(addresses), ""
        while missing:
            within, _, _ = select.select([self._arrivals], [], [], PATIENCE_S)
            assert within, f"expected {missing} at work, found them idle"
            text += os.read(self._arrivals, 4096).decode()
            missing -= set(text.splitlines())

    def open(self) -> None:
        """Let all through, now and later."""
        if self._open is None:
            self._open = os.open(self.gate, os.O_RDWR)

    def close(self) -> None:
        """Open it, and close the pipes."""
        self.open()
        assert self._open is not None
        os.close(self._open)
        os.close(self._arrivals)


def wait_until(condition: Callable[[], object]) -> None:
    """Look now and then until something holds that will; fail where it does not."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, "expected it to hold by now"
        time.sleep(0.01)
