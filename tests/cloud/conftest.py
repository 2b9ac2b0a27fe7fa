"""An S3 server for the tests here: moto's, in a process of its own on a port of loopback."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

import nimprep
from nimprep.store import objects
from tests.cloud.server import BUCKET, VARIABLES, Proxy
from tests.fakes import write_gmrp

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
    process = subprocess.Popen(
        [sys.executable, "-c", SERVE], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    _, found = json.loads(process.stdout.readline())
    make = urllib.request.Request(f"http://127.0.0.1:{found}/{BUCKET}", method="PUT")
    urllib.request.urlopen(make).close()
    yield found
    process.kill()
    process.communicate()


@pytest.fixture
def proxy(port: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[Proxy]:
    """Return what stands before the server; every request of the test goes through it."""
    made = Proxy(port)
    for name, value in VARIABLES.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("AWS_ENDPOINT_URL", made.url)
    monkeypatch.setattr(objects, "BACKOFF_S", 0.001)
    yield made
    made.close()


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
def made(url: str, raw: Path, proxy: Proxy) -> str:
    """Return the URL of the dataset's store; requests are counted from here on."""
    nimprep.convert(raw, url, shard_length=2, camera=CAMERA)
    proxy.forget()
    return url
