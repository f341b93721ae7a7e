"""A virtual campaign of harness bundles: taped ones (Table 4.1) and those in a conduit (Table 4.2).

Three samples of each of eleven and eight types differ by a factor on all moments, log-normal with a
standard deviation of 4 %; each test has clocks, a pose and a twist of its own; all tests with one
load cell share what its gain is off by. Of every third conduit bundle the load frame's export was
not kept: crosshead speed and time have to do.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from labpipe.virtual_lab.conduit_bundle import (
    CONDUIT_TYPES,
    LOAD_CELL,
    ConduitClocks,
    ConduitScenario,
    conduit_scenario,
)
from labpipe.virtual_lab.conduit_exports import (
    ConduitObservation,
    observe_conduit,
    simulate_conduit,
)
from labpipe.virtual_lab.scenario import Pose
from labpipe.virtual_lab.taped_bundle import TapedCampaign, simulate_taped

_WITHOUT_FRAME = 3


@dataclass(frozen=True, slots=True)
class ConduitCampaign:
    """How a campaign of conduit bundles is run.

    Parameters
    ----------
    types : keys of `CONDUIT_TYPES`, in order
    samples : of each type
    scatter : standard deviation of the logarithm of a sample's factor on its bundle's moments
    rate : Hz, of the force recorder
    fps : frames per second of the cameras
    """

    types: tuple[str, ...] = tuple(CONDUIT_TYPES)
    samples: int = 3
    scatter: float = 0.04
    rate: float = 500.0
    fps: float = 25.0


def simulate_harness(
    folder: Path,
    *,
    seed: int = 1,
    samples: int = 3,
    taped: TapedCampaign | None = None,
    conduits: ConduitCampaign | None = None,
) -> list[Path]:
    """Run both campaigns and write the exports, test sheets and truths.

    Parameters
    ----------
    folder : one folder per test is made in it
    seed : the same seed gives the same files
    samples : of each type, where the campaigns are not given
    taped, conduits : how; None for what `small_campaigns` says

    Returns
    -------
    The folders of the tests: 57 of them with three samples of all nineteen types.
    """
    usual_taped, usual_conduits = small_campaigns(samples)
    taped, conduits = taped or usual_taped, conduits or usual_conduits
    return simulate_taped(taped, folder, seed) + [
        simulate_conduit(scenario, folder / scenario.name, seed=own)
        for scenario, own in conduit_scenarios(conduits, seed)
    ]


def small_campaigns(samples: int = 3) -> tuple[TapedCampaign, ConduitCampaign]:
    """Both campaigns with as few recorded numbers as their evaluation can do with."""
    return (
        TapedCampaign(samples=samples, rate=100.0, fps=12.5, cycles=2),
        ConduitCampaign(samples=samples, rate=200.0, fps=12.5),
    )


def observe_conduits(campaign: ConduitCampaign, seed: int = 1) -> Iterator[ConduitObservation]:
    """Run a campaign of conduit bundles in memory, one test after the other.

    Parameters
    ----------
    campaign : how
    seed : the same seed gives the same tests as on disk
    """
    for scenario, own in conduit_scenarios(campaign, seed):
        yield observe_conduit(scenario, own)


def conduit_scenarios(
    campaign: ConduitCampaign, seed: int = 1
) -> Iterator[tuple[ConduitScenario, int]]:
    """The tests of a campaign of conduit bundles, each with its own seed.

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
        If a type is none of `CONDUIT_TYPES`.
    """
    random = np.random.default_rng([seed, 67])
    gain_error = LOAD_CELL.gain_uncertainty * float(random.standard_normal())
    for kind, name in enumerate(campaign.types):
        for sample in range(1, campaign.samples + 1):
            scenario = _sample(campaign, name, sample, gain_error, random)
            yield scenario, 100_000 * seed + 50_000 + 100 * kind + sample


def _sample(
    campaign: ConduitCampaign,
    name: str,
    sample: int,
    gain_error: float,
    random: np.random.Generator,
) -> ConduitScenario:
    usual = conduit_scenario(name)
    factor = float(np.exp(campaign.scatter * random.standard_normal()))
    clocks = ConduitClocks(
        rate=campaign.rate,
        fps=campaign.fps,
        trigger_lag=float(random.uniform(2e-3, 12e-3)),
        recorder_drift=float(random.uniform(-40e-6, 40e-6)),
        camera_lead=float(random.uniform(0.5, 3.0)),
    )
    twist = float(random.choice([-1.0, 1.0]) * random.uniform(0.03, 0.12))
    return replace(
        usual,
        name=f"{name}-{sample}",
        sample=sample,
        factor=factor,
        clocks=clocks,
        load_cell=replace(usual.load_cell, gain_error=gain_error),
        markers=replace(usual.markers, twist=twist),
        pose=Pose(yaw=float(random.uniform(-0.4, 0.4))),
        has_frame_export=sample % _WITHOUT_FRAME != 0,
    )
