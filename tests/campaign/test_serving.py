"""The server of a report: to this machine alone, and no file but the campaign's."""

from __future__ import annotations

import json
import shutil
import socket
import struct
import threading
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from http.client import HTTPConnection
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from labpipe.campaign.decisions import add_decisions, read_decisions
from labpipe.campaign.serving import ReportServer, Site
from labpipe.errors import UsageError
from tests.builders.pulled_campaigns import WHEN, decision_on, make_pulls

PAGE = "<head><meta content=\"connect-src 'none'\"></head><body>ü</body>"


class Answer(NamedTuple):
    status: int
    headers: Mapping[str, str]
    body: bytes

    @property
    def said(self) -> Any:
        return json.loads(self.body)


class Asked:
    """A server at work, and what its own page would ask of it."""

    def __init__(self, server: ReportServer, made: list[str]) -> None:
        self.server, self.made, self.site = server, made, server.site
        self.host = f"127.0.0.1:{server.server_port}"

    def raw(self, method: str, path: str, body: str | None = None, **headers: str) -> Answer:
        connection = HTTPConnection("127.0.0.1", self.server.server_port, timeout=10)
        sent = {"Host": self.host} | {
            key.replace("_", "-"): header for key, header in headers.items()
        }
        connection.request(method, path, body, {key: each for key, each in sent.items() if each})
        got = connection.getresponse()
        answer = Answer(got.status, dict(got.getheaders()), got.read())
        connection.close()
        return answer

    def get(self, path: str, **headers: str) -> Answer:
        return self.raw("GET", f"/{self.site.token}/{path}", **headers)

    def post(self, path: str, body: object = "", **headers: str) -> Answer:
        text = body if isinstance(body, str) else json.dumps(body)
        own = {"Origin": f"http://{self.host}"} | headers
        return self.raw("POST", f"/{self.site.token}/{path}", text, **own)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_pulls(tmp_path_factory.mktemp("done"), ("T-1", "T-2"))


@pytest.fixture
def asked(done: Path, tmp_path: Path) -> Iterator[Asked]:
    processed = tmp_path / "processed" / "c"
    shutil.copytree(done, processed)
    (processed / "report" / "figures").mkdir(parents=True)
    (processed / "report" / "report.html").write_text(PAGE, "utf-8")
    (processed / "report" / "figures" / "f ü.svg").write_text("<svg/>", "utf-8")
    (processed / "report" / "tables.xlsx").write_bytes(b"PK")
    (processed / ".secret.json").write_text("{}", "utf-8")
    (tmp_path / "beside.json").write_text("{}", "utf-8")
    made: list[str] = []
    site = Site(processed, "c", processed / "report", lambda: made.append("report"), str)
    with ReportServer(site, 0) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield Asked(server, made)
        server.shutdown()
        thread.join()


def test_the_page_may_talk_to_its_server(asked: Asked) -> None:
    answer = asked.get("report/report.html")
    assert answer.status == 200
    assert answer.body.decode() == PAGE.replace("'none'", "'self'")
    assert answer.headers["Content-Type"] == "text/html; charset=utf-8"
    assert answer.headers["Referrer-Policy"] == "no-referrer"
    assert answer.headers["Cache-Control"] == "no-store"
    assert "Python" not in answer.headers["Server"]
    place = asked.get("").headers["Location"]
    assert place == f"/{asked.site.token}/report/report.html"
    assert asked.server.socket.getsockname()[0] == "127.0.0.1"
    assert asked.server.address == f"http://{asked.host}/{asked.site.token}/"


def test_files_of_the_campaign(asked: Asked) -> None:
    figure = asked.get("report/figures/f%20%C3%BC.svg")
    assert (figure.status, figure.body) == (200, b"<svg/>")
    assert figure.headers["Content-Type"] == "image/svg+xml"
    assert figure.headers["Content-Security-Policy"].startswith("sandbox; default-src 'none'")
    assert asked.get("T-1/summary.json").said["test"] == "T-1"
    assert asked.get("report/tests/T-1.html").body.decode().endswith("/T-1/result.h5")
    table = asked.get("report/tables.xlsx")
    assert table.headers["Content-Disposition"] == "attachment"
    assert table.headers["X-Content-Type-Options"] == "nosniff"


@pytest.mark.parametrize(
    "path",
    [
        "../../beside.json", "%2e%2e/%2e%2e/beside.json", "report/../../../beside.json",
        "..\\..\\beside.json", "%2fetc/passwd", ".secret.json", "report/%00", "link.json", "T-1",
        "report/C:/x", "report//report.html", "%ff", "report/tests/..%2fT-1.html",
    ],
)  # fmt: skip
def test_no_other_file(asked: Asked, path: str) -> None:
    (asked.site.folder / "link.json").symlink_to(asked.site.folder.parent.parent / "beside.json")
    answer = asked.get(path)
    assert answer.status == 404
    assert answer.said == {"error": "There is no such file in this campaign."}


def test_who_has_no_token_gets_nothing(asked: Asked) -> None:
    for path in ("/", "/report/report.html", "//report/report.html", "/x/report/report.html"):
        answer = asked.raw("GET", path)
        assert answer.status == 403
        assert answer.said["error"] == "Open the address that labpipe serve printed."
    other = Site(asked.site.folder, "c", asked.site.report, lambda: None, str)
    assert len({other.token, asked.site.token}) == 2
    assert len(other.token) >= 32


