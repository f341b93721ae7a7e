"""Define campaigns of virtual tests: their specimens, the scatter of samples, and mishaps.

The parameters of a campaign determine its scenarios. All tests with one load cell have the same
gain error; each bending test has its own clocks and pose.

References
----------
.. [1] *Modeling and characterization of wire harnesses for digital manufacturing applications*,
       dissertation.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from labpipe.virtual_lab.cantilever_scenarios import (
    TAPED_CELL,
    WIRE_CELL,
    CantileverScenario,
    Clocks,
    build_taped_scenario,
    build_wire_scenario,
)
from labpipe.virtual_lab.instruments import MISHAPS, NO_MISHAPS, Pose
from labpipe.virtual_lab.lab_files import Scenario, simulate_test
from labpipe.virtual_lab.specimens import CONDUIT_TYPES, TAPED_TYPES, WIRES, StrandedWire
from labpipe.virtual_lab.tensile import (
    GAIN_UNCERTAINTY,
    TABLE_2_3,
    GripSlip,
    TensileScenario,
    build_corrugated_tube,
    build_pet_tape,
    build_stiff_bar,
    build_twist_tube,
)
from labpipe.virtual_lab.three_point import (
    CONDUIT_CELL,
    ConduitClocks,
    ConduitScenario,
    build_conduit_scenario,
)


class Campaign(Protocol):
    """Set of virtual tests."""

    def list_scenarios(self, seed: int = 1) -> Iterator[tuple[Scenario, int]]:
        """Yield the tests, each with its own seed.

        Parameters
        ----------
        seed : seed of the scatter between samples and of the gain errors

        Yields
        ------
        Scenario and seed of the test. Equal seeds of the campaign give equal tests, and the seeds
        of its tests are unique.

        Raises
        ------
        KeyError
            If a type or a name is unknown.
        """


def simulate_campaigns(campaigns: Iterable[Campaign], folder: Path, seed: int = 1) -> list[Path]:
    """Simulate campaigns and write exports, test sheets and true values.

    Parameters
    ----------
    campaigns : campaigns, in order
    folder : folder in which each test gets a folder
    seed : seed of the campaigns; equal seeds give equal files

    Returns
    -------
    Folder of each test, in order.
    """
    return [
        simulate_test(scenario, folder / scenario.name, test_seed)
        for campaign in campaigns
        for scenario, test_seed in campaign.list_scenarios(seed)
    ]


@dataclass(frozen=True, slots=True)
class ChosenTests:
    """Chosen tests of campaigns.

    Parameters
    ----------
    campaigns : campaigns that contain the tests; their order is kept
    names : names of the chosen tests
    """

    campaigns: Sequence[Campaign]
    names: tuple[str, ...]

    def list_scenarios(self, seed: int = 1) -> Iterator[tuple[Scenario, int]]:
        """Yield the tests; see `Campaign`."""
        tests = [test for campaign in self.campaigns for test in campaign.list_scenarios(seed)]
        if unknown_names := set(self.names) - {scenario.name for scenario, _ in tests}:
            raise KeyError(*sorted(unknown_names))
        yield from (test for test in tests if test[0].name in self.names)


class WireGroup(NamedTuple):
    """Samples of one wire and length.

    Parameters
    ----------
    wire : wire of all samples, without the factor of a sample
    length : length from the clamped end to the pull point, m
    """

    wire: StrandedWire
    length: float


WIRE_GROUPS = (
    *(WireGroup(WIRES[name], 0.085) for name in ("A1", "A2", "A3")),
    *(WireGroup(WIRES[name], length) for name in ("B1", "B2") for length in (0.085, 0.1)),
)
"""Three wires with samples of 85 mm, and two wires with samples of 85 mm and of 100 mm. In [1]_ the
samples of A3 are 120 mm long, which protects the load cell; here they are 85 mm long."""


@dataclass(frozen=True, slots=True)
class WireCampaign:
    """Single wires in the cantilever rig, for calibration.

    Parameters
    ----------
    groups : wires and lengths, in order; samples of one wire are of one spool
    samples : number of samples of each group
    scatter : standard deviation of the logarithm of the factor on the moments of a sample
    rate : sampling rate of the force recorder, Hz
    fps : frames per second of the cameras
    cycles : number of cycles of each test
    has_mishaps : whether markers are lost or mislabelled
    """

    groups: tuple[WireGroup, ...] = WIRE_GROUPS
    samples: int = 3
    scatter: float = 0.03
    rate: float = 200.0
    fps: float = 50.0
    cycles: int = 3
    has_mishaps: bool = True

    def list_scenarios(self, seed: int = 1) -> Iterator[tuple[CantileverScenario, int]]:
        """Yield the tests; see `Campaign`. Samples of a wire are numbered over all its lengths."""
        random = np.random.default_rng([seed, 41])
        gain_error = WIRE_CELL.gain_uncertainty * float(random.standard_normal())
        counts: Counter[str] = Counter()
        for wire, length in (group for group in self.groups for _ in range(self.samples)):
            counts[wire.name] += 1
            sample = counts[wire.name]
            sample_wire = replace(wire, factor=_draw_factor(random, self.scatter))
            scenario = build_wire_scenario(sample_wire, length, cycles=self.cycles)
            name = f"{wire.name}-{1e3 * length:03.0f}-{sample}"
            scenario = replace(scenario, name=name, sample=sample)
            scenario = _set_up_rig(self, scenario, gain_error, random)
            mishaps = scenario.mishaps if self.has_mishaps else NO_MISHAPS
            yield replace(scenario, mishaps=mishaps), 1000 * seed + counts.total()


@dataclass(frozen=True, slots=True)
class TapedCampaign:
    """Taped bundles (Table 4.1 of [1]_) in the cantilever rig.

    Parameters
    ----------
    types : keys of `TAPED_TYPES`, in order
    samples : number of samples of each type
    scatter : standard deviation of the logarithm of the factor on the moments of a sample
    rate : sampling rate of the force recorder, Hz
    fps : frames per second of the cameras
    cycles : number of cycles of each test
    """

    types: tuple[str, ...] = tuple(TAPED_TYPES)
    samples: int = 3
    scatter: float = 0.04
    rate: float = 200.0
    fps: float = 25.0
    cycles: int = 3

    def list_scenarios(self, seed: int = 1) -> Iterator[tuple[CantileverScenario, int]]:
        """Yield the tests; see `Campaign`."""
        random = np.random.default_rng([seed, 61])
        gain_error = TAPED_CELL.gain_uncertainty * float(random.standard_normal())
        for type_index, name in enumerate(self.types):
            for sample in range(1, self.samples + 1):
                factor = _draw_factor(random, self.scatter)
                scenario = build_taped_scenario(name, cycles=self.cycles, factor=factor)
                scenario = replace(scenario, name=f"{name}-{sample}", sample=sample)
                test_seed = 100_000 * seed + 100 * type_index + sample
                yield _set_up_rig(self, scenario, gain_error, random), test_seed


def _set_up_rig(
    campaign: WireCampaign | TapedCampaign,
    scenario: CantileverScenario,
    gain_error: float,
    random: np.random.Generator,
) -> CantileverScenario:
    """Set the gain error of the campaign, and draw clocks and pose of a test."""
    offset, drift = float(random.uniform(0.3, 2.5)), float(random.uniform(-60e-6, 60e-6))
    return replace(
        scenario,
        clocks=Clocks(rate=campaign.rate, fps=campaign.fps, offset=offset, drift=drift),
        load_cell=replace(scenario.load_cell, gain_error=gain_error),
        pose=Pose(yaw=float(random.uniform(0.3, 0.9))),
        mishaps=MISHAPS[(scenario.sample - 1) % len(MISHAPS)],
    )


@dataclass(frozen=True, slots=True)
class ConduitCampaign:
    """Bundles in a conduit (Table 4.2 of [1]_) in three-point bending.

    Every third sample has no export of the load frame, so that the displacement must be computed
    from speed and time.

    Parameters
    ----------
    types : keys of `CONDUIT_TYPES`, in order
    samples : number of samples of each type
    scatter : standard deviation of the logarithm of the factor on the moments of a sample
    rate : sampling rate of the force recorder, Hz
    fps : frames per second of the cameras
    """

    types: tuple[str, ...] = tuple(CONDUIT_TYPES)
    samples: int = 3
    scatter: float = 0.04
    rate: float = 500.0
    fps: float = 25.0

    def list_scenarios(self, seed: int = 1) -> Iterator[tuple[ConduitScenario, int]]:
        """Yield the tests; see `Campaign`. Each has its own factor, clocks, twist and pose."""
        random = np.random.default_rng([seed, 67])
        gain_error = CONDUIT_CELL.gain_uncertainty * float(random.standard_normal())
        for type_index, name in enumerate(self.types):
            conduit = build_conduit_scenario(name)
            for sample in range(1, self.samples + 1):
                factor = _draw_factor(random, self.scatter)
                clocks = ConduitClocks(
                    rate=self.rate,
                    fps=self.fps,
                    trigger_lag=float(random.uniform(2e-3, 12e-3)),
                    recorder_drift=float(random.uniform(-40e-6, 40e-6)),
                    camera_lead=float(random.uniform(0.5, 3.0)),
                )
                twist = float(random.choice([-1.0, 1.0]) * random.uniform(0.03, 0.12))
                scenario = replace(
                    conduit,
                    name=f"{name}-{sample}",
                    sample=sample,
                    factor=factor,
                    clocks=clocks,
                    load_cell=replace(conduit.load_cell, gain_error=gain_error),
                    markers=replace(conduit.markers, twist=twist),
                    pose=Pose(yaw=float(random.uniform(-0.4, 0.4))),
                    has_frame_export=sample % 3 != 0,
                )
                yield scenario, 100_000 * seed + 50_000 + 100 * type_index + sample


SMALL_HARNESS = (
    TapedCampaign(rate=100.0, fps=12.5, cycles=2),
    ConduitCampaign(rate=200.0, fps=12.5),
)
"""Bundles in tape and in conduits with small recordings: 57 tests, three of each type."""


_SMALL_TUBE = (("outer_diameter", 10.2e-3), ("inner_diameter", 7.4e-3))
_TUBES = {"CT-10-slit": (1.0, ()), "CT-10": (1.1, ()), "CT-7": (1.2, _SMALL_TUBE)}
"""Factor on the forces, and dimensions, m, that differ from the protocol, keyed by tube type."""
_SLIPS = {
    "CT-10-slit-2": (GripSlip(18.75e-3, 0.47), GripSlip(30.85e-3, 0.81)),
    "CT-7-3": (GripSlip(24.3e-3, 0.62, duration=0.1),),
}
"""Slips in the grips, keyed by the name of the test."""
_UNLOADING_TEST = "CT-10-3"
"""Name of the test that includes unloading."""
_MULTI_FILE_SAMPLE = "2b"
"""Name of the sample whose export has several files."""
_TAPES = ((1.01, 60e-3), (1.01, 40e-3), (1.01, 60e-3), (0.98, 60e-3), (0.98, 60e-3))
"""Factor on the forces, and displacement at failure, m, of each tape."""


@dataclass(frozen=True, slots=True)
class TensileCampaign:
    """Tensile tests of tubes and tapes, and of a bar that measures the compliance of the frame.

    Parameters
    ----------
    tapes : factor on the forces, and displacement at failure, m, of each tape
    """

    tapes: tuple[tuple[float, float], ...] = _TAPES

    def list_scenarios(self, seed: int = 1) -> Iterator[tuple[TensileScenario, int]]:
        """Yield the tests; see `Campaign`. Tests on one frame share the error of its load cell."""
        random = np.random.default_rng([seed, 23])
        tube_cell_error, frame_cell_error = (GAIN_UNCERTAINTY * random.standard_normal(2)).tolist()
        tests = [
            *_build_corrugated_tubes(tube_cell_error, random),
            *_build_twist_tubes(frame_cell_error, random),
            *_build_tapes(self.tapes, frame_cell_error, random),
            build_stiff_bar(gain_error=frame_cell_error),
        ]
        yield from ((test, 1000 * seed + index) for index, test in enumerate(tests, start=1))


def _build_corrugated_tubes(
    gain_error: float, random: np.random.Generator
) -> Iterator[TensileScenario]:
    """Build tests of three samples of each type of corrugated tube."""
    for tube_type, (factor, section) in _TUBES.items():
        for sample in range(1, 4):
            name = f"{tube_type}-{sample}"
            sample_factor = factor * _draw_factor(random, 0.01)
            tube = build_corrugated_tube(name, factor=sample_factor, gain_error=gain_error)
            yield replace(
                tube,
                law=replace(tube.law, slack=float(random.uniform(0.3e-3, 0.55e-3))),
                frame=replace(tube.frame, unloads=name == _UNLOADING_TEST),
                slips=_SLIPS.get(name, ()),
                section=section,
            )


def _build_twist_tubes(gain_error: float, random: np.random.Generator) -> Iterator[TensileScenario]:
    """Build tests of the samples of Table 2.3 of [1]_; one export has several files."""
    for sample in TABLE_2_3:
        tube = build_twist_tube(
            sample,
            peak_force=420.0 * _draw_factor(random, 0.04),
            slack=float(random.uniform(0.8e-3, 1.1e-3)),
            break_point=float(random.uniform(7.8e-3, 8.1e-3)),
            gain_error=gain_error,
        )
        part_at = 2.6 if sample == _MULTI_FILE_SAMPLE else None
        yield replace(tube, export=replace(tube.export, part_at=part_at))


def _build_tapes(
    tapes: Sequence[tuple[float, float]], gain_error: float, random: np.random.Generator
) -> Iterator[TensileScenario]:
    """Build tests of tapes from factor on the forces, and displacement at failure, m, of each."""
    for sample, (factor, failure_displacement) in enumerate(tapes, start=1):
        tape = build_pet_tape(
            str(sample),
            factor=factor * _draw_factor(random, 0.01),
            failure_displacement=failure_displacement * _draw_factor(random, 0.02),
            gain_error=gain_error,
        )
        slack = float(random.uniform(0.4e-3, 0.8e-3))
        yield replace(tape, law=replace(tape.law, slack=slack))


def _draw_factor(random: np.random.Generator, scatter: float) -> float:
    """Draw a factor; its logarithm has zero mean and the standard deviation `scatter`."""
    return float(np.exp(scatter * random.standard_normal()))
