"""Serve a store's page and its pictures to this machine, read-only and from memory."""

from __future__ import annotations

import re
import sys
from contextlib import suppress
from functools import lru_cache
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import urlsplit

from nimprep.errors import NimprepError
from nimprep.report.pictures import encode_picture
from nimprep.report.store_page import Examined, page_of

HOST = "127.0.0.1"
SMALL_WIDTH = 480
SMALL_QUALITY = 85

_PICTURE = re.compile(r"/frame/(0|[1-9][0-9]{0,8})/([a-z_-]{1,32})/(small|full)")
_KEPT = 512
"""Small pictures kept in memory, some tens of kilobytes each."""

_IDLE_S = 30


class ViewServer(ThreadingHTTPServer):
    """Answer GET and HEAD of ``/`` and of ``/frame/<number>/<modality>/<small or full>``.

    Nothing a request says is used as a path: a picture is named by its frame's number and by one of
    the store's modalities, and everything else is not found. Only requests that name this machine
    as their host are answered, so that another site's page cannot read the store by giving its
    own name this machine's address.

    Attributes
    ----------
    address : str
        Where the page is.
    """

    daemon_threads = True

    def __init__(self, seen: Examined, port: int) -> None:
        super().__init__((HOST, port), _Handler)
        self.seen = seen
        self.page = page_of(seen, None).encode("utf-8")
        number = self.server_address[1]
        self.address = f"http://{HOST}:{number}/"
        self.hosts = {f"{HOST}:{number}", f"localhost:{number}"}
        # On the instance, so that the pictures go when the server does.
        self.small = lru_cache(_KEPT)(self._small)

    def picture(self, index: int, name: str, size: str) -> tuple[bytes, str] | None:
        """Return a picture's bytes and type; None where there is no such frame or modality."""
        if index >= len(self.seen.store) or name not in self.seen.artist.looks:
            return None
        if size == "small":
            return self.small(index, name), "image/jpeg"
        # Lossless, and quick to make: these bytes travel within one machine.
        return encode_picture(self.seen.artist.draw(index, name), "png"), "image/png"

    def _small(self, index: int, name: str) -> bytes:
        picture = self.seen.artist.draw(index, name, SMALL_WIDTH)
        return encode_picture(picture, "jpeg", SMALL_QUALITY)

    def run(self) -> None:
        """Serve until interrupted (Ctrl-C)."""
        with suppress(KeyboardInterrupt):
            self.serve_forever(poll_interval=0.2)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of a browser that went away; other errors are shown."""
        if not isinstance(sys.exception(), ConnectionError | TimeoutError):
            super().handle_error(request, client_address)


def make_server(seen: Examined, port: int) -> ViewServer:
    """Return a server that listens on 127.0.0.1; port 0 takes any that is free.

    Raises
    ------
    NimprepError
        The port is taken or not to be had.
    """
    try:
        return ViewServer(seen, port)
    except OSError as error:
        raise NimprepError(
            f"{HOST}:{port}: expected a free port, found {error.strerror}; try --port 0"
        ) from error


class _Handler(BaseHTTPRequestHandler):
    server: ViewServer
    protocol_version = "HTTP/1.1"
    server_version = "nimprep"
    sys_version = ""
    timeout = _IDLE_S

    def do_GET(self) -> None:
        self._answer()

    def do_HEAD(self) -> None:
        self._answer()

    def __getattr__(self, name: str) -> Any:
        # The base class asks for do_<METHOD>: any other method is known, and refused.
        if name.startswith("do_"):
            return self._refuse_method
        raise AttributeError(name)

    def _refuse_method(self) -> None:
        # A body was not read: what follows on this connection would be taken for a request.
        self.close_connection = True
        self._send(405, b"only GET and HEAD\n", "text/plain; charset=utf-8", Allow="GET, HEAD")

    def _answer(self) -> None:
        if self.headers.get_all("Host", []) not in [[host] for host in self.server.hosts]:
            self._send(403, b"not served under this name\n", "text/plain; charset=utf-8")
            return
        path = urlsplit(self.path).path if self.path.startswith("/") else ""
        if path == "/":
            self._send(200, self.server.page, "text/html; charset=utf-8")
            return
        named = _PICTURE.fullmatch(path)
        try:
            found = named and self.server.picture(int(named[1]), named[2], named[3])
        except NimprepError as error:
            self._send(500, f"{error}\n".encode(), "text/plain; charset=utf-8")
            return
        if found:
            self._send(200, found[0], found[1])
        else:
            self._send(404, b"not found\n", "text/plain; charset=utf-8")

    def _send(self, status: int, body: bytes, kind: str, **headers: str) -> None:
        self.send_response(status)
        sent = {
            "Content-Type": kind,
            "Content-Length": str(len(body)),
            "Cache-Control": "no-store",
            "X-Content-Type-Options": "nosniff",
            "X-Frame-Options": "DENY",
            "Cross-Origin-Resource-Policy": "same-origin",
            "Referrer-Policy": "no-referrer",
            **headers,
        }
        for name, value in sent.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
        """Log nothing: requests are of no interest to whoever looks at pictures."""
