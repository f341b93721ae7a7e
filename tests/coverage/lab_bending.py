"""Bending tests of the virtual lab in memory, by the shipped protocols, and what is true of them.

What a test sheet says is off by as much as the protocol states, and each test has a load cell of
its own: what an interval allows for has to happen.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from labpipe.process.reading import convert_channels
from labpipe.process.story import reduce_recordings
from labpipe.protocol.load import load_test_sheet, resolve_protocol
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Flags, Floats
from labpipe.records.recording import Recording
from labpipe.records.result import Result
from labpipe.virtual_lab import WireCampaign, observe
from labpipe.virtual_lab.campaigns import WIRE_GROUPS, ConduitCampaign, TapedCampaign
from labpipe.virtual_lab.cantilever_scenarios import (
    KINK_WINDOW,
    CantileverScenario,
    MechanicalPath,
    evaluate_bundle,
    fit_slope,
    solve_path,
)
from labpipe.virtual_lab.instruments import FORCE_PATH, LoadCell
from labpipe.virtual_lab.lab_files import Observation, format_sheet
from labpipe.virtual_lab.specimens import CONDUIT_TYPES, TAPED_TYPES
from labpipe.virtual_lab.three_point import ConduitScenario, ThreePointTest, solve_three_point
from tests.builders.bent_tests import law_moment
from tests.builders.tensile_tests import recordings_of
from tests.builders.three_point import ElasticModel
from tests.coverage.lab_tensile import wandering
from tests.judges.foreign.rig import scale, stated

Truth = dict[str, float]
CheckReport = tuple[tuple[Result, ...], Truth]

ROLES = {"force": ("force.mat",), "markers": ("take.csv",)}
SPEED_ERROR = 0.005
"""Standard uncertainty of the speed that the protocol of conduits states."""
WIRE_WINDOW, UNLOADING = (0.5e-3, 4e-3), (0.3e-3, 3e-3)
"""Of initial and unloading stiffness of wires, m; the second one below the peak."""
CURVATURES = (1.0, 3.0)
"""At which the protocol asks for the bending stiffness of a wire, 1/m."""
STEPS = 40_001
ONE = 0.02
"""Stiffness of a bar to compare with, N m^2; any will do."""


def wire(seed: int) -> CantileverScenario:
    """A wire by the numbers of its law, whose string is slack at first, with mishaps of markers."""
    usual = CantileverScenario(name=f"wire-{seed}")
    return replace(usual, clocks=replace(usual.clocks, rate=1000.0))


def stranded_wire(seed: int) -> CantileverScenario:
    """One of the wires of the virtual campaign, by turns; they share their mechanics."""
    group = WIRE_GROUPS[seed % len(WIRE_GROUPS)]
    campaign = WireCampaign(groups=(group,), samples=1, scatter=0.0, has_mishaps=False)
    ((test, _),) = campaign.list_scenarios(seed)
    return _own_cell(test)


def taped_bundle(seed: int) -> CantileverScenario:
    """A taped bundle, of all types in turn; samples of a type share their mechanics."""
    kind = list(TAPED_TYPES)[seed % len(TAPED_TYPES)]
    campaign = TapedCampaign(types=(kind,), samples=1, rate=100.0, fps=12.5, cycles=2, scatter=0.0)
    ((test, _),) = campaign.list_scenarios(seed)
    return _own_cell(test)


def conduit_bundle(seed: int) -> ConduitScenario:
    """A bundle in a conduit, of all types in turn; every third without the frame's export."""
    kind = list(CONDUIT_TYPES)[seed % len(CONDUIT_TYPES)]
    campaign = ConduitCampaign(types=(kind,), samples=1, rate=200.0, fps=12.5)
    ((test, _),) = campaign.list_scenarios(seed)
    cell = replace(test.load_cell, gain_error=None)
    return replace(test, load_cell=cell, has_frame_export=seed % 3 != 2)


def _own_cell(test: CantileverScenario) -> CantileverScenario:
    return replace(test, load_cell=replace(test.load_cell, gain_error=None))


def on_a_string(
    scenario: CantileverScenario, seed: int, folder: Path, protocols: Path
) -> CheckReport:
    """Observe and process a test of a wire or of a taped bundle.

    Parameters
    ----------
    scenario, seed : the test
    folder : for its sheet
    protocols : the shipped ones

    Returns
    -------
    All results, and what is true, by their names.
    """
    test, name = observe(scenario, seed), scenario.protocol
    plan = _plan(format_sheet(_as_written(scenario, seed), ROLES), folder, protocols)
    seen = recordings_of(test)
    force = _wandering(seen["force"], scenario.load_cell, name, seed)
    results = _reduced({"force": force, "markers": _filmed(seen["markers"], name, seed)}, plan)
    return results, taped_truth(test) if name == "taped-bundle" else wire_truth(test)


