"""Serve a report to a browser on the same machine, and save decisions.

The server of the standard library is sufficient: one user, a few requests a minute, and each answer
is a file or takes a second of work.
"""

from __future__ import annotations

import json
import os
import secrets
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Final
from urllib.parse import unquote, urlsplit

from labpipe.campaign.decisions import (
    ImportedDecisions,
    decision_entry,
    decisions_on,
    import_decisions,
    label_of,
    parse_decisions,
)
from labpipe.errors import LabpipeError, UsageError, error_text, refusal
from labpipe.process.output_paths import RESULT_FILE, files_below
from labpipe.report.lab_report import PAGE_FILE, allow_own_server
from labpipe.report.page_tables import page_file
from labpipe.report.wording import count_of
from labpipe.units import whole_number

LOOPBACK: Final = "127.0.0.1"
REPORT: Final = "report"
_TESTS: Final = page_file("").partition("/")[0]
_TYPES: Final = {
    ".html": "text/html; charset=utf-8",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".pdf": "application/pdf",
    ".json": "application/json",
    ".yaml": "text/plain; charset=utf-8",
    ".csv": "text/plain; charset=utf-8",
}
"""Types that a browser may display; all others are downloads."""
_HEADERS: Final = {
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",  # the address holds the token
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
_NO_SCRIPT: Final = "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src 'self' data:"
"""Policy of all files except labpipe's own pages: other files must not run scripts."""


@dataclass(slots=True)
class Site:
    """A served report.

    Parameters
    ----------
    folder : of the results of the campaign
    campaign : its name
    report : folder of report.html
    make_report : makes the report again
    make_test_page : makes the page of a test from its result file
    token : first part of every address; required for access
    """

    folder: Path
    campaign: str
    report: Path
    make_report: Callable[[], None]
    make_test_page: Callable[[Path], str]
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24))
    work: threading.Lock = field(default_factory=threading.Lock)


class RefusedError(Exception):
    """A refused request, with its HTTP status."""

    def __init__(self, status: HTTPStatus, why: str) -> None:
        super().__init__(why)
        self.status = status


