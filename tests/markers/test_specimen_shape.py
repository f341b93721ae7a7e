"""Shapes against exact solutions of the bent wire, and the deflection they give."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from labpipe.markers.specimen_shape import EXACT, Offsets, ShapeFit, deflection, fit_shape
from labpipe.records.arrays import Floats
from labpipe.records.curve import PointFlag
from tests.judges.bent_wires import (
    CENTRE_OFFSET,
    LAWS,
    LENGTH,
    MARKERS,
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
    uncertainties: Offsets = EXACT,
) -> ShapeFit:
    frames, count = markers.shape[:2]
    seen = np.isfinite(markers).all(axis=2)
    return fit_shape(
        markers,
        np.where(seen, PointFlag.MEASURED, PointFlag.MISSING).astype(np.uint8),
        [f"M{number}" for number in range(count)],
        np.arange(frames) / 50,
        clamp_specimen=np.zeros((frames, 3)) if clamp is None else clamp,
        rotation_lab_to_specimen=np.eye(3),
        offsets=offsets or Offsets(0.006, 0.004, centre_offset),
        uncertainties=uncertainties,
        terms=terms,
        tip=tip,
        rest=REST,
    )


def tip_error(fitted: ShapeFit, wire: BentWire) -> Floats:
    tip = np.array([wire.x[-1], wire.y[-1], 0.0])
    return np.asarray(fitted.shape.positions[20:, -1] - tip, dtype=np.float64)


@pytest.mark.parametrize(
    ("law", "degrees", "terms", "limit"),
    [
        ("elastic", 20, 6, 2e-6),
        ("elastic", 58, 7, 7e-6),
        ("elastic", 58, 8, 1.5e-6),
        ("hardening", 58, 7, 12e-6),
        ("hardening", 58, 8, 5e-6),
        ("kinked", 58, 7, 100e-6),
        ("kinked", 58, 8, 60e-6),
    ],
)
def test_tip_of_a_bent_wire(law: str, degrees: int, terms: int, limit: float) -> None:
    wire = bent(law, degrees)
    fitted = fit(take(wire), terms=terms)
    error = np.abs(tip_error(fitted, wire)[0])
    assert error[1] < limit
    assert error[0] < 2 * limit
    assert np.abs(deflection(fitted.shape, rest=REST)[20] - wire.y[-1]) < limit


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
    found = fit(markers, uncertainties=Offsets(2e-4, 1e-4, 5e-5)).tip_moved
    longer = {
        "grip offset": replace(usual, grip=0.0062),
        "pull offset": replace(usual, pull=0.0041),
        "centre offset": replace(usual, centre=CENTRE_OFFSET + 5e-5),
    }
    assert found.keys() == longer.keys()
    for cause, offsets in longer.items():
        fitted = fit(markers, offsets=offsets).shape.positions
        np.testing.assert_allclose(found[cause], fitted[:, -1, 1] - fitted[:, 0, 1], atol=1e-8)
        assert list(np.flatnonzero(np.isnan(found[cause]))) == [22, 23]


def test_tips_move_as_the_slope_there_has_it() -> None:
    """By the sine of 58 degrees along the wire, and 1 - cosine across."""
    markers, angle = take(bent("elastic", 58)), np.radians(58)
    usual = deflection(fit(markers).shape, rest=REST)[20]
    moved = fit(markers, uncertainties=Offsets(pull=1e-4, centre=1e-4)).tip_moved
    change = {cause: tip[20] - tip[0] - usual for cause, tip in moved.items()}
    assert list(change) == ["pull offset", "centre offset"]
    assert change["pull offset"] == pytest.approx(1e-4 * np.sin(angle), rel=0.01)
    assert change["centre offset"] == pytest.approx(1e-4 * (1 - np.cos(angle)), rel=0.1)


@pytest.mark.parametrize("law", ["hardening", "kinked"])
def test_tip_of_a_wire_that_stays_bent(law: str) -> None:
    wire = bent(law, 58, unloaded=True)
    assert wire.y[-1] > 0.02
    assert np.abs(tip_error(fit(take(wire)), wire)).max() < (60e-6 if law == "kinked" else 5e-6)


@pytest.mark.parametrize("law", list(LAWS))
def test_one_more_term_shows_the_systematic_error(law: str) -> None:
    wire = bent(law, 58)
    fitted = fit(take(wire))
    error = tip_error(fitted, wire)[0, :2]
    assert np.abs(error + fitted.tip_systematic[20, :2]).max() < np.abs(error).max()
    assert np.abs(error[1]) < 2 * np.abs(fitted.tip_systematic[20, 1])


def test_standard_error_of_the_tip_is_what_noise_does() -> None:
    wire = bent("elastic", 58)
    fitted = fit(take(wire, frames=3000, noise=3e-5))
    scatter = np.std(tip_error(fitted, wire), axis=0)
    assert fitted.marker_noise == pytest.approx(3e-5, rel=0.15)
    np.testing.assert_allclose(scatter, 3e-5 * fitted.tip_gain[20], rtol=0.06)
    assert scatter[1] < 5e-5


def test_points_flags_and_names() -> None:
    fitted = fit(take(bent("elastic", 20)))
    shape = fitted.shape
    assert shape.names == ("clamped end", *(f"M{n}" for n in range(8)), "pull point")
    assert shape.flags[0].tolist() == [PointFlag.CONSTRUCTED, *8 * [1], PointFlag.CONSTRUCTED]
    np.testing.assert_array_equal(shape.positions[:, 0], 0.0)
    np.testing.assert_allclose(shape.arc_length, [0, *MARKERS, LENGTH], atol=1e-9)
    np.testing.assert_allclose(shape.positions[0, -1], [LENGTH, 0, 0], atol=1e-9)
    assert shape.length == pytest.approx(LENGTH)
    assert shape.coefficients.shape == (25, 3, 7)
    np.testing.assert_allclose(shape.coefficients.sum(axis=2), shape.positions[:, -1])
    assert fitted.notes == ()


def test_measured_positions_are_kept() -> None:
    markers = take(bent("elastic", 20), noise=3e-5)
    shape = fit(markers).shape
    moved = shape.positions[:, 1:-1] - markers
    np.testing.assert_allclose(moved, np.broadcast_to(moved[0, 0], moved.shape), atol=1e-12)


def test_the_ends_obey_their_conditions() -> None:
    shape = fit(take(bent("elastic", 58))).shape
    power = np.arange(7)
    bend = shape.coefficients @ (power * (power - 1.0))
    np.testing.assert_allclose(bend, 0.0, atol=1e-10)
    np.testing.assert_allclose(shape.coefficients[:, :, 0], 0.0, atol=1e-12)
    slope = shape.coefficients[:, :, 1]
    np.testing.assert_allclose(slope, np.broadcast_to(slope[0], slope.shape), atol=1e-12)


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


def test_motion_of_the_clamp_drops_out() -> None:
    markers = take(bent("elastic", 58))
    clamp = np.linspace(0, 1, len(markers))[:, None] * [0.0, -0.05, 0.001]
    np.testing.assert_allclose(
        fit(markers + clamp[:, None], clamp=clamp).shape.positions,
        fit(markers).shape.positions,
        atol=1e-12,
    )


def test_a_missing_marker_costs_precision_not_truth() -> None:
    wire = bent("elastic", 58)
    markers = take(wire)
    markers[21, 3] = np.nan
    markers[22, [1, 7]] = np.nan
    fitted = fit(markers)
    assert np.abs(tip_error(fitted, wire)).max() < 6e-5
    assert fitted.tip_gain[22, 1] > fitted.tip_gain[21, 1] > fitted.tip_gain[20, 1]
    assert fitted.shape.flags[21, 4] == PointFlag.MISSING


def test_too_few_markers_in_a_frame_leave_it_blank_and_told() -> None:
    markers = take(bent("elastic", 20))
    markers[21:23, 3:] = np.nan
    fitted = fit(markers)
    assert np.isnan(fitted.shape.positions[21:23, -1]).all()
    assert (fitted.shape.flags[21:23, -1] == PointFlag.MISSING).all()
    assert np.isfinite(fitted.shape.positions[[20, 23], -1]).all()
    assert np.isnan(fitted.residual[21])
    assert [note.message for note in fitted.notes] == [
        "no shape in 2 of 25 frames, from 0.420 s to 0.440 s: fewer than 4 markers in sight"
    ]


def test_a_blank_clamp_leaves_the_frame_blank() -> None:
    markers = take(bent("elastic", 20))
    clamp = np.zeros((25, 3))
    clamp[22] = np.nan
    shape = fit(markers, clamp=clamp).shape
    assert np.isnan(shape.positions[22]).all()
    assert (shape.flags[22] == PointFlag.MISSING).all()


def test_a_marker_not_seen_at_rest_is_left_out() -> None:
    markers = take(bent("elastic", 58))
    markers[REST, 2] = np.nan
    fitted = fit(markers)
    assert "M2" not in fitted.shape.names
    assert fitted.notes[0].message == (
        "M2 is not seen before the first loading and was left out of the shape"
    )
    assert np.abs(tip_error(fitted, bent("elastic", 58))).max() < 3e-5


def test_without_a_clamp_the_first_marker_is_the_beginning() -> None:
    markers = take(bent("elastic", 20))[:, ::2]
    fitted = fit_shape(
        markers,
        np.ones(markers.shape[:2], dtype=np.uint8),
        list("abcd"),
        np.arange(25) / 50,
        clamp_specimen=None,
        rotation_lab_to_specimen=np.eye(3),
        offsets=Offsets(),
        terms=4,
        tip="loaded",
        rest=REST,
    )
    shape = fitted.shape
    assert shape.names == ("a", "b", "c", "d")
    np.testing.assert_array_equal(shape.positions, markers)
    np.testing.assert_allclose(shape.arc_length, MARKERS[::2] - MARKERS[0], atol=1e-9)
    np.testing.assert_allclose(shape.coefficients.sum(axis=2), markers[:, -1], atol=1e-12)
    assert np.isnan(fitted.marker_noise)
    assert np.isnan(fitted.tip_systematic).all()


def test_deflection_is_zero_at_rest_on_average() -> None:
    shape = fit(take(bent("elastic", 20), noise=1e-4)).shape
    assert np.mean(deflection(shape, rest=REST)[REST]) == pytest.approx(0.0, abs=1e-12)


def test_too_few_markers_are_refused() -> None:
    markers = take(bent("elastic", 20))
    with pytest.raises(ValueError, match=r"terms=12: expected at most 11 for 8 markers"):
        fit(markers, terms=12)
    markers[REST, :6] = np.nan
    with pytest.raises(ValueError, match=r"markers at rest=2: expected at least 3 markers seen"):
        fit(markers)


def test_shapes_that_do_not_fit_together_are_refused() -> None:
    with pytest.raises(ValueError, match=r"markers_specimen of shape \(5, 4, 3\), flags of shape"):
        fit_shape(
            np.zeros((5, 4, 3)),
            np.ones((5, 3), dtype=np.uint8),
            list("abcd"),
            np.arange(5.0),
            clamp_specimen=None,
            rotation_lab_to_specimen=np.eye(3),
            offsets=Offsets(),
            terms=4,
            tip="loaded",
            rest=slice(0, 2),
        )


def test_a_rest_without_a_shape_is_refused() -> None:
    markers = take(bent("elastic", 20))
    shape = fit(markers).shape
    with pytest.raises(ValueError, match="rest: expected a frame with first and last point"):
        deflection(shape, rest=slice(0, 0))
