from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from labpipe.mechanics.law.plays import PlayLaw, make_elastic_law
from labpipe.records.arrays import Floats
from labpipe.records.curve import BendingCloud, MeasuredLaw
from labpipe.results.bending import compute_prop_force
from labpipe.results.measured_law import (
    N_CLOUD_MEANS,
    N_CLOUD_STATIONS,
    BendingTest,
    LawFit,
    TipPull,
    choose_knots,
    evaluate_law,
    measure_bending,
    measure_cloud,
    tabulate_law,
)
from labpipe.virtual_lab.specimens import WireModel
from tests.builders.bent_tests import (
    HEAVY,
    LENGTH,
    NO_ERRORS,
    STRING,
    WEIGHT,
    bending_test,
    law_moment,
    lifted,
    pulled,
)
from tests.builders.bilinear_laws import bilinear_law

BASIS = choose_knots(0.06, 5)


LAW: Floats = np.array([180.0, 200.0, 240.0, 300.0, 340.0])


COVARIANCE: Floats = np.diag([9.0, 4.0, 4.0, 4.0, 16.0])


def fit(compliance: Floats = LAW) -> LawFit:
    return LawFit(
        basis=BASIS,
        compliance=compliance,
        covariance=COVARIANCE,
        sensitivity=np.zeros((5, 1, 2)),
        residual=9e-6,
        n_coordinates=2,
        noise_variance=1e-10,
    )


def table(*, scale_error: float = 0.0, noise: float = 0.05) -> MeasuredLaw:
    return tabulate_law(
        fit(), [], scale_error=scale_error, noise=1e-5, curvature_noise=noise, n_frames=100
    )


def test_points_lie_on_the_law() -> None:
    moment = np.array([0.001, 0.02, 0.05])
    curvature = BASIS.compute_curvatures(moment) @ LAW
    at = evaluate_law(BASIS.knots, LAW, COVARIANCE, curvature, scale_error=0.0)
    assert at["moment"][0] == pytest.approx(moment, rel=1e-4)
    assert at["secant"][0] == pytest.approx(moment / curvature, rel=1e-4)
    stiffness = 1.0 / (BASIS.compute_compliances(moment) @ LAW)
    assert at["tangent"][0] == pytest.approx(stiffness, rel=1e-3)


@pytest.mark.slow
def test_errors_are_those_of_other_laws() -> None:
    curvature, rng = np.array([1.0, 4.0, 9.0]), np.random.default_rng(3)
    at = evaluate_law(BASIS.knots, LAW, COVARIANCE, curvature, scale_error=0.01)
    drawn = rng.multivariate_normal(LAW, COVARIANCE, 3000)
    scales = 1.0 + 0.01 * rng.standard_normal(3000)
    laws = [evaluate_law(BASIS.knots, law, COVARIANCE, curvature, scale_error=0.0) for law in drawn]
    for name in ("moment", "secant", "tangent"):
        values = scales[:, None] * np.array([other[name][0] for other in laws])
        assert values.std(axis=0) == pytest.approx(at[name][1], rel=0.08)


def test_nothing_is_extrapolated_and_a_flat_law_has_no_stiffness() -> None:
    last = float(BASIS.compute_curvatures(BASIS.knots[-1:])[0] @ LAW)
    curvature = np.array([1e3, -1.0, 1.01 * last, last])
    at = evaluate_law(BASIS.knots, LAW, COVARIANCE, curvature, scale_error=0.0)
    assert np.isnan([at["moment"][0][:3], at["secant"][0][:3], at["tangent"][0][:3]]).all()
    assert at["moment"][0][3] == pytest.approx(BASIS.knots[-1])
    flat = np.array([0.0, 0.0, 0.0, 0.0, 340.0])
    at = evaluate_law(BASIS.knots, flat, COVARIANCE, np.array([0.0]), scale_error=0.0)
    assert np.isinf(at["tangent"][0]).all()
    assert not np.isfinite(at["moment"][1]).any()


def test_below_the_noise_there_is_no_stiffness() -> None:
    law = table(noise=0.5)
    assert law.floor == pytest.approx(0.98, abs=1e-3)
    unknown = law.curvature <= law.floor
    assert law.is_known.tolist() == (~unknown).tolist()
    assert np.isnan(law.secant).tolist() == unknown.tolist()
    assert np.isfinite(law.moment).all()
    assert str(law.reason).startswith(f"below_noise: {int(unknown.sum()) - 1} of 40 curvatures, up")
    sure = table(noise=1e-6)
    assert sure.is_known.tolist() == [False, *[True] * 40]
    assert sure.reason is None


