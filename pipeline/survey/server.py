"""The server of the study's page: three files and two questions, and nothing from elsewhere.

It listens where it is told, on this machine alone by default. What comes in is bounded in size, time and number. A
page of another site can neither read nor send anything: requests must name this address as their host, choices come
as JSON, which browsers send across sites only with a permission that is not given here.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, cast

from pipeline.errors import SurveyError
from pipeline.survey.questionnaire import Questionnaire
from pipeline.survey.visits import RefusedError, Visits
from pipeline.terminal import say

PAGES = Path(__file__).with_name("pages")
LOOPBACK = ("127.0.0.1", "::1", "localhost")
LARGEST_REQUEST, PATIENCE_S, MOST_AT_ONCE = 4_096, 20.0, 512
_FILES = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/survey.js": ("survey.js", "text/javascript; charset=utf-8"),
    "/survey.css": ("survey.css", "text/css; charset=utf-8"),
}
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}


class Server(ThreadingHTTPServer):
    """The server of one study."""

    daemon_threads = True
    request_queue_size = 256

    def __init__(self, bind: str, port: int, visits: Visits, words: dict[str, str]) -> None:
        self.visits = visits
        self.words = words
        self.study = _described(visits.questionnaire)
        self.local = bind in LOOPBACK
        self.places = threading.BoundedSemaphore(MOST_AT_ONCE)
        super().__init__((bind, port), _Handler)

    @property
    def hosts(self) -> set[str]:
        """What a browser on this machine calls this server."""
        return {f"{name}:{self.server_port}" for name in ("127.0.0.1", "localhost", "[::1]")}

    def process_request(self, request: Any, client_address: Any) -> None:
        """Take a request if there is a place for it; else hang up, and the page tries again."""
        if not self.places.acquire(blocking=False):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer a request and free its place."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self.places.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that hangs up is no error."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "lessbench", ""
    timeout = PATIENCE_S

    def do_GET(self) -> None:
        if not self._of_here():
            return
        path = self.path.partition("?")[0]
        if path == "/words":
            server = cast(Server, self.server)
            self._answer(HTTPStatus.OK, _json({"words": server.words, "study": server.study}), _JSON)
        elif path in _FILES:
            name, kind = _FILES[path]
            self._answer(HTTPStatus.OK, (PAGES / name).read_bytes(), kind)
        else:
            self._answer(HTTPStatus.NOT_FOUND, b"there is no such page\n", _TEXT)

    def do_POST(self) -> None:
        if not self._of_here():
            return
        visits = cast(Server, self.server).visits
        ask = {"/enter": visits.enter, "/choose": visits.choose}.get(self.path)
        if ask is None:
            return self._refuse(HTTPStatus.NOT_FOUND, "there is no such page")
        length = self.headers.get("Content-Length", "")
        if self.headers.get_content_type() != "application/json" or not length.isascii() or not length.isdigit():
            return self._refuse(HTTPStatus.BAD_REQUEST, "send JSON, with its length")
        if len(length) > 9 or int(length) > LARGEST_REQUEST:
            return self._refuse(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"send at most {LARGEST_REQUEST} bytes")
        try:
            sent = json.loads(self.rfile.read(int(length)).decode("utf-8"))
            self._answer(HTTPStatus.OK, _json(ask(sent)), _JSON)
        except RefusedError as error:
            self._refuse(HTTPStatus.BAD_REQUEST, str(error))
        except (ValueError, RecursionError):
            self._refuse(HTTPStatus.BAD_REQUEST, "what was sent is no JSON")
        except SurveyError as error:
            self._refuse(HTTPStatus.INSUFFICIENT_STORAGE, "the answer could not be kept")
            say(str(error), error=True)

    def _of_here(self) -> bool:
        """Whether the request was meant for this server, and comes from its own page."""
        server = cast(Server, self.server)
        host, origin = self.headers.get("Host", ""), self.headers.get("Origin")
        if (not server.local or host in server.hosts) and (origin is None or origin.partition("://")[2] == host):
            return True
        self._refuse(HTTPStatus.FORBIDDEN, "this server is called by another name")
        return False

    def _refuse(self, status: HTTPStatus, why: str) -> None:
        self.close_connection = True
        self._answer(status, _json({"refused": why}), _JSON)

    def _answer(self, status: HTTPStatus, body: bytes, kind: str) -> None:
        self.send_response(status)
        for name, value in {**_HEADERS, "Content-Type": kind, "Content-Length": str(len(body))}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:
        """Nothing is logged: addresses of participants are nobody's business."""


_JSON, _TEXT = "application/json", "text/plain; charset=utf-8"


@contextmanager
def serving(bind: str, port: int, visits: Visits, words: dict[str, str]) -> Iterator[Server]:
    """Serve the study from a thread of its own until the block is left.

    Raises:
        SurveyError: the address cannot be had.
    """
    try:
        server = Server(bind, port, visits, words)
    except (OSError, OverflowError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise SurveyError(f"{bind}:{port} cannot be listened at ({reason.lower()}); try --port 0") from None
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def _described(questionnaire: Questionnaire) -> dict[str, object]:
    kinds = {"grid" if trial.grid else "task" for trial in questionnaire.trials.values()}
    return {
        "title": questionnaire.title, "minutes": questionnaire.minutes, "contact": questionnaire.contact,
        "kinds": sorted(kinds),
    }  # fmt: skip


def _json(value: object) -> bytes:
    return json.dumps(value).encode()
