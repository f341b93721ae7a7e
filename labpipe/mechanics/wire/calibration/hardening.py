"""Calibrate the isotropic share of the hardening of a wire by the cycles of cantilever tests.

First loading does not depend on the isotropic share m. The share is determined from the first
unloading and the second loading of each test. Three numbers are used: the residual deflection at
zero force, the energy dissipated in the first cycle, and the ratio of the largest force of the
second cycle to that of the first. They are computed for a few shares with the calibrated law, and
compared with the tests by least squares. One covariance contains the errors of the tests, the
scatter of the samples and the uncertainty of the calibrated parameters.

Creep of the insulation increases residual deflection and energy and decreases the second peak. If
the shares from the residual deflection and from the peaks differ, the result is marked as creep.
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
HARDENING_NUMBERS = (RESIDUAL, ENERGY, RATIO)
"""Residual deflection, m; energy dissipated in the first cycle, J; second peak over first peak."""
SHARES = (0.0, 0.35, 0.7, 1.0)
"""Isotropic shares for which a test is computed; a cubic interpolates between them."""
MAX_DISAGREEMENT = 2.5
"""Largest difference of the shares from residual deflection and from peaks, in standard errors.

If the difference is larger, the result is marked as creep.
"""
LawMaker = Callable[[Mapping[str, float], float], PlayLaw]
"""Function of changes of the logarithms of parameters, keyed by parameter name, and of a share.

It returns the law of the wire for these parameters and this isotropic share.
"""


@dataclass(frozen=True, slots=True)
class CycledTest:
    """Measured numbers of the first two cycles of a test.

    Parameters
    ----------
    test : name of the test
    length : free length of the wire, m
    peak : largest deflection of the tip from rest, m
    numbers : value and standard error of each number, keyed by the names of `HARDENING_NUMBERS`; a
        number that was not measured has no key
    rig : string and counterweight; None for a load normal to the undeformed axis
    self_weight : N/m, weight per length of the wire
    """

    test: str
    length: float
    peak: float
    numbers: Mapping[str, tuple[float, float]]
    rig: StringRig | None = None
    self_weight: float = 0.0

    @property
    def setup(self) -> tuple[object, ...]:
        """Inputs of the computed numbers, with the peak rounded to 1 %."""
        return self.length, round(100.0 * math.log(self.peak)), self.rig, self.self_weight


def compute_cycles(
    law: PlayLaw,
    length: float,
    peak: float,
    *,
    rig: StringRig | None = None,
    self_weight: float = 0.0,
) -> dict[str, float]:
    """Compute the numbers of `HARDENING_NUMBERS` for two cycles to a deflection and back.

    Parameters
    ----------
    law : law of the wire
    length, peak, rig, self_weight : length, peak deflection, rig and weight of the wire, as in
        `CycledTest`

    Returns
    -------
    Values keyed by the names of `HARDENING_NUMBERS`.

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
        unloading, state, end = _return_clamp(law, state, length, rig, rest_load)
        deflections, forces = np.array(unloading).T
        residual = float(np.interp(0.0, forces[::-1], deflections[::-1]))
        for travel in (end * np.linspace(0.0, 1.0, n_steps + 1)[1:]).tolist():
            state = bend_to_travel(law, state, length, rig, travel).state
    energy = _compute_work(loading) - _compute_work(unloading[::-1])
    return {RESIDUAL: residual, ENERGY: energy, RATIO: (state.load - rest_load) / first_peak}


def _compute_work(path: Sequence[tuple[float, float]]) -> float:
    """Integrate the force over deflection, J; points without increase in deflection are dropped."""
    deflections, forces = np.array(path).T
    is_rising = np.diff(deflections, prepend=-np.inf) > 1e-9  # m
    curve = PchipInterpolator(deflections[is_rising], forces[is_rising])
    return float(curve.integrate(curve.x[0], curve.x[-1]))


def _unload_to_zero(
    law: PlayLaw, state: WireState, length: float, rest_load: float
) -> tuple[list[tuple[float, float]], WireState]:
    """Unload to the force at rest.

    Return deflections, m, and forces above the force at rest, N, of the path, and the last state.
    """
    tolerance = 1e-5  # relative to the largest force
    n_steps = 8
    start, largest_force = state.travel, state.load - rest_load
    path, step = [(start, largest_force)], -start / n_steps
    while abs(path[-1][1]) > tolerance * largest_force and len(path) < 4 * n_steps:
        next_state = deflect(law, state, length, path[-1][0] + step)
        force = next_state.load - rest_load
        if force >= -tolerance * largest_force:
            state = next_state
            path.append((next_state.travel, force))
            slope = (path[-2][1] - path[-1][1]) / (path[-2][0] - path[-1][0])
            step = max(-start / n_steps, -path[-1][1] / slope)
        else:  # after too long a step, the next ends at the zero of the line through both points
            step *= path[-1][1] / (path[-1][1] - force)
    return path, state


