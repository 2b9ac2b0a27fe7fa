"""An S3 server on loopback, and a proxy before it that counts requests and spoils some."""

from __future__ import annotations

import contextlib
import http.client
import re
import socket
import struct
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

BUCKET = "bucket"

VARIABLES = {
    "AWS_ACCESS_KEY_ID": "key",
    "AWS_SECRET_ACCESS_KEY": "secret",
    "AWS_REGION": "us-east-1",
    "NO_PROXY": "127.0.0.1",
}


class Request:
    """One request as the server saw it: its method, its path, and the bytes it asked for."""

    def __init__(self, method: str, path: str, span: str | None) -> None:
        self.method = method
        self.path = path.partition("?")[0].removeprefix(f"/{BUCKET}").lstrip("/")
        self.query = path.partition("?")[2]
        self.span = span

    def __repr__(self) -> str:
        return " ".join(filter(None, (self.method, self.path, self.query, self.span)))


Fault = Callable[[Request], str | None]
"""Says what happens to a request: None, "503", "500", "reset", "cut", "lost" or "stall".

"reset" closes the connection before the server sees the request, "lost" after; "cut" in the middle
of the answer; "stall" does not answer.
"""


class Server(ThreadingHTTPServer):
    """Answer each connection in a thread; many may come at once."""

    request_queue_size = 128
    daemon_threads = True


class Proxy:
    """Pass requests on to a server, count them, and spoil those that `fault` chooses."""

    def __init__(self, port: int) -> None:
        self.requests: list[Request] = []
        self.spoilt: list[Request] = []
        self.fault: Fault = lambda request: None
        self.closing = threading.Event()
        self._server = Server(("127.0.0.1", 0), _handler(self, port))
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}"
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,))
        self._thread.start()

    def forget(self) -> None:
        """Count anew."""
        self.requests, self.spoilt = [], []

    def close(self) -> None:
        """Stop."""
        self.closing.set()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def seen(self, method: str, part: str = "") -> list[Request]:
        """Return the requests of a method whose path has a part."""
        return [r for r in self.requests if r.method == method and part in r.path]


def _handler(proxy: Proxy, port: int) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"
        # Else an answer's second packet waits for the first one's receipt: 40 ms a request.
        disable_nagle_algorithm = True

        def _pass_on(self) -> None:
            body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
            request = Request(self.command, self.path, self.headers.get("Range"))
            fault = proxy.fault(request)
            proxy.requests.append(request)
            if fault:
                proxy.spoilt.append(request)
            if fault == "reset":
                return self._hang_up()
            if fault == "stall":
                proxy.closing.wait()
                return self._hang_up()
            if fault and fault.isdigit():
                return self._answer(int(fault), {}, b"<Error><Code>Spoilt</Code></Error>")
            server = http.client.HTTPConnection("127.0.0.1", port)
            server.request(self.command, self.path, body, dict(self.headers))
            answer = server.getresponse()
            data = answer.read()
            headers = dict(answer.getheaders())
            server.close()
            if fault == "lost":
                return self._hang_up()
            return self._answer(answer.status, headers, data, cut=fault == "cut")

        def _answer(
            self, status: int, headers: dict[str, str], data: bytes, cut: bool = False
        ) -> None:
            self.send_response_only(status)
            for name, value in headers.items():
                if name.lower() not in ("content-length", "transfer-encoding", "connection"):
                    self.send_header(name, value)
            length = str(len(data))
            if self.command == "HEAD":
                length = headers.get("Content-Length", length)
            self.send_header("Content-Length", length)
            self.end_headers()
            if self.command != "HEAD":
                self.wfile.write(data[: len(data) // 2] if cut else data)
            if cut:
                self.wfile.flush()
                self._hang_up()

        def _hang_up(self) -> None:
            # Without lingering: the other side sees a reset, as of a server that died.
            self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            self.close_connection = True
            self.connection.close()

        do_GET = do_PUT = do_POST = do_HEAD = do_DELETE = _pass_on  # noqa: N815

        def handle(self) -> None:
            try:
                super().handle()
            except (OSError, ValueError):
                self.close_connection = True

        def finish(self) -> None:
            with contextlib.suppress(OSError, ValueError):
                super().finish()

        def log_message(self, *arguments: object) -> None:
            pass

    return Handler


class FolderHandler(BaseHTTPRequestHandler):
    """Serve a folder's files, whole and in parts, as web servers do."""

    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True

    def __init__(self, folder: Path, *arguments: Any) -> None:
        self._folder = folder
        super().__init__(*arguments)

    def do_GET(self) -> None:
        """Send a file, or the part of it that is asked for."""
        path = self._folder / self.path.lstrip("/")
        data = path.read_bytes() if path.is_file() else b""
        span = re.fullmatch(r"bytes=(\d*)-(\d*)", self.headers.get("Range", ""))
        status = (206 if span else 200) if path.is_file() else 404
        self.send_response_only(status)
        self.send_header("Last-Modified", self.date_time_string())
        if span:
            size = len(data)
            begin = int(span[1]) if span[1] else max(0, size - int(span[2]))
            end = min(int(span[2]) + 1, size) if span[1] and span[2] else size
            self.send_header("Content-Range", f"bytes {begin}-{end - 1}/{size}")
            data = data[begin:end]
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(data)

    do_HEAD = do_GET  # noqa: N815

    def log_message(self, *arguments: object) -> None:
        """Say nothing."""