def on_two_supports(
    scenario: ConduitScenario, seed: int, folder: Path, protocols: Path
) -> CheckReport:
    """The same of a conduit bundle."""
    test = observe(scenario, seed)
    name, random = scenario.protocol, np.random.default_rng([seed, 71])
    seen = recordings_of(test)
    roles: dict[str, Recording] = {
        "force": _wandering(seen["force"], scenario.load_cell, name, seed),
        "markers": _filmed(seen["markers"], name, seed),
    }
    span, speed, travel, centre = random.standard_normal(4).tolist()
    if "frame" in seen:
        travel *= scale(name, "frame", "displacement")
        roles["frame"] = _in_file(seen["frame"], 1.0 + travel)
    span *= stated(name, "specimen", "uncertainty", "span")
    centre *= stated(name, "markers", "centre_uncertainty")
    told = 1.0 + SPEED_ERROR * speed  # of the way that speed and time make
    layout = scenario.markers
    said = replace(
        scenario,
        test=replace(
            scenario.test, span=scenario.test.span + span, stroke=told * scenario.test.stroke
        ),
        speed=told * scenario.speed,
        markers=replace(layout, centre_offset=layout.centre_offset + centre),
    )
    sheet = format_sheet(said, {role: (f"{role}.mat",) for role in roles})
    results = _reduced(roles, _plan(sheet, folder, protocols))
    truth = conduit_truth(test)
    for result in results:
        if result.name == "twist":  # which end of a specimen is its first is nobody's to say
            truth["twist"] = abs(truth["twist"]) * float(np.sign(result.value or 1.0))
    return results, truth


def _filmed(markers: Recording, protocol: str, seed: int) -> Recording:
    """What cameras saw whose scale is off."""
    by = 1.0 + scale(protocol, "markers") * float(np.random.default_rng([seed, 89]).normal())
    tracks = markers.markers
    assert tracks is not None
    bodies = tuple(replace(body, position=by * body.position) for body in tracks.bodies)
    return replace(markers, markers=replace(tracks, positions=by * tracks.positions, bodies=bodies))


def _wandering(force: Recording, cell: LoadCell, protocol: str, seed: int) -> Recording:
    """What a load cell gives whose zero wanders."""
    step, times = 2.0 * cell.full_scale / 2**cell.bits, {c.name: c.time for c in force.clocks}
    channels = tuple(
        replace(
            channel,
            values=wandering(channel.values, times[channel.clock], protocol, seed, step),
        )
        if channel.path.startswith(FORCE_PATH)
        else channel
        for channel in force.channels
    )
    return replace(force, channels=channels)


def _in_file(frame: Recording, by: float) -> Recording:
    """The crosshead in millimetres, before the protocol's names and units are put to it."""
    channels = tuple(
        replace(channel, values=1e3 * by * channel.values, unit="mm")
        for channel in frame.channels
        if channel.name == "Crosshead"
    )
    return replace(frame, channels=channels)


def _as_written(scenario: CantileverScenario, seed: int) -> CantileverScenario:
    """What a person writes down: length and offsets as they were measured."""
    length, grip, pull, centre = np.random.default_rng([seed, 73]).standard_normal(4).tolist()
    name, mechanics, markers = scenario.protocol, scenario.mechanics, scenario.markers
    length *= stated(name, "specimen", "uncertainty", "length")
    offset = stated(name, "markers", "offset_uncertainty")
    x, *across = markers.pivot
    return replace(
        scenario,
        mechanics=replace(mechanics, length=mechanics.length + length),
        markers=replace(
            markers,
            pivot=(x - offset * grip, *across),
            pull_offset=markers.pull_offset + offset * pull,
            centre_offset=markers.centre_offset
            + centre * stated(name, "markers", "centre_uncertainty"),
        ),
    )


def _plan(sheet: str, folder: Path, protocols: Path) -> Protocol:
    path = folder / "test.yaml"
    path.write_text(sheet, encoding="utf-8")
    return resolve_protocol(load_test_sheet(path), path, protocols)


def _reduced(roles: dict[str, Recording], plan: Protocol) -> tuple[Result, ...]:
    recordings: dict[str, Recording] = {
        x: convert_channels(roles[x], source, Path(x)) if x != "markers" else roles[x]
        for x, source in plan.sources.items()
        if x in roles
    }
    return reduce_recordings(recordings, plan).results


def wire_truth(test: Observation[CantileverScenario]) -> Truth:
    """Every number that is known of a wire, by the name of its result."""
    path = solve_path(test.scenario.mechanics)
    truth = {**_of_cycles(test), "initial_stiffness": gain_in_time(path, *WIRE_WINDOW)}
    for cycle in range(1, path.test.cycles + 1):
        truth[f"unloading_stiffness.{cycle}"] = _unloading(path, cycle)
    law = test.scenario.mechanics.wire.build_law()
    for at in CURVATURES:
        moment = float(law_moment(law, np.array([at]))[0])
        truth[f"bending_stiffness_at_{at:g}"] = moment / at
    return truth


