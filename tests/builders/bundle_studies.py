"""Virtual tests of harness bundles in memory, processed by the shipped protocols, and their truth.

What a test sheet says of length, span and speed is off by as much as the protocol states, and each
test has a load cell of its own: what an interval allows for has to happen. What intervals do not
contain (docs/explanations/intervals.md), such as where the markers sit, is exact.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from labpipe.process.reading import name_channels
from labpipe.process.story import reduce_recordings
from labpipe.protocol.load import load_test_sheet, resolve
from labpipe.protocol.schema import Protocol
from labpipe.records.recording import Recording
from labpipe.records.result import Result
from labpipe.virtual_lab import CantileverScenario, ConduitObservation, Observation, observe
from labpipe.virtual_lab.bundles import TAPED_TYPES
from labpipe.virtual_lab.campaigns import ConduitCampaign, TapedCampaign
from labpipe.virtual_lab.cantilever_path import solve_path
from labpipe.virtual_lab.conduit_scenarios import CONDUIT_TYPES, ConduitScenario
from labpipe.virtual_lab.curve_truth import KINK_WINDOW, LoadingTruth, evaluate_taped
from labpipe.virtual_lab.sheet_texts import write_sheet

LENGTH_ERROR, SPEED_ERROR = 0.5e-3, 0.005
"""Standard uncertainties that the protocols state: of length and span, m, and of the speed."""


@dataclass(frozen=True, slots=True)
class Checked:
    """One result of one test against what is true.

    Parameters
    ----------
    test : name and seed
    result : as the pipeline gives it
    true : in the result's unit
    """

    test: str
    result: Result
    true: float

    @property
    def is_covered(self) -> bool:
        interval = self.result.interval
        return interval is not None and interval.lower <= self.true <= interval.upper

    @property
    def z(self) -> float:
        """Deviation in standard errors, by the half of the interval that the truth lies in."""
        interval, value = self.result.interval, self.result.value
        if interval is None or value is None:
            return float("nan")
        half = value - interval.lower if self.true < value else interval.upper - value
        return 1.96 * (value - self.true) / half


def taped_tests(
    runs: int, seed: int, *, cycles: int = 2
) -> Iterator[tuple[CantileverScenario, int]]:
    """As many tests of taped bundles, of all types in turn, each with a load cell of its own.

    Samples of a type are alike, so that they share their mechanics.
    """
    kinds = list(TAPED_TYPES)
    usual = TapedCampaign(samples=1, rate=100.0, fps=12.5, cycles=cycles, scatter=0.0)
    for number in range(runs):
        wanted = replace(usual, types=(kinds[number % len(kinds)],))
        ((test, own),) = wanted.scenarios(1000 * seed + number)
        yield replace(test, load_cell=replace(test.load_cell, gain_error=None)), own


def conduit_tests(runs: int, seed: int) -> Iterator[tuple[ConduitScenario, int]]:
    """As many tests of conduit bundles, of all types in turn; every third without frame export."""
    for number in range(runs):
        kind = list(CONDUIT_TYPES)[number % len(CONDUIT_TYPES)]
        wanted = ConduitCampaign(types=(kind,), samples=1, rate=200.0, fps=12.5)
        ((test, own),) = wanted.scenarios(1000 * seed + number)
        cell = replace(test.load_cell, gain_error=None)
        yield replace(test, load_cell=cell, has_frame_export=number % 3 != 2), own


def check_taped(
    scenario: CantileverScenario, seed: int, folder: Path, protocols: Path
) -> tuple[tuple[Result, ...], list[Checked]]:
    """Observe and process a test of a taped bundle.

    Parameters
    ----------
    scenario, seed : the test
    folder : for its sheet
    protocols : the shipped ones

    Returns
    -------
    All results, and those of which the truth is known.
    """
    test = observe(scenario, seed)
    plan = _plan(write_sheet(_as_measured(scenario, seed)), folder, protocols)
    results = _reduced({"force": test.force, "markers": test.markers}, plan)
    return results, _against(f"{scenario.name} {seed}", results, taped_truth(test))


def check_conduit(
    scenario: ConduitScenario, seed: int, folder: Path, protocols: Path
) -> tuple[tuple[Result, ...], list[Checked]]:
    """The same of a conduit bundle; its bending stiffness is that of small deflections on edges."""
    test = observe(scenario, seed)
    roles: dict[str, Recording] = {"force": test.force, "markers": test.markers}
    if test.frame is not None:
        roles["frame"] = _in_file(test.frame)
    random = np.random.default_rng([seed, 71])
    span = scenario.test.span + LENGTH_ERROR * random.standard_normal()
    scale = 1.0 + SPEED_ERROR * random.standard_normal()  # of the way that speed and time make
    said = replace(
        scenario,
        test=replace(scenario.test, span=span, stroke=scale * scenario.test.stroke),
        speed=scale * scenario.speed,
    )
    sheet = write_sheet(said, {role: (f"{role}.mat",) for role in roles})
    plan = _plan(sheet, folder, protocols)
    results = _reduced(roles, plan)
    return results, _against(f"{scenario.name} {seed}", results, conduit_truth(test))


def _in_file(frame: Recording) -> Recording:
    """The crosshead in millimetres, before the protocol's names and units are put to it."""
    channels = tuple(
        replace(each, values=1e3 * each.values, unit="mm")
        for each in frame.channels
        if each.name == "Crosshead"
    )
    return replace(frame, channels=channels)


