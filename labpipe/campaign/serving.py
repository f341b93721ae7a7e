"""Serve a report by HTTP for ``labpipe serve``, and save decisions on its tests.

The server accepts only requests from the same machine whose URL contains a secret token. It is
based on the server of the standard library, which suffices for one person and a few requests a
minute.
"""

from __future__ import annotations

import json
import os
import secrets
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import chain
from pathlib import Path
from socketserver import TCPServer
from typing import Any, Final
from urllib.parse import unquote, urlsplit

from labpipe.campaign.decisions import (
    find_decision_folder,
    import_decisions,
    parse_decisions,
    read_decisions_by_file,
)
from labpipe.errors import LabpipeError, UsageError, describe_system_error
from labpipe.messages import format_sentence
from labpipe.process.output_paths import RESULT_FILE, list_files_below
from labpipe.report.lab_report import PAGE_FILE, allow_own_server, render_test
from labpipe.report.page_tables import name_page_file
from labpipe.report.wording import format_count
from labpipe.store.result_files import read_result
from labpipe.units import parse_count

LOOPBACK_ADDRESS: Final = "127.0.0.1"
REPORT_FOLDER: Final = "report"
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
"""Content types that a browser may display, keyed by file ending; other files are downloaded."""
_COMMON_HEADERS: Final = {
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",  # the URL contains the token
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    # The files of a campaign must not run scripts.
    "Content-Security-Policy": (
        "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src 'self' data:"
    ),
}
_PAGE_HEADERS: Final = {
    "Content-Type": _INLINE_CONTENT_TYPES[".html"],
    "Content-Security-Policy": "frame-ancestors 'none'",
}
"""Headers of labpipe's own pages, which may run scripts."""
_MAX_LISTED_ERRORS: Final = 10
"""Largest number of faulty or unsaved decisions that a reply lists."""


@dataclass(slots=True)
class Site:
    """A report to serve, and the campaign that stores its decisions.

    Parameters
    ----------
    results_folder : folder of the results of the campaign
    campaign : name of the campaign
    report_folder : folder that contains report.html
    make_report : function that makes the report again
    token : secret first segment of the path of every URL; a request without it is refused
    lock : lock that is held while the report or the page of a test is made, or decisions are saved
    """

    results_folder: Path
    campaign: str
    report_folder: Path
    make_report: Callable[[], None]
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24))
    lock: threading.Lock = field(default_factory=threading.Lock)


class _HttpError(Exception):
    """Reason to refuse a request: an HTTP status, and a message for the page."""

    def __init__(self, status: HTTPStatus, message: str) -> None:
        super().__init__(message)
        self.status = status


