"""What a report's page says of tests, groups and the whole campaign, before it is markup."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import date
from xml.etree import ElementTree

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.curve import FigureLaw, FigureShapes
from labpipe.records.group import Campaign, Group, Sample
from labpipe.records.result import Instrument
from labpipe.report.group_plots import make_group_plots
from labpipe.report.issues import find_causes
from labpipe.report.lab_report import describe_campaign, fill_template, find_open_decisions
from labpipe.report.page_tables import (
    arrange_tests,
    compute_report_id,
    describe_testing,
    find_group_of_rejected,
    list_instruments,
    make_test_rows,
    name_page_file,
)
from labpipe.report.plot_records import GRID_SIZE, Axis, Line, Plot
from labpipe.report.wording import Scale
from tests.builders.campaigns import (
    build_campaign,
    build_group,
    build_sample,
    six_samples,
)


def test_tests_are_numbered_group_by_group_and_rejected_ones_last() -> None:
    samples = six_samples(slips=0)
    two_groups = (build_group("A", samples[:2]), build_group("B", samples[3:]))
    groups = tuple(replace(group, fields={"type": "twist-tube-10"}) for group in two_groups)
    third = samples[2]
    campaign = Campaign("S", groups, rejected={third.source: "bent"}, rejected_samples=(third,))
    page_groups, tests = arrange_tests(campaign)
    assert [(test.row_index, test.stem, test.state) for test in tests] == [
        (0, "a", "ok"), (1, "a", "ok"), (2, "b", "ok"), (3, "b", "ok"), (4, "b", "ok"),
        (5, "a", "rejected"),
    ]  # fmt: skip
    assert [test.rejection for test in page_groups[0].rejected] == ["bent"]


def test_a_rejected_test_goes_where_it_fits_best() -> None:
    sample = build_sample("s1", "a")
    a = replace(build_group("A", [sample]), fields={"type": "twist-tube-10", "spool": "s0"})
    b = replace(a, name="B", fields={"type": "twist-tube-10", "spool": "s1"})
    c = replace(a, name="C", fields={"type": "other", "spool": "s1", "length": "75 mm"})
    assert find_group_of_rejected(sample, Campaign("S", (a, b, c))) is b
    assert find_group_of_rejected(sample, Campaign("S", (c,))) is None
    unknown = replace(sample, protocol="other")
    assert find_group_of_rejected(unknown, Campaign("S", (a, b))) is None


def test_an_overdue_calibration_is_said_with_its_tests() -> None:
    due = date(2026, 1, 1)
    cell = Instrument("force", ("force",), "LC-500", date(2025, 1, 1), due)
    good, late, undated = (replace(sample, instruments=(cell,)) for sample in six_samples()[:3])
    good, late = (replace(good, date=date(2025, 12, 31)), replace(late, date=date(2026, 1, 2)))
    no_due = replace(good, instruments=(replace(cell, due=None),))
    for samples, expected in (
        ([good, undated], "calibration due 2026-01-01"),
        ([good, late, undated], "calibration OVERDUE since 2026-01-01 in 1 test"),
        ([no_due], "no due date stated"),
    ):
        (line,) = list_instruments(samples)
        assert (line.calibration, line.is_overdue) == (expected, "OVERDUE" in expected)


def test_the_id_of_a_report_changes_with_its_tests_and_decisions() -> None:
    group = build_group("A", six_samples())
    campaign = Campaign("S", (group,))
    changed_campaigns = [
        replace(campaign, groups=(replace(group, samples=group.samples[1:]),)),
        replace(campaign, rejected={"x": "bent"}), replace(campaign, title="T"),
    ]  # fmt: skip
    assert compute_report_id(campaign) == compute_report_id(Campaign("S", (group,)))
    assert len(set(map(compute_report_id, (campaign, *changed_campaigns)))) == 4


def test_decided_and_rejected() -> None:
    samples = six_samples(slips=0)
    first = replace(samples[0], decision="fine (me)", date=date(2026, 3, 2), operator="me")
    second = replace(samples[1], label="c/x")
    group = build_group("A", [first])
    rejected = {second.source: "bent (me)"}
    campaign = Campaign("S", (group,), rejected=rejected, rejected_samples=(second,))
    row, other_row = make_test_rows(arrange_tests(campaign)[1])
    assert (row["decision"], row["grounds"], row["reason"]) == ("accept", "fine (me)", "")
    texts = ("reject", "bent (me)", "Rejected: bent (me)")
    assert (other_row["decision"], other_row["grounds"], other_row["reason"]) == texts
    assert other_row["page"] == "tests/c__x.html" == name_page_file("c/x")
    odd = Campaign("S", (build_group("A", [replace(first, label="a#1 50 %?")]),))
    (row,) = make_test_rows(arrange_tests(odd)[1])
    assert row["address"] == "tests/a%231%2050%20%25%3F.html"


def test_what_is_to_be_decided_until_somebody_did() -> None:
    campaign = build_campaign()
    open_decisions = find_open_decisions(find_causes(campaign)[0], arrange_tests(campaign)[1])
    headings = {decision.cause.heading for decision in open_decisions}
    assert headings == {"Failed", "Doubtful", "Outlier"}
    assert describe_campaign(campaign, open_decisions).endswith(" 3 to decide")
    rejected = replace(campaign.groups[0].samples[0], decision="bent (me)")
    tests = arrange_tests(replace(campaign, rejected_samples=(rejected,)))[1]
    assert find_open_decisions(find_causes(campaign)[0], tests) == open_decisions
    group = campaign.groups[0]
    decided = tuple(replace(sample, decision="fine (me)") for sample in group.samples)
    settled = replace(campaign, groups=(replace(group, samples=decided),))
    assert not find_open_decisions(find_causes(settled)[0], arrange_tests(settled)[1])
    assert describe_campaign(settled, []).endswith(" 0 to decide")


def test_days_and_operators_of_some_tests() -> None:
    six = six_samples()
    march = replace(six[0], date=date(2026, 3, 6), operator="A. Tester")
    later = replace(six[1], date=date(2026, 3, 2), operator="A. Tester")
    expected = (
        ([six[0]], "on an unknown day (no sheet states one) by operator not stated"),
        ([march, later], "2026-03-02 to 2026-03-06 by A. Tester"),
        (
            [march, six[2]],
            "2026-03-06, 1 test of unknown day by A. Tester (1 test without operator)",
        ),
    )
    for samples, text in expected:
        assert describe_testing(samples) == text


MM = Scale(1.0, "mm")
X, Y = Axis("Displacement", MM, 0.0, 10.0), Axis("Force", Scale(1.0, "N"), -1.0, 9.0)


def points(path: str, x: Axis, y: Axis) -> list[Floats]:
    """What a browser makes of a path: its strokes, in the units of the axes."""
    strokes = []
    for stroke in filter(None, re.split("M", path.rstrip("z"))):
        numbers = np.array(re.findall(r"-?\d+", stroke), dtype=np.float64)
        steps = np.reshape(numbers, (-1, 2)).cumsum(axis=0) / GRID_SIZE
        across = x.low + steps[:, 0] * (x.high - x.low)
        strokes.append(np.column_stack([across, y.high - steps[:, 1] * (y.high - y.low)]))
    return strokes


def test_a_line_is_what_its_steps_say_to_sixteen_bit() -> None:
    noise = np.random.default_rng(7)
    x, y = np.sort(noise.uniform(0, 10, 120)), noise.uniform(-1, 9, 120)
    y[40] = np.nan
    first, second = points(Line("curve", x, y).format_path(X, Y), X, Y)
    np.testing.assert_allclose(first, np.column_stack([x, y])[:40], atol=10 / GRID_SIZE)
    np.testing.assert_allclose(second, np.column_stack([x, y])[41:], atol=10 / GRID_SIZE)


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-3.7, 12.0), (1e-5, 3e-5), (4e7, 5e7)])
def test_ticks_are_round_few_and_inside(low: float, high: float) -> None:
    shares, texts = zip(*Axis(low=low, high=high).choose_ticks(6), strict=True)
    assert 3 <= len(shares) <= 7
    assert -1e-9 <= min(shares) <= max(shares) <= 1 + 1e-9
    values = np.array([float(text.replace("\u2212", "-")) for text in texts])
    np.testing.assert_allclose(np.diff(values), values[1] - values[0], rtol=1e-6)
    np.testing.assert_allclose(low + np.array(shares) * (high - low), values, rtol=1e-6, atol=1e-12)


def test_a_plot_is_well_formed_and_its_words_are_text() -> None:
    line = Line("curve c0", np.array([0.0, 10.0]), np.array([0.0, 8.0]), test=3, group='a"b')
    plot = Plot(Axis('"mm" <', MM, 0.0, 10.0), Y, [line], kind="curves", title="<b>")
    template = '{% from "plots.html" import svg %}{{ svg(plot) }}'
    root = ElementTree.fromstring(fill_template(template, plot=plot))
    assert root.get("aria-label") == "<b>"
    (area,) = (element for element in root.iter() if element.get("class") == "area")
    assert [area.get(f"data-{name}") for name in ("x0", "x1", "y0", "y1")] == [
        "0", "10", "-1", "9",
    ]  # fmt: skip
    assert area.get("data-x-name") == '"mm" <'
    (path,) = area
    assert (path.get("data-t"), path.get("data-group")) == ("3", 'a"b')


def panels(group: Group, *rejected: Sample) -> dict[str, Plot]:
    (page_group,), _ = arrange_tests(Campaign("S", (group,), rejected_samples=rejected))
    return {plot.kind: plot for plot in make_group_plots(page_group)}


def test_curves_are_drawn_where_they_are() -> None:
    sample = build_sample("s1", "a")
    plot = panels(build_group("A", [sample], scaled=False))["curves"]
    (line,) = (line for line in plot.lines if line.look == "curve c0")
    assert len(line.x) <= 90
    curve = sample.loading[0]
    force = np.interp(line.x, curve.displacement, curve.force)
    np.testing.assert_allclose(line.y, force, atol=1e-9)
    assert "mean" not in [line.look for line in plot.lines]


def test_shapes_have_one_scale_and_laws_their_intervals() -> None:
    tips = np.array([0.0, 0.01, 0.02])
    along = np.linspace(0.0, 0.1, 6)
    places = np.stack([np.stack([along, tip * along / 0.1], axis=1) for tip in tips])
    law = FigureLaw(np.array([0.0, 10.0]), *(np.array([0.0, m]) for m in (0.02, 0.018, 0.022)))
    shapes = FigureShapes(tips, places)
    samples = [replace(sample, shapes=shapes, law=law) for sample in six_samples()[:2]]
    drawn = panels(build_group("A", samples))
    plot, moment = drawn["shapes"], drawn["moment"]
    width, height = plot.size
    across = (plot.x.high - plot.x.low) / width
    assert (plot.y.high - plot.y.low) / height == pytest.approx(across)
    assert plot.caption.startswith("Markers at 0, 10, 20 mm")
    assert np.isnan(plot.lines[0].x).sum() == 3
    looks = [line.look for line in moment.lines]
    assert looks == ["band c0", "band c1", "curve c0", "curve c1"]
    assert moment.lines[2].y[-1] == pytest.approx(0.02)
