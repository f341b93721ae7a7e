"""Calibrate the isotropic share of the hardening of a wire by the cycles of cantilever tests.

First loading does not depend on the isotropic share. The share is determined from the first
unloading and the second loading of each test, with three measures: the residual deflection at zero
force, the energy dissipated in the first cycle, and the ratio of the largest force of the second
cycle to that of the first. The measures are computed for a few shares with the calibrated law, and
fitted to the tests by least squares. Their covariance contains the errors of the tests, the scatter
of the samples and the uncertainty of the calibrated parameters.

Creep of the insulation increases residual deflection and energy and decreases the second peak. If
the shares from the residual deflection and from the peaks differ, the result is marked as affected
by creep.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from labpipe.mechanics.law.plays import PlayLaw
from labpipe.mechanics.wire.cantilever import (
    StringRig,
    WireState,
    bend_to_travel,
    compute_shape,
    deflect,
    make_straight,
)
from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval
from labpipe.records.wire import IsotropicShare

RESIDUAL, ENERGY, RATIO = "residual", "energy", "ratio"
CYCLE_MEASURES = (RESIDUAL, ENERGY, RATIO)
"""Residual deflection, m; energy dissipated in the first cycle, J; second peak by first peak."""
COMPUTED_SHARES = (0.0, 0.35, 0.7, 1.0)
"""Isotropic shares for which measures are computed; a cubic interpolates between them."""
MAX_SHARE_DIFFERENCE = 2.5
"""Largest difference of the shares from residual deflection and from peaks, in standard errors.

If the difference is larger, the result is marked as affected by creep.
"""
LawMaker = Callable[[Mapping[str, float], float], PlayLaw]
"""Function that returns the law of a wire for changed parameters and an isotropic share.

