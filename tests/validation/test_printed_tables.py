"""Numbers that others have printed: NIST, Rosner, Student, tables of the source.

NIST StRD Norris, NoInt1 and NoInt2 (itl.nist.gov/div898/strd/lls); Rosner, Technometrics 25 (1983)
165 with critical values of the NIST/SEMATECH handbook (1.3.5.17.3); Student, Biometrika 6 (1908) 1
with Welch's interval of R (``t.test``) and the equivalence test of TOSTER (``t_TOST``). ACSR
Cardinal under 40 kN (friction 0.7, a curve named after Foti) is not insulated: pressure comes from
its tension alone.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from labpipe.mechanics.wire.bending_law import (
    Contacts,
    compute_moment_curve,
    compute_slip_stiffness,
    compute_stick_stiffness,
)
from labpipe.mechanics.wire.cross_section import place_rings
from labpipe.records.arrays import Floats
from labpipe.results.curves import compute_slope, compute_zero_crossing
from labpipe.statistics.means import compute_mean, compute_nested_mean
from labpipe.statistics.significance import (
    compute_contrast,
    compute_equivalence_p,
    run_outlier_test,
    subtract_means,
)
from labpipe.uncertainty.autocorrelation import LinearFit, fit_linear, orthonormalise
from tests.builders.stranded_wires import WIRES, cardinal, layers_of, tube, wire

NORRIS = """
0.1 0.2 338.8 337.4 118.1 118.2 888.0 884.6 9.2 10.1 228.1 226.5 668.5 666.3 998.5 996.3
449.1 448.6 778.9 777.0 559.2 558.2 0.3 0.4 0.1 0.6 778.1 775.5 668.8 666.9 339.3 338.0
448.9 447.5 10.8 11.6 557.7 556.0 228.3 228.1 998.0 995.8 888.8 887.6 119.6 120.2 0.3 0.3
0.6 0.3 557.6 556.8 339.3 339.1 888.0 887.2 998.5 999.0 778.9 779.0 10.2 11.1 117.6 118.3
228.9 229.2 668.4 669.1 449.2 448.9 0.2 0.5
"""

"""Pairs y x."""


def classical_errors(fit: LinearFit, design: Floats, values: Floats) -> tuple[float, Floats]:
    """Residual deviation, and standard errors of the coefficients in independent noise."""
    left, (count, unknowns) = values - design @ fit.coefficients, design.shape
    deviation = float(np.sqrt(left @ left / (count - unknowns)))
    return deviation, deviation * np.linalg.norm(orthonormalise(design)[1], axis=1)


def test_norris() -> None:
    y, x = np.array(NORRIS.split(), dtype=np.float64).reshape(-1, 2).T
    assert compute_slope(x, y) == pytest.approx(1.00211681802045, rel=1e-13)
    zero_crossing = 0.262323073774029 / 1.00211681802045
    assert compute_zero_crossing(x, y) == pytest.approx(zero_crossing, rel=1e-10)
    slopes = compute_slope(np.array([x, x[::-1]]), np.array([y, 3.0 * y[::-1]]))
    assert slopes == pytest.approx(np.array([1.0, 3.0]) * 1.00211681802045, rel=1e-13)
    design = np.column_stack([np.ones_like(x), x])
    fit = fit_linear(design, y)
    assert fit.n == 36
    assert fit.coefficients == pytest.approx([-0.262323073774029, 1.00211681802045], rel=1e-11)
    deviation, errors = classical_errors(fit, design, y)
    assert errors == pytest.approx([0.232818234301152, 0.429796848199937e-3], rel=1e-11)
    assert deviation == pytest.approx(0.884796396144373, rel=1e-11)


@pytest.mark.parametrize(
    ("x", "y", "slope"),
    [
        (range(60, 71), range(130, 141), 2.07438016528926),
        ((4, 5, 6), (3, 4, 4), 0.727272727272727),
    ],
    ids=["NoInt1", "NoInt2"],
)
def test_lines_through_the_origin(x: range, y: range, slope: float) -> None:
    # NoInt2 has three samples; its rows twice give the same slope.
    times = 1 if len(x) > 6 else 2
    design = np.tile(np.array(x, dtype=np.float64), times)[:, None]
    fit = fit_linear(design, np.tile(np.array(y, dtype=np.float64), times))
    assert fit.coefficients[0] == pytest.approx(slope, rel=1e-12)


VALUES = """
-0.25 0.68 0.94 1.15 1.20 1.26 1.26 1.34 1.38 1.43 1.49 1.49 1.55 1.56 1.58 1.65 1.69 1.70 1.76
1.77 1.81 1.91 1.94 1.96 1.99 2.06 2.09 2.10 2.14 2.15 2.23 2.24 2.26 2.35 2.37 2.40 2.47 2.54
2.62 2.64 2.90 2.92 2.92 2.93 3.21 3.26 3.30 3.59 3.68 4.30 4.64 5.34 5.42 6.01
"""


def test_outliers_of_rosner() -> None:
    """Three are marked; one alone is not: the other two make the scatter large."""
    named = {str(at): float(value) for at, value in enumerate(VALUES.split())}
    spools = dict.fromkeys(named, "one")
    suspects = run_outlier_test(named, spools, max_outliers=10).select_outliers(0.05)
    assert [suspect.value for suspect in suspects] == [6.01, 5.42, 5.34]
    assert {suspect.method for suspect in suspects} == {"generalised ESD test"}
    # 3.118 where 3.158 is needed
    (alone,) = run_outlier_test(named, spools, max_outliers=1).select_outliers(0.1)
    assert alone.value == 6.01
    assert 0.05 < alone.p < 0.1


def test_students_two_groups() -> None:
    first = compute_mean([0.7, -1.6, -0.2, -1.2, -0.1, 3.4, 3.7, 0.8, 0.0, 2.0])
    second = compute_mean([1.9, 0.8, 1.1, 0.1, -0.1, 4.4, 5.5, 1.6, 4.6, 3.4])
    difference = subtract_means(first, second)
    assert difference.mean == pytest.approx(1.58)
    assert difference.interval is not None
    assert difference.interval.lower == pytest.approx(-0.2054832, abs=5e-8)
    assert difference.interval.upper == pytest.approx(3.3654832, abs=5e-8)
    contrast = compute_contrast(first, second, 0.5 / first.mean)
    assert contrast is not None
    assert compute_equivalence_p(contrast) == pytest.approx(0.89, abs=0.005)


TABLE = {2: 12.706, 3: 4.303, 4: 3.182, 5: 2.776, 6: 2.571, 10: 2.262, 30: 2.045}

"""By number of samples."""


@pytest.mark.parametrize("n", TABLE)
def test_interval_is_made_with_it(n: int) -> None:
    values = np.arange(n, dtype=np.float64)
    found = compute_mean(values)
    assert found.interval is not None
    half = 0.5 * (found.interval.upper - found.interval.lower)
    assert half == pytest.approx(TABLE[n] * np.std(values, ddof=1) / np.sqrt(n), rel=2e-4)


FIRST_REGION = {"1": [58.33, 57.71, 56.28], "2": [47.09, 48.19, 46.08]}

SECOND_REGION = {"1": [31.78, 33.98, 32.98], "2": [27.38, 28.81, 30.50]}

"""1/m, by spool."""


def test_two_spools_of_three_samples() -> None:
    """Means of spools, scatter within and between, pooled and not; they are not pooled."""
    found = compute_nested_mean(FIRST_REGION)
    assert [found.spool_means[key].mean for key in "12"] == pytest.approx([57.44, 47.12], abs=5e-3)
    assert (found.within_spools, found.between_spools) == pytest.approx((1.05, 7.27), abs=0.005)
    pooled = compute_mean([value for values in FIRST_REGION.values() for value in values])
    assert pooled.interval is not None
    assert found.chosen.interval is not None
    assert pooled.mean == pytest.approx(52.28, abs=0.005)
    assert pooled.interval.upper - pooled.mean == pytest.approx(6.01, abs=0.005)
    assert found.chosen.interval.upper - found.chosen.mean == pytest.approx(65.6, abs=0.05)
    assert not found.is_pooled
    assert not compute_nested_mean(SECOND_REGION).is_pooled
    assert compute_nested_mean(SECOND_REGION).chosen.mean == pytest.approx(30.905, abs=0.005)


PRINTED = {"C1": 1.46, "C2": 2.75, "C3": 6.22, "C4": 16.96, "C5": 39.87}

HEXAGONAL = {"C1": 1.46, "C2": 2.85, "C3": 5.95, "C4": 15.6, "C5": 36.4}

CONCENTRIC = {"C1": 1.62, "C2": 3.15, "C3": 6.60, "C4": 17.9, "C5": 41.9}

"""1e-3 N m^2."""


@pytest.mark.parametrize("name", sorted(PRINTED))
def test_bounds(name: str) -> None:
    low = 1e3 * compute_stick_stiffness(wire(name))
    high = 1e3 * compute_stick_stiffness(place_rings(layers_of(name), tube(WIRES[name][0])))
    assert low == pytest.approx(HEXAGONAL[name], rel=3e-3)
    assert high == pytest.approx(CONCENTRIC[name], rel=3e-3)
    if name != "C2":
        assert low - 0.005 < PRINTED[name] < high
    else:
        assert PRINTED[name] < low


TENSION = 40e3

INNER_ONLY = Contacts((0.7,) * 4, (0.0,) * 4)

"""Each layer rubs on what it is pressed against by its own pull and that of the layers outside."""

SHARED = Contacts((0.7,) * 4, (0.35, 0.35, 0.35, 0.0), has_lay_lengths=True)

"""Sliding against the layer outside is shared between the two; pressure by lay lengths."""


@pytest.fixture(scope="module")
def published(realdata: Path) -> tuple[Floats, Floats]:
    file = realdata / "datasets" / "FLEXION_CARDINAL_H40kN_mu0.7_FOTI.csv"
    curvature, moment = np.loadtxt(file, delimiter=",", skiprows=1).T
    return curvature, moment


def rms(contacts: Contacts, published: tuple[Floats, Floats], orientation: float = 0.0) -> float:
    curvature, moment = published
    found = compute_moment_curve(
        cardinal(), contacts, curvature, tension=TENSION, orientation=orientation
    )
    return float(np.sqrt(np.mean((found.moment - moment) ** 2)))


def test_stiffness_bounds() -> None:
    """Published 30.2 N m^2 is with cos(alpha) for the helix; the energy average is 0.3 % less."""
    assert compute_slip_stiffness(cardinal()) == pytest.approx(30.2, rel=4e-3)
    assert compute_stick_stiffness(cardinal()) == pytest.approx(1891.0, rel=2e-4)


@pytest.mark.realdata
def test_friction_on_the_inner_side(published: tuple[Floats, Floats]) -> None:
    assert rms(INNER_ONLY, published) <= 3.2


@pytest.mark.realdata
@pytest.mark.parametrize("orientation", [0.0, 0.05, 0.1, 0.2])
def test_lay_lengths_and_shared_sliding_are_closer(
    published: tuple[Floats, Floats], orientation: float
) -> None:
    assert rms(SHARED, published, orientation) <= 1.5
