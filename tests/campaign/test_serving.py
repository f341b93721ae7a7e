"""The server of a report answers this machine only, with files of the campaign only."""

from __future__ import annotations

import json
import os
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
from labpipe.store.result_files import read_run
from tests.builders.pulled_campaigns import WHEN, decision_on, make_pulls

PAGE = "<head><meta content=\"connect-src 'none'\"></head><body>ü</body>"


class Answer(NamedTuple):
    status: int
    headers: Mapping[str, str]
    body: bytes

    @property
    def json(self) -> Any:
        return json.loads(self.body)


class Client:
    """A running server, and the requests of its own page."""

    def __init__(self, server: ReportServer, made: list[str]) -> None:
        self.server, self.made, self.site = server, made, server.site
        self.host = f"127.0.0.1:{server.server_port}"

    def raw(self, method: str, path: str, body: str | None = None, **headers: str) -> Answer:
        connection = HTTPConnection("127.0.0.1", self.server.server_port, timeout=60)
        sent = {"Host": self.host} | {
            key.replace("_", "-"): header for key, header in headers.items()
        }
        connection.request(method, path, body, {key: text for key, text in sent.items() if text})
        response = connection.getresponse()
        answer = Answer(response.status, dict(response.getheaders()), response.read())
        connection.close()
        return answer

    def get(self, path: str, **headers: str) -> Answer:
        return self.raw("GET", f"/{self.site.token}/{path}", **headers)

    def post(self, path: str, body: object = "", **headers: str) -> Answer:
        text = body if isinstance(body, str) else json.dumps(body)
        all_headers = {"Origin": f"http://{self.host}"} | headers
        return self.raw("POST", f"/{self.site.token}/{path}", text, **all_headers)


@pytest.fixture(scope="module")
def pulls(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_pulls(tmp_path_factory.mktemp("done"), ("T-1", "T-2"))


@pytest.fixture
def client(pulls: Path, tmp_path: Path) -> Iterator[Client]:
    processed = tmp_path / "processed" / "c"
    shutil.copytree(pulls, processed)
    (processed / "report" / "figures").mkdir(parents=True)
    (processed / "report" / "report.html").write_text(PAGE, "utf-8")
    (processed / "report" / "figures" / "f ü.svg").write_text("<svg/>", "utf-8")
    (processed / "report" / "tables.xlsx").write_bytes(b"PK")
    (processed / ".secret.json").write_text("{}", "utf-8")
    (tmp_path / "beside.json").write_text("{}", "utf-8")
    made: list[str] = []
    site = Site(processed, "c", processed / "report", lambda: made.append("report"))
    with ReportServer(site, 0) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield Client(server, made)
        server.shutdown()
        thread.join()


@pytest.mark.skipif(os.name == "nt", reason="other programs could then use the port")
def test_a_port_is_free_again_after_a_connection(client: Client) -> None:
    assert client.server.socket.getsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR)


def test_report_page_may_connect_to_its_server(client: Client) -> None:
    answer = client.get("report/report.html")
    assert answer.status == 200
    assert answer.body.decode() == PAGE.replace("'none'", "'self'")
    assert answer.headers["Content-Type"] == "text/html; charset=utf-8"
    assert answer.headers["Referrer-Policy"] == "no-referrer"
    assert answer.headers["Cache-Control"] == "no-store"
    assert "Python" not in answer.headers["Server"]
    place = client.get("").headers["Location"]
    assert place == f"/{client.site.token}/report/report.html"
    assert client.server.socket.getsockname()[0] == "127.0.0.1"
    assert client.server.report_url == f"http://{client.host}/{client.site.token}/"


def test_get_files_of_the_campaign(client: Client) -> None:
    figure = client.get("report/figures/f%20%C3%BC.svg")
    assert (figure.status, figure.body) == (200, b"<svg/>")
    assert figure.headers["Content-Type"] == "image/svg+xml"
    assert figure.headers["Content-Security-Policy"].startswith("sandbox; default-src 'none'")
    assert client.get("T-1/summary.json").json["test"] == "T-1"
    assert "<h1>T-1" in client.get("report/tests/T-1.html").body.decode()
    table = client.get("report/tables.xlsx")
    assert table.headers["Content-Disposition"] == "attachment"
    assert table.headers["X-Content-Type-Options"] == "nosniff"


