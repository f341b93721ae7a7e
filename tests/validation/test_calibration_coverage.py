"""Intervals of a calibration, and bands of wires that were not used, hold as often as they say.

Seeded campaigns of synthetic tests, each with its own noise, samples and gain of the load cell,
made by the path station by station; compared with 95 % by an exact two-sided binomial test at 1 %,
which the numbers of one study share.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import binomtest

from labpipe.records.wire_calibration import Calibration
from labpipe.wire.calibration.calibrate_wire import Settings, calibrate
from labpipe.wire.calibration.prediction import predict
from tests.builders.loading_tests import TRUTH, exact_curve, measured, rig_of, wire_of

QUICK, FULL = 20, 200
SCATTER, GAIN, NOISE = 0.03, 0.005, 0.002
UNUSED = (("A1", 0.085), ("A3", 0.12))
AT = np.array([0.005, 0.02, 0.05])


@dataclass(frozen=True)
class Hits:
    """How many campaigns held: parameters (3,), bands of the mean and of one sample (wires, 3)."""

    parameters: np.ndarray
    mean: np.ndarray
    sample: np.ndarray


def study(lengths: tuple[float, ...], runs: int) -> Hits:
    parameters = np.zeros(3, dtype=np.int64)
    mean, sample = np.zeros((2, len(UNUSED), len(AT)), dtype=np.int64)
    for seed in range(runs):
        curves = measured(lengths=lengths, seed=seed, scatter=SCATTER, gain=GAIN, noise=NOISE)
        found = calibrate(wire_of("A2"), curves, Settings(gain=GAIN))
        assert isinstance(found, Calibration)
        for number, parameter in enumerate(found.parameters):
            parts = parameter.intervals
            parameters[number] += any(part.lower <= TRUTH[number] <= part.upper for part in parts)
        assert found.friction_separability is not None
        assert not any(found.friction_separability.are_identified.values())
        for wire in range(len(UNUSED)):
            in_mean, in_sample = held(found, wire, seed)
            mean[wire] += in_mean
            sample[wire] += in_sample
    return Hits(parameters, mean, sample)


def held(found: Calibration, wire: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Whether the bands of a wire that was not used hold its mean sample, and one measured sample.

    The same load cell reads it: its gain is the first draw of the campaign.
    """
    name, length = UNUSED[wire]
    band = predict(found, wire_of(name), length, AT, rig=rig_of(length), noise=NOISE)
    gain = np.exp(GAIN * np.random.default_rng(seed).normal())
    exact = gain * exact_curve(name, length)(AT)
    generator = np.random.default_rng(10_000 + 10 * seed + wire)
    factor = np.exp(SCATTER * generator.normal())
    one = factor * exact + NOISE * generator.normal(size=len(AT))
    return (
        (band.lower_mean <= exact) & (exact <= band.upper_mean),
        (band.lower <= one) & (one <= band.upper),
    )


def assert_covers(hits: np.ndarray, runs: int) -> None:
    for count in hits.ravel():
        chance = binomtest(int(count), runs, 0.95).pvalue
        assert chance > 0.01 / hits.size, f"{count} of {runs}: {hits.tolist()}"


@pytest.mark.slow
def test_quick() -> None:
    hits = study((0.085,), QUICK)
    for part in (hits.parameters, hits.mean, hits.sample):
        assert_covers(part, QUICK)


@pytest.mark.slow
@pytest.mark.parametrize("lengths", [(0.085,), (0.085, 0.1, 0.12)])
def test_full(lengths: tuple[float, ...]) -> None:
    hits = study(lengths, FULL)
    for part in (hits.parameters, hits.mean, hits.sample):
        assert_covers(part, FULL)
