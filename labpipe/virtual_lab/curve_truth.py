"""True numbers of a bundle's curve: kink, plateau, and the stiffness of each cycle.

Curves are free of noise. Numbers are found by search, not by the formulas of the processing: the
kink over all breaks of a fine grid, the plateau by the tangent from the end.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.virtual_lab.cantilever_path import MechanicalPath

KINK_WINDOW = (0.2e-3, 5e-3)
STIFFNESS_RANGE = 5e-3
_KINK_GRID_POINTS = 800


@dataclass(frozen=True, slots=True)
class KinkTruth:
    """The two joined straight lines closest to a curve.

    Parameters
    ----------
    displacement, force : m, N, of their intersection
    stiffness_before, stiffness_after : N/m
    """

    displacement: float
    force: float
    stiffness_before: float
    stiffness_after: float


@dataclass(frozen=True, slots=True)
class LoadingTruth:
    """Numbers of a first loading; lengths in m.

    Parameters
    ----------
    tangent_at_zero : N/m
    stiffness : N/m, slope of the least-squares line over the first 5 mm
    secant_stiffness : N/m, force at 5 mm over 5 mm
    windowed_stiffness : N/m, slope of the least-squares line over `KINK_WINDOW`
    kink : within `KINK_WINDOW`
    end_tangent : N/m, slope of the least-squares line over the last 5 mm
    end_slope : the same as a share of `windowed_stiffness`
    plateau_displacement, plateau_force : m, N, from which the tangent over a millimetre stays below
        a tenth of `windowed_stiffness`; None if `end_slope` is not below it
    """

    tangent_at_zero: float
    stiffness: float
    secant_stiffness: float
    windowed_stiffness: float
    kink: KinkTruth
    end_tangent: float
    end_slope: float
    plateau_displacement: float | None
    plateau_force: float | None

    def scaled(self, factor: float) -> LoadingTruth:
        """Return the numbers with all forces multiplied by `factor`."""
        kink = replace(
            self.kink,
            force=factor * self.kink.force,
            stiffness_before=factor * self.kink.stiffness_before,
            stiffness_after=factor * self.kink.stiffness_after,
        )
        return replace(
            self,
            tangent_at_zero=factor * self.tangent_at_zero,
            stiffness=factor * self.stiffness,
            secant_stiffness=factor * self.secant_stiffness,
            windowed_stiffness=factor * self.windowed_stiffness,
            kink=kink,
            end_tangent=factor * self.end_tangent,
            plateau_force=None if self.plateau_force is None else factor * self.plateau_force,
        )


@dataclass(frozen=True, slots=True)
class TapedTruth:
    """True numbers of a bundle in the cantilever rig.

    Parameters
    ----------
    loading : of the first cycle
    bending_stiffness : N m^2, K L^3 / 3 with the slope K over `KINK_WINDOW`, uncorrected
    loading_stiffness : N/m, of each cycle, slope over 5 mm from where the force exceeds the rest
    hardening : loading stiffnesses relative to the first cycle
    """

    loading: LoadingTruth
    bending_stiffness: float
    loading_stiffness: tuple[float, ...]
    hardening: tuple[float, ...]


def evaluate_taped(path: MechanicalPath) -> TapedTruth:
    """Return the true numbers of a bundle in the cantilever rig.

    Parameters
    ----------
    path : the solved test

    Returns
    -------
    The numbers. Displacement is the deflection of the pull point, force the tension of the string
    less that at rest.
    """
    loading = evaluate_loading(*_loading(path, 1))
    slopes = tuple(_slope_after_slack(*_loading(path, n)) for n in range(1, path.test.cycles + 1))
    return TapedTruth(
        loading=loading,
        bending_stiffness=loading.windowed_stiffness * path.test.length**3 / 3.0,
        loading_stiffness=slopes,
        hardening=tuple(slope / slopes[0] for slope in slopes),
    )


def _loading(path: MechanicalPath, cycle: int) -> tuple[Floats, Floats]:
    """Return deflection and force of one loading, m and N."""
    n_steps = 20_001
    progress = path.test.stroke * (2.0 * (cycle - 1) + np.linspace(0.0, 1.0, n_steps))
    return path.deflection(progress), path.tension(progress) - path.rest.tension


def _slope_after_slack(displacement: Floats, force: Floats) -> float:
    """Return the slope over the first 5 mm from where the force exceeds zero, N/m."""
    slack = np.flatnonzero(force <= 0.0)
    begin = 0 if len(slack) == 0 else int(slack[-1])
    pair = slice(begin, begin + 2)
    start = float(np.interp(0.0, force[pair], displacement[pair]))
    moving = slice(begin, None)
    return line_slope(displacement[moving], force[moving], start, start + STIFFNESS_RANGE)


def evaluate_loading(displacement: Floats, force: Floats) -> LoadingTruth:
    """Return the true numbers of a first loading.

    Parameters
    ----------
    displacement, force : shape (n,), m, N, free of noise; the displacement increases from zero and
        is dense enough for linear interpolation

    Returns
    -------
    The numbers.
    """
    plateau_share = 0.1  # slope of the plateau over that of the window
    zero_distance = 0.02e-3
    windowed = line_slope(displacement, force, *KINK_WINDOW)
    last = float(displacement[-1])
    end = line_slope(displacement, force, last - STIFFNESS_RANGE, last)
    is_level = end < plateau_share * windowed
    tangents = _tangents(displacement, force)
    onset = _last_above(*tangents, plateau_share * windowed) if is_level else None
    return LoadingTruth(
        tangent_at_zero=float(np.interp(zero_distance, displacement, force)) / zero_distance,
        stiffness=line_slope(displacement, force, 0.0, STIFFNESS_RANGE),
        secant_stiffness=float(np.interp(STIFFNESS_RANGE, displacement, force)) / STIFFNESS_RANGE,
        windowed_stiffness=windowed,
        kink=find_kink(displacement, force, *KINK_WINDOW),
        end_tangent=end,
        end_slope=end / windowed,
        plateau_displacement=onset,
        plateau_force=None if onset is None else float(np.interp(onset, displacement, force)),
    )


def line_slope(displacement: Floats, force: Floats, start: float, stop: float) -> float:
    """Return the slope of the least-squares line between two displacements, N/m."""
    grid = np.linspace(start, stop, _KINK_GRID_POINTS)
    return float(np.polyfit(grid, np.interp(grid, displacement, force), 1, w=_roots())[0])


def _roots() -> Floats:
    """Return the roots of the trapezoidal weights of a grid."""
    roots = np.ones(_KINK_GRID_POINTS)
    roots[[0, -1]] = np.sqrt(0.5)
    return roots


def find_kink(displacement: Floats, force: Floats, start: float, stop: float) -> KinkTruth:
    """Find the kink as the best break of two joined lines between two displacements, m.

    Parameters
    ----------
    displacement, force : shape (n,), m, N, free of noise
    start, stop : m

    Returns
    -------
    The best by least squares, with the break refined by a parabola through the best of the grid and
    its neighbours.
    """
    grid = np.linspace(start, stop, _KINK_GRID_POINTS)
    wanted = np.interp(grid, displacement, force)
    breaks = grid[10:-10]
    misfits = np.array([_two_lines(grid, wanted, place)[1] for place in breaks.tolist()])
    best = int(np.clip(np.argmin(misfits), 1, len(misfits) - 2))
    below, middle, above = misfits[best - 1 : best + 2]
    shift = 0.5 * (below - above) / (below - 2.0 * middle + above)
    place = float(breaks[best] + np.clip(shift, -1.0, 1.0) * (breaks[1] - breaks[0]))
    (level, first, change), _ = _two_lines(grid, wanted, place)
    return KinkTruth(place, float(level + first * place), float(first), float(first + change))


def _two_lines(grid: Floats, wanted: Floats, place: float) -> tuple[Floats, float]:
    """Return level, slope and change of slope of the best pair of lines, and the sum of squares."""
    basis = np.column_stack([np.ones_like(grid), grid, np.maximum(grid - place, 0.0)])
    roots = _roots()
    coefficients = np.linalg.lstsq(roots[:, None] * basis, roots * wanted, rcond=None)[0]
    return coefficients, float(np.sum((roots * (basis @ coefficients - wanted)) ** 2))


def _tangents(displacement: Floats, force: Floats) -> tuple[Floats, Floats]:
    """Return the middles of intervals of a millimetre, m, and the tangents over them, N/m."""
    tangent_step = 1e-3
    half = 0.5 * tangent_step
    grid = np.linspace(half, displacement[-1] - half, 2001)
    ahead, behind = (np.interp(grid + step, displacement, force) for step in (half, -half))
    return grid, (ahead - behind) / tangent_step


def _last_above(grid: Floats, tangent: Floats, limit: float) -> float | None:
    """Return where the tangent finally falls below a limit, m; None if it is above at the end."""
    above = np.flatnonzero(tangent >= limit)
    if len(above) == 0 or above[-1] == len(grid) - 1:
        return None
    pair = slice(above[-1], above[-1] + 2)
    return float(np.interp(-limit, -tangent[pair], grid[pair]))
