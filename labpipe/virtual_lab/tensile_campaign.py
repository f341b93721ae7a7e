"""A virtual campaign of tensile tests: how many of each kind, how they scatter, what goes wrong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from labpipe.virtual_lab.tensile_exports import simulate_tensile
from labpipe.virtual_lab.tensile_samples import (
    GAIN_UNCERTAINTY,
    TABLE_2_3,
    corrugated_tube,
    pet_tape,
    stiff_bar,
    twist_tube,
)
from labpipe.virtual_lab.tensile_scenario import GripSlip, TensileScenario

TWIST_TUBE_IN_PARTS = "2b"
_SMALL_TUBE = (("outer_diameter", 10.2e-3), ("inner_diameter", 7.4e-3))
_TUBE_SLIPS = {
    "CT-10-slit-2": (GripSlip(18.75e-3, 0.47), GripSlip(30.85e-3, 0.81)),
    "CT-7-3": (GripSlip(24.3e-3, 0.62, duration=0.1),),
}
_UNLOADED = "CT-10-3"


def simulate_tensile_campaign(folder: Path, seed: int = 1) -> list[Path]:
    """Run the whole campaign and write the exports, test sheets and truths.

    Parameters
    ----------
    folder : one folder per test is made in it
    seed : the same seed gives the same files

    Returns
    -------
    The folders of the tests.
    """
    return [
        simulate_tensile(scenario, folder / scenario.name, seed=1000 * seed + number)
        for number, scenario in enumerate(tensile_scenarios(seed), start=1)
    ]


def tensile_scenarios(seed: int = 1) -> list[TensileScenario]:
    """The tests of `simulate_tensile_campaign`.

    Parameters
    ----------
    seed : of the scatter between samples and of what each load cell is off by

    Returns
    -------
    Nine corrugated tubes, six twist tubes, five tapes, one stiff bar. All tests of one frame share
    the error of its load cell.
    """
    random = np.random.default_rng([seed, 23])
    small, large = GAIN_UNCERTAINTY * random.standard_normal(2)
    tubes = _corrugated_tubes(float(small), random)
    return [
        *tubes,
        *_twist_tubes(float(large), random),
        *_tapes(float(large), random),
        stiff_bar(gain_error=float(large)),
    ]


def _scatter(random: np.random.Generator, relative: float) -> float:
    """A factor close to 1."""
    return float(np.exp(relative * random.standard_normal()))


def _corrugated_tubes(gain_error: float, random: np.random.Generator) -> list[TensileScenario]:
    tubes = []
    for kind, factor in (("CT-10-slit", 1.0), ("CT-10", 1.1), ("CT-7", 1.2)):
        for sample in range(1, 4):
            tube = corrugated_tube(
                f"{kind}-{sample}", factor=factor * _scatter(random, 0.01), gain_error=gain_error
            )
            law = replace(tube.law, slack=float(random.uniform(0.3e-3, 0.55e-3)))
            frame = replace(tube.frame, unloads=tube.name == _UNLOADED)
            slips = _TUBE_SLIPS.get(tube.name, ())
            section = _SMALL_TUBE if kind == "CT-7" else ()
            tubes.append(replace(tube, law=law, frame=frame, slips=slips, section=section))
    return tubes


def _twist_tubes(gain_error: float, random: np.random.Generator) -> list[TensileScenario]:
    tubes = [
        twist_tube(
            sample,
            peak_force=420.0 * _scatter(random, 0.04),
            slack=float(random.uniform(0.8e-3, 1.1e-3)),
            break_point=float(random.uniform(7.8e-3, 8.1e-3)),
            gain_error=gain_error,
        )
        for sample in TABLE_2_3
    ]
    return [_in_parts(tube) if tube.sample == TWIST_TUBE_IN_PARTS else tube for tube in tubes]


def _in_parts(tube: TensileScenario) -> TensileScenario:
    return replace(tube, export=replace(tube.export, in_parts=True, part_at=2.6))


def _tapes(gain_error: float, random: np.random.Generator) -> list[TensileScenario]:
    spools = {"1": 1.01, "2": 1.01, "3": 1.01, "4": 0.98, "5": 0.98}
    tapes = []
    for sample, spool in spools.items():
        around = 40e-3 if sample == "2" else 60e-3
        tape = pet_tape(
            sample,
            factor=spool * _scatter(random, 0.01),
            fails_at=around * _scatter(random, 0.02),
            gain_error=gain_error,
        )
        slack = float(random.uniform(0.4e-3, 0.8e-3))
        tapes.append(replace(tape, law=replace(tape.law, slack=slack)))
    return tapes