The first argument has changes of the logarithms of parameters, keyed by parameter name.
"""


@dataclass(frozen=True, slots=True)
class CycledTest:
    """Measures of the first two cycles of a test.

    Parameters
    ----------
    test : name of the test
    length : m, free length of the wire
    peak : m, largest deflection of the tip from rest
    measures : value and standard error of each measure, keyed by the names of `CYCLE_MEASURES`; a
        measure without a value has no key
    rig : string and counterweight; None for a load normal to the undeformed axis
    self_weight : N/m, weight per length of the wire
    """

    test: str
    length: float
    peak: float
    measures: Mapping[str, tuple[float, float]]
    rig: StringRig | None = None
    self_weight: float = 0.0

    @property
    def setup(self) -> tuple[object, ...]:
        """Inputs of the computed measures, with the logarithm of the peak rounded to 0.01."""
        return self.length, round(100.0 * math.log(self.peak)), self.rig, self.self_weight


def compute_cycles(
    law: PlayLaw,
    length: float,
    peak: float,
    *,
    rig: StringRig | None = None,
    self_weight: float = 0.0,
) -> dict[str, float]:
    """Compute the measures of two cycles to a deflection and back.

    Parameters
    ----------
    law : law of the wire
    length, peak, rig, self_weight : length, peak deflection, rig and weight of the wire, as in
        `CycledTest`

    Returns
    -------
    Measures, keyed by the names of `CYCLE_MEASURES`.

    Raises
    ------
    ValueError
        If no equilibrium is found on the path.

    Notes
    -----
    With a string, the clamp moves by the same travel in each cycle and returns to its initial
    position, where the counterweight bends the wire back. Without a string, a cycle ends at the
    force at rest, which a load cell reads as zero.
    """
    n_stations, n_steps = 40, 9
    state = make_straight(law, n_stations, self_weight=self_weight)
    if self_weight > 0.0 or rig is not None:
        state = deflect(law, state, length, 0.0, rig)
    rest_load = state.load
    deflections = peak * np.linspace(0.0, 1.0, n_steps + 1)[1:] ** 2
    loading = [(0.0, 0.0)]
    for deflection in deflections.tolist():
        state = deflect(law, state, length, deflection, rig)
        loading.append((deflection, state.load - rest_load))
    first_peak = loading[-1][1]
    if rig is None:
        unloading, state = _unload_to_zero(law, state, length, rest_load)
        residual = unloading[-1][0]
        for deflection in np.linspace(residual, peak, n_steps + 1)[1:].tolist():
            state = deflect(law, state, length, deflection)
    else:
        unloading, state, peak_travel = _return_clamp(law, state, length, rig, rest_load)
        deflections, forces = np.array(unloading).T
        residual = float(np.interp(0.0, forces[::-1], deflections[::-1]))
        for travel in (peak_travel * np.linspace(0.0, 1.0, n_steps + 1)[1:]).tolist():
            state = bend_to_travel(law, state, length, rig, travel).state
    energy = _compute_work(loading) - _compute_work(unloading[::-1])
    return {RESIDUAL: residual, ENERGY: energy, RATIO: (state.load - rest_load) / first_peak}


def _compute_work(path: Sequence[tuple[float, float]]) -> float:
    """Integrate force over deflection, J; a point without an increase in deflection is left out."""
    deflections, forces = np.array(path).T
    is_rising = np.diff(deflections, prepend=-np.inf) > 1e-9  # m
    curve = PchipInterpolator(deflections[is_rising], forces[is_rising])
    return float(curve.integrate(curve.x[0], curve.x[-1]))


def _unload_to_zero(
    law: PlayLaw, state: WireState, length: float, rest_load: float
) -> tuple[list[tuple[float, float]], WireState]:
    """Unload to the force at rest.

    Returns
    -------
    Deflection, m, and force above that at rest, N, of each point of the path; the last state.
    """
    tolerance = 1e-5  # relative to the largest force
    n_steps = 8
    start_deflection, largest_force = state.travel, state.load - rest_load
    path, step = [(start_deflection, largest_force)], -start_deflection / n_steps
    while abs(path[-1][1]) > tolerance * largest_force and len(path) < 4 * n_steps:
        next_state = deflect(law, state, length, path[-1][0] + step)
        force = next_state.load - rest_load
        if force >= -tolerance * largest_force:
            state = next_state
            path.append((next_state.travel, force))
            slope = (path[-2][1] - path[-1][1]) / (path[-2][0] - path[-1][0])
            step = max(-start_deflection / n_steps, -path[-1][1] / slope)
        else:  # the step was too long; the next ends at the zero of the line through both points
            step *= path[-1][1] / (path[-1][1] - force)
    return path, state


def _return_clamp(
    law: PlayLaw, state: WireState, length: float, rig: StringRig, rest_load: float
) -> tuple[list[tuple[float, float]], WireState, float]:
    """Move the clamp back to zero travel.

    Returns
    -------
    Deflection, m, and force above that at rest, N, of each point of the path; the last state; and
    the first travel, m.
    """
    n_steps = 12
    shape = compute_shape(state, length)
    first_travel = rig.compute_taut_travel(float(shape.x[-1]), float(shape.y[-1]))
    path, state = [(state.travel, state.load - rest_load)], replace(state, travel=first_travel)
    for travel in (first_travel * np.linspace(1.0, 0.0, n_steps + 1)[1:]).tolist():
        shape = bend_to_travel(law, state, length, rig, travel)
        state = shape.state
        path.append((float(shape.y[-1]), state.load - rest_load))
    return path, state, first_travel


def calibrate_share(
    tests: Sequence[CycledTest],
    make_law: LawMaker,
    names: Sequence[str],
    parameter_covariance: Floats,
    scatter: float = 0.0,
) -> IsotropicShare | None:
    """Calibrate the isotropic share by the cycles of tests.

    Parameters
    ----------
    tests : tests of the calibrated wire
    make_law : function that returns the calibrated law for changed parameters and a share
    names : names of the calibrated parameters
    parameter_covariance : shape (names, names), covariance of the logarithms of the parameters
    scatter : relative scatter of residual deflection and energy between samples

    Returns
    -------
    The isotropic share, from 0 to 1; None if the tests have no measures, or if no equilibrium is
    found.
    """
    tests = [test for test in tests if test.measures]
    setups = {test.setup: test for test in tests}
    if not tests:
        return None
    try:
        computed = {key: _compute_measures(test, make_law, names) for key, test in setups.items()}
    except ValueError:
        return None
    rows = [(test, name) for test in tests for name in CYCLE_MEASURES if name in test.measures]
    measured, errors = np.array([test.measures[name] for test, name in rows]).T
    by_share, by_parameter = (
        np.stack([computed[test.setup][i][:, CYCLE_MEASURES.index(name)] for test, name in rows])
        for i in range(2)
    )
    row_names = np.array([name for _, name in rows])
    sample_errors = np.where(row_names == RATIO, 0.0, measured * scatter)
    covariance = np.diag(errors**2 + sample_errors**2)
    covariance += by_parameter @ parameter_covariance @ by_parameter.T
    grid = np.linspace(0.0, 1.0, 401)
    cubics = [np.polyfit(COMPUTED_SHARES, values, 3) for values in by_share]
    residuals = measured[:, None] - np.stack([np.polyval(cubic, grid) for cubic in cubics])
    share, share_error = _estimate_share(grid, residuals, covariance)
    fits = {}
    for name in (RESIDUAL, RATIO):
        rows_of_name = np.flatnonzero(row_names == name)
        if len(rows_of_name):
            name_covariance = covariance[np.ix_(rows_of_name, rows_of_name)]
            fits[name] = _estimate_share(grid, residuals[rows_of_name], name_covariance)
    is_creep = False
    if len(fits) == 2:
        shares, fit_errors = np.array(list(fits.values())).T
        is_creep = abs(shares[1] - shares[0]) > MAX_SHARE_DIFFERENCE * np.hypot(*fit_errors)
    interval = Interval.make_normal(share, share_error)
    return IsotropicShare(
        value=share,
        interval=Interval(max(interval.lower, 0.0), min(interval.upper, 1.0)),
        intervals={name: Interval.make_normal(*fit) for name, fit in fits.items()},
        n_tests=len(tests),
        is_creep=bool(is_creep),
    )


def _compute_measures(
    test: CycledTest, make_law: LawMaker, names: Sequence[str]
) -> tuple[Floats, Floats]:
    """Compute the measures of a test for each share, and their derivatives.

    The derivatives are those with respect to log parameters, for one intermediate share. The shapes
    are (shares, measures) and (parameters, measures).
    """
    log_step, derivative_share = 0.1, 0.5

    def compute(share: float, changes: Mapping[str, float]) -> list[float]:
        law, weight = make_law(changes, share), test.self_weight
        cycles = compute_cycles(law, test.length, test.peak, rig=test.rig, self_weight=weight)
        return [cycles[name] for name in CYCLE_MEASURES]

    by_share = np.array([compute(share, {}) for share in COMPUTED_SHARES])
    reference = compute(derivative_share, {})
    changed = np.array([compute(derivative_share, {name: log_step}) for name in names])
    return by_share, (changed.reshape(-1, len(CYCLE_MEASURES)) - reference) / log_step


def _estimate_share(grid: Floats, residuals: Floats, covariance: Floats) -> tuple[float, float]:
    """Estimate the share by least squares, and its standard error.

    The error is computed from the second derivative of the sum of squares with respect to the
    share. It is larger if the residuals scatter more than their covariance.
    """
    half_width = 20  # number of grid points on each side to which a parabola is fitted
    squares = np.einsum("ng,nm,mg->g", residuals, np.linalg.inv(covariance), residuals)
    best_row = int(np.argmin(squares))
    centre = min(max(best_row, half_width), len(grid) - half_width - 1)
    window = slice(centre - half_width, centre + half_width + 1)
    square_term = np.polyfit(grid[window] - grid[centre], squares[window], 2)[0]
    error = 1.0 / np.sqrt(max(square_term, 1e-12))
    freedom = len(residuals) - 1
    if freedom > 0:
        error *= np.sqrt(max(1.0, squares[best_row] / freedom))
    return float(grid[best_row]), float(error)
