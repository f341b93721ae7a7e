"""Tensile tests of the virtual lab in memory, off by as much as the shipped protocols say."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.virtual_lab.lab_files import Observation
from labpipe.virtual_lab.tensile import (
    TABLE_2_3,
    GripSlip,
    TensileScenario,
    build_corrugated_tube,
    build_pet_tape,
    build_stiff_bar,
    build_twist_tube,
)
from tests.builders.tensile_tests import true_values
from tests.judges.foreign.rig import scale, stated, wander, zero_drift


def drawn(kind: str, seed: int) -> TensileScenario:
    """The test of a kind by a seed.

    Parameters
    ----------
    kind : name of a shipped protocol that the virtual lab knows
    seed : of the sample and of what its load cell is off by
    """
    random = np.random.default_rng([seed, 7])
    gain_error = scale(kind, "frame", "force") * float(random.standard_normal())
    return KINDS[kind](random, gain_error)


def as_recorded(
    kind: str, seed: int, test: Observation[TensileScenario]
) -> Observation[TensileScenario]:
    """The test, crosshead and zero of the force off by as much as the protocol says."""
    by = scale(kind, "frame", "displacement") * float(np.random.default_rng([seed, 79]).normal())
    record = test.records["frame"]
    travel = record.displacement * (1.0 + by)
    step = test.scenario.instruments.force_step
    force = wandering(record.force, record.time, kind, seed, step)
    return replace(test, records={"frame": replace(record, displacement=travel, force=force)})


def wandering(force: Floats, time: Floats, kind: str, seed: int, step: float) -> Floats:
    """A force, in any unit, whose zero wanders by as much as the protocol says of the largest.

    Parameters
    ----------
    force, time : as it was recorded, unloaded at first; s
    kind : name of the protocol
    seed : of the test
    step : of the converter, in the unit of the force; 0 for none
    """
    largest = float(np.abs(force - force[0]).max())
    random, apart = np.random.default_rng([seed, 97]), float(np.median(np.diff(time)))
    moved = zero_drift(kind) * largest * wander(len(force), apart, random)
    return np.asarray(force + (step * np.rint(moved / step) if step else moved))


def truth(kind: str, seed: int, test: Observation[TensileScenario]) -> dict[str, float]:
    """True values; the specimen is not as large as the protocol says."""
    random = np.random.default_rng([seed, 83])
    sizes = {
        name: size + stated(kind, "specimen", "uncertainty", name) * float(random.normal())
        for name, size in {"length": test.scenario.length, **SECTIONS.get(kind, {})}.items()
    }
    stretched = test.truth["stiffness_first"] * sizes["length"]
    return true_values(test) | {
        name: stretched / area(sizes) for name, area in AREAS.get(kind, {}).items()
    }


def _tube(random: np.random.Generator, gain_error: float) -> TensileScenario:
    factor = float(np.exp(0.02 * random.standard_normal()))
    tube = build_corrugated_tube("CT-10-1", factor=factor, gain_error=gain_error)
    first, second = random.uniform(0.45, 0.9, 2)
    slips = (
        GripSlip(float(random.uniform(17e-3, 20e-3)), float(first)),
        GripSlip(float(random.uniform(28e-3, 33e-3)), float(second), duration=0.1),
    )
    law = replace(tube.law, slack=float(random.uniform(0.3e-3, 0.55e-3)))
    return replace(tube, law=law, slips=slips)


def _twist(random: np.random.Generator, gain_error: float) -> TensileScenario:
    return build_twist_tube(
        str(random.choice(list(TABLE_2_3))),
        peak_force=420.0 * float(np.exp(0.04 * random.standard_normal())),
        slack=float(random.uniform(0.8e-3, 1.1e-3)),
        break_point=float(random.uniform(7.8e-3, 8.1e-3)),
        gain_error=gain_error,
    )


def _tape(random: np.random.Generator, gain_error: float) -> TensileScenario:
    tape = build_pet_tape(
        "1",
        factor=float(np.exp(0.02 * random.standard_normal())),
        failure_displacement=float(random.uniform(45e-3, 65e-3)),
        gain_error=gain_error,
    )
    return replace(tape, law=replace(tape.law, slack=float(random.uniform(0.4e-3, 0.8e-3))))


def _bar(random: np.random.Generator, gain_error: float) -> TensileScenario:
    del random
    return build_stiff_bar(gain_error=gain_error)


KINDS = {
    "corrugated-tube": _tube,
    "twist-tube": _twist,
    "pet-tape": _tape,
    "stiff-bar": _bar,
}
SECTIONS = {
    "corrugated-tube": {"outer_diameter": 14.1e-3, "inner_diameter": 10.7e-3, "wall": 0.27e-3},
    "pet-tape": {"width": 18.79e-3, "thickness": 0.28e-3},
}
"""As the protocols say, m."""


def _wall(sizes: dict[str, float]) -> float:
    return math.pi * (sizes["outer_diameter"] - sizes["wall"]) * sizes["wall"]


def _annulus(sizes: dict[str, float]) -> float:
    return 0.25 * math.pi * (sizes["outer_diameter"] ** 2 - sizes["inner_diameter"] ** 2)


def _rectangle(sizes: dict[str, float]) -> float:
    return sizes["width"] * sizes["thickness"]


AREAS = {
    "corrugated-tube": {"modulus_thin_wall": _wall, "modulus_annulus": _annulus},
    "pet-tape": {"modulus": _rectangle},
}
"""Moduli that the protocols ask for, by name."""
