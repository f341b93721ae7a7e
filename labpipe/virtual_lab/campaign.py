"""Virtual tests and a small virtual campaign, ready to be processed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from labpipe.virtual_lab.exports import write_exports
from labpipe.virtual_lab.instruments import observe
from labpipe.virtual_lab.scenario import CantileverScenario, Mishaps, Pose, Stretch

MISHAPS = (
    Mishaps(),
    Mishaps(n_gaps=4, long_gap=0.0, switch=Stretch(1, 0.62, 1.0), unlabelled=None),
    Mishaps(n_gaps=12, long_gap=0.8, switch=None, unlabelled=Stretch(2, 0.3, 0.33)),
)
"""What goes wrong in the tests of a campaign, in turn."""


def simulate_test(scenario: CantileverScenario, folder: Path, seed: int) -> Path:
    """Run a virtual test and write its exports, test sheet and truth.

    Parameters
    ----------
    scenario : the test
    folder : of this test; made if it is not there
    seed : the same seed gives the same files

    Returns
    -------
    The folder.

    Raises
    ------
    ValueError
        If the scenario has no solution or asks for what is not allowed.
    """
    return write_exports(observe(scenario, seed), folder)


def simulate_campaign(
    folder: Path,
    *,
    samples: int = 3,
    rate: float = 1000.0,
    scatter: float = 0.03,
    seed: int = 1,
) -> list[Path]:
    """Run a small campaign: samples of one A2 spool, each with mishaps of its own.

    Parameters
    ----------
    folder : one folder per test is made in it
    samples : how many
    rate : Hz, of the force recorder
    scatter : relative standard deviation of the wire's moments between samples
    seed : the same seed gives the same files

    Returns
    -------
    The folders of the tests.
    """
    scenarios = campaign_scenarios(samples=samples, rate=rate, scatter=scatter, seed=seed)
    return [
        simulate_test(scenario, folder / scenario.name, seed=1000 * seed + number)
        for number, scenario in enumerate(scenarios, start=1)
    ]


def campaign_scenarios(
    *, samples: int, rate: float, scatter: float, seed: int
) -> list[CantileverScenario]:
    """The tests of `simulate_campaign`: wires, clocks and poses differ from sample to sample."""
    random = np.random.default_rng([seed, 5])
    return [_sample(number, rate, scatter, random) for number in range(1, samples + 1)]


def _sample(
    number: int, rate: float, scatter: float, random: np.random.Generator
) -> CantileverScenario:
    usual = CantileverScenario()
    wire = usual.mechanics.wire.scaled(float(np.exp(scatter * random.standard_normal())))
    return replace(
        usual,
        name=f"A2-085-{number}",
        sample=number,
        mechanics=replace(usual.mechanics, wire=wire, slack=float(random.uniform(0.5e-3, 2e-3))),
        clocks=replace(
            usual.clocks,
            rate=rate,
            offset=float(random.uniform(0.3, 2.5)),
            drift=float(random.uniform(-60e-6, 60e-6)),
        ),
        pose=Pose(yaw=float(random.uniform(0.3, 0.9))),
        mishaps=MISHAPS[(number - 1) % len(MISHAPS)],
    )
