"""The report's page as text and as files: closed tags, escaped names, its policy, its size."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from dataclasses import replace
from datetime import date
from html.parser import HTMLParser
from io import BytesIO
from pathlib import Path

import pytest
from PIL import Image

from labpipe.errors import UsageError
from labpipe.records.curve import Interval
from labpipe.records.group import BoundedStiffness, Campaign
from labpipe.records.quality import Reason
from labpipe.records.result import Instrument, Status
from labpipe.report.lab_report import (
    format_page_data,
    read_logo,
    read_page_script,
    render_page,
    render_test,
    write_report,
)
from tests.approved import Approve
from tests.builders.bundle_campaigns import bundle_campaign, conduit_cases
from tests.builders.campaigns import build_campaign, build_group, build_sample, six_samples
from tests.store.builders_result import build_result

VOID = {"meta", "br", "link", "img"}
HEADS = {"h1", "h2", "h3", "caption", "summary"}
BLOCKS = HEADS | {"tr", "li", "p", "dl", "figcaption", "section"}
CELLS = {"td", "th", "dd", "text"}


class Outline(HTMLParser):
    """Tags that are open at the end, and what a reader reads, a line for each row of a table."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.words = [""]
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: object) -> None:  # noqa: ARG002
        if tag not in VOID:
            self.open.append(tag)
        if tag in BLOCKS:
            self.words.append(f"{tag}: ")
        self.words[-1] += " | " if tag in CELLS else ""

    def handle_data(self, data: str) -> None:
        if not {"style", "script"}.intersection(self.open):
            self.words[-1] += data

    def lines(self) -> list[str]:
        text = "\n".join(" ".join(text_of_element.split()) for text_of_element in self.words)
        return re.sub(r"[0-9a-f]{10}, labpipe", "#, labpipe", text).splitlines()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_files_and_pages_of_tests_beside_them(tmp_path: Path) -> None:
    pages = {"tests/tt-s1a.html": "<p>one</p>"}
    files = write_report(build_campaign(), tmp_path, test_pages=pages)
    assert [path.name for path in files] == ["report.html", "tables.xlsx", "tt-s1a.html"]
    assert {path for path in tmp_path.rglob("*") if path.is_file()} == set(files)
    assert files[2].read_text(encoding="utf-8") == "<p>one</p>"
    assert '<a class="test-page" href="tests/tt-s1a.html">' in files[0].read_text(encoding="utf-8")


def test_a_page_is_as_small_as_it_should_be() -> None:
    """At most 0.3 MB and 3 kB a test, as one group of 15 of 60 tests shows."""
    samples = [build_sample(f"s{n % 3}", str(n), cycles=3, slips=1, seed=n) for n in range(15)]
    group = build_group("type", samples)
    full, empty = (len(render_page(Campaign("S", groups))) for groups in ((group,), ()))
    assert 4 * (full - empty) + empty < 0.3e6 + 60 * 3e3


@pytest.fixture(scope="module")
def page() -> str:
    return render_page(build_campaign())


def test_the_page_is_well_formed_and_fetches_nothing(page: str) -> None:
    assert page.count('scope="col"') + page.count('scope="row"') == len(re.findall("<th[ >]", page))
    assert '<html lang="en">' in page
    assert 'name="viewport"' in page
    ids = re.findall(r' id="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'href="#([^"]+)"', page)) <= set(ids)
    assert not re.findall(r"(?:src|href)=\"(?!#)|<link|@import|url\(", page)


def test_only_its_own_style_and_script_count(page: str) -> None:
    (policy,) = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]+)"', page)
    assert policy.startswith("default-src 'none'; ")
    assert policy.count("connect-src 'none'") == 1
    for tag in ("style", "script"):
        (text,) = re.findall(rf"<{tag}>(.*?)</{tag}>", page, re.DOTALL)
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"{tag}-src 'sha256-{digest}'" in policy
    assert not re.findall(r" (?:style|on[a-z]+)=", page.partition("<script>")[0])


def test_text_of_people_is_escaped() -> None:
    name = "<script>alert(1)</script>"
    sample = replace(build_sample("s<1>", "a"), test=name, label=f"a/{name}", operator="<b>")
    page = render_page(
        Campaign("A & <b> */ </style>", (build_group("<i>", [sample]),), name="<i>"),
        {"Lab": "<u>"},
    )
    assert page.count("<script") == 2
    assert page.count("</style>") == 1
    assert not re.findall("<[iu]>", page)
    assert "<b>" not in re.sub(r"<b>(CANNOT|DIFFERENT|[^<]*</b>)", "", page)
    assert "<title>A &amp; &lt;b&gt; */ &lt;/style&gt;</title>" in page
    assert Outline(page).open == []


def test_data_cannot_end_their_element() -> None:
    hostile = "</script><!-- & \u2028 \ud800 '\""
    entry = {"test": hostile, "run": "r", "decision": "reject", "because": hostile, "by": "A"}
    campaign = Campaign(hostile, (), labpipe_version="1.2", name=hostile, decisions=(entry,))
    text = format_page_data(campaign, report_id="abc")
    assert not set("<>&") & set(text)
    assert text.isascii()
    assert json.loads(text) == {
        "schema": 1, "campaign": hostile, "report": "abc", "labpipe": "1.2", "decisions": [entry],
    }  # fmt: skip