def test_intervals_hold_the_scale_and_what_frames_share() -> None:
    plain, scaled = table(), table(scale_error=0.05)
    assert (scaled.secant_upper - scaled.secant)[-1] == pytest.approx(
        np.hypot((plain.secant_upper - plain.secant)[-1], 1.96 * 0.05 * plain.secant[-1]), rel=1e-3
    )
    shared = tabulate_law(
        fit(), [np.full(5, 10.0)], scale_error=0.0, noise=1e-5, curvature_noise=0.05, n_frames=1
    )
    assert shared.compliance_covariance == pytest.approx(COVARIANCE + 100.0)


STIFFNESS = 5e-3


SHAPES = pulled(make_elastic_law(STIFFNESS), travel=0.05, frames=101)


TEST = bending_test(SHAPES)


def test_an_elastic_wire_has_one_stiffness_everywhere() -> None:
    cloud = measure_cloud(TEST)
    assert cloud.frames_per_mean == 2
    assert cloud.curvature.shape == (N_CLOUD_MEANS, N_CLOUD_STATIONS)
    assert (set(cloud.branch.tolist()), set(cloud.cycle.tolist())) == ({0}, {1})
    inner = np.s_[:, 2:-4]  # a polynomial is poor at its ends, and at the tip there is no moment
    bent = np.abs(cloud.curvature[inner]) > 2.0
    ratio = (cloud.moment[inner] / cloud.curvature[inner])[bent]
    assert ratio == pytest.approx(STIFFNESS, rel=0.02)
    # at rest the counterweight bends it down
    assert cloud.moment_at_rest[0] == pytest.approx(-0.0265 * 0.085, rel=1e-3)
    assert cloud.moment_at_rest[-1] == pytest.approx(0.0, abs=1e-9)


def test_noise_of_curvatures_is_as_stated() -> None:
    exact = measure_cloud(TEST)
    clouds = [measure_cloud(bending_test(SHAPES, noise=2e-5, seed=seed)) for seed in range(2)]
    off = np.stack([(cloud.curvature - exact.curvature) for cloud in clouds])
    ratio = off[..., :-1] / np.stack([cloud.curvature_error for cloud in clouds])[..., :-1]
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1.0, abs=0.1)


def test_errors_of_moments_add_up() -> None:
    def cloud_with(**errors: float) -> BendingCloud:
        return measure_cloud(replace(TEST, errors=replace(NO_ERRORS, **errors)))

    scaled = cloud_with(force_scale=0.01)
    assert scaled.moment_error == pytest.approx(np.abs(0.01 * scaled.moment), abs=1e-9)
    assert cloud_with(force_zero=1e-3).moment_error[0, 0] == pytest.approx(0.085e-3, rel=0.01)
    force = scaled.force[-1]
    assert cloud_with(end_position=1e-4).moment_error[-1] == pytest.approx(1e-4 * force)
    lean = float(np.sin(SHAPES[-1].angle[-1]))  # an axis that lies lower moves the tip by so much
    assert lean > 0.5
    centre = cloud_with(centre_offset=1e-4).moment_error[-1]
    assert centre == pytest.approx(1e-4 * lean * force, rel=0.02)


def law_of(test: BendingTest) -> MeasuredLaw:
    bending = measure_bending(test)
    assert bending.law is not None, bending.reason
    return bending.law


LAWS: dict[str, tuple[PlayLaw, float]] = {
    "elastic": (make_elastic_law(5e-3), 5e-4),
    "stick and slip": (WireModel().build_law(), 2e-3),
    "kinked": (bilinear_law(8e-3, 2e-3, 0.02), 1.5e-2),  # rounded between two knots
}


@pytest.mark.slow
@pytest.mark.parametrize(("law", "share"), LAWS.values(), ids=LAWS)
def test_an_exact_loading_gives_its_law(law: PlayLaw, share: float) -> None:
    measured = law_of(bending_test(pulled(law, travel=0.05, frames=101)))
    above = measured.curvature > 1.0
    true = law_moment(law, measured.curvature)
    assert measured.moment[above] == pytest.approx(true[above], rel=share)
    assert measured.curvature[-1] > 20.0


