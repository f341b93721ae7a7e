"""Numbers of a force-displacement loop against what the loop was made from."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.fits.loops import energy_of, secant_stiffness, sense_of_loading
from labpipe.records.arrays import Floats
from labpipe.records.estimates import Estimate, Failure
from tests.builders.noise_rows import KINDS, noise_rows, spreads

STIFFNESS = 20.0


def value(found: Estimate | Failure) -> Estimate:
    assert isinstance(found, Estimate), found
    return found


def test_stiffness_is_exact_on_a_line() -> None:
    time = np.arange(0.0, 4.0, 0.02)
    found = value(
        secant_stiffness(time, 1e-3 * time, 0.02 * time + 1.0, np.ones(len(time), dtype=bool))
    )
    assert found.value == pytest.approx(STIFFNESS, rel=1e-12)
    assert found.n == 200


def test_stiffness_is_not_made_small_by_a_noisy_displacement() -> None:
    time, pulls, slopes, plain = np.arange(0.0, 4.0, 0.02), [], [], []
    for seed in range(400):
        rng = np.random.default_rng(seed)
        path = 1e-3 * time + rng.normal(0, 3e-4, len(time))
        force = 0.02 * time + rng.normal(0, 1e-3, len(time))
        found = value(secant_stiffness(time, path, force, np.ones(len(time), dtype=bool)))
        pulls.append((found.value - STIFFNESS) / found.error)
        slopes.append(found.value)
        plain.append(float(np.polyfit(path, force, 1)[0]))
    assert np.mean(slopes) == pytest.approx(STIFFNESS, rel=5e-3)
    assert np.mean(plain) < 0.95 * STIFFNESS
    assert np.std(pulls) == pytest.approx(1.0, abs=0.12)


def test_stiffness_says_why_not() -> None:
    time = np.arange(0.0, 4.0, 0.02)
    none = np.zeros(len(time), dtype=bool)
    found = secant_stiffness(time, time, time, none)
    assert found == Failure("too_few_samples", "0 samples in the stretch, 8 are needed")
    still = secant_stiffness(time, np.ones_like(time), time, ~none)
    assert still == Failure("no_travel", "the displacement does not change over the stretch")


def loop() -> tuple[Floats, Floats, Floats]:
    """An ellipse of half axes 10 mm and 0.5 N: its area is pi 0.01 0.5 J."""
    time = np.linspace(0.0, 100.0, 5001)
    phase = 2 * np.pi * time / 100.0
    return time, -1e-2 * np.cos(phase), 0.5 * np.sin(phase)


def test_energy_is_the_area_of_the_loop() -> None:
    _, path, force = loop()
    assert energy_of(path, force) == pytest.approx(np.pi * 1e-2 * 0.5, rel=1e-6)


def test_a_loop_of_few_samples_has_its_area() -> None:
    """A triangle of 2 m and 3 N below another one, by hand: 1.5 + 3.5 - 2.5 - 0.5 J."""
    d, f = np.array([0.0, 1.0, 2.0, 1.0, 0.0]), np.array([0.0, 3.0, 4.0, 1.0, 0.0])
    assert energy_of(d, f) == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("values", "sense"),
    [
        ([0.0, 50.0, 100.0, 0.0], 1.0),
        ([0.0, -50.0, -100.0], -1.0),
        ([50.0, 75.0, 100.0, 0.0], 1.0),
        ([np.nan, -20.0, 15.0], 1.0),
        ([np.nan], 1.0),
    ],
)
def test_sense_of_loading(values: list[float], sense: float) -> None:
    assert sense_of_loading(np.array(values)) == sense


def test_energy_of_many_rows_is_the_trapezoid_of_each() -> None:
    rng = np.random.default_rng(3)
    d, f = rng.normal(size=(2, 3, 40))
    expected = [float(np.trapezoid(force, path)) for path, force in zip(d, f, strict=True)]
    np.testing.assert_allclose(energy_of(d, f), expected, rtol=1e-12)
    exact = [float(np.trapezoid(force, d[0])) for force in f]
    np.testing.assert_allclose(energy_of(d[0], f), exact, rtol=1e-12)
    # 1 N over 2 mm, then 3 N over 1 mm, halfway from one to the other in between
    assert energy_of(np.array([0.0, 2e-3, 3e-3]), np.array([1.0, 1.0, 3.0])) == pytest.approx(4e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_energy_of_replicates_scatters_as_tests_do(kind: str) -> None:
    _, path, force = loop()
    shape = (200, len(path))
    paths = path + noise_rows(kind, 5e-5, shape, seed=1)
    forces = force + noise_rows(kind, 1e-3, shape, seed=2)
    tests, replicates = spreads(lambda _d, _f: energy_of, paths, forces)
    assert replicates == pytest.approx(tests, rel=1e-9)
    if kind == "white":
        # By hand: noise of each sample times half the step of the other over two samples, and
        # times the noise of that.
        steps, rises = np.gradient(path), np.gradient(force)
        parts = 1e-3 * steps, 5e-5 * rises, np.full(len(path), 1e-3 * 5e-5 / np.sqrt(2.0))
        assert replicates == pytest.approx(np.linalg.norm(np.concatenate(parts)), rel=0.15)
