"""Figures and tables of bundles and harnesses: what is drawn, not how."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.mechanics.wire.bundle_model import compute_bundle_model
from labpipe.records.curve import Interval
from labpipe.records.group import BoundedStiffness, Campaign
from labpipe.records.harness_bundle import BundleLoop, FrictionFit
from labpipe.records.quality import Reason
from labpipe.report.harness_figures import (
    DrawnBoundary,
    DrawnHarness,
    DrawnShape,
    DrawnSweep,
    make_bundle_page,
    make_harness_page,
    make_loop_page,
    make_sweep_page,
    make_view_plot,
)
from labpipe.report.page_tables import make_bounds_table
from tests.approved import Approve
from tests.builders.bundle_campaigns import bundle_of, grouped, three_of
from tests.builders.bundles import bundle, example_wires
from tests.report.figure_words import all_words, table_words

MIXED = compute_bundle_model(
    bundle(("B1", 4), ("B2", 3), arrangement="asymmetric", conduit_bore=4e-3), example_wires()
)
ALIKE = compute_bundle_model(bundle(("B1", 7)), example_wires())


GROUPS = tuple(grouped(three_of(bundle_of("7 B1"))))
NAME = GROUPS[0].name
ENDS, SHARE = Interval(0.0058, 0.0062), Interval(0.0290, 0.0316)
ROW = BoundedStiffness(NAME, "t-1", 0.006, ENDS, 0.0015, 0.0045, 0.15, (0.15, 0.16), 0.0303, SHARE)


DEFLECTION = np.array([0.0, 0.02, 0.01, 0.02, 0.01])
FORCE = np.array([0.0, 1.0, 0.1, 1.0, 0.1])
LOOP = BundleLoop(0.1, DEFLECTION, FORCE, np.array([0, 0, 1, 2, 3]), (1e-3, 0.2), 0.015)
FIT = FrictionFit(
    composite_share=0.13,
    slip_curvature=0.3,
    slide_curvature=4.5,
    held=0.2,
    held_lower=0.15,
    held_upper=0.26,
    loop=LOOP,
    predicted=1.1 * FORCE,
    is_held_out=np.array([False, False, False, True, True]),
    error_fitted=0.04,
    error_held_out=0.07,
    loss=2e-3,
    predicted_loss=2.2e-3,
)
TURN = np.linspace(0.0, np.pi / 2.0, 11)
ARC = 0.1 * np.column_stack([np.sin(TURN), np.zeros(11), 1.0 - np.cos(TURN)])
ROUND = DrawnShape(
    9, ARC, np.full(11, 0.1), (ARC - 0.004, ARC + 0.004), (np.full(11, 0.08), np.full(11, 0.13))
)
HARNESS = DrawnHarness(
    name="corner",
    note="A note.",
    arc_length=0.1 * TURN,
    shapes=(DrawnShape(3, ARC * [1.0, 1.0, 0.0], np.full(11, np.inf)), ROUND),
    boundaries=(
        DrawnBoundary("left", "clip", ARC[0], np.zeros((0, 3)), np.array([1.0, 0.0, 0.0])),
        DrawnBoundary("hand", "grip", ARC[-1], ARC[[0, -1]]),
        DrawnBoundary("guide", "ring", ARC[5], np.zeros((0, 3)), is_holding=False),
    ),
    planes=((np.array([0.0, 0.0, -0.02]), np.array([0.0, 0.0, 1.0])),),
    allowed_radius=0.05,
)
SWEEP = DrawnSweep(
    name="corner",
    note="A note.",
    length=np.array([0.15, 0.2]),
    radius=np.array([0.03, np.nan]),
    radius_over_steps=np.array([0.02, np.nan]),
    radius_band=(np.array([0.025, np.nan]), np.array([0.04, np.nan])),
    shapes=(ARC, ARC[:0]),
    allowed_radius=0.05,
    is_doubtful=np.array([False, True]),
)


def test_a_view_has_the_line_with_its_radius() -> None:
    lines = {line.look: line for line in make_view_plot(HARNESS, "side").lines}
    shown, band = lines["harness_line"], lines["harness_band"]
    assert (shown.x[0], shown.y[0], shown.x[-1], shown.y[-1]) == pytest.approx((0.0, 0.0, 0.1, 0.1))
    assert shown.values == pytest.approx(np.full(11, 0.1))
    assert [np.nanmin(band.x), np.nanmax(band.x)] == pytest.approx([-0.004, 0.104])
    assert [np.nanmin(band.y), np.nanmax(band.y)] == pytest.approx([-0.004, 0.104])


def test_table_of_places(approved: Approve) -> None:
    short = (Reason("short", "it ends early"),)
    absent = (Reason("not_in_sheet", "no bounds: the sheet has no B3"),)
    bare = replace(ROW, test="", interval=None, principal=(0.15, 0.15), degree_interval=None)
    lacking = BoundedStiffness(NAME, "t-2", 0.006, None, reasons=absent)
    failed = replace(bare, test="t-3", value=None, degree=float("nan"), reasons=short)
    campaign = Campaign("Synthetic", GROUPS, wire_sheet="wires.xlsx")
    table = make_bounds_table(replace(campaign, bounded_stiffnesses=(ROW, bare, lacking, failed)))
    assert table is not None
    approved(table_words(table))
    assert make_bounds_table(campaign) is None


def test_words(approved: Approve) -> None:
    plain = replace(HARNESS, shapes=(replace(ROUND, band=None),), boundaries=(), planes=())
    pages = {
        "bundle": make_bundle_page(MIXED),
        "bundle of one wire": make_bundle_page(ALIKE),
        "cycles of a bundle": make_loop_page("TWB-1", FIT),
        "harness": make_harness_page(HARNESS),
        "harness without a band": make_harness_page(plain),
        "sweep": make_sweep_page(SWEEP),
        "sweep without a band": make_sweep_page(replace(SWEEP, radius_band=None)),
    }
    approved(all_words(pages))
    assert make_sweep_page(replace(SWEEP, shapes=(ARC[:0],) * 2)).plots[0].reason
