"""`nimprep view`: what is served, to whom, and everything that is not."""

from __future__ import annotations

import http.client
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

import nimprep
from nimprep.errors import NimprepError
from nimprep.report.server import HOST, ViewServer, make_server
from nimprep.report.store_page import examine
from tests.processes import PATIENCE_S, Processes

from .stores import gmrp_store

FRAMES = 5


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return gmrp_store(tmp_path_factory.mktemp("view"), FRAMES)


@pytest.fixture(scope="module")
def server(store: Path) -> Iterator[ViewServer]:
    with make_server(examine(store), 0) as made:
        thread = threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        try:
            yield made
        finally:
            made.shutdown()
            thread.join()


def ask(
    server: ViewServer, path: str, method: str = "GET", host: str | None = None, body: bytes = b""
) -> tuple[int, dict[str, str], bytes]:
    connection = http.client.HTTPConnection(HOST, server.server_address[1], timeout=PATIENCE_S)
    try:
        connection.putrequest(method, path, skip_host=True)
        connection.putheader("Host", host or f"{HOST}:{server.server_address[1]}")
        if body:
            connection.putheader("Content-Length", str(len(body)))
        connection.endheaders(body or None)
        answer = connection.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read()
    finally:
        connection.close()


def test_the_page_is_served_with_every_frame_and_no_picture_in_it(server: ViewServer) -> None:
    status, headers, body = ask(server, "/")
    assert status == 200
    assert headers["Content-Type"] == "text/html; charset=utf-8"
    page = body.decode()
    data = re.search(r'id="gallery-data">(.*?)</script>', page, re.S)
    assert data is not None
    gallery = json.loads(data[1])
    assert gallery["served"] is True
    assert gallery["shown"] == list(range(FRAMES))
    assert "pictures-0" not in page
    assert "img-src data: 'self'" in page.replace("&#39;", "'")


def test_a_full_picture_has_the_pixels_of_the_store(server: ViewServer, store: Path) -> None:
    status, headers, body = ask(server, "/frame/3/rgb/full")
    assert (status, headers["Content-Type"]) == (200, "image/png")
    image = cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_COLOR_RGB)
    assert np.array_equal(image, nimprep.open_store(store)[3].rgb)


@pytest.mark.parametrize("name", ["rgb", "depth", "normal", "hha", "label"])
def test_each_modality_has_a_small_picture(server: ViewServer, name: str) -> None:
    for _ in range(2):
        status, headers, body = ask(server, f"/frame/0/{name}/small")
        assert (status, headers["Content-Type"]) == (200, "image/jpeg")
        assert cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_COLOR).shape == (24, 32, 3)


def test_head_answers_as_get_without_the_body(server: ViewServer) -> None:
    for path in ("/", "/frame/1/depth/full", "/frame/9/depth/full"):
        got, told = ask(server, path), ask(server, path, "HEAD")
        assert told[0] == got[0]
        assert told[1]["Content-Length"] == str(len(got[2]))
        with socket.create_connection(server.server_address[:2], timeout=PATIENCE_S) as connection:
            name = f"{HOST}:{server.server_address[1]}"
            request = f"HEAD {path} HTTP/1.1\r\nHost: {name}\r\nConnection: close\r\n\r\n"
            connection.sendall(request.encode())
            with connection.makefile("rb") as answer:
                assert answer.read().endswith(b"\r\n\r\n")


@pytest.mark.parametrize(
    "path",
    [
        f"/frame/{FRAMES}/rgb/full",
        "/frame/-1/rgb/full",
        "/frame/01/rgb/full",
        "/frame/1e0/rgb/full",
        "/frame/99999999999999999999/rgb/full",
        "/frame/0/frame_id/full",
        "/frame/0/rgb/large",
        "/frame/0/rgb",
        "/frame/0/rgb/full/",
        "/frame/0/RGB/full",
        "/frame/0/..%2frgb/full",
        "/frame/0/../0/rgb/full",
        "/../zarr.json",
        "/zarr.json",
        "/%2e%2e/etc/passwd",
        "/etc/passwd",
        "/favicon.ico",
        "/index.html",
        "http://127.0.0.1/",
        "*",
        "",
        "/frame/%D9%A1/rgb/full",
    ],
)
def test_nothing_else_is_there(server: ViewServer, path: str) -> None:
    status, _, body = ask(server, path or "x")
    assert status in (400, 404)
    assert b"zarr" not in body