@pytest.mark.parametrize(
    ("weighs", "off"), [(True, 0.002), pytest.param(False, 0.02, marks=pytest.mark.slow)]
)
def test_a_wire_with_weight_gives_its_law_from_rest_on(*, weighs: bool, off: float) -> None:
    """It lies level, bent by its weight before anything is measured; left out, it shows."""
    law = WireModel(1e-3, 4e-5, 1e-3, 0.01, last_moment=0.06).build_law()
    shapes = lifted(law, travel=0.05, frames=201)
    own = HEAVY if weighs else 0.0
    pull = TipPull(STRING, WEIGHT, WEIGHT + compute_prop_force(own, LENGTH), LENGTH, own)
    measured = law_of(bending_test(shapes, pull=pull))
    above = (measured.curvature > 0.5) & (measured.curvature < 10.0)
    true = law_moment(law, measured.curvature, most=0.05)
    error = np.max(np.abs(measured.moment[above] / true[above] - 1.0))
    assert error < off if weighs else error > off


WIRE = WireModel().build_law()


SHAPES_LAW = pulled(WIRE, travel=0.05, frames=101)


@cache
def with_errors(**errors: float) -> MeasuredLaw:
    return law_of(replace(bending_test(SHAPES_LAW), errors=replace(NO_ERRORS, **errors)))


def test_errors_of_the_force_widen_the_interval() -> None:
    def half_width(**errors: float) -> float:
        """Of the moment at the largest curvature, as a share."""
        law = with_errors(**errors)
        return float((law.moment_upper[-10] / law.moment[-10] - 1.0) / 1.96)

    assert half_width(force_scale=0.01) == pytest.approx(0.01, rel=0.01)
    assert half_width(force_zero=0.01) == pytest.approx(0.01, rel=0.5)
    assert half_width() < half_width(alternative_tension=0.0265) < 0.05


@pytest.mark.parametrize("end", ["clamp", pytest.param("tip", marks=pytest.mark.slow)])
def test_a_wrong_place_of_an_end_is_within_its_interval(end: str) -> None:
    """Ends that are a millimetre elsewhere change the law by what is stated for it."""
    test, more = bending_test(SHAPES_LAW), 1e-3
    shape = test.shape
    along, positions = shape.arc_length.copy(), shape.positions
    if end == "tip":
        along[-1] += more
    else:
        along[1:] += more
        positions = positions + np.array([more, 0.0, 0.0])
    moved = replace(shape, length=shape.length + more, arc_length=along, positions=positions)
    law, stated = law_of(replace(test, shape=moved)), with_errors(end_position=more)
    true = law_moment(WIRE, law.curvature)
    off = np.abs(law.moment - true)[15:]
    assert (off < 1.05 * (stated.moment_upper - stated.moment)[15:]).all()
    assert off.max() > 0.005 * true.max()


def test_a_centre_offset_changes_the_law_by_what_is_stated_for_it() -> None:
    """The law found anew with markers a little farther off, against the interval's own part."""
    more, test = 1e-4, bending_test(SHAPES_LAW)
    farther = replace(test.shape, positions=test.shape.positions + np.array([0.0, more, 0.0]))
    moved = law_of(replace(test, shape=farther, centre_offset=test.centre_offset + more))
    bare, wide = with_errors(), with_errors(centre_offset=more)
    at = np.array([2.0, 5.0, 10.0, 15.0])
    half, none = (
        np.interp(at, law.curvature, law.moment_upper - law.moment) / 1.96 for law in (wide, bare)
    )
    moment, moved_moment = (np.interp(at, law.curvature, law.moment) for law in (bare, moved))
    assert np.abs(moved_moment - moment) == pytest.approx(np.sqrt(half**2 - none**2), rel=0.1)
    assert (np.abs(moved_moment - moment) > 5e-4 * moment).all()


def test_few_frames_or_a_force_the_other_way_have_a_cloud_and_no_law() -> None:
    few, whole = bending_test(SHAPES_LAW[:12]), bending_test(SHAPES_LAW)
    for test, reason in (
        (few, "no_law: frames of the first loading=12: expected at least 24"),
        (replace(whole, force=-whole.force), "expected more towards the pull than at rest"),
    ):
        bending = measure_bending(test)
        assert bending.law is None
        assert reason in str(bending.reason)
        assert len(bending.cloud.curvature) >= 12
