"""A virtual tension test of a metal with an extensometer, and its true numbers.

The first loading follows Ramberg and Osgood: strain = s / E + 0.2 % (s / Rp)^n, so that the 0.2 %
proof stress is Rp by definition. From the uniform strain on the specimen necks: its force falls as
the square of the further strain, until it breaks.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.store.replace import storing
from labpipe.virtual_lab.observations import SHEET_FILE, TRUTH_FILE

EXPORT_FILE = "tension.csv"


@dataclass(frozen=True, slots=True)
class MetalTension:
    """A virtual tension test.

    Parameters
    ----------
    name : of the test and of its folder
    modulus, proof_stress : E and Rp0.2, Pa
    hardening : exponent n
    diameter, gauge_length : m, of the specimen and of the extensometer
    uniform_strain, last_strain : at the largest force, and at the break
    last_share : force at the break, of the largest one
    extensometer_off : strain at which the extensometer is taken off; None if it stays on
    rate : Hz
    strain_rates : 1/s, up to 0.4 % of strain, and from there on
    force_noise, extension_noise : N and m, white
    frame_compliance : m/N, of machine and grips
    preload : N, at the start
    """

    name: str = "tension-1"
    modulus: float = 200e9
    proof_stress: float = 400e6
    hardening: float = 12.0
    diameter: float = 5e-3
    gauge_length: float = 25e-3
    uniform_strain: float = 0.10
    last_strain: float = 0.15
    last_share: float = 0.75
    extensometer_off: float | None = None
    rate: float = 10.0
    strain_rates: tuple[float, float] = (1e-4, 1e-3)
    force_noise: float = 3.0
    extension_noise: float = 3e-8
    frame_compliance: float = 4e-8
    preload: float = 50.0

    @property
    def area(self) -> float:
        """Return the original area, m^2."""
        return 0.25 * np.pi * self.diameter**2

    def stress(self, strain: Floats) -> Floats:
        """Return the stress of first loading without necking, Pa, at strains of any shape."""
        stresses = self.proof_stress * np.linspace(0.0, 4.0, 40_001)
        strains = stresses / self.modulus + 0.002 * (stresses / self.proof_stress) ** self.hardening
        return np.interp(strain, strains, stresses)

    def force(self, strain: Floats) -> Floats:
        """Return the force, N, at strains of any shape."""
        uniform = self.area * self.stress(np.minimum(strain, self.uniform_strain))
        further = (strain - self.uniform_strain) / (self.last_strain - self.uniform_strain)
        return uniform * (1.0 - (1.0 - self.last_share) * np.maximum(further, 0.0) ** 2)

    def truth(self) -> dict[str, float]:
        """Return the true values of the results of the protocol ``iso-6892``, SI."""
        strength = float(self.stress(np.array(self.uniform_strain)))
        last = self.last_share * strength
        return {
            "elastic_modulus": self.modulus,
            "proof_stress_0_2": self.proof_stress,
            "proof_stress_1": self.proof_stress * 5.0 ** (1.0 / self.hardening),
            "tensile_strength": strength,
            "elongation_at_maximum_force": self.uniform_strain,
            "plastic_elongation_at_maximum_force": self.uniform_strain - strength / self.modulus,
            "elongation_at_break": self.last_strain,
            "plastic_elongation_at_break": self.last_strain - last / self.modulus,
        }


def simulate_tension(scenario: MetalTension, folder: Path, seed: int) -> Path:
    """Run a virtual tension test and write its export, test sheet and truth.

    Parameters
    ----------
    scenario : the test
    folder : of this test; created if it does not exist; files of the same names are replaced
    seed : the same seed gives identical files

    Returns
    -------
    The folder.

    Raises
    ------
    StoreError
        If the files cannot be written.
    """
    random = np.random.default_rng([seed, 68])
    slow, fast = scenario.strain_rates
    knee = 0.004
    start = scenario.preload / (scenario.area * scenario.modulus)
    seconds = (knee - start) / slow + (scenario.last_strain - knee) / fast
    time = np.arange(int(seconds * scenario.rate)) / scenario.rate
    turn = (knee - start) / slow
    strain = start + slow * np.minimum(time, turn) + fast * np.maximum(time - turn, 0.0)
    force, extension = scenario.force(strain), scenario.gauge_length * (strain - start)
    travel = 1.2 * extension + scenario.frame_compliance * force
    noisy = extension + random.normal(0.0, scenario.extension_noise, len(time))
    if scenario.extensometer_off is not None:
        noisy = np.where(strain > scenario.extensometer_off, np.nan, noisy)
    columns = (
        time,
        1e-3 * (force + random.normal(0.0, scenario.force_noise, len(time))),
        1e3 * travel,
        1e3 * noisy,
    )
    rows = np.column_stack(columns).tolist()
    lines = [
        f"SYNTHETIC: made by labpipe's virtual lab, seed {seed}, not a measurement",
        "Time,Force,Crosshead,Extensometer",
        "s,kN,mm,mm",
        *(",".join("" if np.isnan(value) else f"{value:.7g}" for value in row) for row in rows),
    ]
    facts = {"synthetic": True, "seed": seed, "scenario": asdict(scenario), **scenario.truth()}
    with storing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / EXPORT_FILE).write_text("\n".join(lines) + "\n", encoding="utf-8")
        (folder / SHEET_FILE).write_text(_write_sheet(scenario), encoding="utf-8")
        (folder / TRUTH_FILE).write_text(json.dumps(facts) + "\n", encoding="utf-8")
    return folder


def _write_sheet(scenario: MetalTension) -> str:
    sizes = f"gauge_length: {1e3 * scenario.gauge_length:g} mm"
    section = f"{{outer_diameter: {1e3 * scenario.diameter:g} mm}}"
    return f"""\
# A synthetic test, made by labpipe's virtual lab. Its true values are in truth.json.
test: {scenario.name}
protocol: iso-6892
specimen: {{type: virtual steel, spool: bar-1, sample: '1', {sizes}, section: {section}}}
date: 2026-03-13
operator: virtual lab
files: {{frame: {EXPORT_FILE}}}
"""