@pytest.mark.parametrize(
    "host",
    ["evil.example", "127.0.0.1", "localhost", "evil.example:{port}", "127.0.0.1:1", "[::1]"],
)
def test_other_hosts_are_refused(server: ViewServer, host: str) -> None:
    named = host.format(port=server.server_address[1])
    for path in ("/", "/frame/0/rgb/small"):
        status, _, body = ask(server, path, host=named)
        assert status == 403
        assert len(body) < 100


def test_localhost_is_this_machine_too(server: ViewServer) -> None:
    assert ask(server, "/", host=f"localhost:{server.server_address[1]}")[0] == 200


def test_a_request_without_or_with_two_hosts_is_refused(server: ViewServer) -> None:
    good = f"Host: {HOST}:{server.server_address[1]}\r\n"
    for hosts in ("", good + "Host: evil.example\r\n"):
        with socket.create_connection(server.server_address[:2], timeout=PATIENCE_S) as connection:
            connection.sendall(f"GET / HTTP/1.1\r\n{hosts}Connection: close\r\n\r\n".encode())
            assert connection.recv(64).startswith(b"HTTP/1.1 403 ")


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "BREW"])
def test_only_get_and_head_are_answered(server: ViewServer, method: str) -> None:
    status, headers, _ = ask(server, "/", method, body=b"GET / HTTP/1.1\r\n\r\n")
    assert status == 405
    assert headers["Allow"] == "GET, HEAD"


def test_answers_keep_other_sites_out(server: ViewServer) -> None:
    for path in ("/", "/frame/0/rgb/full", "/nowhere"):
        headers = ask(server, path)[1]
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert headers["X-Frame-Options"] == "DENY"
        assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
        assert headers["Cache-Control"] == "no-store"
        assert "Access-Control-Allow-Origin" not in headers
        assert "Python" not in headers["Server"]


def test_it_listens_on_this_machine_only(server: ViewServer) -> None:
    assert server.socket.getsockname()[0] == "127.0.0.1"


def test_many_requests_at_once_get_their_own_pictures(server: ViewServer, store: Path) -> None:
    opened = nimprep.open_store(store)
    wrong = []

    def look(frame: int) -> None:
        body = ask(server, f"/frame/{frame}/rgb/full")[2]
        image = cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_COLOR_RGB)
        if not np.array_equal(image, opened[frame].rgb):
            wrong.append(frame)

    threads = [threading.Thread(target=look, args=(i % FRAMES,)) for i in range(20)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def test_a_damaged_picture_is_told_and_the_rest_goes_on(tmp_path: Path) -> None:
    path = gmrp_store(tmp_path, 2)
    with make_server(examine(path), 0) as made:
        thread = threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        try:
            for file in (path / "rgb" / "c").rglob("*"):
                if file.is_file():
                    data = bytearray(file.read_bytes())
                    data[40] ^= 1
                    file.write_bytes(data)
            status, _, body = ask(made, "/frame/0/rgb/full")
            assert status == 500
            assert b"wrong checksum" in body
            assert ask(made, "/frame/0/depth/full")[0] == 200
        finally:
            made.shutdown()
            thread.join()


def test_a_port_in_use_is_told(server: ViewServer) -> None:
    with pytest.raises(NimprepError, match=r"expected a free port, found .*; try --port 0"):
        make_server(server.seen, server.server_address[1])


def test_the_command_says_where_and_an_interrupt_ends_it_cleanly(
    store: Path, processes: Processes
) -> None:
    before = {p: p.stat().st_mtime_ns for p in store.rglob("*")}
    command = [sys.executable, "-m", "nimprep", "view", str(store), "--port", "0"]
    process = processes.start(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    assert process.stdout is not None
    line = process.stdout.readline()
    found = re.search(r"5 frames at http://127\.0\.0\.1:(\d+)/", line)
    assert found, line
    connection = http.client.HTTPConnection(HOST, int(found[1]), timeout=PATIENCE_S)
    connection.request("GET", "/frame/0/rgb/small")
    assert connection.getresponse().read()
    connection.close()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, errors) == (0, "")
    assert {p: p.stat().st_mtime_ns for p in store.rglob("*")} == before
