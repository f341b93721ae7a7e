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
    decision_entry,
    decisions_on,
    import_decisions,
    label_of,
    parse_decisions,
)
from labpipe.errors import LabpipeError, UsageError, describe_system_error
from labpipe.process.output_paths import RESULT_FILE, files_below
from labpipe.report.lab_report import PAGE_FILE, allow_own_server
from labpipe.report.page_tables import name_page_file
from labpipe.report.wording import write_count
from labpipe.units import parse_count

LOOPBACK: Final = "127.0.0.1"
REPORT: Final = "report"
_TEST_PAGES_FOLDER: Final = name_page_file("").partition("/")[0]
_INLINE_CONTENT_TYPES: Final = {
    ".html": "text/html; charset=utf-8",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".pdf": "application/pdf",
    ".json": "application/json",
    ".yaml": "text/plain; charset=utf-8",
    ".csv": "text/plain; charset=utf-8",
}
"""Types that a browser may display; all others are downloads."""
_COMMON_HEADERS: Final = {
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",  # the address holds the token
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
_NO_SCRIPT_POLICY: Final = (
    "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src 'self' data:"
)
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
            found = (getattr(error, "strerror", None) or "an impossible number").lower()
            raise UsageError.about("campaign.port", f"--port {port}", found=found) from error

    def server_bind(self) -> None:
        """Bind without resolving the host name, which may need a network."""
        self.socket.bind(self.server_address)
        self.server_address = self.socket.getsockname()
        self.server_name, self.server_port = LOOPBACK, int(self.server_address[1])

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print errors, except lost and timed-out connections."""
        if not isinstance(sys.exception(), (ConnectionError, TimeoutError)):
            super().handle_error(request, client_address)

    @property
    def address(self) -> str:
        """Return the address of the report."""
        return f"http://{LOOPBACK}:{self.server_port}/{self.site.token}/"


@dataclass(frozen=True, slots=True)
class _Reply:
    """Content of a reply, and what its headers say."""

    content: bytes = b""
    content_type: str = _INLINE_CONTENT_TYPES[".json"]
    policy: str = _NO_SCRIPT_POLICY
    status: HTTPStatus = HTTPStatus.OK
    more: tuple[tuple[str, str], ...] = ()


def _page(text: str) -> _Reply:
    return _Reply(text.encode(), _INLINE_CONTENT_TYPES[".html"], policy="frame-ancestors 'none'")


def _json(content: object, status: HTTPStatus = HTTPStatus.OK) -> _Reply:
    return _Reply(json.dumps(content).encode(), status=status)


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

    def _answer(self, make: Callable[[list[str]], _Reply]) -> None:
        try:
            reply = make(self._authorised_path())
        except RefusedError as error:
            reply = _json({"error": str(error)}, error.status)
        except LabpipeError as error:
            reply = _json({"error": str(error)}, HTTPStatus.CONFLICT)
        except (ConnectionError, TimeoutError):
            raise  # the browser closed the connection
        except OSError as error:
            reply = _json({"error": describe_system_error(error)}, HTTPStatus.INTERNAL_SERVER_ERROR)
        self.send_response(reply.status)
        length = str(len(reply.content))
        own = {"Content-Type": reply.content_type, "Content-Length": length}
        own["Content-Security-Policy"] = reply.policy
        for name, value in (own | _COMMON_HEADERS | dict(reply.more)).items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(reply.content)

    def _authorised_path(self) -> list[str]:
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

    def _get(self, parts: list[str]) -> _Reply:
        site = self.server.site
        if parts in ([], [""], [REPORT], [REPORT, ""]):
            location = f"/{site.token}/{REPORT}/{PAGE_FILE}"
            return _Reply(status=HTTPStatus.FOUND, more=(("Location", location),))
        if parts == [REPORT, PAGE_FILE]:
            return _page(allow_own_server((site.report / PAGE_FILE).read_text(encoding="utf-8")))
        if len(parts) == 3 and parts[:2] == [REPORT, _TEST_PAGES_FOLDER]:
            with site.work:
                return _page(site.make_test_page(_find_test("/".join(parts[1:]), site)))
        file = _find_file(parts, site)
        content_type = _INLINE_CONTENT_TYPES.get(file.suffix.lower(), "")
        more = () if content_type else (("Content-Disposition", "attachment"),)
        return _Reply(file.read_bytes(), content_type or "application/octet-stream", more=more)

    def _post(self, parts: list[str]) -> _Reply:
        if self.headers.get("Origin") is None:
            raise RefusedError(HTTPStatus.FORBIDDEN, "Expected a request from the report page.")
        body = self._body()
        site = self.server.site
        with site.work:
            if parts == [REPORT, "decisions"]:
                return _json(_save(body, site))
            if parts == [REPORT, REPORT]:
                site.make_report()
                return _json({"said": "The report was rebuilt."})
        raise _not_found()

    def _body(self) -> bytes:
        # of a request body
        max_bytes = 5_000_000
        header = self.headers.get("Content-Length", "")
        length = parse_count(header)
        if length is None or length > max_bytes:
            self.close_connection = True
            limits = f"expected at most {max_bytes} bytes, found {header[:20] or 'no length'}."
            raise RefusedError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"decisions: {limits}")
        return self.rfile.read(length)


def _check_sender(headers: Any, port: int) -> None:
    """Refuse requests of other sites, also under a host name of theirs."""
    host, origin = headers.get("Host", ""), headers.get("Origin")
    why = ""
    if host not in {f"{name}:{port}" for name in (LOOPBACK, "localhost")}:
        why = f"Host: expected {LOOPBACK}:{port}, found {host!r}."
    elif origin is not None and origin != f"http://{host}":
        why = f"Origin: expected http://{host}, found {origin!r}."
    elif headers.get("Sec-Fetch-Site", "none") not in {"none", "same-origin"}:
        why = "The request came from another site."
    if why:
        raise RefusedError(HTTPStatus.FORBIDDEN, f"{why} Open the address as printed.")


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
        if name_page_file(label_of(file, site.folder)) == name:
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
    sentences = [f"{write_count(len(taken.added) + taken.n_known, 'decision')} saved."]
    sentences += [f"{decision.test}: not saved: {why}." for decision, why in taken.not_imported]
    sentences += ["They take effect when the report is made again."] * bool(taken.added)
    return {"said": " ".join(sentences), "decisions": entries}
