"""Intervals and bands of a calibration hold as often as they say, from recordings on.

Seeded campaigns of the virtual lab go through the same reduction as exports do: force in volts on
a clock of its own, markers at 25 frames per second with gaps and mistaken labels. Three samples of
A2 calibrate; a sample of A1, and one of B1 on another length, are predicted. Counts are held
against 95 % by an exact two-sided binomial test at 1 %, which the numbers of the study share. A
campaign of which a test is refused, as the command would with a reason, is not counted; hardly any
may be.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from scipy.stats import binomtest

from labpipe.records.wire_calibration import PARAMETERS, Calibration
from labpipe.report.calibration_shown import ValidationGroup
from labpipe.studies.first_loadings import NotUsableError
from labpipe.studies.validation import compare
from labpipe.units import GRAVITY
from labpipe.virtual_lab.cantilever_scenarios import (
    CantileverScenario,
    LoadCell,
    wire_scenario,
)
from labpipe.virtual_lab.specimens import WIRES
from labpipe.wire.calibration.calibrate_wire import Settings, calibrate
from tests.builders.wire_chain import CALIBRATED, UNUSED, gain_read, loadings_of, mean_curve, wires

FIRST_SEED, RUNS, WORKERS = 2001, 200, 2


MOST_REFUSED = 4


TRUTH = np.array([WIRES[CALIBRATED].parameters[name] for name in PARAMETERS])


AT = np.array([0.005, 0.02, 0.05])
"""Deflections, m, at which bands are looked at."""


NUMBERS = len(PARAMETERS) + 2 * len(UNUSED) * len(AT)
"""That share the 1 %."""


@dataclass(frozen=True)
class Hits:
    """What held: parameters (3,); bands of the mean, and of one more sample (wires, 3).

    Of so many campaigns.
    """

    parameters: np.ndarray
    mean: np.ndarray
    sample: np.ndarray
    campaigns: int = 1


def study(seeds: Sequence[int], protocols: Path) -> Hits:
    """Hits of some campaigns."""
    with TemporaryDirectory() as folder:
        found = [campaign(seed, protocols, Path(folder)) for seed in seeds]
        return together([each for each in found if each is not None])


def together(hits: Sequence[Hits]) -> Hits:
    return Hits(
        sum((each.parameters for each in hits), np.zeros(3, np.int64)),
        sum((each.mean for each in hits), np.zeros((len(UNUSED), len(AT)), np.int64)),
        sum((each.sample for each in hits), np.zeros((len(UNUSED), len(AT)), np.int64)),
        sum(each.campaigns for each in hits),
    )


def campaign(seed: int, protocols: Path, folder: Path) -> Hits | None:
    """Calibrate one campaign as the command does, and see what its intervals and bands hold."""
    try:
        loadings = list(loadings_of(seed, protocols, folder))
    except NotUsableError:
        return None
    own = [each for each in loadings if each.curve.wire == CALIBRATED]
    built = wires(folder)
    settings = Settings(gain=max(each.gain for each in own))
    found = calibrate(built[CALIBRATED], [each.curve for each in own], settings)
    assert isinstance(found, Calibration)
    assert found.friction_separability is not None
    assert not any(found.friction_separability.are_identified.values())
    inside = [
        any(part.lower <= value <= part.upper for part in parameter.intervals)
        for parameter, value in zip(found.parameters, TRUTH, strict=True)
    ]
    groups = {(each.wire, each.length): each for each in compare(found, built, loadings)}
    gain = gain_read(seed)
    held = np.array([in_bands(groups[key], gain) for key in UNUSED], dtype=np.int64)
    return Hits(np.array(inside, dtype=np.int64), held[:, 0], held[:, 1])


def in_bands(group: ValidationGroup, gain: float) -> tuple[np.ndarray, np.ndarray]:
    """Whether the bands hold the true curve of the mean sample, and the points of the tested one.

    At the measured points next to where they are looked at; all is read by the same load cell.
    """
    band, (sample,) = group.prediction, group.samples.values()
    assert band is not None
    nearest = [int(np.argmin(np.abs(sample.displacement - at))) for at in AT]
    deflection, force = sample.displacement[nearest], sample.force[nearest]
    truth = gain * mean_curve(group.wire, group.length)(deflection)
    lower, upper, lower_mean, upper_mean = (
        np.interp(deflection, band.deflection, values)
        for values in (band.lower, band.upper, band.lower_mean, band.upper_mean)
    )
    return (
        (lower_mean <= truth) & (truth <= upper_mean),
        (lower <= force) & (force <= upper),
    )


@pytest.fixture(scope="module")
def hits(repository: Path) -> Hits:
    protocols = repository / "protocols"
    blocks = [range(FIRST_SEED + n, FIRST_SEED + RUNS, WORKERS) for n in range(WORKERS)]
    with ProcessPoolExecutor(WORKERS, mp_context=get_context("fork")) as workers:
        return together(list(workers.map(study, blocks, [protocols] * WORKERS)))


@pytest.mark.slow
def test_parameters_and_bands_are_covered(hits: Hits) -> None:
    assert hits.campaigns >= RUNS - MOST_REFUSED
    for part in (hits.parameters, hits.mean, hits.sample):
        for count in part.ravel():
            chance = binomtest(int(count), hits.campaigns, 0.95).pvalue
            assert chance > 0.01 / NUMBERS, f"{count} of {hits.campaigns}: {part.tolist()}"


WEIGHT = 0.0027 * GRAVITY


def scenario(name: str = "A3", factor: float = 1.0) -> CantileverScenario:
    return replace(
        CantileverScenario(),
        mechanics=wire_scenario(WIRES[name].scaled(factor), 0.085).mechanics,
        load_cell=LoadCell(gain_error=0.01, noise=1e-3),
    )
