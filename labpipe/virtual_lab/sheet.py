"""Write the test sheet of a virtual test: what a person at the bench would have filled in.

The sheet knows the nominal gain of the load cell, never the true one, and overrides the shipped
protocol only where the scenario's rig differs from it.
"""

from __future__ import annotations

from collections.abc import Iterator

from labpipe.virtual_lab.bundle_sheet import bundle_lines
from labpipe.virtual_lab.bundles import BundleModel
from labpipe.virtual_lab.scenario import CantileverScenario

PROTOCOL = "wire-cantilever"
FORCE_FILE, MARKER_FILE = "force.mat", "take.csv"
PROTOCOL_VALUES = {
    "sources.force.calibration.gain": "0.5 N/V",
    "sources.force.calibration.gain_uncertainty": "0.2 %",
    "rig.crosshead_speed": "1 mm/s",
    "rig.stroke": "53 mm",
    "rig.cycles": "3",
    "rig.string.length": "760 mm",
    "rig.string.counterweight": "2.7 g",
    "markers.grip_offset": "6 mm",
    "markers.pull_offset": "4 mm",
    "markers.centre_offset": "0.8 mm",
}
"""What the shipped protocol says, key by key."""
BUNDLE_PROTOCOL = "taped-bundle"
BUNDLE_PROTOCOL_VALUES = PROTOCOL_VALUES | {
    "sources.force.calibration.gain": "0.89 N/V",
    "markers.pull_offset": "6.35 mm",
    "markers.centre_offset": "2.75 mm",
}
"""The same of the protocol of taped bundles: a cell of 2 lb, markers 0.5 in apart on a bundle of
nineteen wires of 1.1 mm."""


def write_sheet(scenario: CantileverScenario) -> str:
    """Word the test sheet.

    Parameters
    ----------
    scenario : the test

    Returns
    -------
    The text of ``test.yaml``.
    """
    is_bundle = isinstance(scenario.mechanics.wire, BundleModel)
    lines = [
        "# A synthetic test, made by labpipe's virtual lab. Its truth stands in truth.json.",
        f"test: {scenario.name}",
        f"protocol: {BUNDLE_PROTOCOL if is_bundle else PROTOCOL}",
        *_specimen(scenario),
        f"date: {scenario.date}",
        "operator: virtual lab",
        f"files: {{force: {FORCE_FILE}, markers: {MARKER_FILE}}}",
        *_overrides(scenario),
    ]
    return "\n".join(lines) + "\n"


def _specimen(scenario: CantileverScenario) -> Iterator[str]:
    said = {
        "type": scenario.specimen_type,
        "spool": scenario.spool,
        "sample": scenario.sample,
        "length": _millimetres(scenario.mechanics.length),
    }
    bundle = scenario.mechanics.wire
    if not isinstance(bundle, BundleModel):
        yield f"specimen: {{{', '.join(f'{key}: {value}' for key, value in said.items())}}}"
        return
    yield "specimen:"
    yield from (f"  {key}: {value}" for key, value in said.items())
    yield from bundle_lines(bundle)


def _overrides(scenario: CantileverScenario) -> Iterator[str]:
    values = _values(scenario)
    is_bundle = isinstance(scenario.mechanics.wire, BundleModel)
    usual = BUNDLE_PROTOCOL_VALUES if is_bundle else PROTOCOL_VALUES
    changed = {key: value for key, value in values.items() if value != usual[key]}
    if changed:
        yield "overrides:"
    for key, value in changed.items():
        yield f"  {key}: {{value: {value}, because: the virtual rig is set so}}"


def _values(scenario: CantileverScenario) -> dict[str, str]:
    mechanics, markers, cell = scenario.mechanics, scenario.markers, scenario.load_cell
    return {
        "sources.force.calibration.gain": f"{cell.gain:.10g} N/V",
        "sources.force.calibration.gain_uncertainty": f"{100 * cell.gain_uncertainty:.10g} %",
        "rig.crosshead_speed": f"{1e3 * scenario.speed:.10g} mm/s",
        "rig.stroke": _millimetres(mechanics.stroke),
        "rig.cycles": f"{mechanics.cycles}",
        "rig.string.length": _millimetres(mechanics.string_length),
        "rig.string.counterweight": f"{1e3 * mechanics.counterweight:.10g} g",
        "markers.grip_offset": _millimetres(-markers.pivot[0]),
        "markers.pull_offset": _millimetres(markers.pull_offset),
        "markers.centre_offset": _millimetres(markers.centre_offset),
    }


def _millimetres(length: float) -> str:
    return f"{1e3 * length:.10g} mm"