class ReportServer(ThreadingHTTPServer):
    """Serves one report on the loopback address.

    Parameters
    ----------
    site : to serve
    port : number; 0 for any free one

    Raises
    ------
    UsageError
        If the port is in use.
    """

    daemon_threads = True
    allow_reuse_address = os.name != "nt"  # on Windows it allows other programs on the same port

    def __init__(self, site: Site, port: int) -> None:
        self.site = site
        try:
            super().__init__((LOOPBACK, port), _Handler)
        except (OSError, OverflowError) as error:
            raise _port_error(port, error) from error

    def server_bind(self) -> None:
        """Bind without resolving the host name, which may need a network."""
        self.socket.bind(self.server_address)
        self.server_address = self.socket.getsockname()
        self.server_name, self.server_port = LOOPBACK, int(self.server_address[1])

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print errors, except for closed connections."""
        if not isinstance(sys.exception(), (ConnectionError, TimeoutError)):
            super().handle_error(request, client_address)

    @property
    def address(self) -> str:
        """Return the address of the report."""
        return f"http://{LOOPBACK}:{self.server_port}/{self.site.token}/"


def _port_error(port: int, error: Exception) -> UsageError:
    state = (getattr(error, "strerror", None) or "an impossible number").lower()
    remedy = "Choose another with --port, or 0 for any free one."
    return UsageError(
        error_text(f"--port {port}", "", expected="a free port", found=state, remedy=remedy)
    )


class _Handler(BaseHTTPRequestHandler):
    server: ReportServer
    server_version, sys_version = "labpipe", ""
    timeout = 30.0

    def do_GET(self) -> None:
        """Send a page or a file."""
        self._answer(self._get)

    def do_POST(self) -> None:
        """Save decisions, or make the report again."""
        self._answer(self._post)

    def log_message(self, format: str, *args: object) -> None:
        """Do not print requests."""

    def _answer(self, make: Callable[[list[str]], None]) -> None:
        try:
            make(self._parts())
        except RefusedError as error:
            self._send_json({"error": str(error)}, error.status)
        except LabpipeError as error:
            self._send_json({"error": str(error)}, HTTPStatus.CONFLICT)
        except (ConnectionError, TimeoutError):
            raise  # the browser closed the connection
        except OSError as error:
            self._send_json({"error": refusal(error)}, HTTPStatus.INTERNAL_SERVER_ERROR)

    def _parts(self) -> list[str]:
        """Check a request, and return the parts of its address after the token."""
        _check_sender(self.headers, self.server.server_port)
        try:
            parts = unquote(urlsplit(self.path).path, errors="strict").split("/")[1:]
        except ValueError:
            raise _not_found() from None
        token = self.server.site.token
        if not secrets.compare_digest(parts[0].encode("utf-8", "replace"), token.encode()):
            raise RefusedError(HTTPStatus.FORBIDDEN, "Open the address that labpipe serve printed.")
        return parts[1:]

    def _get(self, parts: list[str]) -> None:
        site = self.server.site
        if parts in ([], [""], [REPORT], [REPORT, ""]):
            self._redirect(f"/{site.token}/{REPORT}/{PAGE_FILE}")
            return
        if parts == [REPORT, PAGE_FILE]:
            text = (site.report / PAGE_FILE).read_text(encoding="utf-8")
            self._send(
                allow_own_server(text).encode(), _TYPES[".html"], policy="frame-ancestors 'none'"
            )
            return
        if len(parts) == 3 and parts[:2] == [REPORT, _TESTS]:
            with site.work:
                text = site.make_test_page(_find_test("/".join(parts[1:]), site))
            self._send(text.encode(), _TYPES[".html"], policy="frame-ancestors 'none'")
            return
        self._send_file(_find_file(parts, site))

    def _post(self, parts: list[str]) -> None:
        if self.headers.get("Origin") is None:
            raise RefusedError(HTTPStatus.FORBIDDEN, "Expected a request from the report page.")
        body = self._body()
        site = self.server.site
        if parts == [REPORT, "decisions"]:
            with site.work:
                answer = _save(body, site)
        elif parts == [REPORT, REPORT]:
            with site.work:
                site.make_report()
            answer = {"said": "The report was made again."}
        else:
            raise _not_found()
        self._send_json(answer)

    def _body(self) -> bytes:
        # of a request body
        max_bytes = 5_000_000
        header = self.headers.get("Content-Length", "")
        length = whole_number(header)
        if length is None or length > max_bytes:
            self.close_connection = True
            limits = f"expected at most {max_bytes} bytes, found {header[:20] or 'no length'}."
            raise RefusedError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"decisions: {limits}")
        return self.rfile.read(length)

    def _redirect(self, place: str) -> None:
        self.send_response(HTTPStatus.FOUND)
        self.send_header("Location", place)
        self.send_header("Content-Length", "0")
        self._end_headers(_NO_SCRIPT)

    def _send_file(self, file: Path) -> None:
        content_type = _TYPES.get(file.suffix.lower())
        more = {} if content_type else {"Content-Disposition": "attachment"}
        self._send(file.read_bytes(), content_type or "application/octet-stream", more=more)

    def _send_json(self, content: object, status: HTTPStatus = HTTPStatus.OK) -> None:
        text = json.dumps(content).encode()
        self._send(text, _TYPES[".json"], status=status)

    def _send(
        self,
        content: bytes,
        content_type: str,
        *,
        policy: str = _NO_SCRIPT,
        status: HTTPStatus = HTTPStatus.OK,
        more: dict[str, str] | None = None,
    ) -> None:
        self.send_response(status)
        self.send_header("Content-Type", content_type)
        self.send_header("Content-Length", str(len(content)))
        for name, value in (more or {}).items():
            self.send_header(name, value)
        self._end_headers(policy)
        self.wfile.write(content)

    def _end_headers(self, policy: str) -> None:
        self.send_header("Content-Security-Policy", policy)
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        self.end_headers()


def _check_sender(headers: Any, port: int) -> None:
    """Refuse requests of other sites, also under a host name of theirs."""
    own_hosts = {f"{name}:{port}" for name in (LOOPBACK, "localhost")}
    host, origin = headers.get("Host", ""), headers.get("Origin")
    if host not in own_hosts:
        why = f"Host: expected {LOOPBACK}:{port}, found {host!r}. Open the address as printed."
        raise RefusedError(HTTPStatus.FORBIDDEN, why)
    if origin is not None and origin != f"http://{host}":
        why = f"Origin: expected http://{host}, found {origin!r}. Open the address as printed."
        raise RefusedError(HTTPStatus.FORBIDDEN, why)
    if headers.get("Sec-Fetch-Site", "none") not in {"none", "same-origin"}:
        raise RefusedError(
            HTTPStatus.FORBIDDEN, "The request came from another site. Open the address as printed."
        )


def _not_found() -> RefusedError:
    return RefusedError(HTTPStatus.NOT_FOUND, "There is no such file in this campaign.")


def _find_file(parts: list[str], site: Site) -> Path:
    """Find a file of the report or campaign; refuse hidden files and others."""
    if any(not part or part.startswith(".") or set(part) & set('\\:\0"') for part in parts):
        raise _not_found()
    is_report = parts[0] == REPORT
    top = (site.report if is_report else site.folder).resolve()
    file = top.joinpath(*parts[1:] if is_report else parts).resolve()
    if not file.is_relative_to(top) or not file.is_file():
        raise _not_found()
    return file


def _find_test(name: str, site: Site) -> Path:
    """Find the result of a test by the name of its page."""
    for file in files_below(site.folder, RESULT_FILE):
        if page_file(label_of(file, site.folder)) == name:
            return file
    raise _not_found()


def _save(body: bytes, site: Site) -> dict[str, Any]:
    """Import the decisions of a page; return the answer with all decisions."""
    read = parse_decisions(body, Path("decisions"))
    if read.faults:
        raise RefusedError(HTTPStatus.BAD_REQUEST, "\n".join(read.faults))
    taken = import_decisions(site.folder, site.campaign, read.decisions)
    stored = decisions_on(files_below(site.folder, RESULT_FILE))
    entries = [decision_entry(decision) for decisions in stored.values() for decision in decisions]
    return {"said": _save_message(taken), "decisions": entries}


def _save_message(taken: ImportedDecisions) -> str:
    sentences = [f"{count_of(len(taken.added) + taken.n_known, 'decision')} saved."]
    sentences += [f"{decision.test}: not saved: {why}." for decision, why in taken.not_imported]
    sentences += ["They take effect when the report is made again."] * bool(taken.added)
    return " ".join(sentences)
