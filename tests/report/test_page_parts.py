"""Script, rules and data of a report's page, as text."""

from __future__ import annotations

import json
import re

from labpipe.records.group import Campaign
from labpipe.report.page_parts import page_data, page_script, page_style, served

HOSTILE = "</script><!-- & \u2028 \ud800 '\""


def test_data_cannot_end_their_element() -> None:
    entry = {"test": HOSTILE, "run": "r", "decision": "reject", "because": HOSTILE, "by": "A"}
    campaign = Campaign(HOSTILE, (), labpipe_version="1.2", name=HOSTILE, decisions=(entry,))
    text = page_data(campaign, report="abc")
    assert not set("<>&") & set(text)
    assert text.isascii()
    assert json.loads(text) == {
        "schema": 1,
        "campaign": HOSTILE,
        "report": "abc",
        "labpipe": "1.2",
        "decisions": [entry],
    }


def test_the_script_asks_no_network_and_makes_no_markup_of_text() -> None:
    script = page_script()
    assert "</script" not in script.lower()
    assert script.startswith('"use strict";\n(() => {')
    for word in ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval(",
                 "XMLHttpRequest", "WebSocket", "sendBeacon", "import("):  # fmt: skip
        assert word not in script
    # Where a machine serves the page itself, it talks to that, by names beside the page.
    assert re.findall(r"fetch\((\S+?)[,)]", script) == ['"decisions"', '"report"']


def test_rules_fetch_nothing() -> None:
    style = page_style()
    assert "url(" not in style
    assert "@import" not in style
    assert "</style" not in style.lower()


def test_a_served_page_may_talk_to_its_machine() -> None:
    page = "<head><meta content=\"default-src 'none'; connect-src 'none'\"></head><body>x</body>"
    assert served(page) == page.replace("connect-src 'none'", "connect-src 'self'")
    told = "<head></head><body>connect-src 'none'</body>"
    assert served(told) == told
