"""The taped bundles of the source's Table 4.1 in the cantilever rig.

The rig is that of single wires with another load cell: 2 lb, on a bundle of 114.3 mm (4.5 in), with
a marker every half inch. Wires, tapes and shares are those of `virtual_lab.bundles`; PET tape never
slides.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from labpipe.virtual_lab.bundles import BundleModel
from labpipe.virtual_lab.campaign import MISHAPS, simulate_test
from labpipe.virtual_lab.instruments import Observation, observe
from labpipe.virtual_lab.scenario import (
    NO_MISHAPS,
    CantileverScenario,
    Clocks,
    LoadCell,
    MarkerLayout,
    MechanicalTest,
    Pose,
)

LENGTH = 0.1143
MARKER_SPACING = 0.0127
LOAD_CELL = LoadCell(gain=0.89, gain_uncertainty=0.002, noise=3e-3)
"""A cell of 2 lb (8.9 N at 10 V). All tests of a campaign share what its gain is off by."""

_PVC = BundleModel()
_PET = replace(_PVC, glue_strain=None, tape="PET")

TAPED_TYPES = {
    "TWB-B1-7-PVC": replace(_PVC, wires=(("B1", 7),)),
    "TWB-B1-12-PVC": replace(_PVC, wires=(("B1", 12),)),
    "TWB-B1-19-PVC": replace(_PVC, wires=(("B1", 19),)),
    "TWB-B2-7-PVC": replace(_PVC, wires=(("B2", 7),)),
    "TWB-B2-12-PVC": replace(_PVC, wires=(("B2", 12),)),
    "TWB-B2-19-PVC": replace(_PVC, wires=(("B2", 19),)),
    "TWB-MX-sym-PVC": replace(_PVC, wires=(("B1", 9), ("B2", 10)), arrangement="symmetric"),
    "TWB-MX-asym-PVC": replace(_PVC, wires=(("B1", 10), ("B2", 9)), arrangement="asymmetric"),
    "TWB-B1-19-PET": replace(_PET, wires=(("B1", 19),)),
    "TWB-B2-7-PET": replace(_PET, wires=(("B2", 7),)),
    "TWB-B2-19-PET": replace(_PET, wires=(("B2", 19),)),
}
"""Table 4.1."""


@dataclass(frozen=True, slots=True)
class TapedCampaign:
    """How a campaign of taped bundles is run.

    Parameters
    ----------
    types : names in `TAPED_TYPES`, in order
    samples : of each type
    scatter : standard deviation of the logarithm of a sample's factor on its bundle's moments
    rate : Hz, of the force recorder
    fps : frames per second of the cameras
    speed : m/s, of the clamp
    cycles : of each test
    has_mishaps : whether markers are lost and mistaken
    """

    types: tuple[str, ...] = tuple(TAPED_TYPES)
    samples: int = 3
    scatter: float = 0.04
    rate: float = 200.0
    fps: float = 25.0
    speed: float = 1e-3
    cycles: int = 3
    has_mishaps: bool = True


def simulate_taped(campaign: TapedCampaign, folder: Path, seed: int = 1) -> list[Path]:
    """Run a campaign and write the exports, test sheets and truths.

    Parameters
    ----------
    campaign : how
    folder : one folder per test is made in it
    seed : the same seed gives the same files

    Returns
    -------
    The folders of the tests.
    """
    return [
        simulate_test(scenario, folder / scenario.name, seed=own)
        for scenario, own in taped_scenarios(campaign, seed)
    ]


def observe_taped(campaign: TapedCampaign, seed: int = 1) -> Iterator[Observation]:
    """Run a campaign in memory, one test after the other.

    Parameters
    ----------
    campaign : how
    seed : the same seed gives the same tests as on disk
    """
    for scenario, own in taped_scenarios(campaign, seed):
        yield observe(scenario, own)


def taped_scenarios(
    campaign: TapedCampaign, seed: int = 1
) -> Iterator[tuple[CantileverScenario, int]]:
    """The tests of a campaign, each with its own seed.

    Parameters
    ----------
    campaign : how
    seed : of what differs between samples, and of what the load cell is off by

    Yields
    ------
    Scenario and seed.

    Raises
    ------
    KeyError
        If a type is none of `TAPED_TYPES`.
    """
    random = np.random.default_rng([seed, 61])
    gain_error = LOAD_CELL.gain_uncertainty * float(random.standard_normal())
    for kind, name in enumerate(campaign.types):
        for sample in range(1, campaign.samples + 1):
            scenario = _sample(campaign, name, sample, gain_error, random)
            yield scenario, 100_000 * seed + 100 * kind + sample


def _sample(
    campaign: TapedCampaign, name: str, sample: int, gain_error: float, random: np.random.Generator
) -> CantileverScenario:
    bundle = TAPED_TYPES[name].scaled(float(np.exp(campaign.scatter * random.standard_normal())))
    offset, drift = float(random.uniform(0.3, 2.5)), float(random.uniform(-60e-6, 60e-6))
    yaw = float(random.uniform(0.3, 0.9))
    return replace(
        taped_scenario(bundle, cycles=campaign.cycles),
        name=f"{name}-{sample}",
        specimen_type=name,
        spool=f"{name}-s1",
        sample=sample,
        speed=campaign.speed,
        clocks=Clocks(rate=campaign.rate, fps=campaign.fps, offset=offset, drift=drift),
        load_cell=replace(LOAD_CELL, gain_error=gain_error),
        pose=Pose(yaw=yaw),
        mishaps=MISHAPS[(sample - 1) % len(MISHAPS)] if campaign.has_mishaps else NO_MISHAPS,
    )


def taped_scenario(bundle: BundleModel, *, cycles: int = 3) -> CantileverScenario:
    """One test of a bundle, without mishaps.

    Parameters
    ----------
    bundle : the sample
    cycles : each a loading and an unloading branch

    Returns
    -------
    The scenario: the string straight from the start, carrying the counterweight; markers in the
    middles of nine stretches of half an inch.

    Notes
    -----
    Solved positions are crowded where the wires begin to slip. The looked-up force is within 3 mN
    of that of many more positions, and within 12 mN where the tape begins to slide; the noise is
    3 mN. Exports and truth are of the same looked-up path.
    """
    half = 0.5 * MARKER_SPACING
    return CantileverScenario(
        name="TWB-1",
        specimen_type="TWB",
        spool="TWB-s1",
        mechanics=taped_test(bundle, cycles=cycles),
        load_cell=LOAD_CELL,
        markers=MarkerLayout(
            n_markers=9, first=half, pull_offset=half, centre_offset=bundle.radius
        ),
        mishaps=NO_MISHAPS,
        date="2026-03-11",
    )


def taped_test(bundle: BundleModel, *, cycles: int = 3) -> MechanicalTest:
    """The rig with a bundle in it, straight and held by the string."""
    return MechanicalTest(
        wire=bundle,
        length=LENGTH,
        slack=None,
        cycles=cycles,
        steps_per_branch=60,
        crowding=2.0,
        n_stations=32,
    )
