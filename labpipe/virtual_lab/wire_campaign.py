"""A virtual campaign to calibrate by: samples of five wires, two of them in two lengths.

Calibrations may take one of them (A2) and predict the others. The source makes the samples of A3
120 mm long to spare its load cell; here they are 85 mm, as those of A1 and A2 are.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

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
from labpipe.virtual_lab.stranded import WIRES, StrandedWire

LOAD_CELL = LoadCell(gain=0.05, gain_uncertainty=0.002, noise=0.5e-3)
"""A cell of 0.5 N for forces of 20 to 250 mN, with a noise of a thousandth of that at any rate. All
tests of a campaign share what its gain is off by."""


@dataclass(frozen=True, slots=True)
class WireGroup:
    """Samples of one wire and length.

    Parameters
    ----------
    wire : as all its samples are, but for their own factor
    length : m, clamped end to pull point
    """

    wire: StrandedWire
    length: float


GROUPS = (
    *(WireGroup(WIRES[name], 0.085) for name in ("A1", "A2", "A3")),
    *(WireGroup(WIRES[name], length) for name in ("B1", "B2") for length in (0.085, 0.1)),
)
"""Three wires of 85 mm, and two of both 85 and 100 mm."""


@dataclass(frozen=True, slots=True)
class WireCampaign:
    """How a campaign is run.

    Parameters
    ----------
    groups : wires and lengths, in order; samples of one wire are of one spool
    samples : of each group
    scatter : standard deviation of the logarithm of a sample's factor on its wire's moments
    rate : Hz, of the force recorder
    fps : frames per second of the cameras
    cycles : of each test
    has_mishaps : whether markers are lost and mistaken
    """

    groups: tuple[WireGroup, ...] = GROUPS
    samples: int = 3
    scatter: float = 0.03
    rate: float = 200.0
    fps: float = 50.0
    cycles: int = 3
    has_mishaps: bool = True


def wire_campaign(
    folder: Path,
    *,
    samples: int = 3,
    rate: float = 200.0,
    fps: float = 50.0,
    cycles: int = 3,
    seed: int = 1,
) -> list[Path]:
    """Run the usual campaign and write the exports, test sheets and truths.

    Parameters
    ----------
    folder : one folder per test is made in it
    samples, rate, fps, cycles : see `WireCampaign`
    seed : the same seed gives the same files

    Returns
    -------
    The folders of the tests.
    """
    campaign = WireCampaign(samples=samples, rate=rate, fps=fps, cycles=cycles)
    return simulate_wires(campaign, folder, seed)


def simulate_wires(campaign: WireCampaign, folder: Path, seed: int = 1) -> list[Path]:
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
        for scenario, own in wire_scenarios(campaign, seed)
    ]


def observe_wires(campaign: WireCampaign, seed: int = 1) -> Iterator[Observation]:
    """Run a campaign in memory, one test after the other.

    Parameters
    ----------
    campaign : how
    seed : the same seed gives the same tests as on disk
    """
    for scenario, own in wire_scenarios(campaign, seed):
        yield observe(scenario, own)


def wire_scenarios(
    campaign: WireCampaign, seed: int = 1
) -> Iterator[tuple[CantileverScenario, int]]:
    """The tests of a campaign, each with its own seed.

    Parameters
    ----------
    campaign : how
    seed : of what differs between samples, and of what the load cell is off by

    Yields
    ------
    Scenario and seed. Samples of a wire are numbered on from length to length.
    """
    random = np.random.default_rng([seed, 41])
    gain_error = LOAD_CELL.gain_uncertainty * float(random.standard_normal())
    made: Counter[str] = Counter()
    for group in campaign.groups:
        for _ in range(campaign.samples):
            made[group.wire.name] += 1
            scenario = _sample(campaign, group, made[group.wire.name], gain_error, random)
            yield scenario, 1000 * seed + made.total()


def _sample(
    campaign: WireCampaign,
    group: WireGroup,
    number: int,
    gain_error: float,
    random: np.random.Generator,
) -> CantileverScenario:
    wire = group.wire.scaled(float(np.exp(campaign.scatter * random.standard_normal())))
    offset, drift = float(random.uniform(0.3, 2.5)), float(random.uniform(-60e-6, 60e-6))
    return CantileverScenario(
        name=f"{wire.name}-{1e3 * group.length:03.0f}-{number}",
        specimen_type=wire.name,
        spool=f"{wire.name}-s1",
        sample=number,
        mechanics=wire_test(wire, group.length, cycles=campaign.cycles),
        clocks=Clocks(rate=campaign.rate, fps=campaign.fps, offset=offset, drift=drift),
        load_cell=replace(LOAD_CELL, gain_error=gain_error),
        markers=MarkerLayout(centre_offset=wire.diameter / 2.0),
        pose=Pose(yaw=float(random.uniform(0.3, 0.9))),
        mishaps=MISHAPS[(number - 1) % len(MISHAPS)] if campaign.has_mishaps else NO_MISHAPS,
    )


def wire_test(wire: StrandedWire, length: float, *, cycles: int = 3) -> MechanicalTest:
    """The rig of the source with a stranded wire in it, straight and held by the string.

    Parameters
    ----------
    wire : the sample
    length : m
    cycles : each a loading and an unloading branch

    Notes
    -----
    Positions are crowded where the strands begin to slip: between them the looked-up force is
    within 0.06 mN (even ones: 5 mN), with half as many stations within 0.02 mN.
    """
    return MechanicalTest(
        wire=wire,
        length=length,
        slack=None,
        cycles=cycles,
        steps_per_branch=80,
        crowding=2.5,
        n_stations=32,
    )