@pytest.mark.parametrize(
    ("headers", "why"),
    [
        ({"Host": "evil.example"}, "Host: expected 127.0.0.1:"),
        ({"Origin": "http://evil.example"}, "Origin: expected http://127.0.0.1:"),
        ({"Origin": "null"}, "found 'null'"),
        ({"Sec_Fetch_Site": "cross-site"}, "The request came from another site."),
    ],
)
def test_other_sites_are_refused(asked: Asked, headers: dict[str, str], why: str) -> None:
    for answer in (
        asked.get("report/report.html", **headers), asked.post("report/report", **headers)
    ):  # fmt: skip
        assert answer.status == 403
        assert why in answer.said["error"]
    assert asked.made == []


def test_a_request_without_a_page_changes_nothing(asked: Asked) -> None:
    assert asked.post("report/report", Origin="").status == 403
    assert asked.made == []
    assert asked.raw("DELETE", f"/{asked.site.token}/report/report.html").status == 501


def test_decisions_are_saved_at_once(asked: Asked) -> None:
    entry = {k: v for k, v in asdict(decision_on(asked.site.folder, "T-2")).items() if v}
    stale = entry | {"test": "T-1"}
    sent = {"schema": 1, "campaign": "c", "decisions": [entry, stale]}
    answer = asked.post("report/decisions", sent, Content_Type="application/json")
    assert answer.status == 200
    assert answer.said["decisions"] == [entry]
    assert answer.said["said"] == (
        "1 decision saved. T-1: not saved: exports, sheet, protocol or labpipe changed since the"
        " decision. They take effect when the report is made again."
    )
    (kept,) = read_decisions(asked.site.folder).decisions
    assert (kept.test, kept.decision, kept.when) == ("T-2", "reject", WHEN)
    assert asked.post("report/report").said == {"said": "The report was rebuilt."}
    assert asked.made == ["report"]


@pytest.mark.parametrize(
    ("body", "length", "status", "message"),
    [
        ("{", "", 400, "decisions, line 1, column 2: expected decisions in JSON"),
        ("[" * 100_000, "", 400, "decisions: expected decisions in JSON"),
        ("[]", "", 400, "found JSON without a list 'decisions'"),
        ('{"schema": 2, "decisions": []}', "", 400, "schema: expected decisions in JSON, found 2"),
        ('{"schema": 1, "decisions": [{"test": "T-1"}]}', "", 400, "decisions.0: expected test,"),
        ("", "5000001", 413, "decisions: expected at most 5000000 bytes, found 5000001."),
        ("", 5000 * "9", 413, "found 99999999999999999999."),
        ("", "-1", 413, "found -1."),
    ],
)
def test_what_is_no_decision_is_refused(
    asked: Asked, body: str, length: str, status: int, message: str
) -> None:
    answer = asked.post("report/decisions", body, Content_Length=length)
    assert answer.status == status
    assert message in answer.said["error"]
    assert not (asked.site.folder / "decisions.json").exists()


@pytest.mark.parametrize(
    "request_text",
    [
        "POST /x/report/decisions HTTP/1.1\r\n\r\n",
        "POST /{token}/report/decisions HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\n"
        "Content-Length: 4000000\r\n\r\nthe rest",
        "GET /{token}/report/none HTTP/1.1\r\nHost: {host}\r\n\r\n",
        "no request\r\n\r\n",
    ],
)
def test_a_browser_that_goes_away(
    asked: Asked, capfd: pytest.CaptureFixture[str], request_text: str
) -> None:
    asked.server.daemon_threads = False  # so that closing waits for the threads of all requests
    content = request_text.format(token=asked.site.token, host=asked.host).encode()
    with socket.create_connection(("127.0.0.1", asked.server.server_port)) as browser:
        browser.sendall(content)
        browser.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    assert asked.get("report/report.html").status == 200
    asked.server.shutdown()
    asked.server.server_close()
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("when", ["9999999-99", "yesterday", "2026-13-01", 10_000 * "9"])
def test_a_decision_at_no_time_is_not_saved(asked: Asked, when: str) -> None:
    entry = asdict(decision_on(asked.site.folder, "T-1")) | {"when": when}
    answer = asked.post("report/decisions", {"schema": 1, "decisions": [entry]})
    assert answer.said["decisions"] == []
    assert f"T-1: not saved: its time '{when[:40]}' is not in the form 20" in answer.said["said"]
    assert not (asked.site.folder / "decisions.json").exists()


def test_what_goes_wrong_is_said_to_the_page(asked: Asked) -> None:
    add_decisions(asked.site.folder, "c", [])
    (asked.site.folder / "decisions.json").write_text("{", "utf-8")
    entry = asdict(decision_on(asked.site.folder, "T-1"))
    answer = asked.post("report/decisions", {"schema": 1, "decisions": [entry]})
    assert answer.status == 409
    assert "decisions.json, line 1, column 2: expected decisions in JSON" in answer.said["error"]
    (asked.site.report / "report.html").unlink()
    gone = asked.get("report/report.html")
    assert gone.status == 500
    assert "found no such file" in gone.said["error"]


def test_a_port_in_use_is_said(asked: Asked) -> None:
    port = asked.server.server_port
    with pytest.raises(UsageError, match=rf"--port {port}: expected a free port, found address al"):
        ReportServer(asked.site, port)
    with pytest.raises(
        UsageError, match=r"--port 99999: expected a free port, found an impossible"
    ):
        ReportServer(asked.site, 99999)
