"""A process that runs conversions in children that can be killed, each started within milliseconds.

It imports what they need once and forks; it has no threads of its own, which a fork would break.
Run as a program it takes a line of JSON per child on stdin, [task, source, store, step, atomic],
and answers with the child's number; to any next line, with its exit status.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path


def append(source: Path, store: Path) -> None:
    """Append as a nightly job would."""
    import nimprep

    nimprep.append_frames(source, store, workers=2, skip_existing=True, on_error="skip")


def convert(source: Path, store: Path) -> None:
    """Replace a store."""
    import nimprep

    nimprep.convert(source, store, shard_length=4, seed=1, overwrite=True, modalities=("depth",))


def merge(source: Path, store: Path) -> None:
    """Join all stores of a folder."""
    import nimprep

    nimprep.merge_stores(sorted(source.glob("*.zarr")), store)


TASKS = {"append": append, "convert": convert, "merge": merge}


def die_at(step: int, atomic: bool) -> None:
    """Kill this process at the so-manieth change of a name or removal while a store is published.

    Parameters
    ----------
    atomic : bool
        Whether two folders can change names at once.
    """
    import nimprep.store.writer as writer
    from nimprep.conversion.workspace import LocalWorkspace

    steps = iter(range(step, -1, -1))

    def dying(function: Callable[..., object]) -> Callable[..., object]:
        def run(*arguments: object, **named: object) -> object:
            if next(steps) == 0:
                os.kill(os.getpid(), signal.SIGKILL)
            return function(*arguments, **named)

        return run

    def cannot(a: Path, b: Path) -> bool:
        return False

    publish = LocalWorkspace.publish

    def publish_and_die(self: LocalWorkspace, *arguments: object) -> None:
        writer.exchange = dying(writer.exchange) if atomic else cannot  # type: ignore[assignment]
        for name in ("replace", "unlink"):
            setattr(Path, name, dying(getattr(Path, name)))
        writer.sync_folder = dying(writer.sync_folder)  # type: ignore[assignment]
        shutil.rmtree = dying(shutil.rmtree)  # type: ignore[assignment]
        publish(self, *arguments)  # type: ignore[arg-type]

    LocalWorkspace.publish = publish_and_die  # type: ignore[method-assign, assignment]


class Mortals:
    """Start children by the program in this file."""

    def __init__(self) -> None:
        # The tests' own path, so that both run the same code.
        path = os.pathsep.join(p for p in sys.path if p)
        self._server = subprocess.Popen(
            [sys.executable, __file__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": path},
        )

    def start(
        self, task: str, source: Path, store: Path, step: int | None = None, atomic: bool = True
    ) -> int:
        """Start a child; return its process id."""
        return self._ask(json.dumps([task, str(source), str(store), step, atomic]))

    def _ask(self, line: str) -> int:
        assert self._server.stdin is not None
        assert self._server.stdout is not None
        self._server.stdin.write(f"{line}\n")
        self._server.stdin.flush()
        return int(self._server.stdout.readline())

    def wait(self) -> int:
        """Wait for the child; return its exit code, -9 where it was killed."""
        return self._ask("wait")

    def run(self, *arguments: object, **named: object) -> int:
        """Start a child and wait for it."""
        self.start(*arguments, **named)  # type: ignore[arg-type]
        return self.wait()

    def close(self) -> None:
        """End the program."""
        self._server.communicate()


def _serve() -> None:
    import numpy as np

    import nimprep
    import nimprep.conversion.append
    import nimprep.conversion.merge

    # Whoever is killed leaves what it wrote to the system.
    os.fsync = lambda descriptor: None  # type: ignore[assignment]
    camera = nimprep.Camera(fx=30.0, fy=30.0, cx=15.5, cy=11.5, width=32, height=24)
    depth = np.linspace(1, 3, 24 * 32, dtype=np.float32).reshape(24, 32)
    nimprep.estimate_normals(depth, camera, num_threads=1)
    nimprep.encode_hha(depth, camera, num_threads=1)
    for line in sys.stdin:
        task, source, store, step, atomic = json.loads(line)
        child = os.fork()
        if child == 0:
            warnings.simplefilter("ignore")
            if step is not None:
                die_at(step, atomic)
            try:
                TASKS[task](Path(source), Path(store))
            except BaseException as error:
                print(repr(error), file=sys.stderr, flush=True)
                os._exit(1)
            os._exit(0)
        print(child, flush=True)
        # Until somebody asks, so that a number is nobody else's as long as it may be killed.
        sys.stdin.readline()
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)


if __name__ == "__main__":
    _serve()