def test_the_script_asks_no_network_and_makes_no_markup_of_text() -> None:
    script = read_page_script()
    assert script.startswith('"use strict";\n(() => {')
    for word in ("</script", "innerHTML", "outerHTML", "insertAdjacentHTML", "document.write",
                 "eval(", "XMLHttpRequest", "WebSocket", "sendBeacon", "import("):  # fmt: skip
        assert word not in script
    # Where a machine serves the page itself, it talks to that, by names beside the page.
    assert re.findall(r"fetch\((\S+?)[,)]", script) == ['"decisions"', '"report"']


def test_who_when_with_what_and_every_number() -> None:
    cell = Instrument("force", ("force",), "LC-500", date(2025, 1, 1), date(2026, 1, 1))
    result = replace(
        build_result(half_cycle=1.0), date=date(2026, 3, 2), operator="A <b>", instruments=(cell,),
        figures=("force-displacement",),
    )  # fmt: skip
    reasons = (Reason("code_1", "it slipped"),)
    changed = [replace(x, status=Status.DOUBTFUL, reasons=reasons) for x in result.results[:2]]
    specimen = replace(result.specimen, observed={"separation": "in the jaw"})
    result = replace(result, specimen=specimen, results=(*changed, *result.results[2:]))
    page = render_test(result, report="abc")
    assert "2026-03-02 by A &lt;b&gt;" in page
    assert "separation: in the jaw" in page  # without a verdict, too
    assert "force LC-500 (calibrated 2025-01-01, due 2026-01-01)" in page
    assert page.count("It slipped.") == page.count("As above.") == page.count("<img") == 1
    for name in ("code_1", *(number.name for number in result.results)):
        assert f'title="{name}"' in page
    assert not re.findall(r' style="|<script', page)
    assert all(source.sha256 in page for source in result.inputs)


def test_words_and_numbers_of_pages(page: str, approved: Approve) -> None:
    """All of a usual campaign; headings of one without faults, and of bundles with questions."""
    bundles = bundle_campaign(conduit_cases())
    reasons = (Reason("x", "no bounds: why"),)
    place = BoundedStiffness(bundles.groups[0].name, "t-1", None, None, reasons=reasons)
    placed = render_page(replace(bundles, bounded_stiffnesses=(place,), wire_sheet="<wires>.xlsx"))
    plain = render_page(Campaign("Synthetic", (build_group("A", six_samples(slips=0)),)))
    whole, *pages = [Outline(text) for text in (page, plain, render_page(bundles), placed)]
    assert not any(outline.open for outline in (whole, *pages))
    lines = [line for outline in pages[:2] for line in outline.lines()]
    assert 'id="to-decide"' not in plain
    assert "slipping and sticking" not in page
    assert "--wire SHEET" not in placed
    assert "&lt;wires&gt;.xlsx" in placed
    assert "No bounds: why." in placed
    approved([*whole.lines(), *(line for line in lines if line.split(":")[0] in HEADS)])


def test_tip_of_a_single_test_names_its_estimate() -> None:
    sample = build_sample("s1", "a")
    result = replace(sample.results[0], value=9.0, estimate=8.0, interval=Interval(7.0, 9.0))
    group = build_group("A", [replace(sample, results=(result,))])
    tip = "one test: uncertainty of its measurement; interval of the estimate 8.0"
    assert f'title="{tip}"' in render_page(Campaign("S", (group,)))


def picture(kind: str, size: tuple[int, int] = (30, 10)) -> bytes:
    file = BytesIO()
    Image.new("RGB", size).save(file, kind)
    return file.getvalue()


@pytest.mark.parametrize("kind", ["PNG", "JPEG"])
def test_a_picture_is_read_into_the_page(kind: str, tmp_path: Path) -> None:
    content = picture(kind)
    (tmp_path / "logo").write_bytes(content)
    head, _, data = read_logo(tmp_path / "logo").partition(",")
    assert head == f"data:image/{kind.lower()};base64"
    assert base64.b64decode(data) == content


def test_what_is_no_picture_is_one_message(tmp_path: Path) -> None:
    for content, fault in (
        (b"<svg onload='x'/>", "a file of another format"),
        (b"", "a file of another format"),
        (picture("GIF"), "a file of another format"),
        (picture("PNG")[:45], "a file that cannot be read"),
        (b"\x89PNG" + bytes(300_000), "300004 bytes"),
    ):
        (tmp_path / "logo").write_bytes(content)
        with pytest.raises(UsageError, match=f"expected a picture, PNG or JPEG, .*found {fault}"):
            read_logo(tmp_path / "logo")
    with pytest.raises(UsageError, match="found no file"):
        read_logo(tmp_path / "none")
    with pytest.raises(UsageError, match="found no file"):
        read_logo(tmp_path)
