from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.bending.bent_frames import BendingErrors, BendingTest, TipPull, held_at_rest
from labpipe.bending.fitted_law import LawFit, law_knots
from labpipe.bending.law_table import (
    ROWS,
    STATIONS,
    bending_cloud,
    law_points,
    measure_bending,
    tabulate,
)
from labpipe.law.plays import LinearLaw, MomentLaw
from labpipe.records.arrays import Floats
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

BASIS = law_knots(0.06, 5)


LAW: Floats = np.array([180.0, 200.0, 240.0, 300.0, 340.0])


COVARIANCE: Floats = np.diag([9.0, 4.0, 4.0, 4.0, 16.0])


def fit(compliance: Floats = LAW) -> LawFit:
    return LawFit(
        basis=BASIS,
        compliance=compliance,
        covariance=COVARIANCE,
        sensitivity=np.zeros((5, 1, 2)),
        residual=9e-6,
        n=2,
        variance=1e-10,
    )


def table(*, scale_error: float = 0.0, noise: float = 0.05) -> MeasuredLaw:
    return tabulate(
        fit(), [], scale_error=scale_error, noise=1e-5, curvature_noise=noise, n_frames=100
    )


def test_points_lie_on_the_law() -> None:
    moment = np.array([0.001, 0.02, 0.05])
    curvature = BASIS.values(moment) @ LAW
    at = law_points(BASIS.knots, LAW, COVARIANCE, curvature, scale_error=0.0)
    assert at.moment == pytest.approx(moment, rel=1e-4)
    assert at.secant == pytest.approx(moment / curvature, rel=1e-4)
    assert at.tangent == pytest.approx(1.0 / (BASIS.slopes(moment) @ LAW), rel=1e-3)


@pytest.mark.slow
def test_errors_are_those_of_other_laws() -> None:
    curvature, rng = np.array([1.0, 4.0, 9.0]), np.random.default_rng(3)
    at = law_points(BASIS.knots, LAW, COVARIANCE, curvature, scale_error=0.01)
    drawn = rng.multivariate_normal(LAW, COVARIANCE, 3000)
    scales = 1.0 + 0.01 * rng.standard_normal(3000)
    others = [law_points(BASIS.knots, law, COVARIANCE, curvature, scale_error=0.0) for law in drawn]
    for name in ("moment", "secant", "tangent"):
        values = scales[:, None] * np.array([getattr(other, name) for other in others])
        assert values.std(axis=0) == pytest.approx(getattr(at, f"{name}_error"), rel=0.08)


def test_nothing_is_extrapolated() -> None:
    last = float(BASIS.values(BASIS.knots[-1:])[0] @ LAW)
    curvature = np.array([1e3, -1.0, 1.01 * last])
    at = law_points(BASIS.knots, LAW, COVARIANCE, curvature, scale_error=0.0)
    assert np.isnan([at.moment, at.secant, at.tangent]).all()
    at = law_points(BASIS.knots, LAW, COVARIANCE, np.array([last]), scale_error=0.0)
    assert at.moment == pytest.approx(BASIS.knots[-1:])


def test_a_flat_law_has_no_stiffness() -> None:
    flat = np.array([0.0, 0.0, 0.0, 0.0, 340.0])
    at = law_points(BASIS.knots, flat, COVARIANCE, np.array([0.0]), scale_error=0.0)
    assert np.isinf(at.tangent).all()
    assert not np.isfinite(at.moment_error).any()


def test_below_the_noise_there_is_no_stiffness() -> None:
    law = table(noise=0.5)
    assert law.floor == pytest.approx(0.98, abs=1e-3)
    unknown = law.curvature <= law.floor
    assert law.is_known.tolist() == (~unknown).tolist()
    assert np.isnan(law.secant[unknown]).all()
    assert np.isfinite(law.secant[~unknown]).all()
    assert np.isfinite(law.moment).all()
    last = law.curvature[unknown].max()
    assert str(law.reason) == (
        f"below_noise: {int(unknown.sum()) - 1} of 40 curvatures, up to {last:.3g} 1/m, are not "
        "above their noise (1.96 standard errors of the cloud are 0.98 1/m)"
    )


def test_all_but_zero_can_be_known() -> None:
    law = table(noise=1e-6)
    assert law.is_known.tolist() == [False, *[True] * 40]
    assert law.reason is None


def test_intervals_hold_the_scale_and_what_frames_share() -> None:
    plain, scaled = table(), table(scale_error=0.05)
    assert (scaled.secant_upper - scaled.secant)[-1] == pytest.approx(
        np.hypot((plain.secant_upper - plain.secant)[-1], 1.96 * 0.05 * plain.secant[-1]), rel=1e-3
    )
    shared = tabulate(
        fit(), [np.full(5, 10.0)], scale_error=0.0, noise=1e-5, curvature_noise=0.05, n_frames=1
    )
    assert shared.compliance_covariance == pytest.approx(COVARIANCE + 100.0)


