"""Calibrate the isotropic share of a wire's hardening by the cycles of its tests.

First loading does not depend on the share m. The share follows from the first unloading and the
second loading of each test: the residual deflection at zero force, the energy lost in the first
cycle, and the largest force of the second cycle over that of the first. They are computed for a few
shares with the calibrated law, and compared with the tests by least squares; the errors of the
tests, the scatter of the samples and the uncertainty of the calibrated parameters are in one
covariance.

Creep of the insulation raises residual deflection and energy and lowers the second peak. If the
shares by residual deflection and by peaks differ, the result is marked as creep.
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
"""Residual deflection, m; energy lost in the first cycle, J; second over first peak force."""
SHARES = (0.0, 0.35, 0.7, 1.0)
"""Shares for which a test is computed; a cubic interpolates between them."""
MAX_DISAGREEMENT = 2.5
"""Largest difference of the shares by residual deflection and by peaks without creep, in standard
errors."""
LawAt = Callable[[Mapping[str, float], float], PlayLaw]
"""Law for changes of the logarithms of parameters, by name, and an isotropic share."""


@dataclass(frozen=True, slots=True)
class CycledTest:
    """Numbers of the first two cycles of a test.

    Parameters
    ----------
    test : name of the test
    length : free length, m
    peak : largest deflection from rest, m
    numbers : value and standard error, by names of `HARDENING_NUMBERS`; missing numbers are left
        out
    rig : string and counterweight; None for a load normal to the undeformed axis
    self_weight : N/m, of the wire
    """

    test: str
    length: float
    peak: float
    numbers: Mapping[str, tuple[float, float]]
    rig: StringRig | None = None
    self_weight: float = 0.0

    @property
    def setup(self) -> tuple[object, ...]:
        """Return the inputs of the computed numbers, the peak to 1 %."""
        return self.length, round(100.0 * math.log(self.peak)), self.rig, self.self_weight


def compute_cycles(
    law: PlayLaw,
    length: float,
    peak: float,
    *,
    rig: StringRig | None = None,
    self_weight: float = 0.0,
) -> dict[str, float]:
    """Compute the numbers of two cycles to a deflection and back.

    Parameters
    ----------
    law, length, rig, self_weight : properties of the wire and its test, as of `CycledTest`
    peak : m, deflection from rest

    Returns
    -------
    Values by names of `HARDENING_NUMBERS`.

    Raises
    ------
    ValueError
        If no equilibrium is found on the way.

    Notes
    -----
    On a string the clamp moves by the same travel in every cycle, and back to where the test began:
    the counterweight then bends the wire back. Without one, a cycle ends at the force at rest,
    which a load cell reads as zero.
    """
    stations, steps = 40, 9
    state = make_straight(law, stations, self_weight=self_weight)
    if self_weight > 0.0 or rig is not None:
        state = deflect(law, state, length, 0.0, rig)
    at_rest = state.load
    deflections = peak * np.linspace(0.0, 1.0, steps + 1)[1:] ** 2
    loading = [(0.0, 0.0)]
    for deflection in deflections.tolist():
        state = deflect(law, state, length, deflection, rig)
        loading.append((deflection, state.load - at_rest))
    first_peak = loading[-1][1]
    if rig is None:
        unloading, state = _unload_to_zero(law, state, length, at_rest)
        residual = unloading[-1][0]
        for deflection in np.linspace(residual, peak, steps + 1)[1:].tolist():
            state = deflect(law, state, length, deflection)
    else:
        unloading, state, travel = _return_clamp(law, state, length, rig, at_rest)
        deflections, forces = np.array(unloading).T
        residual = float(np.interp(0.0, forces[::-1], deflections[::-1]))
        for share in np.linspace(0.0, 1.0, steps + 1)[1:]:
            state = bend_to_travel(law, state, length, rig, travel * float(share)).state
    energy = _compute_work(loading) - _compute_work(unloading[::-1])
    return {RESIDUAL: residual, ENERGY: energy, RATIO: (state.load - at_rest) / first_peak}


def _compute_work(path: Sequence[tuple[float, float]]) -> float:
    """Integrate the force over rising deflections; leave out points that do not rise."""
    deflections, forces = np.array(path).T
    rises = np.diff(deflections, prepend=-np.inf) > 1e-9
    curve = PchipInterpolator(deflections[rises], forces[rises])
    return float(curve.integrate(curve.x[0], curve.x[-1]))


def _unload_to_zero(
    law: PlayLaw, state: WireState, length: float, at_rest: float
) -> tuple[list[tuple[float, float]], WireState]:
    """Unload to the force at rest; return deflections and forces above it, and the state."""
    tolerance, steps = 1e-5, 8  # of the largest force; steps of the deflection
    top, largest = state.travel, state.load - at_rest
    path, step = [(top, largest)], -top / steps
    while abs(path[-1][1]) > tolerance * largest and len(path) < 4 * steps:
        next_state = deflect(law, state, length, path[-1][0] + step)
        force = next_state.load - at_rest
        if force >= -tolerance * largest:
            state = next_state
            path.append((next_state.travel, force))
            slope = (path[-2][1] - path[-1][1]) / (path[-2][0] - path[-1][0])
            step = max(-top / steps, -path[-1][1] / slope)
        else:  # too far: the zero of the line through both points
            step *= path[-1][1] / (path[-1][1] - force)
    return path, state


def _return_clamp(
    law: PlayLaw, state: WireState, length: float, rig: StringRig, at_rest: float
) -> tuple[list[tuple[float, float]], WireState, float]:
    """Move the clamp back; return deflections and forces on the way, the state, and the travel."""
    steps = 12
    tip = compute_shape(state, length)
    travel = rig.find_taut_travel(float(tip.x[-1]), float(tip.y[-1]))
    path, state = [(state.travel, state.load - at_rest)], replace(state, travel=travel)
    for share in np.linspace(1.0, 0.0, steps + 1)[1:]:
        shape = bend_to_travel(law, state, length, rig, travel * float(share))
        state = shape.state
        path.append((float(shape.y[-1]), state.load - at_rest))
    return path, state, travel


def calibrate_share(
    tests: Sequence[CycledTest],
    law_at: LawAt,
    names: Sequence[str],
    covariance: Floats,
    scatter: float = 0.0,
) -> IsotropicShare | None:
    """Calibrate the isotropic share by the cycles of tests.

    Parameters
    ----------
    tests : tests of the calibrated wire
    law_at : calibrated law
    names : names of the calibrated parameters
    covariance : shape (names, names), of the logarithms of the parameters
    scatter : relative scatter of samples, of residual deflection and energy

    Returns
    -------
    The share, within 0 and 1; None without a number, or if no equilibrium is found on the way.
    """
    tests = [test for test in tests if test.numbers]
    setups = {test.setup: test for test in tests}
    if not tests:
        return None
    try:
        computed = {setup: _compute_test(test, law_at, names) for setup, test in setups.items()}
    except ValueError:
        return None
    rows = [(test, name) for test in tests for name in HARDENING_NUMBERS if name in test.numbers]
    measured, errors = np.array([test.numbers[name] for test, name in rows]).T
    columns = np.array([HARDENING_NUMBERS.index(name) for _, name in rows])
    pairs = [
        [part[:, column] for part in computed[test.setup]]
        for (test, _), column in zip(rows, columns, strict=True)
    ]
    by_share, by_parameter = (np.stack(part) for part in zip(*pairs, strict=True))
    scale = np.where(columns == HARDENING_NUMBERS.index(RATIO), 0.0, measured * scatter)
    noise = np.diag(errors**2 + scale**2) + by_parameter @ covariance @ by_parameter.T
    grid = np.linspace(0.0, 1.0, 401)
    fitted = np.stack([np.polyval(np.polyfit(SHARES, curve, 3), grid) for curve in by_share])
    residuals = measured[:, None] - fitted
    value, error = _estimate_share(grid, residuals, noise)
    fits = {}
    for name in (RESIDUAL, RATIO):
        chosen = columns == HARDENING_NUMBERS.index(name)
        if chosen.any():
            fits[name] = _estimate_share(grid, residuals[chosen], noise[np.ix_(chosen, chosen)])
    is_creep = False
    if len(fits) == 2:
        shares, share_errors = np.array(list(fits.values())).T
        is_creep = abs(shares[1] - shares[0]) > MAX_DISAGREEMENT * np.hypot(*share_errors)
    interval = Interval.normal_95(value, error)
    return IsotropicShare(
        value=value,
        interval=Interval(max(interval.lower, 0.0), min(interval.upper, 1.0)),
        by_number={name: Interval.normal_95(*part) for name, part in fits.items()},
        n_tests=len(tests),
        is_creep=bool(is_creep),
    )


def _compute_test(test: CycledTest, law_at: LawAt, names: Sequence[str]) -> tuple[Floats, Floats]:
    """Compute the numbers for each share, and their derivatives by the logarithms of parameters.

    Shapes (shares, numbers) and (parameters, numbers); the derivatives are at a middle share.
    """
    step, middle = 0.1, 0.5  # of a logarithm

    def compute(share: float, changes: Mapping[str, float]) -> list[float]:
        law, weight = law_at(changes, share), test.self_weight
        cycles = compute_cycles(law, test.length, test.peak, rig=test.rig, self_weight=weight)
        return [cycles[name] for name in HARDENING_NUMBERS]

    by_share = np.array([compute(share, {}) for share in SHARES])
    changed = np.array([compute(middle, {name: step}) for name in names])
    return by_share, (changed.reshape(-1, len(HARDENING_NUMBERS)) - compute(middle, {})) / step


def _estimate_share(grid: Floats, residuals: Floats, noise: Floats) -> tuple[float, float]:
    """Return the share of least squares, and its standard error by the curvature there.

    If the residuals scatter more than `noise`, the error grows with their root mean square.
    """
    squares = np.einsum("ng,nm,mg->g", residuals, np.linalg.inv(noise), residuals)
    best = int(np.argmin(squares))
    inner = min(max(best, 20), len(grid) - 21)
    near_minimum = slice(inner - 20, inner + 21)
    square_term = np.polyfit(grid[near_minimum] - grid[inner], squares[near_minimum], 2)[0]
    error = 1.0 / np.sqrt(max(square_term, 1e-12))
    freedom = len(residuals) - 1
    if freedom > 0:
        error *= np.sqrt(max(1.0, squares[best] / freedom))
    return float(grid[best]), float(error)
