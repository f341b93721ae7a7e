from __future__ import annotations

import numpy as np
import pytest

from labpipe.markers.rings import find_sections
from labpipe.markers.three_point_axis import _linearised, fit_bent_axis, fit_span
from labpipe.records.arrays import Floats
from tests.builders.three_point import RADIUS, SPAN, STROKE, BendingRecord, curvature_at, tracks

PLACES = 0.0127 * np.arange(-7.0, 8.0)


def points(bend: float) -> Floats:
    """Points with curvature bend x (1 - 2 |x| / span), small slopes, straight overhangs."""
    u = np.clip(1.0 - 2.0 * np.abs(PLACES) / SPAN, 0.0, None)
    half = 0.5 * SPAN
    y = -bend * half**2 * ((1.0 - u) / 2.0 - (1.0 - u**3) / 6.0)
    y -= bend * half / 2.0 * np.clip(np.abs(PLACES) - half, 0.0, None)
    return np.column_stack([PLACES, y, 0.0 * PLACES])[None]


def test_the_small_bend_of_an_elastic_beam() -> None:
    bent = fit_bent_axis(points(0.01), span=SPAN, terms=3)

    assert bent.mid_span[0] == pytest.approx(0.01, rel=1e-3)
    # To 1 %: over a span the three powers are nearly alike, only their sum is well known.
    assert bent.curvature[0] == pytest.approx([0.01, 0.0, 0.0], abs=1e-4)
    assert bent.deflection[0] == pytest.approx(0.01 * SPAN**2 / 12.0, rel=1e-3)
    assert abs(bent.support_slope[0]) == pytest.approx(0.01 * SPAN / 4.0, rel=1e-2)


def test_a_line_is_no_bend_and_missing_points_are_left_out() -> None:
    straight = np.column_stack([PLACES, 0.1 * PLACES + 0.002])[None]
    bent = fit_bent_axis(straight, span=SPAN, terms=3)
    assert bent.mid_span[0] == pytest.approx(0.0, abs=1e-9)
    assert bent.height[0] == pytest.approx(0.002)

    some = points(0.01)
    some[0, 3] = np.nan
    assert fit_bent_axis(some, span=SPAN, terms=3).mid_span[0] == pytest.approx(0.01, rel=1e-3)
    some[0, :10] = np.nan
    assert np.isnan(fit_bent_axis(some, span=SPAN, terms=3).mid_span).all()


def test_the_stated_noise_is_that_of_the_points() -> None:
    random = np.random.default_rng(3)
    many = np.repeat(points(5.0)[..., :2], 400, axis=0)
    many[..., 1] += random.normal(0.0, 2e-5, many.shape[:2])

    bent = fit_bent_axis(many, span=SPAN, terms=3)

    assert bent.noise == pytest.approx(2e-5, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("facing", ["side", "load"])
def test_a_bent_rod_with_two_rows_of_markers(facing: str) -> None:
    """The elastica by another method: curvature at full stroke is moment over EI."""
    angles = np.radians([55.0, 125.0] if facing == "side" else [145.0, 215.0])
    record = BendingRecord(noise=(0.0, 0.0, 1e-7), angles=tuple(float(each) for each in angles))
    made = tracks(record, np.random.default_rng(0))
    rest = np.asarray(made.time < 2.0)
    sections = find_sections(made.positions, rest=rest, apart=0.004)
    bent_most = np.nanmax(np.abs(sections.markers[..., 1] - sections.at_rest[:, 1]), axis=1) > 0.015

    found = fit_span(sections, span=SPAN, radius=RADIUS, facing=facing, bent_most=bent_most)

    top = int(np.argmin(np.abs(made.time - record.cameras_early - record.lasts)))
    assert found.bent.mid_span[top] == pytest.approx(curvature_at(STROKE), rel=8e-3)
    assert found.bent.deflection[top] == pytest.approx(STROKE, rel=5e-3)
    assert found.bent.residual[top] < 3e-6
    # Markers ahead of the axis are carried sideways by the twist, which tilts y by 12 mrad.
    close = 1e-3 if facing == "side" else 2.5e-3
    assert np.abs(found.twist[top]) == pytest.approx(np.full(15, 0.05), abs=close)
    assert found.mid_span == pytest.approx(0.0, abs=1e-4)
    assert found.side_share < 0.02


def test_markers_on_one_side_of_mid_span_alone() -> None:
    made = tracks(BendingRecord(), np.random.default_rng(0))
    rest = np.asarray(made.time < 2.0)
    sections = find_sections(made.positions[:, :16], rest=rest, apart=0.004)
    said = (
        r"mm of mid-span: expected some 45.72 mm away on both sides, which is 60 % of half the span"
    )
    with pytest.raises(ValueError, match=said):
        fit_span(
            sections,
            span=SPAN,
            radius=RADIUS,
            facing="side",
            bent_most=np.asarray(np.abs(made.time - 62.0) < 20.0),
        )


def test_too_few_sections() -> None:
    made = tracks(BendingRecord(), np.random.default_rng(0))
    rest = np.asarray(made.time < 2.0)
    sections = find_sections(made.positions[:, :10], rest=rest, apart=0.004)
    with pytest.raises(ValueError, match="5 sections with markers: expected at least 6"):
        fit_span(sections, span=SPAN, radius=RADIUS, facing="side", bent_most=~rest)


def test_beyond_its_grid_an_axis_goes_on_straight() -> None:
    """A sine of 0.6 is a slope of 0.75 everywhere."""
    grid = np.linspace(-1.0, 1.0, 11)
    x = np.array([[-1.1, -1.0, 0.0, 0.55, 1.0, 1.2]])
    _, y = _linearised(np.array([[0.6, 0.2]]), np.ones((11, 1)), grid, x)
    assert y == pytest.approx(0.2 + 0.75 * x)