class ReportServer(ThreadingHTTPServer):
    """HTTP server of one report on the loopback address.

    Parameters
    ----------
    site : report to serve
    port : number of the port; 0 for any free port

    Raises
    ------
    UsageError
        If the port is in use or not valid.
    """

    daemon_threads = True
    allow_reuse_address = os.name != "nt"  # on Windows, other programs could then use the port

    def __init__(self, site: Site, port: int) -> None:
        self.site = site
        try:
            super().__init__((LOOPBACK_ADDRESS, port), _RequestHandler)
        except (OSError, OverflowError) as error:
            reason = (getattr(error, "strerror", None) or "an impossible number").lower()
            raise UsageError.about("campaign.port", f"--port {port}", found=reason) from error

    def server_bind(self) -> None:
        """Bind the socket without resolving the host name, which may need a network."""
        TCPServer.server_bind(self)
        self.server_name, self.server_port = LOOPBACK_ADDRESS, int(self.server_address[1])

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print errors, except those of lost or timed-out connections."""
        if not isinstance(sys.exception(), (ConnectionError, TimeoutError)):
            super().handle_error(request, client_address)

    @property
    def report_url(self) -> str:
        """URL of the report, with the token."""
        return f"http://{LOOPBACK_ADDRESS}:{self.server_port}/{self.site.token}/"


class _RequestHandler(BaseHTTPRequestHandler):
    """Handler of one HTTP request."""

    server: ReportServer
    server_version, sys_version = "labpipe", ""
    default_request_version = "HTTP/1.0"  # replies to malformed requests then have a status line
    timeout = 30.0  # s

    def do_GET(self) -> None:
        """Send a page or a file."""
        self._answer_request(self._answer_get)

    def do_POST(self) -> None:
        """Save decisions, or make the report again."""
        self._answer_request(self._answer_post)

    def log_message(self, format: str, *args: object) -> None:
        """Suppress the log line that the base class prints for each request."""

    def _answer_request(self, send_reply: Callable[[list[str]], None]) -> None:
        """Reply to an authorised request, or send the status and the message of an error.

        Parameters
        ----------
        send_reply : function that is called with the segments of the path after the token
        """
        try:
            send_reply(self._read_authorised_path())
        except _HttpError as error:
            self._send_json({"error": str(error)}, error.status)
        except LabpipeError as error:
            self._send_json({"error": str(error)}, HTTPStatus.CONFLICT)
        except (ConnectionError, TimeoutError):
            raise  # the connection was closed or timed out
        except OSError as error:
            message = {"error": describe_system_error(error)}
            self._send_json(message, HTTPStatus.INTERNAL_SERVER_ERROR)
        except Exception:
            message = {"error": format_sentence("campaign.server_fault")}
            self._send_json(message, HTTPStatus.INTERNAL_SERVER_ERROR)
            raise  # the server prints the traceback and accepts further requests

    def _send_reply(
        self, content: bytes, headers: dict[str, str], status: HTTPStatus = HTTPStatus.OK
    ) -> None:
        """Send a reply; `headers` replace common headers with the same name."""
        self.send_response(status)
        for header in (_COMMON_HEADERS | {"Content-Length": str(len(content))} | headers).items():
            self.send_header(*header)
        self.end_headers()
        self.wfile.write(content)

    def _send_json(self, content: object, status: HTTPStatus = HTTPStatus.OK) -> None:
        """Send a reply in JSON."""
        self._send_reply(json.dumps(content).encode(), {"Content-Type": "application/json"}, status)

    def _read_authorised_path(self) -> list[str]:
        """Check origin and token of a request; return the segments of the path after the token."""
        _require_same_origin(self.headers, self.server.server_port)
        try:
            token, *path = unquote(urlsplit(self.path).path, errors="strict").split("/")[1:]
        except ValueError:
            raise _make_not_found_error() from None
        expected_token = self.server.site.token
        if not secrets.compare_digest(token.encode("utf-8", "replace"), expected_token.encode()):
            raise _HttpError(HTTPStatus.FORBIDDEN, format_sentence("campaign.wrong_address"))
        return path

    def _answer_get(self, path: list[str]) -> None:
        """Send the report, the page of a test or a file, or redirect to the report."""
        site = self.server.site
        if path in ([], [""], [REPORT_FOLDER], [REPORT_FOLDER, ""]):
            location = f"/{site.token}/{REPORT_FOLDER}/{PAGE_FILE}"
            self._send_reply(b"", {"Location": location}, HTTPStatus.FOUND)
        elif path == [REPORT_FOLDER, PAGE_FILE]:
            html = (site.report_folder / PAGE_FILE).read_text(encoding="utf-8")
            self._send_reply(allow_own_server(html).encode(), _PAGE_HEADERS)
        elif len(path) == 3 and path[:2] == [REPORT_FOLDER, _TEST_PAGES_FOLDER]:
            with site.lock:
                html = render_test(read_result(_find_result_file("/".join(path[1:]), site)))
            self._send_reply(html.encode(), _PAGE_HEADERS)
        else:
            file = _find_file(path, site)
            content_type = _INLINE_CONTENT_TYPES.get(file.suffix.lower())
            headers = {"Content-Type": content_type or "application/octet-stream"}
            headers |= {} if content_type else {"Content-Disposition": "attachment"}
            self._send_reply(file.read_bytes(), headers)

    def _answer_post(self, path: list[str]) -> None:
        """Save decisions or make the report again, and send a message."""
        if self.headers.get("Origin") is None:
            raise _HttpError(HTTPStatus.FORBIDDEN, format_sentence("campaign.no_origin"))
        body = self._read_body()
        site = self.server.site
        with site.lock:
            if path == [REPORT_FOLDER, "decisions"]:
                reply = _save_decisions(body, site)
            elif path == [REPORT_FOLDER, "report"]:
                site.make_report()
                reply = {"message": format_sentence("campaign.report_rebuilt")}
            else:
                raise _make_not_found_error()
        self._send_json(reply)

    def _read_body(self) -> bytes:
        """Read the body of a request; refuse a large body, and one of unknown size."""
        max_bytes = 5_000_000
        header = self.headers.get("Content-Length", "")
        length = parse_count(header)
        if length is not None and length <= max_bytes:
            return self.rfile.read(length)
        length_text = header[:20] or "no length"
        message = format_sentence("campaign.large_request", limit=max_bytes, found=length_text)
        status = HTTPStatus.REQUEST_ENTITY_TOO_LARGE if header else HTTPStatus.LENGTH_REQUIRED
        raise _HttpError(status, message)


def _require_same_origin(headers: Any, port: int) -> None:
    """Refuse requests from pages of other sites, and requests to another host name."""
    host, origin = headers.get("Host", ""), headers.get("Origin")
    reason = ""
    if host not in {f"{name}:{port}" for name in (LOOPBACK_ADDRESS, "localhost")}:
        reason = f"Host: expected {LOOPBACK_ADDRESS}:{port}, found {host!r}."
    elif origin is not None and origin != f"http://{host}":
        reason = f"Origin: expected http://{host}, found {origin!r}."
    elif headers.get("Sec-Fetch-Site", "none") not in {"none", "same-origin"}:
        reason = "The request came from another site."
    if reason:
        raise _HttpError(HTTPStatus.FORBIDDEN, format_sentence("campaign.other_site", why=reason))


def _make_not_found_error() -> _HttpError:
    """Make the error of a request for a page or a file that does not exist."""
    return _HttpError(HTTPStatus.NOT_FOUND, format_sentence("campaign.no_such_file"))


def _find_file(path: list[str], site: Site) -> Path:
    """Find a file of the report or of the campaign; refuse hidden files and files outside both."""
    if any(not name or name.startswith(".") or set(name) & set('\\:\0"') for name in path):
        raise _make_not_found_error()
    is_report_file = path[0] == REPORT_FOLDER
    top = (site.report_folder if is_report_file else site.results_folder).resolve()
    with suppress(OSError, RuntimeError):  # RuntimeError: a loop of links, before Python 3.13
        file = top.joinpath(*path[1:] if is_report_file else path).resolve(strict=True)
        if file.is_relative_to(top) and file.is_file():
            return file
    raise _make_not_found_error()


def _find_result_file(page: str, site: Site) -> Path:
    """Find the result file of the test that has a given page."""
    for file in list_files_below(site.results_folder, RESULT_FILE):
        if name_page_file(find_decision_folder(file, site.results_folder)[1]) == page:
            return file
    raise _make_not_found_error()


def _save_decisions(body: bytes, site: Site) -> dict[str, Any]:
    """Import the decisions of a request; return a message and the decisions on processed tests."""
    content = parse_decisions(body, Path("decisions"))
    if content.faults:
        raise _HttpError(HTTPStatus.BAD_REQUEST, "\n".join(content.faults[:_MAX_LISTED_ERRORS]))
    import_result = import_decisions(site.results_folder, site.campaign, content.decisions)
    decisions_by_file = read_decisions_by_file(list_files_below(site.results_folder, RESULT_FILE))
    entries = [asdict(decision) for decision in chain(*decisions_by_file.values())]
    n_saved = len(import_result.added) + import_result.n_stored_before
    sentences = [f"{format_count(n_saved, 'decision')} saved."]
    not_saved_messages = [
        f"{decision.test}: not saved: {reason}." for decision, reason in import_result.not_imported
    ]
    sentences += not_saved_messages[:_MAX_LISTED_ERRORS]
    if (n_unlisted := len(not_saved_messages) - _MAX_LISTED_ERRORS) > 0:
        sentences.append(f"{n_unlisted} more not saved.")
    if import_result.added:
        sentences.append(format_sentence("campaign.decisions_take_effect"))
    return {"message": " ".join(sentences), "decisions": entries}
