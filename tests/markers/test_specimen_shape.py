"""Shapes against exact solutions of the bent wire, bases of curves, curves of many frames."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from labpipe.markers import specimen_shape
from labpipe.markers.specimen_shape import (
    NO_UNCERTAINTY,
    EndConditions,
    Offsets,
    ShapeFit,
    build_curve_basis,
    compute_deflection,
    fit_frames,
    fit_rest_curve,
    fit_shape,
)
from labpipe.records.arrays import Floats
from labpipe.records.curve import PointFlag
from tests.judges.reference_wires import (
    CENTRE_OFFSET,
    LAWS,
    BentWire,
    bent_wire,
    straight_wire,
)

REST = slice(0, 20)
PIVOT = np.array([-0.006, -0.0017, 0.0003])  # beside the axis, and 6 mm before the clamped end


@cache
def bent(law: str, degrees: int, unloaded: bool = False) -> BentWire:
    return bent_wire(LAWS[law], np.radians(degrees), unloaded=unloaded)


def take(wire: BentWire, *, frames: int = 5, noise: float = 0.0, seed: int = 0) -> Floats:
    """Markers relative to the pivot: 20 frames at rest, then `frames` of the bent wire."""
    rng = np.random.default_rng(seed)
    shapes: Floats = np.array([straight_wire().markers()] * 20 + [wire.markers()] * frames)
    shaken = shapes - PIVOT + noise * rng.standard_normal(shapes.shape)
    return np.asarray(shaken, dtype=np.float64)


def fit(
    markers: Floats,
    *,
    terms: int = 7,
    tip: Literal["free", "loaded"] = "free",
    clamp: Floats | None = None,
    centre_offset: float = CENTRE_OFFSET,
    offsets: Offsets | None = None,
    uncertainties: Offsets = NO_UNCERTAINTY,
) -> ShapeFit:
    frames, count = markers.shape[:2]
    visible = np.isfinite(markers).all(axis=2)
    return fit_shape(
        markers,
        np.where(visible, PointFlag.MEASURED, PointFlag.MISSING).astype(np.uint8),
        [f"M{number}" for number in range(count)],
        np.arange(frames) / 50,
        clamp_specimen=np.zeros((frames, 3)) if clamp is None else clamp,
        rotation_lab_to_specimen=np.eye(3),
        offsets=offsets or Offsets(0.006, 0.004, centre_offset),
        uncertainties=uncertainties,
        terms=terms,
        tip=tip,
        rest_frames=REST,
    )


def tip_error(fitted: ShapeFit, wire: BentWire) -> Floats:
    tip = np.array([wire.x[-1], wire.y[-1], 0.0])
    return np.asarray(fitted.shape.positions[20:, -1] - tip, dtype=np.float64)


@pytest.mark.parametrize(
    ("law", "degrees", "terms", "limit"),
    [
        ("elastic", 20, 6, 2e-6),
        ("elastic", 58, 8, 1.5e-6),
        ("hardening", 58, 8, 5e-6),
        ("kinked", 58, 8, 60e-6),
    ],
)
def test_tip_of_a_bent_wire(law: str, degrees: int, terms: int, limit: float) -> None:
    wire = bent(law, degrees)
    fitted = fit(take(wire), terms=terms)
    error = np.abs(tip_error(fitted, wire)[0])
    assert error[1] < limit
    assert error[0] < 2 * limit
    assert np.abs(compute_deflection(fitted.shape, rest_frames=REST)[20] - wire.y[-1]) < limit


def with_gaps(wire: BentWire) -> Floats:
    """A take that lacks a marker in one frame, six in another (too many) and all in a third."""
    markers = take(wire, frames=6)
    markers[21, 3] = markers[22, 2:] = markers[23] = np.nan
    return markers


def test_other_offsets_make_other_tips() -> None:
    """The same as a fit of its own with each offset longer, of a wire clamped 3 degrees askew."""
    askew = Rotation.from_euler("z", 3.0, degrees=True).as_matrix()
    markers = with_gaps(bent("hardening", 58)) @ askew.T
    usual = Offsets(0.006, 0.004, CENTRE_OFFSET)
    tips = fit(markers, uncertainties=Offsets(2e-4, 1e-4, 5e-5)).perturbed_tip
    longer = {
        "grip offset": replace(usual, grip=0.0062),
        "pull offset": replace(usual, pull=0.0041),
        "centre offset": replace(usual, centre=CENTRE_OFFSET + 5e-5),
    }
    assert tips.keys() == longer.keys()
    for cause, offsets in longer.items():
        fitted = fit(markers, offsets=offsets).shape.positions
        np.testing.assert_allclose(tips[cause], fitted[:, -1, 1] - fitted[:, 0, 1], atol=1e-8)
        assert list(np.flatnonzero(np.isnan(tips[cause]))) == [22, 23]


@pytest.mark.parametrize("law", list(LAWS))
def test_one_more_term_shows_the_systematic_error(law: str) -> None:
    wire = bent(law, 58)
    fitted = fit(take(wire))
    error = tip_error(fitted, wire)[0, :2]
    assert np.abs(error + fitted.tip_change[20, :2]).max() < np.abs(error).max()
    assert np.abs(error[1]) < 2 * np.abs(fitted.tip_change[20, 1])


def test_standard_error_of_the_tip_is_what_noise_does() -> None:
    wire = bent("elastic", 58)
    fitted = fit(take(wire, frames=3000, noise=3e-5))
    scatter = np.std(tip_error(fitted, wire), axis=0)
    assert fitted.marker_noise == pytest.approx(3e-5, rel=0.15)
    np.testing.assert_allclose(scatter, 3e-5 * fitted.tip_gain[20], rtol=0.06)
    assert scatter[1] < 5e-5


def test_a_loaded_tip_may_bend() -> None:
    arc = straight_wire().arc_length
    angle = 10.0 * arc  # constant curvature up to the end
    circle = BentWire(arc, angle, np.sin(angle) / 10, (1 - np.cos(angle)) / 10)
    free, loaded = (fit(take(circle), tip=tip) for tip in ("free", "loaded"))
    assert np.abs(tip_error(loaded, circle)).max() < 2e-6
    assert np.abs(tip_error(free, circle)).max() > 2e-5


@given(angle=st.floats(-0.03, 0.03), lift=st.floats(-0.003, 0.003))
def test_a_crooked_grip_is_found_from_the_rest(angle: float, lift: float) -> None:
    turn = Rotation.from_rotvec([0, 0, angle]).as_matrix()
    wire = bent("elastic", 58)
    markers = (take(wire) + PIVOT) @ turn.T + [0.006 * np.cos(angle), lift, 0.0]
    fitted = fit(markers)
    assert fitted.clamp_angle == pytest.approx(angle, abs=1e-6)
    tip = turn @ [wire.x[-1], wire.y[-1], 0.0]
    # 6 um is the error of seven terms on this shape; the pivot's height is a lever that turns with
    # the axis, which moves the clamped end by their product and the tip by a tenth of it at most
    bound = 7e-6 + 0.1 * abs(lift * angle)
    np.testing.assert_allclose(fitted.shape.positions[20, -1, 1], tip[1], atol=bound)


def test_missing_markers_cost_precision_not_truth() -> None:
    """Too few in a frame leave it blank, and are noted."""
    wire = bent("elastic", 58)
    markers = take(wire)
    markers[21, 3] = np.nan
    markers[22, [1, 7]] = np.nan
    markers[23, 3:] = np.nan
    fitted = fit(markers)
    error = np.abs(tip_error(fitted, wire))
    assert np.isnan(error[3]).all()
    assert np.nanmax(error) < 6e-5
    assert fitted.tip_gain[22, 1] > fitted.tip_gain[21, 1] > fitted.tip_gain[20, 1]
    assert fitted.shape.flags[21, 4] == PointFlag.MISSING
    assert fitted.shape.flags[23, -1] == PointFlag.MISSING
    assert np.isfinite(fitted.shape.positions[24, -1]).all()
    assert np.isnan(fitted.residual[23])
    assert [note.message for note in fitted.notes] == [
        "no shape in 1 of 25 frames, from 0.460 s to 0.460 s: fewer than 4 visible markers"
    ]


def test_shapes_that_cannot_be_fitted() -> None:
    markers = take(bent("elastic", 20))
    with pytest.raises(ValueError, match=r"terms=12: expected at most 11 for 8 markers"):
        fit(markers, terms=12)
    with pytest.raises(ValueError, match="rest: expected a frame with first and last point"):
        compute_deflection(fit(markers).shape, rest_frames=slice(0, 0))
    assert build_curve_basis(terms=4, length=0.085, has_clamp=True, free_tip=True)
    with pytest.raises(ValueError, match=r"terms=3: expected at least 4"):
        build_curve_basis(terms=3, length=0.085, has_clamp=True, free_tip=True)
    markers[REST, :6] = np.nan
    with pytest.raises(ValueError, match=r"markers at rest=2: expected at least 3 markers seen"):
        fit(markers)


def sagging(offset: float) -> tuple[Floats, Floats]:
    """Markers on an arc of 0.5 m radius that leaves the clamp at 0.1 rad."""
    s = np.linspace(0.008, 0.081, 8)
    angle = 0.1 - 2 * s
    axis = np.column_stack([np.sin(0.1) - np.sin(angle), np.cos(angle) - np.cos(0.1), 0 * s]) / 2
    normal = np.column_stack([-np.sin(angle), np.cos(angle), 0 * s])
    return s, axis + offset * normal


S = np.linspace(0.01, 0.08, 8)
X = np.array([1.0, 0.0, 0.0])
ENDS = EndConditions(length=0.085, direction=X, free_tip=False)


def parabolas(frames: int) -> Floats:
    """Markers on y = a s^2, z = s^2, x = s, with a from 0 to 1."""
    a = np.linspace(0, 1, frames)[:, None]
    return np.stack([S + 0 * a, a * S**2, S**2 + 0 * a], axis=2)


def test_a_curve_of_the_basis_is_met_exactly() -> None:
    fits = fit_frames(parabolas(5), S, 0.0, ENDS, terms=4)
    expected = np.zeros((5, 3, 4))
    expected[:, 0, 1], expected[:, 2, 2] = 0.085, 0.085**2
    expected[:, 1, 2] = np.linspace(0, 1, 5) * 0.085**2
    np.testing.assert_allclose(fits.coefficients, expected, atol=1e-14)
    np.testing.assert_allclose(fits.residual, 0.0, atol=1e-14)
    assert fits.min_markers == 2
    assert fits.n_spare == 6
    assert fits.freedom.tolist() == 5 * [6]


def test_frames_that_miss_markers_give_what_they_would_alone() -> None:
    rng = np.random.default_rng(1)
    markers = parabolas(40) + 1e-5 * rng.standard_normal((40, 8, 3))
    markers[rng.random((40, 8)) < 0.3] = np.nan
    together = fit_frames(markers, S, 0.001, ENDS, terms=5)
    for frame in range(40):
        alone = fit_frames(markers[frame : frame + 1], S, 0.001, ENDS, terms=5)
        found, expected = together.coefficients[frame], alone.coefficients[0]
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(together.gain[frame], alone.gain[0])


def test_without_a_clamp_arc_length_starts_at_the_first_marker() -> None:
    s, markers = sagging(0.0)
    rest_curve = fit_rest_curve(markers, offsets=Offsets(), has_clamp=False, free_tip=False)
    np.testing.assert_allclose(rest_curve.arc_length, s - s[0], atol=1e-7)


def test_frames_are_grouped_by_many_visible_markers() -> None:
    visible = np.arange(3 * 70).reshape(3, 70) != 135
    groups = specimen_shape._group_by_visible_markers(visible)
    assert sorted(frames.tolist() for _, frames in groups) == [[0, 2], [1]]
