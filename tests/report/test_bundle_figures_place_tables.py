from __future__ import annotations

from labpipe.records.curve import Interval
from labpipe.records.group import BundlePlace, Campaign
from labpipe.records.quality import Reason
from labpipe.report.bundle_figures import has_bundles, place_scales, place_table
from tests.builders.bundle_campaigns import bundle_of, grouped, three_of
from tests.builders.campaigns import build_campaign

GROUPS = tuple(grouped(three_of(bundle_of("7 B1"))))
NAME = GROUPS[0].name
PLACE = BundlePlace(
    NAME, "t-1", 0.0060, Interval(0.0058, 0.0062), 0.0015, 0.0045, 0.15, (0.15, 0.16),
    0.0303, Interval(0.0290, 0.0316),
)  # fmt: skip


def campaign(*places: BundlePlace) -> Campaign:
    return Campaign("Synthetic", GROUPS, places=places, wire_sheet="wires.xlsx")


def test_a_row_with_bounds_and_share() -> None:
    table = place_table(campaign(PLACE))
    assert table is not None
    (row,) = table.rows
    assert [(cell.text, cell.small) for cell in row] == [
        ("t-1", NAME),
        ("6000", "5800 to 6200"),
        ("1500", ""),
        ("4500", ""),
        ("150000", "150000 to 160000"),
        ("3.03 %", "2.90 to 3.16 %"),
    ]
    assert table.heads[1] == "Bending stiffness (N\u00b7mm\u00b2)"


def test_a_mean_without_interval_has_a_share_without() -> None:
    bare = BundlePlace(NAME, "", 0.006, None, 0.0015, 0.0045, 0.15, (0.15, 0.15), 0.0303)
    table = place_table(campaign(bare))
    assert table is not None
    cells = table.rows[0]
    assert cells[0].text == f"mean of {NAME}"
    assert (cells[4].small, cells[5].text, cells[5].small) == ("", "3.0 %", "")


def test_what_has_no_bounds_or_no_value_says_why() -> None:
    lacking = BundlePlace(
        NAME,
        "t-1",
        0.006,
        None,
        reasons=(Reason("not_in_sheet", "no bounds: the sheet has no B3"),),
    )
    failed = BundlePlace(
        NAME,
        "t-2",
        None,
        None,
        0.0015,
        0.0045,
        0.15,
        (0.15, 0.15),
        reasons=(Reason("short", "it ends early"),),
    )
    table = place_table(campaign(lacking, failed))
    assert table is not None
    one, two = table.rows
    assert one[5].small == "No bounds: the sheet has no B3."
    assert (one[1].text, one[2].text) == ("6000", "\u2013")
    assert (two[1].text, two[2].text, two[5].text) == ("\u2013", "1500", "\u2013")
    assert two[5].small == "It ends early."


def test_no_places() -> None:
    assert place_table(campaign()) is None
    assert has_bundles(campaign())
    assert not has_bundles(build_campaign())
    assert place_scales(campaign())[NAME].unit == "N*mm^2"
