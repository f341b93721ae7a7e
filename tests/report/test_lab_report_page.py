from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser

import pytest

from labpipe.records.group import BundlePlace, Campaign
from labpipe.records.quality import Reason
from labpipe.report.lab_report import FiguresBetween, render_page
from labpipe.report.saving import Inline, SavedFigure
from tests.builders.bundle_campaigns import bundle_campaign, bundle_of, conduit_cases, three_of
from tests.builders.campaigns import build_campaign, build_group, build_sample, six_samples

FIGURE = SavedFigure(Inline("<svg></svg>", {"s1": "fill: none"}), "How to <read> it.", ())


class Outline(HTMLParser):
    """Tags that are open at the end, and all that were opened."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: Counter[str] = Counter()
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: object) -> None:  # noqa: ARG002
        self.tags[tag] += 1
        if tag not in {"meta", "br", "link", "img"}:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def page_of(campaign: Campaign) -> str:
    names = [f"g{number}" for number in range(len(campaign.groups))]
    return render_page(campaign, names, [[FIGURE] for _ in campaign.groups])


@pytest.fixture(scope="module")
def page() -> str:
    return page_of(build_campaign())


def test_order_of_the_page(page: str) -> None:
    wanted = [
        "<h1>Synthetic campaign</h1>",
        "7 samples from 3 spools in 3 groups, tested by twist-tube. 1 test could not be read.",
        "<h2>What needs a look</h2>", "Tests that could not be read (1)", "<h2>twist-tube-10</h2>",
        "twist-tube-10: means", "how they are averaged", "every sample, part 1", "slips in the",
        "<figure>", "<h2>twist-tube-7</h2>", "<h2>twist-tube-5</h2>",
        "The group has no sample with a curve.", "<h2>Differences between groups</h2>",
        "<h2>How the numbers were made</h2>", "No outlier was removed",
        "how each number was made", "<h2>Where they come from</h2>", "Made by labpipe 0.0",
    ]  # fmt: skip
    rest = page
    for words in wanted:
        before, found, rest = rest.partition(words)
        assert found, (words, before[-200:])


def test_every_tag_is_closed_and_tables_can_be_read_aloud(page: str) -> None:
    outline = Outline(page)
    assert outline.open == []
    assert outline.tags["table"] == outline.tags["caption"] > 10
    assert page.count('scope="col"') + page.count('scope="row"') == len(re.findall("<th[ >]", page))
    assert '<html lang="en">' in page
    assert 'name="viewport"' in page


def test_ids_are_unique_and_links_lead_to_them(page: str) -> None:
    ids = re.findall(r' id="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'href="#([^"]+)"', page)) <= set(ids)


def test_nothing_is_fetched_or_run(page: str) -> None:
    assert "<script" not in page
    assert "<link" not in page
    assert not re.findall(r"(?:src|href)=\"(?!#)", page)
    assert "@import" not in page
    assert "url(" not in page


def test_text_of_people_is_escaped() -> None:
    sample = replace(build_sample("s<1>", "a"), test="<script>alert(1)</script>")
    page = page_of(Campaign("A & <b>", (build_group("<i>", [sample]),)))
    assert "<script" not in page
    assert "<i>" not in page
    assert "<title>A &amp; &lt;b&gt;</title>" in page
    assert "How to &lt;read&gt; it." in page


def test_a_campaign_without_fault_says_so() -> None:
    page = page_of(Campaign("Synthetic", (build_group("A", six_samples(slips=0)),)))
    assert "Nothing: every test could be read, every number could be computed" in page
    assert "Differences between groups" not in page
    assert "tt-s1a, tt-s1b, tt-s1c, tt-s2a, tt-s2b, tt-s2c \u00b7 force: Moving average" in page
    assert ".s1 {fill: none}" in page


def test_what_all_tests_share_is_in_the_intervals_and_the_page_says_so(page: str) -> None:
    assert page.count("<dt>What all tests of a rig share</dt>") == 1
    assert "<dt>Value and estimate</dt>" in page
    assert "A mean keeps three significant digits" in page


def test_questions_stand_before_all_other_differences() -> None:
    campaign = bundle_campaign(conduit_cases())
    names = [f"g{number}" for number in range(len(campaign.groups))]
    figures = [[FIGURE] for _ in campaign.groups]
    page = render_page(campaign, names, figures, FiguresBetween({"taping": [FIGURE]}, []))
    wanted = [
        "<h2>Between slipping and sticking</h2>", "labpipe report ... --wire SHEET",
        "<h2>Differences between groups</h2>", "all else being equal", "18 pairs are not judged",
        "<h3>Wire</h3>", "Wire: B2 against B1, all else equal", "<h3>Number</h3>",
        "<h3>Taping</h3>", "<figure>", "Taping: half-lap against none, all else equal",
        "<h3>Conduit</h3>", "<h2>How the numbers were made</h2>",
    ]  # fmt: skip
    rest = page
    for words in wanted:
        before, found, rest = rest.partition(words)
        assert found, (words, before[-200:])
    outline = Outline(page)
    assert outline.open == []
    assert outline.tags["table"] == outline.tags["caption"]
    assert set(re.findall(r'href="#([^"]+)"', page)) <= set(re.findall(r' id="([^"]+)"', page))


def test_places_of_bundles_stand_on_the_page() -> None:
    campaign = bundle_campaign(three_of(bundle_of("7 B1")))
    place = BundlePlace(
        campaign.groups[0].name, "t-1", None, None, reasons=(Reason("x", "no bounds: why"),)
    )
    page = render_page(
        replace(campaign, places=(place,), wire_sheet="<wires>.xlsx"),
        ["g"], [[]], FiguresBetween({}, [FIGURE]),
    )  # fmt: skip
    assert "--wire SHEET" not in page
    assert "&lt;wires&gt;.xlsx" in page
    assert "No bounds: why." in page
    assert page.count("<figure>") == 1


def test_groups_without_a_bundle_have_none_of_this(page: str) -> None:
    assert "slipping and sticking" not in page
    assert "all else equal" not in page
    assert page.count("<h3>") == page.count("<h3>Samples") + page.count("<h3>Figures") + page.count(
        "<h3>Remarks"
    )
