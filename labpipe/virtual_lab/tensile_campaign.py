"""A virtual campaign of tensile tests: tubes, tapes and the bar that tells what the frame gives.

Sizes, speeds and the scatter of the twist tubes are those of sections 2.2 and 2.3 and Table 2.3 of
the source; forces that it does not print are plausible ones.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from labpipe.virtual_lab.tensile_exports import simulate_tensile
from labpipe.virtual_lab.tensile_scenario import (
    BilinearLaw,
    ExportLayout,
    Failure,
    FrameInstruments,
    GripSlip,
    LoadFrame,
    Program,
    TensileScenario,
)

TABLE_2_3 = {
    "1a": (58.33, 31.78),
    "1b": (57.71, 33.98),
    "1c": (56.28, 32.98),
    "2a": (47.09, 27.38),
    "2b": (48.19, 28.81),
    "2c": (46.08, 30.50),
}
"""First and second stiffness of the twist tubes over their peak force, 1/m, by sample."""
TWIST_TUBE_IN_PARTS = "2b"
GIVE = 2e-7
"""Compliance of the MTS frame with load cell and grips, m/N."""
GAIN_UNCERTAINTY = 0.0025
"""Relative standard uncertainty of both load cells: half of the limit of ISO 7500-1 class 0.5."""

_CORRUGATED = BilinearLaw(1.80e3, 0.55e3, 19e-3, knee=18e-3, slack=0.4e-3, toe=0.4e-3)
_SMALL_TUBE = (("outer_diameter", 10.2e-3), ("inner_diameter", 7.4e-3))
_TAPE = BilinearLaw(12.0e3, 2.1e3, 6.5e-3, knee=3e-3, slack=0.5e-3, toe=0.8e-3)
_BAR = BilinearLaw(1.55e8, 1.55e8, 1.0, slack=20e-6, toe=0.3e-6)
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


def corrugated_tube(name: str, *, factor: float = 1.0, gain_error: float = 0.0) -> TensileScenario:
    """One corrugated tube of 10 mm: no slip, no failure, stopped at 50 mm.

    Parameters
    ----------
    name : type and number of the sample, such as ``CT-10-slit-1``
    factor : by which its forces are larger than those of the slit tube
    gain_error : of the load cell
    """
    kind, _, sample = name.rpartition("-")
    law = replace(
        _CORRUGATED,
        stiffness_first=_CORRUGATED.stiffness_first * factor,
        stiffness_second=_CORRUGATED.stiffness_second * factor,
    )
    return TensileScenario(
        name=name,
        protocol="corrugated-tube",
        specimen_type=kind,
        spool=f"{kind}-s1",
        sample=sample,
        length=114.3e-3,
        law=law,
        frame=LoadFrame(speed=0.423e-3, stroke=50e-3),
        instruments=_r_controller(gain_error),
        export=ExportLayout(Program.R_CONTROLLER, "lbf"),
        date="2026-03-09",
    )


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


def twist_tube(
    sample: str,
    *,
    peak_force: float = 420.0,
    slack: float = 0.9e-3,
    break_point: float = 8.0e-3,
    gain_error: float = 0.0,
) -> TensileScenario:
    """One twist tube of Table 2.3, pulled until it tears.

    Parameters
    ----------
    sample : of the table
    peak_force : N, at which it tears
    slack : m
    break_point : m, from the foot, as seen at the crosshead
    gain_error : of the load cell

    Notes
    -----
    The table's numbers are those seen at the crosshead. Where the tube tears follows from them:
    1 = n1 b + n2 (d - b), with d the displacement from the foot and b the break point.
    """
    first, second = TABLE_2_3[sample]
    law = BilinearLaw(
        stiffness_first=_without_give(first * peak_force),
        stiffness_second=_without_give(second * peak_force),
        break_point=break_point * (1.0 - GIVE * first * peak_force),
        knee=1.0e-3,
        slack=slack,
        toe=0.6e-3,
    )
    tears_at = law.foot + break_point + (1.0 - first * break_point) / second
    return TensileScenario(
        name=f"twist-tube-{sample}",
        protocol="twist-tube",
        specimen_type="twist-tube-10",
        spool=f"twist-tube-s{sample[0]}",
        sample=sample,
        length=75e-3,
        law=law,
        frame=LoadFrame(speed=5e-3, stroke=60e-3, overrun=0.31, compliance=GIVE),
        instruments=_test_suite(100.0, gain_error),
        failure=Failure(tears_at, duration=0.02, residue=0.03, tail=0.15),
        export=ExportLayout(Program.TEST_SUITE, "kN"),
        date="2026-03-10",
    )


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


def _without_give(stiffness: float) -> float:
    """Stiffness of the specimen alone, from what is seen at the crosshead of the MTS frame."""
    return stiffness / (1.0 - GIVE * stiffness)


def pet_tape(
    sample: str, *, factor: float = 1.0, fails_at: float = 60e-3, gain_error: float = 0.0
) -> TensileScenario:
    """One PET tape, pulled until it breaks; a few fibres hold on.

    Parameters
    ----------
    sample : counted over both spools: 1 to 3 of the first, 4 and 5 of the second
    factor : by which its forces are larger than usual
    fails_at : m, displacement
    gain_error : of the load cell
    """
    law = replace(
        _TAPE,
        stiffness_first=_TAPE.stiffness_first * factor,
        stiffness_second=_TAPE.stiffness_second * factor,
    )
    return TensileScenario(
        name=f"pet-tape-{sample}",
        protocol="pet-tape",
        specimen_type="pet-tape",
        spool="pet-tape-s1" if int(sample) <= 3 else "pet-tape-s2",
        sample=sample,
        length=0.3,
        law=law,
        frame=LoadFrame(speed=0.5e-3, stroke=0.1, overrun=2.3, compliance=GIVE),
        instruments=_test_suite(20.0, gain_error),
        failure=Failure(fails_at, duration=0.15, residue=0.06, tail=1.2),
        export=ExportLayout(Program.TEST_SUITE, "N"),
        date="2026-03-11",
    )


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


def stiff_bar(*, gain_error: float = 0.0) -> TensileScenario:
    """A steel bar of 12 mm in the MTS frame: what the crosshead travels is the frame's give.

    Parameters
    ----------
    gain_error : of the load cell
    """
    usual = _test_suite(10.0, gain_error)
    return TensileScenario(
        name="stiff-bar-1",
        protocol="stiff-bar",
        specimen_type="stiff-bar",
        spool="steel-12",
        sample="1",
        length=0.15,
        law=_BAR,
        frame=LoadFrame(speed=5e-6, stroke=0.35e-3, overrun=0.52, compliance=GIVE),
        instruments=replace(usual, displacement_noise=2e-8, displacement_tare=0.0),
        export=ExportLayout(Program.TEST_SUITE, "kN"),
        date="2026-03-11",
    )


def _test_suite(rate: float, gain_error: float) -> FrameInstruments:
    """A 50 kN load cell, strong for what it measures here."""
    return FrameInstruments(
        rate=rate,
        first_sample=1.95 / rate,
        white_noise=0.15,
        slow_noise=0.25,
        correlation_time=5.0 / rate,
        displacement_noise=2e-7,
        displacement_tare=1.2e-5,
        tare=2.7,
        gain_error=gain_error,
        gain_uncertainty=GAIN_UNCERTAINTY,
    )


def _r_controller(gain_error: float) -> FrameInstruments:
    """A 500 lbf load cell and a displacement sensor that reads to 1/10000 inch."""
    return FrameInstruments(
        rate=20.0,
        first_sample=0.087,
        white_noise=0.02,
        slow_noise=0.03,
        correlation_time=0.3,
        displacement_noise=1e-6,
        displacement_step=2.54e-6,
        force_step=4.4482216152605e-3,
        tare=-0.83,
        displacement_tare=1.016e-3,
        gain_error=gain_error,
        gain_uncertainty=GAIN_UNCERTAINTY,
    )
