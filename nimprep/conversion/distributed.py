"""Encoding units on other machines: the same units, as tasks of a Dask cluster that is running.

The cluster's workers read the source and write the target themselves; only a job goes to them and
only records come back. What Dask calls a retry is for faults of the machinery: a bad frame is bad
everywhere, and comes back as the error it is.
"""

from __future__ import annotations

import asyncio
import logging
import pickle
import time
import uuid
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import closing, contextmanager
from itertools import islice
from typing import Any

from nimprep import __version__
from nimprep.conversion.plan import Job
from nimprep.conversion.records import UnitRecord
from nimprep.conversion.worker import Reply, packed
from nimprep.errors import ClusterError, NimprepError

CONNECT_S = 10.0
"""How long a scheduler may take to answer."""

PATIENCE_S = 300.0
"""How long a cluster may be without any worker: one that grows on demand needs minutes."""

LOOK_S = 5.0
"""How often to look for workers while nothing is finished."""

AHEAD = 2
"""Units in the works per thread of the cluster: one at work, one that waits."""

RETRIES = 3


def encode_units(job: Job, todo: Sequence[int], done: Callable[[], None]) -> Generator[UnitRecord]:
    """Encode and write units on the cluster that the job's options name; yield their records.

    Records come as units are finished, in any order. Held by each thread of a worker: the
    compressed chunks of one unit, and one frame.

    Parameters
    ----------
    todo : sequence of int
        Units' numbers.
    done : callable
        Called for each frame, once its unit is written.

    Raises
    ------
    ClusterError
        The cluster is out of reach, without workers, or its workers cannot do the work.
    NimprepError
        A frame is bad or the disk full; the units finished by then have been yielded.
    """
    units = job.units()
    left = iter(todo)
    waiting: dict[Any, int] = {}
    with _connected(job.options.scheduler or "") as client:
        submit = _submitter(client, job)
        while True:
            room = max(AHEAD, AHEAD * _threads(client)) - len(waiting)
            waiting |= {submit(number): number for number in islice(left, max(0, room))}
            if not waiting:
                return
            failure: NimprepError | None = None
            for future in _finished(client, list(waiting)):
                try:
                    record = _record(future, waiting.pop(future))
                except NimprepError as error:
                    failure = failure or error
                    continue
                for _ in units[record.number]:
                    done()
                # Even after a bad frame: what is whole must not be made again.
                yield record
            if failure is not None:
                raise failure


def check_scheduler(address: str) -> None:
    """Make sure that there is a Dask scheduler at an address.

    Raises
    ------
    ClusterError
        There is none, or Dask is not installed.
    """
    try:
        import distributed  # noqa: F401
    except ImportError as error:
        raise ClusterError(
            f"--scheduler: expected Dask's distributed, found {error}; "
            "pip install 'nimprep[distributed]'"
        ) from error
    try:
        # In a thread of its own, since the caller's may have an event loop that runs.
        with ThreadPoolExecutor(1) as pool:
            pool.submit(asyncio.run, _knock(address)).result()
    except (OSError, ValueError) as error:
        raise ClusterError(
            f"{address}: expected a Dask scheduler, found {str(error) or 'no answer'}; start one "
            "with dask scheduler, or convert without --scheduler"
        ) from error


async def _knock(address: str) -> None:
    from distributed import Security
    from distributed.comm import connect

    arguments = Security().get_connection_args("client")
    # Dask bounds the connection alone: who takes it and then says nothing would never be left.
    greeting = connect(address, timeout=CONNECT_S / 2, **arguments)
    (await asyncio.wait_for(greeting, CONNECT_S)).abort()


@contextmanager
def _connected(address: str) -> Iterator[Any]:
    """Give a client; when the context ends, tasks that nobody waits for any more are dropped."""
    from distributed import Client

    log = logging.getLogger("distributed.client")
    level = log.level
    # A lost connection is told once, below, and not as tracebacks on stderr beside it.
    log.setLevel(logging.CRITICAL + 1)
    try:
        with closing(Client(address, timeout=CONNECT_S, set_as_default=False)) as client:
            yield client
    except NimprepError:
        raise
    except (OSError, CancelledError) as error:
        raise ClusterError(
            f"{address}: expected the cluster to see it through, found the connection lost or the "
            "tasks cancelled; the same command goes on from what is kept"
        ) from error
    finally:
        log.setLevel(level)


def _threads(client: Any) -> int:
    return sum(client.nthreads().values())


def _submitter(client: Any, job: Job) -> Callable[[int], Any]:
    """Send the job to the cluster, once; return what submits a unit of it by number."""
    run = uuid.uuid4().hex
    data = packed(job, run)
    # A task that returns it, and not scattered data: the scheduler can make that anew when the
    # worker that holds it is lost.
    shared = client.submit(_constant(), data, key=f"nimprep-job-{run}", retries=RETRIES)
    encode = _entry()

    def submit(number: int) -> Any:
        key = f"nimprep-unit-{run}-{number}"
        return client.submit(encode, __version__, shared, number, key=key, retries=RETRIES)

    return submit


def _constant() -> Callable[[bytes], bytes]:
    # Defined within, like `_entry`'s, so that it travels as code and not by its name: neither the
    # scheduler nor a worker needs nimprep to take it in.
    def constant(data: bytes) -> bytes:
        return data

    return constant


def _entry() -> Callable[[str, bytes, int], Reply]:
    """Return what workers run; it can say so where nimprep is missing."""

    def encode(version: str, data: bytes, number: int) -> tuple[str, bytes]:
        try:
            import nimprep

            found = f"nimprep {nimprep.__version__}"
        except ImportError as error:
            found = str(error)
        if found != f"nimprep {version}":
            from distributed import get_worker

            return "version", f"{found} on worker {get_worker().address}".encode()
        from nimprep.conversion.worker import encode_unit_of

        return encode_unit_of(data, number)

    return encode


def _finished(client: Any, futures: Sequence[Any]) -> set[Any]:
    """Wait until some futures are done; return them."""
    from distributed import wait

    alone_since = None
    while True:
        try:
            with client.as_current():
                finished: set[Any] = wait(
                    futures, timeout=LOOK_S, return_when="FIRST_COMPLETED"
                ).done
            return finished
        except TimeoutError:
            pass
        if _threads(client):
            alone_since = None
            continue
        address = client.scheduler.address
        if alone_since is None:
            alone_since = time.monotonic()
            warnings.warn(
                f"{address}: no workers, waiting {PATIENCE_S:.0f} s for some", stacklevel=2
            )
        if time.monotonic() - alone_since >= PATIENCE_S:
            raise ClusterError(
                f"{address}: expected workers, found none for {PATIENCE_S:.0f} s; start some with "
                f"dask worker {address}"
            )


def _record(future: Any, number: int) -> UnitRecord:
    from distributed import KilledWorker

    try:
        kind, data = future.result()
    except KilledWorker as error:
        raise ClusterError(
            f"unit {number}: expected a worker to finish it, found the last "
            f"{error.allowed_failures + 1} lost at it; give workers more memory, or fewer frames "
            "at a time by --shard-length"
        ) from error
    if kind == "version":
        raise ClusterError(
            f"expected nimprep {__version__} on every worker, found {data.decode()}; "
            "install the same version there"
        )
    if kind == "error":
        raise pickle.loads(data)
    return UnitRecord.from_json(data)
