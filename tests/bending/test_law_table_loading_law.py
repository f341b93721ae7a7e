"""The law of exact first loadings, found again; and what is said where there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.bending.bent_frames import BendingErrors, BendingTest, TipPull, held_at_rest
from labpipe.bending.law_table import measure_bending
from labpipe.law.plays import LinearLaw, MomentLaw
from labpipe.records.curve import MeasuredLaw
from labpipe.virtual_lab.specimens import WireModel
from tests.builders.bent_tests import (
    HEAVY,
    LENGTH,
    STRING,
    WEIGHT,
    bending_test,
    law_moment,
    lifted,
    loaded,
    pulled,
)
from tests.builders.bilinear_laws import bilinear_law

LAWS: dict[str, tuple[MomentLaw, float]] = {
    "elastic": (LinearLaw(5e-3), 5e-4),
    "stick and slip": (WireModel().law(), 2e-3),
    "kinked": (bilinear_law(8e-3, 2e-3, 0.02), 1.5e-2),  # rounded between two knots
}


def found(law: MomentLaw) -> MeasuredLaw:
    bending = measure_bending(bending_test(pulled(law, travel=0.05, frames=101)))
    assert bending.law is not None, bending.reason
    return bending.law


@pytest.mark.slow
@pytest.mark.parametrize(("law", "share"), LAWS.values(), ids=LAWS)
def test_an_exact_loading_gives_its_law(law: MomentLaw, share: float) -> None:
    measured = found(law)
    above = measured.curvature > 1.0
    true = law_moment(law, measured.curvature)
    assert measured.moment[above] == pytest.approx(true[above], rel=share)
    assert measured.curvature[-1] > 20.0


@pytest.mark.parametrize(("weighs", "off"), [(True, 0.002), (False, 0.02)])
def test_a_wire_with_weight_gives_its_law_from_rest_on(*, weighs: bool, off: float) -> None:
    """It lies level, bent by its weight before anything is measured; left out, it shows."""
    law = replace(WireModel(), stick_moment=2e-4).scaled(0.2).law()
    shapes = lifted(law, travel=0.05, frames=201)
    own = HEAVY if weighs else 0.0
    pull = TipPull(STRING, WEIGHT, WEIGHT + held_at_rest(own, LENGTH), LENGTH, own)
    measured = measure_bending(bending_test(shapes, pull=pull)).law
    assert measured is not None
    above = (measured.curvature > 0.5) & (measured.curvature < 10.0)
    true = law_moment(law, measured.curvature, most=0.05)
    error = np.max(np.abs(measured.moment[above] / true[above] - 1.0))
    assert error < off if weighs else error > off


def test_without_a_string_the_load_is_normal() -> None:
    test = bending_test(loaded(LinearLaw(5e-3), force=2.0, frames=61), has_string=False)
    law = measure_bending(test).law
    assert law is not None
    assert law.secant[10:] == pytest.approx(5e-3, rel=1e-3)
    assert law.tangent[10:] == pytest.approx(5e-3, rel=2e-3)


WIRE = WireModel().law()
SHAPES = pulled(WIRE, travel=0.05, frames=101)


def halves(errors: BendingErrors) -> float:
    """Half width of the interval of the moment at the largest curvature, as a share."""
    test = replace(bending_test(SHAPES), errors=errors)
    law = measure_bending(test).law
    assert law is not None
    return float((law.moment_upper[-10] / law.moment[-10] - 1.0) / 1.96)


def test_errors_of_force_and_places_widen_the_interval() -> None:
    none = BendingErrors(0.0, 0.0, 0.0, 0.0)
    bare = halves(none)
    assert halves(replace(none, force_scale=0.01)) == pytest.approx(0.01, rel=0.01)
    assert halves(replace(none, force_zero=0.01)) == pytest.approx(0.01, rel=0.5)
    assert halves(replace(none, offset=1e-3)) > 0.01
    assert bare < halves(replace(none, other_tension_at_rest=0.0265)) < 0.05


@pytest.mark.parametrize("end", ["clamp", "tip"])
def test_a_wrong_place_of_an_end_is_within_its_interval(end: str) -> None:
    """Ends that are a millimetre elsewhere change the law by what is stated for it."""
    law = measure_bending(_moved(end, 1e-3)).law
    stated = measure_bending(
        replace(bending_test(SHAPES), errors=BendingErrors(0.0, 0.0, 0.0, 1e-3))
    ).law
    assert law is not None
    assert stated is not None
    true = law_moment(WIRE, law.curvature)
    off = np.abs(law.moment - true)[15:]
    assert (off < 1.05 * (stated.moment_upper - stated.moment)[15:]).all()
    assert off.max() > 0.005 * true.max()


def test_a_centre_offset_changes_the_law_by_what_is_stated_for_it() -> None:
    """The law found anew with markers a little farther off, against the interval's own part."""
    more, test = 1e-4, bending_test(SHAPES)
    farther = replace(test.shape, positions=test.shape.positions + np.array([0.0, more, 0.0]))
    again = replace(test, shape=farther, centre_offset=test.centre_offset + more)
    stated = replace(test, errors=BendingErrors(0.0, 0.0, 0.0, 0.0, centre=more))
    bare, moved, wide = (measure_bending(each).law for each in (test, again, stated))
    assert bare is not None
    assert moved is not None
    assert wide is not None
    at = np.array([2.0, 5.0, 10.0, 15.0])
    half, none = (
        np.interp(at, law.curvature, law.moment_upper - law.moment) / 1.96 for law in (wide, bare)
    )
    before, after = (np.interp(at, law.curvature, law.moment) for law in (bare, moved))
    assert np.abs(after - before) == pytest.approx(np.sqrt(half**2 - none**2), rel=0.1)
    assert (np.abs(after - before) > 5e-4 * before).all()


def _moved(end: str, more: float) -> BendingTest:
    test = bending_test(SHAPES)
    shape = test.shape
    if end == "tip":
        shape = replace(shape, length=shape.length + more)
        along = np.append(shape.arc_length[:-1], shape.arc_length[-1] + more)
        return replace(test, shape=replace(shape, arc_length=along))
    along = np.concatenate([[0.0], shape.arc_length[1:] + more])
    positions = shape.positions + np.array([more, 0.0, 0.0])
    return replace(
        test,
        shape=replace(shape, length=shape.length + more, arc_length=along, positions=positions),
    )


def test_few_frames_have_a_cloud_and_no_law() -> None:
    bending = measure_bending(bending_test(SHAPES[:12]))
    assert bending.law is None
    assert str(bending.reason) == ("no_law: frames of the first loading=12: expected at least 24")
    assert bending.cloud.curvature.shape[0] == 12


def test_a_force_the_other_way_has_no_law() -> None:
    test = bending_test(SHAPES)
    bending = measure_bending(replace(test, force=-test.force))
    assert bending.law is None
    assert "expected more towards the pull than at rest" in str(bending.reason)