@pytest.mark.parametrize(
    "path",
    [
        "../../beside.json", "%2e%2e/%2e%2e/beside.json", "report/../../../beside.json",
        "..\\..\\beside.json", "%2fetc/passwd", ".secret.json", "report/%00", "link.json", "T-1",
        "report/C:/x", "report//report.html", "%ff", "report/tests/..%2fT-1.html", "loop", "loop/x",
        5000 * "a",
    ],
)  # fmt: skip
def test_other_files_are_not_found(client: Client, path: str) -> None:
    (client.site.results_folder / "link.json").symlink_to(
        client.site.results_folder.parent.parent / "beside.json"
    )
    (client.site.results_folder / "loop").symlink_to(client.site.results_folder / "loop")
    answer = client.get(path)
    assert answer.status == 404
    assert answer.json == {"error": "There is no such file in this campaign."}


def test_request_without_token_is_refused(client: Client) -> None:
    for path in ("/", "/report/report.html", "//report/report.html", "/x/report/report.html"):
        answer = client.raw("GET", path)
        assert answer.status == 403
        assert answer.json["error"] == "Open the address that labpipe serve printed."
    second_site = Site(client.site.results_folder, "c", client.site.report_folder, lambda: None)
    assert len({second_site.token, client.site.token}) == 2
    assert len(second_site.token) >= 32


@pytest.mark.parametrize(
    ("headers", "why"),
    [
        ({"Host": "evil.example"}, "Host: expected 127.0.0.1:"),
        ({"Origin": "http://evil.example"}, "Origin: expected http://127.0.0.1:"),
        ({"Origin": "null"}, "found 'null'"),
        ({"Sec_Fetch_Site": "cross-site"}, "The request came from another site."),
    ],
)
def test_other_sites_are_refused(client: Client, headers: dict[str, str], why: str) -> None:
    for answer in (
        client.get("report/report.html", **headers), client.post("report/report", **headers)
    ):  # fmt: skip
        assert answer.status == 403
        assert why in answer.json["error"]
    assert client.made == []


def test_post_without_origin_changes_nothing(client: Client) -> None:
    assert client.post("report/report", Origin="").status == 403
    assert client.made == []
    assert client.raw("DELETE", f"/{client.site.token}/report/report.html").status == 501


def test_save_decisions(client: Client) -> None:
    entry = {k: v for k, v in asdict(decision_on(client.site.results_folder, "T-2")).items() if v}
    stale = entry | {"test": "T-1"}
    sent = {"schema": 1, "campaign": "c", "decisions": [entry, stale]}
    answer = client.post("report/decisions", sent, Content_Type="application/json")
    assert answer.status == 200
    assert answer.json["decisions"] == [entry]
    assert answer.json["message"] == (
        "1 decision saved. T-1: not saved: exports, sheet, protocol or labpipe changed since the"
        " decision. Decisions take effect when the report is made again."
    )
    (stored,) = read_decisions(client.site.results_folder).decisions
    assert (stored.test, stored.decision, stored.when) == ("T-2", "reject", WHEN)
    assert client.post("report/report").json == {"message": "The report was rebuilt."}
    assert client.made == ["report"]