STIFFNESS = 5e-3


SHAPES = pulled(LinearLaw(STIFFNESS), travel=0.05, frames=101)


TEST = bending_test(SHAPES)


def test_rows_and_places() -> None:
    cloud = bending_cloud(TEST)
    assert cloud.frames_per_mean == 2
    assert cloud.curvature.shape == (ROWS, STATIONS)
    assert set(cloud.branch.tolist()) == {0}
    assert set(cloud.cycle.tolist()) == {1}


def test_an_elastic_wire_has_one_stiffness_everywhere() -> None:
    cloud = bending_cloud(TEST)
    inner = np.s_[:, 2:-4]  # a polynomial is poor at its ends, and at the tip there is no moment
    bent = np.abs(cloud.curvature[inner]) > 2.0
    ratio = (cloud.moment[inner] / cloud.curvature[inner])[bent]
    assert ratio == pytest.approx(STIFFNESS, rel=0.02)


def test_at_rest_the_counterweight_bends_it_down() -> None:
    at_rest = bending_cloud(TEST).moment_at_rest
    assert at_rest[0] == pytest.approx(-0.0265 * 0.085, rel=1e-3)
    assert at_rest[-1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.slow
def test_noise_of_curvatures_is_as_stated() -> None:
    exact = bending_cloud(TEST)
    clouds = [bending_cloud(bending_test(SHAPES, noise=2e-5, seed=seed)) for seed in range(12)]
    off = np.stack([(cloud.curvature - exact.curvature) for cloud in clouds])
    ratio = off[..., :-1] / np.stack([cloud.curvature_error for cloud in clouds])[..., :-1]
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1.0, abs=0.1)


def test_errors_of_moments_add_up() -> None:
    errors = BendingErrors(force_noise=0.0, force_zero=0.0, force_scale=0.01, offset=0.0)
    scaled = bending_cloud(replace(TEST, errors=errors))
    assert scaled.moment_error == pytest.approx(np.abs(0.01 * scaled.moment), abs=1e-9)
    zero = bending_cloud(replace(TEST, errors=replace(errors, force_scale=0.0, force_zero=1e-3)))
    assert zero.moment_error[0, 0] == pytest.approx(0.085e-3, rel=0.01)
    place = bending_cloud(replace(TEST, errors=replace(errors, force_scale=0.0, offset=1e-4)))
    assert place.moment_error[-1] == pytest.approx(1e-4 * place.force[-1])
    centre = bending_cloud(replace(TEST, errors=replace(errors, force_scale=0.0, centre=1e-4)))
    lean = float(np.sin(SHAPES[-1].angle[-1]))  # an axis that lies lower moves the tip by so much
    assert lean > 0.5
    assert centre.moment_error[-1] == pytest.approx(1e-4 * lean * centre.force[-1], rel=0.02)


def test_a_shape_without_spare_markers_has_no_second_opinion() -> None:
    cloud = bending_cloud(bending_test(SHAPES[:20], terms=11))
    assert np.isnan(cloud.curvature_systematic).all()
    assert cloud.noise.shape == cloud.curvature.shape


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


SHAPES_LAW = pulled(WIRE, travel=0.05, frames=101)


def halves(errors: BendingErrors) -> float:
    """Half width of the interval of the moment at the largest curvature, as a share."""
    test = replace(bending_test(SHAPES_LAW), errors=errors)
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
        replace(bending_test(SHAPES_LAW), errors=BendingErrors(0.0, 0.0, 0.0, 1e-3))
    ).law
    assert law is not None
    assert stated is not None
    true = law_moment(WIRE, law.curvature)
    off = np.abs(law.moment - true)[15:]
    assert (off < 1.05 * (stated.moment_upper - stated.moment)[15:]).all()
    assert off.max() > 0.005 * true.max()


def test_a_centre_offset_changes_the_law_by_what_is_stated_for_it() -> None:
    """The law found anew with markers a little farther off, against the interval's own part."""
    more, test = 1e-4, bending_test(SHAPES_LAW)
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
    test = bending_test(SHAPES_LAW)
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
    bending = measure_bending(bending_test(SHAPES_LAW[:12]))
    assert bending.law is None
    assert str(bending.reason) == ("no_law: frames of the first loading=12: expected at least 24")
    assert bending.cloud.curvature.shape[0] == 12


def test_a_force_the_other_way_has_no_law() -> None:
    test = bending_test(SHAPES_LAW)
    bending = measure_bending(replace(test, force=-test.force))
    assert bending.law is None
    assert "expected more towards the pull than at rest" in str(bending.reason)
