from __future__ import annotations

import base64
import hashlib
import re
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser

import pytest

from labpipe.records.group import BundlePlace, Campaign
from labpipe.records.quality import Reason
from labpipe.report.lab_report import Letterhead, render_page
from tests.builders.bundle_campaigns import bundle_campaign, bundle_of, conduit_cases, three_of
from tests.builders.campaigns import build_campaign, build_group, build_sample, six_samples

VOID = {"meta", "br", "link", "img"}


class Outline(HTMLParser):
    """Tags that are open at the end, and all that were opened."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: Counter[str] = Counter()
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: object) -> None:  # noqa: ARG002
        self.tags[tag] += 1
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def page() -> str:
    return render_page(build_campaign())


def in_order(page: str, wanted: list[str]) -> None:
    rest = page
    for words in wanted:
        before, found, rest = rest.partition(words)
        assert found, (words, before[-200:])


def test_order_of_the_page(page: str) -> None:
    in_order(page, [
        "<h1>Synthetic campaign</h1>",
        "7 tests \u00b7 0 rejected \u00b7 1 not read \u00b7 3 to decide",
        "on an unknown day (no sheet states one) by operator not stated",
        "no calibration certificate stated in the protocols",
        ">To decide</h2>", "<span>Tested</span><span>Checked</span>",
        "<h2>twist-tube-10</h2>", "<figure class=\"plot curves\"",
        "twist-tube-10: every sample", "slips in the grips (1)", "Spool means, and how",
        "<h2>twist-tube-7</h2>", "<h2>twist-tube-5</h2>", "The group has no sample with a curve.",
        "<h2>Comparisons</h2>", "<h2>What needs a look</h2>", "Tests that could not be read (1)",
        "<h2>Tests</h2>", "<h2>How the numbers were made</h2>", "stay in every mean",
        "how each number was made", "<h2>Where they come from</h2>", "made by labpipe 0.0",
    ])  # fmt: skip


def test_every_tag_is_closed_and_tables_have_heads(page: str) -> None:
    outline = Outline(page)
    assert outline.open == []
    assert outline.tags["table"] > 10
    assert page.count('scope="col"') + page.count('scope="row"') == len(re.findall("<th[ >]", page))
    assert '<html lang="en">' in page
    assert 'name="viewport"' in page


def test_ids_are_unique_and_links_lead_to_them(page: str) -> None:
    ids = re.findall(r' id="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'href="#([^"]+)"', page)) <= set(ids)


def test_only_its_own_style_and_script_count(page: str) -> None:
    (policy,) = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]+)"', page)
    assert policy.startswith("default-src 'none'; ")
    assert policy.count("connect-src 'none'") == 1
    for tag in ("style", "script"):
        (text,) = re.findall(rf"<{tag}>(.*?)</{tag}>", page, re.DOTALL)
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"{tag}-src 'sha256-{digest}'" in policy
    assert not re.findall(r" (?:style|on[a-z]+)=", page.partition("<script>")[0])


def test_nothing_is_fetched(page: str) -> None:
    assert "<link" not in page
    assert not re.findall(r"(?:src|href)=\"(?!#)", page)
    assert "@import" not in page
    assert "url(" not in page


def test_text_of_people_is_escaped() -> None:
    name = "<script>alert(1)</script>"
    sample = replace(build_sample("s<1>", "a"), test=name, label=f"a/{name}", operator="<b>")
    page = render_page(
        Campaign("A & <b> */ </style>", (build_group("<i>", [sample]),), name="<i>"),
        letterhead=Letterhead((("Lab", "<u>"),)),
    )
    assert page.count("<script") == 2
    assert page.count("</style>") == 1
    assert "<i>" not in page
    assert "<u>" not in page
    assert "<b>" not in re.sub(r"<b>(CANNOT|DIFFERENT|[^<]*</b>)", "", page)
    assert "<title>A &amp; &lt;b&gt; */ &lt;/style&gt;</title>" in page
    assert Outline(page).open == []


def test_a_campaign_without_fault_says_so() -> None:
    page = render_page(Campaign("Synthetic", (build_group("A", six_samples(slips=0)),)))
    assert "Nothing: every test could be read, every number could be computed" in page
    assert "<h2>Comparisons</h2>" not in page
    assert "0 to decide" in page
    assert 'id="to-decide"' not in page


def test_questions_stand_with_their_pairs() -> None:
    page = render_page(bundle_campaign(conduit_cases()))
    in_order(page, [
        "<h2>Between slipping and sticking</h2>",
        "labpipe report ... --wire SHEET", "<h2>Comparisons</h2>", "18 pairs are not judged",
        "<h3>Wire</h3>", "Wire: B2 against B1", "<figure class=\"plot means\"", "<h3>Number</h3>",
        "<h3>Taping</h3>", "Taping: half-lap against none, all else equal",
        "<h3>Conduit</h3>", "<h2>What needs a look</h2>",
    ])  # fmt: skip
    outline = Outline(page)
    assert outline.open == []
    assert set(re.findall(r'href="#([^"]+)"', page)) <= set(re.findall(r' id="([^"]+)"', page))


def test_places_of_bundles_stand_on_the_page() -> None:
    campaign = bundle_campaign(three_of(bundle_of("7 B1")))
    place = BundlePlace(
        campaign.groups[0].name, "t-1", None, None, reasons=(Reason("x", "no bounds: why"),)
    )
    page = render_page(replace(campaign, places=(place,), wire_sheet="<wires>.xlsx"))
    assert "--wire SHEET" not in page
    assert "&lt;wires&gt;.xlsx" in page
    assert "No bounds: why." in page


def test_groups_without_a_bundle_have_none_of_this(page: str) -> None:
    assert "slipping and sticking" not in page
    assert "all else equal" not in page


def test_a_rejected_test_is_named_drawn_and_listed() -> None:
    samples = six_samples(slips=0)
    out = samples[0]
    group = replace(build_group("A", samples[1:]), fields={"type": "twist-tube-10"})
    campaign = Campaign(
        "Synthetic", (group,), rejected={out.source: "bent (me, today)"}, rejected_samples=(out,)
    )
    page = render_page(campaign)
    assert "1 rejected" in page
    assert f"{out.test} rejected: bent (me, today)." in page
    assert '<path class="rejected" data-t="5"' in page
    assert 'data-state="rejected"' in page
    assert 'data-decision="reject">rejected: bent (me, today)' in page


def test_letterhead() -> None:
    letterhead = Letterhead((("Lab", "Bench 3"), ("Order", "42")), "data:image/png;base64,AAAA")
    page = render_page(build_campaign(), letterhead=letterhead)
    in_order(page, ['src="data:image/png;base64,AAAA"', "<dt>Lab</dt><dd>Bench 3</dd>"])