def test_ten_thousand_decisions_in_one_request(
    client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each result file is read once, so that the lock is held for a short time."""
    files_read: list[Path] = []

    def read_key(file: Path) -> str:
        files_read.append(file)
        return read_run(file)

    monkeypatch.setattr("labpipe.campaign.decisions.read_run", read_key)
    count = 10_000
    entry = asdict(decision_on(client.site.results_folder, "T-2"))
    entries = [entry | {"because": f"reason {number}"} for number in range(count)]
    sent = {"schema": 1, "decisions": entries}
    for _ in range(2):  # the second time, all are known
        answer = client.post("report/decisions", sent)
        assert answer.json["message"].startswith("10000 decisions saved.")
        assert len(answer.json["decisions"]) == count
    assert len(files_read) == 2
    strangers = [entry | {"test": f"X-{number}"} for number in range(count)]
    answer = client.post("report/decisions", {"schema": 1, "decisions": strangers})
    assert answer.json["message"].startswith("0 decisions saved. X-0: not saved: there is no such")
    assert answer.json["message"].endswith("test. 9990 more not saved.")


@pytest.mark.parametrize(
    ("body", "length", "status", "message"),
    [
        ("{", "", 400, "decisions, line 1, column 2: expected decisions in JSON"),
        ("[" * 100_000, "", 400, "decisions: expected decisions in JSON"),
        ("[]", "", 400, "found JSON without a list 'decisions'"),
        ('{"schema": 2, "decisions": []}', "", 400, "schema: expected decisions in JSON, found 2"),
        ('{"schema": 1, "decisions": [{"test": "T-1"}]}', "", 400, "decisions.0: expected test,"),
        ("", "5000001", 413, "Request body: expected a length of at most 5000000 bytes"),
        ("", 5000 * "9", 413, "found 99999999999999999999."),
        ("", "-1", 413, "found -1."),
    ],
)
def test_invalid_decisions_are_refused(
    client: Client, body: str, length: str, status: int, message: str
) -> None:
    answer = client.post("report/decisions", body, Content_Length=length)
    assert answer.status == status
    assert message in answer.json["error"]
    assert not (client.site.results_folder / "decisions.json").exists()


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
def test_lost_connection_prints_nothing(
    client: Client, capfd: pytest.CaptureFixture[str], request_text: str
) -> None:
    client.server.daemon_threads = False  # so that closing waits for the threads of all requests
    content = request_text.format(token=client.site.token, host=client.host).encode()
    with socket.create_connection(("127.0.0.1", client.server.server_port)) as browser:
        browser.sendall(content)
        browser.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    assert client.get("report/report.html").status == 200
    client.server.shutdown()
    client.server.server_close()
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("request_text", "status"),
    [
        ("POST /{token}/report/decisions HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}", 411),
        ("GET /{token}/report/report.html", 403), ("no request", 400), ("GET / FTP/1.1", 400),
    ],
)  # fmt: skip
def test_malformed_request_has_a_status(client: Client, request_text: str, status: int) -> None:
    content = request_text.format(token=client.site.token, host=client.host).encode()
    with socket.create_connection(("127.0.0.1", client.server.server_port)) as browser:
        browser.sendall(content + b"\r\n\r\n")
        assert browser.makefile("rb").readline().startswith(f"HTTP/1.0 {status} ".encode())


def test_fault_of_the_server_is_answered_without_traceback(
    client: Client, capfd: pytest.CaptureFixture[str]
) -> None:
    client.site.make_report = lambda: json.loads("{}")["boom"]
    answer = client.post("report/report")
    assert answer.status == 500
    assert answer.json["error"].startswith("The server failed")
    assert client.get("report/report.html").status == 200
    assert "KeyError: 'boom'" in capfd.readouterr().err


@pytest.mark.parametrize("when", ["9999999-99", "yesterday", "2026-13-01", 10_000 * "9"])
def test_decision_with_invalid_time_is_not_saved(client: Client, when: str) -> None:
    entry = asdict(decision_on(client.site.results_folder, "T-1")) | {"when": when}
    answer = client.post("report/decisions", {"schema": 1, "decisions": [entry]})
    assert answer.json["decisions"] == []
    assert f"T-1: not saved: its time '{when[:40]}' is not of the form 20" in answer.json["message"]
    assert not (client.site.results_folder / "decisions.json").exists()


def test_errors_are_sent_to_the_page(client: Client) -> None:
    add_decisions(client.site.results_folder, "c", [])
    (client.site.results_folder / "decisions.json").write_text("{", "utf-8")
    entry = asdict(decision_on(client.site.results_folder, "T-1"))
    answer = client.post("report/decisions", {"schema": 1, "decisions": [entry]})
    assert answer.status == 409
    assert "decisions.json, line 1, column 2: expected decisions in JSON" in answer.json["error"]
    (client.site.report_folder / "report.html").unlink()
    gone = client.get("report/report.html")
    assert gone.status == 500
    assert "found no such file" in gone.json["error"]


def test_port_in_use_is_refused(client: Client) -> None:
    port = client.server.server_port
    with pytest.raises(UsageError, match=rf"--port {port}: expected a free port, found address al"):
        ReportServer(client.site, port)
    with pytest.raises(
        UsageError, match=r"--port 99999: expected a free port, found an impossible"
    ):
        ReportServer(client.site, 99999)
