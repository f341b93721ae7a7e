"""Campaigns of stranded wires from their recordings to first loadings, in memory.

What a person gets from the exports of the virtual lab by `labpipe process`, but for the files: the
same recordings, the shipped protocol with what the test sheets override, the same reduction.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from labpipe import __version__
from labpipe.process.reading import name_channels
from labpipe.process.run import reduce_test
from labpipe.protocol.load import dump_protocol, load_test_sheet, resolve
from labpipe.protocol.schema import Protocol
from labpipe.protocol.sheet_grammar import TestSheet
from labpipe.results.shapes import MomentCurvature
from labpipe.store.read import RawTest
from labpipe.studies.first_loadings import FirstLoading, first_loading
from labpipe.studies.validation import built_wire
from labpipe.studies.wire_specs import read_wire_sheet
from labpipe.virtual_lab.cameras import film_cantilever
from labpipe.virtual_lab.campaigns import WireCampaign, WireGroup
from labpipe.virtual_lab.cantilever_path import MechanicalPath, Segment, solve_path
from labpipe.virtual_lab.cantilever_scenarios import (
    CantileverScenario,
    MechanicalTest,
    wire_scenario,
)
from labpipe.virtual_lab.recorders import plan_cantilever, record_cantilever_force
from labpipe.virtual_lab.sheet_texts import write_sheet, write_wire_sheet
from labpipe.virtual_lab.specimens import WIRES, StrandedWire
from labpipe.wire.calibration.calibrate_wire import Wire

CALIBRATED = "A2"
UNUSED = (("A1", 0.085), ("B1", 0.1))
"""Wires and lengths that are predicted; one sample of each is tested."""
SAMPLES = 3
POINTS = 272
"""Of each curve, as a calibration takes them where nothing else is said."""
_FACTORS = np.array([0.8, 1.0, 1.25])
"""Of the samples whose mechanics are solved; those between are interpolated."""
_CAMPAIGN = WireCampaign(
    groups=(
        WireGroup(WIRES[CALIBRATED], 0.085),
        *(WireGroup(WIRES[name], length) for name, length in UNUSED),
    ),
    samples=SAMPLES,
    fps=25.0,
    cycles=2,
)


def loadings_of(seed: int, protocols: Path, folder: Path) -> Iterator[FirstLoading]:
    """First loadings of a campaign: three samples of the calibrated wire, one of each other.

    Parameters
    ----------
    seed : of the campaign: scatter of the samples, gain of the load cell, noise, mishaps
    protocols : folder of the shipped ones
    folder : test sheets are written there
    """
    for scenario, own in _CAMPAIGN.scenarios(seed):
        if scenario.specimen_type == CALIBRATED or (scenario.sample - 1) % SAMPLES == 0:
            yield processed(scenario, own, protocols, folder)


def processed(
    scenario: CantileverScenario, seed: int, protocols: Path, folder: Path
) -> FirstLoading:
    """Observe a test and reduce it to its first loading."""
    path = folder / f"{scenario.name}.yaml"
    path.write_text(write_sheet(scenario), encoding="utf-8")
    sheet = load_test_sheet(path)
    protocol = _without_law(resolve(sheet, path, protocols))
    raw = observed(scenario, seed, protocol, sheet)
    return first_loading(reduce_test(raw, protocol), protocol, points=POINTS)


def observed(
    scenario: CantileverScenario, seed: int, protocol: Protocol, sheet: TestSheet
) -> RawTest:
    """What would be read from the exports of a test, as `virtual_lab.observations` makes them."""
    path, schedule = path_of(scenario.mechanics), plan_cantilever(scenario)
    force_seed, marker_seed = np.random.SeedSequence(seed).spawn(2)
    force = record_cantilever_force(path, scenario, schedule, np.random.default_rng(force_seed))
    take = film_cantilever(path, scenario, schedule, np.random.default_rng(marker_seed))
    named = name_channels(force.recording(), protocol.sources["force"], Path("force.mat"))
    return RawTest(
        test=scenario.name,
        specimen=sheet.specimen.record,
        protocol=protocol.name,
        protocol_yaml=dump_protocol(protocol),
        test_yaml="",
        labpipe_version=__version__,
        inputs=(),
        recordings={"force": named, "markers": take.recording()},
    )


def path_of(test: MechanicalTest) -> MechanicalPath:
    """Path of a sample, from those of three others.

    With moments f times as large a wire does under a counterweight w what the plain one does under
    w / f, at f times the force, and that is smooth in 1 / f: a parabola through three solutions.
    """
    wire = _stranded(test)
    inverses = 1.0 / _FACTORS
    solved = [_plain(test, float(inverse)) for inverse in inverses]
    shares = _shares(inverses, 1.0 / wire.factor)
    mixed = zip(*(each.segments for each in solved), strict=True)
    segments = tuple(_mixed(parts, shares, wire.factor) for parts in mixed)
    return replace(solved[1], test=test, segments=segments)


def gain_read(seed: int) -> float:
    """What the load cell of a campaign reads, over what it feels."""
    scenario, _ = next(_CAMPAIGN.scenarios(seed))
    assert scenario.load_cell.gain_error is not None
    return 1.0 / (1.0 + scenario.load_cell.gain_error)


def mean_curve(name: str, length: float) -> CubicSpline:
    """True force over deflection of the first loading of a sample without scatter, N and m."""
    test = wire_scenario(WIRES[name], length, cycles=_CAMPAIGN.cycles).mechanics
    first = path_of(test).segments[0]
    return CubicSpline(first.y[:, -1] - first.y[0, -1], first.tension - first.tension[0])


def wires(folder: Path) -> Mapping[str, Wire]:
    """The wires as the sheet of the virtual lab has them.

    Parameters
    ----------
    folder : the sheet is written there
    """
    sheet = write_wire_sheet(folder)
    return {spec.name: built_wire(spec, sheet) for spec in read_wire_sheet(sheet)}


@lru_cache(maxsize=32)
def _plain(test: MechanicalTest, inverse: float) -> MechanicalPath:
    weight = test.counterweight * inverse
    return solve_path(
        replace(test, wire=replace(_stranded(test), factor=1.0), counterweight=weight)
    )


def _stranded(test: MechanicalTest) -> StrandedWire:
    assert isinstance(test.wire, StrandedWire)
    assert _FACTORS[0] <= test.wire.factor <= _FACTORS[-1]
    return test.wire


def _shares(nodes: np.ndarray, at: float) -> np.ndarray:
    """Weights of the solutions in the parabola through them (Lagrange)."""
    others = [np.delete(nodes, number) for number in range(len(nodes))]
    return np.array(
        [np.prod((at - other) / (own - other)) for own, other in zip(nodes, others, strict=True)]
    )


def _mixed(parts: tuple[Segment, ...], shares: np.ndarray, factor: float) -> Segment:
    """A stretch of the path; all have the same positions, for no string goes slack."""
    for part in parts:
        np.testing.assert_array_equal(part.progress, parts[0].progress)

    def mix(name: str) -> np.ndarray:
        return np.asarray(np.tensordot(shares, [getattr(part, name) for part in parts], axes=1))

    return replace(
        parts[0], tension=factor * mix("tension"), x=mix("x"), y=mix("y"), angle=mix("angle")
    )


def _without_law(protocol: Protocol) -> Protocol:
    """Leave out the measured law of bending, which no first loading asks for."""
    kept = tuple(each for each in protocol.results if not isinstance(each, MomentCurvature))
    figures = tuple(each for each in protocol.report.figures if each != "moment-curvature")
    report = protocol.report.model_copy(update={"figures": figures})
    return protocol.model_copy(update={"results": kept, "report": report})