def _return_clamp(
    law: PlayLaw, state: WireState, length: float, rig: StringRig, rest_load: float
) -> tuple[list[tuple[float, float]], WireState, float]:
    """Move the clamp back to zero travel.

    Return deflections, m, and forces above the force at rest, N, of the path, the last state, and
    the first travel, m.
    """
    n_steps = 12
    shape = compute_shape(state, length)
    start = rig.compute_taut_travel(float(shape.x[-1]), float(shape.y[-1]))
    path, state = [(state.travel, state.load - rest_load)], replace(state, travel=start)
    for travel in (start * np.linspace(1.0, 0.0, n_steps + 1)[1:]).tolist():
        shape = bend_to_travel(law, state, length, rig, travel)
        state = shape.state
        path.append((float(shape.y[-1]), state.load - rest_load))
    return path, state, start


def calibrate_share(
    tests: Sequence[CycledTest],
    make_law: LawMaker,
    names: Sequence[str],
    covariance: Floats,
    scatter: float = 0.0,
) -> IsotropicShare | None:
    """Calibrate the isotropic share by the cycles of tests.

    Parameters
    ----------
    tests : tests of the calibrated wire
    make_law : function that returns the calibrated law for changed parameters and a share
    names : names of the calibrated parameters
    covariance : shape (names, names), covariance of the logarithms of the parameters
    scatter : relative scatter of residual deflection and energy between samples

    Returns
    -------
    The isotropic share, from 0 to 1; None if the tests have no numbers, or if no equilibrium is
    found.
    """
    tests = [test for test in tests if test.numbers]
    setups = {test.setup: test for test in tests}
    if not tests:
        return None
    try:
        computed = {setup: _compute_test(test, make_law, names) for setup, test in setups.items()}
    except ValueError:
        return None
    rows = [(test, name) for test in tests for name in HARDENING_NUMBERS if name in test.numbers]
    measured, errors = np.array([test.numbers[name] for test, name in rows]).T
    columns = np.array([HARDENING_NUMBERS.index(name) for _, name in rows])
    row_columns = list(zip(rows, columns, strict=True))
    by_share = np.stack([computed[test.setup][0][:, column] for (test, _), column in row_columns])
    by_parameter = np.stack(
        [computed[test.setup][1][:, column] for (test, _), column in row_columns]
    )
    sample_error = np.where(columns == HARDENING_NUMBERS.index(RATIO), 0.0, measured * scatter)
    noise = np.diag(errors**2 + sample_error**2) + by_parameter @ covariance @ by_parameter.T
    grid = np.linspace(0.0, 1.0, 401)
    fitted = np.stack([np.polyval(np.polyfit(SHARES, curve, 3), grid) for curve in by_share])
    residuals = measured[:, None] - fitted
    value, error = _estimate_share(grid, residuals, noise)
    fits = {}
    for name in (RESIDUAL, RATIO):
        is_name = columns == HARDENING_NUMBERS.index(name)
        if is_name.any():
            fits[name] = _estimate_share(grid, residuals[is_name], noise[np.ix_(is_name, is_name)])
    is_creep = False
    if len(fits) == 2:
        shares, share_errors = np.array(list(fits.values())).T
        is_creep = abs(shares[1] - shares[0]) > MAX_DISAGREEMENT * np.hypot(*share_errors)
    interval = Interval.make_normal(value, error)
    return IsotropicShare(
        value=value,
        interval=Interval(max(interval.lower, 0.0), min(interval.upper, 1.0)),
        intervals={name: Interval.make_normal(*fit) for name, fit in fits.items()},
        n_tests=len(tests),
        is_creep=bool(is_creep),
    )


def _compute_test(
    test: CycledTest, make_law: LawMaker, names: Sequence[str]
) -> tuple[Floats, Floats]:
    """Compute the numbers of a test for each share, and derivatives with respect to log parameters.

    The shapes are (shares, numbers) and (parameters, numbers). The derivatives are computed for one
    intermediate share.
    """
    log_step, derivative_share = 0.1, 0.5

    def compute(share: float, changes: Mapping[str, float]) -> list[float]:
        law, weight = make_law(changes, share), test.self_weight
        cycles = compute_cycles(law, test.length, test.peak, rig=test.rig, self_weight=weight)
        return [cycles[name] for name in HARDENING_NUMBERS]

    by_share = np.array([compute(share, {}) for share in SHARES])
    reference = compute(derivative_share, {})
    changed = np.array([compute(derivative_share, {name: log_step}) for name in names])
    return by_share, (changed.reshape(-1, len(HARDENING_NUMBERS)) - reference) / log_step


def _estimate_share(grid: Floats, residuals: Floats, noise: Floats) -> tuple[float, float]:
    """Estimate the share by least squares, and its standard error.

    The error is computed from the second derivative of the sum of squares with respect to the
    share. It is larger if the residuals scatter more than `noise`, the covariance of the residuals.
    """
    half_width = 20  # number of grid points on each side to which a parabola is fitted
    squares = np.einsum("ng,nm,mg->g", residuals, np.linalg.inv(noise), residuals)
    best_row = int(np.argmin(squares))
    centre = min(max(best_row, half_width), len(grid) - half_width - 1)
    window = slice(centre - half_width, centre + half_width + 1)
    square_term = np.polyfit(grid[window] - grid[centre], squares[window], 2)[0]
    error = 1.0 / np.sqrt(max(square_term, 1e-12))
    freedom = len(residuals) - 1
    if freedom > 0:
        error *= np.sqrt(max(1.0, squares[best_row] / freedom))
    return float(grid[best_row]), float(error)