def _as_measured(scenario: CantileverScenario, seed: int) -> CantileverScenario:
    """What a person writes down: the length as it was measured. Offsets of markers are exact."""
    off = LENGTH_ERROR * float(np.random.default_rng([seed, 73]).standard_normal())
    mechanics = scenario.mechanics
    return replace(scenario, mechanics=replace(mechanics, length=mechanics.length + off))


def _plan(sheet: str, folder: Path, protocols: Path) -> Protocol:
    path = folder / "test.yaml"
    path.write_text(sheet, encoding="utf-8")
    return resolve(load_test_sheet(path), path, protocols)


def _reduced(roles: dict[str, Recording], plan: Protocol) -> tuple[Result, ...]:
    named: dict[str, Recording] = {
        role: name_channels(roles[role], source, Path(role)) if role != "markers" else roles[role]
        for role, source in plan.sources.items()
    }
    return reduce_recordings(named, plan).results


def _against(name: str, results: tuple[Result, ...], true: dict[str, float]) -> list[Checked]:
    return [Checked(name, each, _signed(each, true)) for each in results if each.name in true]


def _signed(result: Result, true: dict[str, float]) -> float:
    """Which end of a specimen is its first is nobody's to say, and so the sense of its twist."""
    value = true[result.name]
    return abs(value) * float(np.sign(result.value or 1.0)) if result.name == "twist" else value


def taped_truth(test: Observation) -> dict[str, float]:
    """Every number that is known of a taped bundle, by the name of its result."""
    told, clocks = evaluate_taped(solve_path(test.scenario.mechanics)), test.scenario.clocks
    values = {"clock_offset": clocks.offset, "clock_drift": clocks.drift}
    values |= _of_loading(told.loading, told.bending_stiffness)
    for number, each in enumerate(test.truth.cycles, start=1):
        values[f"peak_force.{number}"] = each.peak_force
        values[f"peak_displacement.{number}"] = each.peak_deflection
        values[f"energy.{number}"] = each.energy
        values[f"loading_stiffness.{number}"] = told.loading_stiffness[number - 1]
        values[f"hardening.{number}"] = told.hardening[number - 1]
        if each.residual_deflection is not None:
            values[f"residual_displacement.{number}"] = each.residual_deflection
    values["initial_stiffness"] = _gain_in_time(test)
    return values


def _gain_in_time(test: Observation) -> float:
    """Ratio of what force and deflection gain in time over the window of the first loading."""
    path = solve_path(test.scenario.mechanics)
    progress = np.linspace(0.0, 0.5 * path.test.stroke, 40_001)
    deflection = path.deflection(progress)
    first, last = np.searchsorted(deflection, KINK_WINDOW)
    part = slice(int(first), int(last))
    lever = progress[part] - progress[part].mean()
    force = path.tension(progress[part]) - path.rest.tension
    return float((lever @ force) / (lever @ deflection[part]))


def _of_loading(loading: LoadingTruth, bending_stiffness: float) -> dict[str, float]:
    values = {
        "initial_stiffness": loading.windowed_stiffness,
        "bending_stiffness": bending_stiffness,
        "kink_displacement": loading.kink.displacement,
        "kink_force": loading.kink.force,
        "end_slope": loading.end_slope,
    }
    if loading.plateau_displacement is not None and loading.plateau_force is not None:
        values["plateau_displacement"] = loading.plateau_displacement
        values["plateau_force"] = loading.plateau_force
    return values


def conduit_truth(test: ConduitObservation) -> dict[str, float]:
    """Every number that is known of a conduit bundle, by the name of its result."""
    truth = test.truth
    values = _of_loading(truth.loading, truth.bending_stiffness) | {
        "peak_force.1": truth.peak_force,
        "peak_displacement.1": test.scenario.test.stroke,  # not the place of the largest force
        "energy.1": truth.energy,
        "mid_span_curvature": truth.middle.curvature,
        "mid_span_bending_stiffness": truth.middle.bending_stiffness,
        "twist": truth.middle.twist,
    }
    if test.frame is not None:
        values["clock_offset"] = truth.clocks["force_offset"]
        values["clock_drift"] = truth.clocks["drift"]
    return values
