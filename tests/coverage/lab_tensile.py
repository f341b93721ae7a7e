"""Tensile tests of the virtual lab in memory; load cells are off as their certificates allow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labpipe.virtual_lab import TensileScenario
from labpipe.virtual_lab.tensile_scenarios import (
    GAIN_UNCERTAINTY,
    TABLE_2_3,
    GripSlip,
    corrugated_tube,
    pet_tape,
    stiff_bar,
    twist_tube,
)


def drawn(kind: str, seed: int) -> TensileScenario:
    """The test of a kind by a seed.

    Parameters
    ----------
    kind : name of a shipped protocol that the virtual lab knows
    seed : of the sample and of what its load cell is off by
    """
    random = np.random.default_rng([seed, 7])
    gain_error = float(GAIN_UNCERTAINTY * random.standard_normal())
    return KINDS[kind](random, gain_error)


def _tube(random: np.random.Generator, gain_error: float) -> TensileScenario:
    factor = float(np.exp(0.02 * random.standard_normal()))
    tube = corrugated_tube("CT-10-1", factor=factor, gain_error=gain_error)
    first, second = random.uniform(0.45, 0.9, 2)
    slips = (
        GripSlip(float(random.uniform(17e-3, 20e-3)), float(first)),
        GripSlip(float(random.uniform(28e-3, 33e-3)), float(second), duration=0.1),
    )
    law = replace(tube.law, slack=float(random.uniform(0.3e-3, 0.55e-3)))
    return replace(tube, law=law, slips=slips)


def _twist(random: np.random.Generator, gain_error: float) -> TensileScenario:
    return twist_tube(
        str(random.choice(list(TABLE_2_3))),
        peak_force=420.0 * float(np.exp(0.04 * random.standard_normal())),
        slack=float(random.uniform(0.8e-3, 1.1e-3)),
        break_point=float(random.uniform(7.8e-3, 8.1e-3)),
        gain_error=gain_error,
    )


def _tape(random: np.random.Generator, gain_error: float) -> TensileScenario:
    tape = pet_tape(
        "1",
        factor=float(np.exp(0.02 * random.standard_normal())),
        fails_at=float(random.uniform(45e-3, 65e-3)),
        gain_error=gain_error,
    )
    return replace(tape, law=replace(tape.law, slack=float(random.uniform(0.4e-3, 0.8e-3))))


def _bar(random: np.random.Generator, gain_error: float) -> TensileScenario:
    del random
    return stiff_bar(gain_error=gain_error)


KINDS = {
    "corrugated-tube": _tube,
    "twist-tube": _twist,
    "pet-tape": _tape,
    "stiff-bar": _bar,
}
