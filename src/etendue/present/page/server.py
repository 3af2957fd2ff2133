"""Server of the live page: local, read-only, and accessible only to users who know its address.

In:  an archive; a port, 0 for any free one.
Out: answers to GET below a path that cannot be guessed. A request that names another host is refused, so that a web
     page cannot reach the server by pointing its own name at this address. Nothing is written, and no path of a request
     is ever used as a path on disk.
"""

from __future__ import annotations

import hmac
import secrets
import selectors
import socket
import threading
import time
from collections import OrderedDict
from concurrent.futures import ThreadPoolExecutor
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any
from urllib.parse import parse_qsl, urlsplit

from etendue.errors import EtendueError
from etendue.present.page.live import HttpRefusal, Live

HOST = "127.0.0.1"
HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "X-Frame-Options": "DENY",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
}


ANSWERING = 8  # threads: each handles one request at a time
# connections without a request yet; beyond this the oldest is closed, well below the usual limit of 1024 open files
WAITING = 900
PATIENCE = 30.0  # seconds until a connection without a request is closed


class Server(HTTPServer):
    """HTTP server that answers until ``shutdown`` at the address ``url``. A connection without a request occupies no
    thread.
    """

    request_queue_size = 128

    def __init__(self, live: Live, port: int = 0) -> None:
        self.pool = ThreadPoolExecutor(ANSWERING, "answer")
        # by connection: the address of the client, and the time since which the connection waits
        self.waiting: OrderedDict[socket.socket, tuple[Any, float]] = OrderedDict()
        super().__init__((HOST, port), _Handler)  # closes the socket itself if the port is taken
        self.live = live
        self.token = secrets.token_urlsafe(24)
        self.over, self.ended = threading.Event(), threading.Event()
        self.ended.set()

    def serve_forever(self, poll_interval: float = 0.1) -> None:
        """Wait for requests on all connections, and let a thread of the pool answer each request."""
        self.ended.clear()
        try:
            with selectors.DefaultSelector() as selector:
                selector.register(self.socket, selectors.EVENT_READ)
                while not self.over.is_set():
                    for key, _ in selector.select(poll_interval):
                        if key.fileobj is self.socket:
                            self._welcome(selector)
                        elif isinstance(key.fileobj, socket.socket) and key.fileobj in self.waiting:
                            selector.unregister(key.fileobj)
                            self.pool.submit(self._answer, key.fileobj, self.waiting.pop(key.fileobj)[0])
                    while self.waiting and time.monotonic() - next(iter(self.waiting.values()))[1] > PATIENCE:
                        self._dismiss(selector)
        finally:
            self.ended.set()

    def _welcome(self, selector: selectors.BaseSelector) -> None:
        try:
            request, address = self.get_request()
        except OSError:  # gone again, or the limit of open files is reached
            if self.waiting:
                self._dismiss(selector)
            return
        self.waiting[request] = address, time.monotonic()
        selector.register(request, selectors.EVENT_READ)
        if len(self.waiting) > WAITING:
            self._dismiss(selector)

    def _dismiss(self, selector: selectors.BaseSelector) -> None:
        """Close the connection that has waited longest."""
        request, _ = self.waiting.popitem(last=False)
        selector.unregister(request)
        self.shutdown_request(request)

    def _answer(self, request: socket.socket, address: Any) -> None:
        try:
            self.finish_request(request, address)
        except Exception:
            self.handle_error(request, address)
        finally:
            self.shutdown_request(request)

    def shutdown(self) -> None:
        """Stop ``serve_forever``, which runs in another thread."""
        self.over.set()
        self.ended.wait()

    def server_close(self) -> None:
        super().server_close()
        for request in self.waiting:
            self.shutdown_request(request)
        self.waiting.clear()
        self.pool.shutdown(wait=False, cancel_futures=True)

    @property
    def url(self) -> str:
        return f"http://{HOST}:{self.server_port}/{self.token}/"

    @property
    def hosts(self) -> tuple[str, str]:
        return f"{HOST}:{self.server_port}", f"localhost:{self.server_port}"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore errors of browsers that have disconnected."""


class _Handler(BaseHTTPRequestHandler):
    server: Server
    server_version = "etendue"
    sys_version = ""
    protocol_version = "HTTP/1.1"
    timeout = 5.0  # seconds until a request must be complete

    def do_GET(self) -> None:
        if self.headers.get("Host", "") not in self.server.hosts:
            return self._send(403, "text/plain", b"wrong host\n")
        if self.headers.get("Sec-Fetch-Site", "none") not in ("none", "same-origin"):
            return self._send(403, "text/plain", b"wrong site\n")
        parts = urlsplit(self.path)
        token, slash, what = parts.path.removeprefix("/").partition("/")
        if not slash or not hmac.compare_digest(token.encode(), self.server.token.encode()):
            return self._send(404, "text/plain", b"nothing here\n")
        answer = self.server.live.answers.get(what)
        if answer is None:
            return self._send(404, "text/plain", b"nothing here\n")
        try:
            kind, body, extra = answer(dict(parse_qsl(parts.query, max_num_fields=32)))
        except HttpRefusal as error:
            return self._send(error.status, "text/plain; charset=utf-8", f"{error}\n".encode())
        except (EtendueError, ValueError, OSError, RuntimeError) as error:
            if self.server.live.gone:
                return self._send(
                    410, "text/plain; charset=utf-8", f"{self.server.live.folder} is no longer there\n".encode()
                )
            return self._send(500, "text/plain; charset=utf-8", f"{error}\n".encode())
        return self._send(200, kind, body, extra)

    def _only_looking(self) -> None:
        self.close_connection = True  # the body is not read
        self._send(405, "text/plain", b"only GET is allowed\n", {"Allow": "GET"})

    do_POST = do_PUT = do_DELETE = do_PATCH = do_OPTIONS = do_HEAD = _only_looking

    def _send(self, status: int, kind: str, body: bytes, extra: dict[str, str] | None = None) -> None:
        self.send_response(status)
        for name, value in {
            "Content-Type": kind,
            "Content-Length": str(len(body)),
            **HEADERS,
            **(extra or {}),
            "Connection": "close",
        }.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing: requests are private."""
