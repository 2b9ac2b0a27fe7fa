"""An S3 server for the tests here: moto's, in a process of its own on a port of loopback."""

from __future__ import annotations

import itertools
import json
import shutil
import socket
import subprocess
import sys
import threading
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import pytest

import nimprep
from nimprep.store import connection, object_lock, objects
from tests.cloud.clock import Clock
from tests.cloud.server import BUCKET, VARIABLES, FolderHandler, Proxy, Server
from tests.fakes import contents, write_gmrp
from tests.processes import Processes

SERVE = """
import json, logging, sys
logging.getLogger("werkzeug").setLevel(logging.ERROR)
from moto.server import ThreadedMotoServer
server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
server.start()
print(json.dumps(server.get_host_and_port()), flush=True)
sys.stdin.read()  # until whoever started it is gone
"""

CAMERA = (30.0, 31.0, 15.0, 11.0)


@pytest.fixture(scope="session")
def port() -> Iterator[int]:
    """Start the server; return its port."""
    with Processes() as processes:
        process = processes.start(
            [sys.executable, "-c", SERVE], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        _, found = json.loads(process.stdout.readline())
        make = urllib.request.Request(f"http://127.0.0.1:{found}/{BUCKET}", method="PUT")
        urllib.request.urlopen(make).close()
        yield found


@pytest.fixture
def proxy(port: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[Proxy]:
    """Return what stands before the server; every request of the test goes through it."""
    made = Proxy(port)
    for name, value in VARIABLES.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("AWS_ENDPOINT_URL", made.url)
    monkeypatch.setattr(connection, "BACKOFF_S", 0.001)
    yield made
    made.close()


@pytest.fixture
def nobody() -> Iterator[str]:
    """Return an address at which nobody answers, nor can begin to."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        yield f"http://127.0.0.1:{taken.getsockname()[1]}"


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """Return the clock by which locks grow stale."""
    made = Clock()
    monkeypatch.setattr(object_lock, "time", made)
    return made


_numbers = itertools.count()


@pytest.fixture
def url(proxy: Proxy) -> str:
    """Return a place for a store that no other test has."""
    return f"s3://{BUCKET}/{next(_numbers)}/out.zarr"


@pytest.fixture(scope="session")
def raw(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a dataset of 7 frames."""
    return write_gmrp(tmp_path_factory.mktemp("raw") / "gmrp", frames=7)


@pytest.fixture(scope="session")
def local(raw: Path) -> Path:
    """Return the dataset's store on the disk, two frames to a shard."""
    return nimprep.convert(raw, raw.parent / "local.zarr", shard_length=2, camera=CAMERA).path  # type: ignore[return-value]


@pytest.fixture
def made(url: str, local: Path, proxy: Proxy) -> str:
    """Return the URL of the dataset's store; requests are counted from here on."""
    storage = objects.ObjectStorage(url)
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda item: storage.write(item[0], [item[1]]), contents(local).items()))
    proxy.forget()
    return url


@pytest.fixture
def web(local: Path) -> Iterator[str]:
    """Return the address of a web server that has the store, and one without its intrinsics."""
    part = local.parent / "part.zarr"
    if not part.exists():
        shutil.copytree(local, part)
        (part / "intrinsics" / "c" / "0" / "0" / "0").unlink()
    server = Server(("127.0.0.1", 0), partial(FolderHandler, local.parent))
    thread = threading.Thread(target=server.serve_forever, args=(0.05,))
    thread.start()
    yield f"http://127.0.0.1:{server.server_address[1]}"
    server.shutdown()
    server.server_close()
    thread.join()