def taped_truth(test: Observation[CantileverScenario]) -> Truth:
    """Every number that is known of a taped bundle, by the name of its result."""
    path = solve_path(test.scenario.mechanics)
    told = evaluate_bundle(path)
    truth = {**_of_cycles(test), **_of_loading(told["loading"], told["bending_stiffness"])}
    pairs = zip(told["loading_stiffness"], told["hardening"], strict=True)
    for cycle, (stiffness, hardening) in enumerate(pairs, start=1):
        truth[f"loading_stiffness.{cycle}"] = stiffness
        truth[f"hardening.{cycle}"] = hardening
        truth[f"unloading_stiffness.{cycle}"] = _unloading(path, cycle)
    return truth | {"initial_stiffness": gain_in_time(path, *KINK_WINDOW)}


def _of_cycles(test: Observation[CantileverScenario]) -> Truth:
    clocks = test.scenario.clocks
    truth = {"clock_offset": clocks.offset, "clock_drift": clocks.drift}
    for cycle, each in enumerate(test.truth["cycles"], start=1):
        truth[f"peak_force.{cycle}"] = each["peak_force"]
        truth[f"peak_displacement.{cycle}"] = each["peak_deflection"]
        truth[f"energy.{cycle}"] = each["energy"]
        if each["residual_deflection"] is not None:
            truth[f"residual_displacement.{cycle}"] = each["residual_deflection"]
    return truth


def gain_in_time(path: MechanicalPath, start: float, end: float) -> float:
    """Ratio of what force and deflection gain in time over a window of the first loading, N/m."""
    progress = np.linspace(0.0, path.test.stroke, STEPS)
    deflection = path.compute_deflection(progress)
    inside = (deflection >= start) & (deflection <= end)
    return _ratio(progress, deflection, path.compute_tension(progress), inside)


def _unloading(path: MechanicalPath, cycle: int) -> float:
    """The same from the turn of a cycle on, a little below its largest deflection."""
    progress = path.test.stroke * (2.0 * cycle - 1.0 + np.linspace(0.0, 1.0, STEPS))
    deflection = path.compute_deflection(progress)
    below = float(deflection.max()) - deflection
    inside = (below >= UNLOADING[0]) & (below <= UNLOADING[1])
    return _ratio(progress, deflection, path.compute_tension(progress), inside)


def _ratio(progress: Floats, deflection: Floats, force: Floats, inside: Flags) -> float:
    lever = progress[inside] - progress[inside].mean()
    return float((lever @ force[inside]) / (lever @ deflection[inside]))


def _of_loading(loading: dict[str, Any], bending_stiffness: float) -> Truth:
    truth = {
        "initial_stiffness": loading["windowed_stiffness"],
        "bending_stiffness": bending_stiffness,
        "kink_displacement": loading["kink"]["displacement"],
        "kink_force": loading["kink"]["force"],
        "end_slope": loading["end_slope"],
    }
    if loading["plateau_displacement"] is not None and loading["plateau_force"] is not None:
        truth["plateau_displacement"] = loading["plateau_displacement"]
        truth["plateau_force"] = loading["plateau_force"]
    return truth


def as_elastic_bar(rig: ThreePointTest, stiffness: float) -> float:
    """Stiffness of the elastic bar that is as stiff in the same rig over the same window, N m^2."""
    return ONE * stiffness / windowed(replace(rig, bundle=ElasticModel(ONE)))


@lru_cache(maxsize=16)
def windowed(test: ThreePointTest) -> float:
    """Slope of force over displacement in the window of the initial stiffness, N/m."""
    way = np.linspace(0.0, test.stroke, STEPS)
    return fit_slope(way, solve_three_point(test).compute_force(way), *KINK_WINDOW)


def conduit_truth(test: Observation[ConduitScenario]) -> Truth:
    """Every number that is known of a conduit bundle, by the name of its result."""
    known = test.truth
    stiffness = as_elastic_bar(test.scenario.test, known["loading"]["windowed_stiffness"])
    truth = _of_loading(known["loading"], stiffness) | {
        "peak_force.1": known["peak_force"],
        "peak_displacement.1": test.scenario.test.stroke,  # not the place of the largest force
        "energy.1": known["energy"],
        "mid_span_curvature": known["middle"]["curvature"],
        "mid_span_bending_stiffness": known["middle"]["bending_stiffness"],
        "twist": known["middle"]["twist"],
    }
    if "frame" in test.records:
        truth["clock_offset"] = known["clocks"]["force_offset"]
        truth["clock_drift"] = known["clocks"]["drift"]
    return truth
