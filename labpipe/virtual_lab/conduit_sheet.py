"""The test sheet of a virtual conduit bundle: what a person at the bench would have filled in."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping

from labpipe.virtual_lab.bundle_sheet import bundle_lines
from labpipe.virtual_lab.conduit_bundle import ConduitScenario

PROTOCOL = "conduit-bundle"
PROTOCOL_VALUES = {
    "sources.force.calibration.gain": "-0.21082 N/V",
    "sources.force.calibration.gain_uncertainty": "0.2 %",
    "rig.crosshead_speed": "0.5 mm/s",
    "rig.stroke": "29.4 mm",
    "specimen.section.outer_diameter": "14.1 mm",
    "markers.centre_offset": "8.55 mm",
}
"""What the shipped protocol says, key by key."""


def write_conduit_sheet(scenario: ConduitScenario, files: Mapping[str, str]) -> str:
    """Word the test sheet.

    Parameters
    ----------
    scenario : the test
    files : name of the export, by role

    Returns
    -------
    The text of ``test.yaml``.
    """
    lines = [
        "# A synthetic test, made by labpipe's virtual lab. Its truth stands in truth.json.",
        f"test: {scenario.name}",
        f"protocol: {PROTOCOL}",
        "specimen:",
        f"  type: {scenario.specimen_type}",
        f"  spool: {scenario.spool}",
        f"  sample: {scenario.sample}",
        f"  span: {1e3 * scenario.test.span:.10g} mm",
        *bundle_lines(scenario.bundle),
        f"date: {scenario.date}",
        "operator: virtual lab",
        "files:",
        *(f"  {role}: {json.dumps(file, ensure_ascii=False)}" for role, file in files.items()),
        *_overrides(scenario),
    ]
    return "\n".join(lines) + "\n"


def _overrides(scenario: ConduitScenario) -> Iterator[str]:
    cell, markers = scenario.load_cell, scenario.markers
    values = {
        "sources.force.calibration.gain": f"{cell.gain:.10g} N/V",
        "sources.force.calibration.gain_uncertainty": f"{100 * cell.gain_uncertainty:.10g} %",
        "rig.crosshead_speed": f"{1e3 * scenario.speed:.10g} mm/s",
        "rig.stroke": f"{1e3 * scenario.test.stroke:.10g} mm",
        "specimen.section.outer_diameter": f"{2e3 * scenario.test.outer_radius:.10g} mm",
        "markers.centre_offset": f"{1e3 * markers.centre_offset:.10g} mm",
    }
    changed = {key: value for key, value in values.items() if value != PROTOCOL_VALUES[key]}
    if changed:
        yield "overrides:"
    for key, value in changed.items():
        yield f"  {key}: {{value: {value}, because: the virtual rig is set so}}"
