"""Write test sheets and the sheet of the wires, as filled in at the bench.

A test sheet states the nominal gain of the load cell, never the true one, and overrides the shipped
protocol only where the scenario's rig differs from it.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping, Sequence
from io import StringIO
from math import degrees
from pathlib import Path
from typing import TypeAlias

from labpipe.records.harness_bundle import NONE
from labpipe.virtual_lab.bundles import BundleModel, lay_wires
from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario
from labpipe.virtual_lab.conduit_scenarios import ConduitScenario
from labpipe.virtual_lab.specimens import WIRES, StrandedWire
from labpipe.virtual_lab.tensile_scenarios import TensileScenario

Scenario: TypeAlias = CantileverScenario | ConduitScenario | TensileScenario
"""A virtual test of any of the three kinds."""

RECORDER_FILES: Mapping[str, tuple[str, ...]] = {"force": ("force.mat",), "markers": ("take.csv",)}
"""Exports of force recorder and cameras, by role."""
WIRE_SHEET = "wires.csv"

_WIRE_VALUES = {
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
PROTOCOL_VALUES = {
    "wire-cantilever": _WIRE_VALUES,
    # A cell of 2 lb, markers 0.5 in apart on a bundle of nineteen wires of 1.1 mm.
    "taped-bundle": _WIRE_VALUES
    | {
        "sources.force.calibration.gain": "0.89 N/V",
        "markers.pull_offset": "6.35 mm",
        "markers.centre_offset": "2.75 mm",
    },
    "conduit-bundle": {
        "sources.force.calibration.gain": "-0.21082 N/V",
        "sources.force.calibration.gain_uncertainty": "0.2 %",
        "rig.crosshead_speed": "0.5 mm/s",
        "rig.stroke": "29.4 mm",
        "specimen.section.outer_diameter": "14.1 mm",
        "markers.centre_offset": "8.55 mm",
    },
}
"""Values of the shipped protocols of bending tests, by key."""
PROTOCOL_UNCERTAINTY = {"corrugated-tube": 0.0025, "twist-tube": 0.0025, "pet-tape": 0.0025}
"""Uncertainty of the scale of force in the shipped protocols, by name; none in the others."""

_WIRE_COLUMNS = (
    "wire",
    "wire_diameter_mm",
    "strands",
    "strand_diameter_mm",
    "lay_angles_deg",
    "insulation_thickness_mm",
    "layout",
)


def write_sheet(scenario: Scenario, files: Mapping[str, Sequence[str]] = RECORDER_FILES) -> str:
    """Write the test sheet.

    Parameters
    ----------
    scenario : the test
    files : names of the exports, by role

    Returns
    -------
    The text of ``test.yaml``.
    """
    protocol = protocol_of(scenario)
    lines = [
        "# A synthetic test, made by labpipe's virtual lab. Its truth stands in truth.json.",
        f"test: {_text(scenario, scenario.name)}",
        f"protocol: {protocol}",
        *_specimen(scenario),
        f"date: {scenario.date}",
        "operator: virtual lab",
        *_files(scenario, files),
        *_overrides(scenario, protocol),
    ]
    return "\n".join(lines) + "\n"


def protocol_of(scenario: Scenario) -> str:
    """Return the name of the shipped protocol of a test."""
    match scenario:
        case TensileScenario():
            return scenario.protocol
        case ConduitScenario():
            return "conduit-bundle"
        case CantileverScenario():
            is_bundle = isinstance(scenario.mechanics.wire, BundleModel)
            return "taped-bundle" if is_bundle else "wire-cantilever"


def _text(scenario: Scenario, text: str) -> str:
    """Write a text, for tensile tests as JSON, as their exports have commas in their names."""
    return json.dumps(text, ensure_ascii=False) if isinstance(scenario, TensileScenario) else text


def _specimen(scenario: Scenario) -> Iterator[str]:
    entries = {
        "type": _text(scenario, scenario.specimen_type),
        "spool": _text(scenario, scenario.spool),
        "sample": _text(scenario, str(scenario.sample)),
    }
    bundle: object = None
    match scenario:
        case TensileScenario():
            entries["length"] = _millimetres(scenario.length)
        case ConduitScenario():
            bundle = scenario.bundle
            entries["span"] = _millimetres(scenario.test.span)
        case CantileverScenario():
            bundle = scenario.mechanics.wire
            entries["length"] = _millimetres(scenario.mechanics.length)
            if scenario.mechanics.mass_per_length:
                mass = 1e3 * scenario.mechanics.mass_per_length
                entries["mass_per_length"] = f"{mass:.6g} g/m"
    if isinstance(bundle, BundleModel):
        yield "specimen:"
        yield from (f"  {key}: {value}" for key, value in entries.items())
        yield from bundle_lines(bundle)
    else:
        yield f"specimen: {_in_braces(entries)}"


def bundle_lines(bundle: BundleModel) -> Iterator[str]:
    """Write the indented block ``bundle`` of a specimen.

    Parameters
    ----------
    bundle : with two kinds of wires, their places are written, too
    """
    yield "  bundle:"
    wires = {
        name: _in_braces({"number": number, "diameter": _millimetres(WIRES[name].diameter)})
        for name, number in bundle.wires
    }
    yield f"    wires: {_in_braces(wires)}"
    yield f"    number: {bundle.number}"
    yield f"    arrangement: {bundle.arrangement}"
    if len(bundle.wires) > 1:
        yield "    positions:"
        layout = lay_wires(bundle)
        for x, y in zip(layout.x.tolist(), layout.y.tolist(), strict=True):
            yield f"      - [{1e3 * x:.4f} mm, {1e3 * y:.4f} mm]"
    for key in ("tape", "taping", "conduit"):
        if getattr(bundle, key) != NONE:
            yield f"    {key}: {getattr(bundle, key)}"
    if bundle.conduit_bore is not None:
        yield f"    conduit_bore: {_millimetres(bundle.conduit_bore)}"


def _files(scenario: Scenario, files: Mapping[str, Sequence[str]]) -> Iterator[str]:
    if isinstance(scenario, ConduitScenario):
        yield "files:"
        for role, (name,) in files.items():
            yield f"  {role}: {json.dumps(name, ensure_ascii=False)}"
        return
    entries = {}
    for role, names in files.items():
        texts = [_text(scenario, name) for name in names]
        entries[role] = texts[0] if len(texts) == 1 else f"[{', '.join(texts)}]"
    yield f"files: {_in_braces(entries)}"


def _overrides(scenario: Scenario, protocol: str) -> Iterator[str]:
    """Yield the differences from the protocol with their reasons."""
    match scenario:
        case TensileScenario():
            changes = _tensile_changes(scenario)
        case ConduitScenario():
            changes = _rig_changes(_conduit_values(scenario), protocol)
        case CantileverScenario():
            changes = _rig_changes(_cantilever_values(scenario), protocol)
    if changes:
        yield "overrides:"
    for key, (value, reason) in changes.items():
        yield f"  {key}: {{value: {value}, because: {reason}}}"


def _rig_changes(values: Mapping[str, str], protocol: str) -> dict[str, tuple[str, str]]:
    usual = PROTOCOL_VALUES[protocol]
    changed = {key: value for key, value in values.items() if value != usual[key]}
    return {key: (value, "the virtual rig is set so") for key, value in changed.items()}


def _tensile_changes(scenario: TensileScenario) -> dict[str, tuple[str, str]]:
    """Return differences from the protocol: certificate of the load cell, another size of tube."""
    changes = {}
    uncertainty = scenario.instruments.gain_uncertainty
    if uncertainty != PROTOCOL_UNCERTAINTY.get(scenario.protocol, 0.0):
        certificate = (f"{100.0 * uncertainty:.10g} %", "certificate of the load cell")
        changes["sources.frame.channels.force.scale_uncertainty"] = certificate
    for name, size in scenario.section:
        changes[f"specimen.section.{name}"] = (_millimetres(size), "a tube of another size")
    return changes


def _cantilever_values(scenario: CantileverScenario) -> dict[str, str]:
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


def _conduit_values(scenario: ConduitScenario) -> dict[str, str]:
    cell = scenario.load_cell
    return {
        "sources.force.calibration.gain": f"{cell.gain:.10g} N/V",
        "sources.force.calibration.gain_uncertainty": f"{100 * cell.gain_uncertainty:.10g} %",
        "rig.crosshead_speed": f"{1e3 * scenario.speed:.10g} mm/s",
        "rig.stroke": _millimetres(scenario.test.stroke),
        "specimen.section.outer_diameter": _millimetres(2.0 * scenario.test.outer_radius),
        "markers.centre_offset": _millimetres(scenario.markers.centre_offset),
    }


def write_wire_sheet(folder: Path) -> Path:
    """Write the sheet of the virtual wires that `labpipe model` and `labpipe calibrate` read.

    It states what is known without a test: dimensions and materials. Friction is left to a
    calibration.

    Parameters
    ----------
    folder : made if it is not there

    Returns
    -------
    The sheet, with a row for each of `virtual_lab.specimens.WIRES`.
    """
    text = StringIO()
    sheet = csv.writer(text, lineterminator="\n")
    sheet.writerow(_WIRE_COLUMNS)
    sheet.writerows(_wire_row(wire) for wire in WIRES.values())
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / WIRE_SHEET
    path.write_text(text.getvalue(), encoding="utf-8")
    return path


def _wire_row(wire: StrandedWire) -> tuple[str, ...]:
    return (
        wire.name,
        f"{1e3 * wire.diameter:.6g}",
        str(wire.n_strands),
        f"{1e3 * wire.strand:.9g}",
        ";".join(f"{degrees(angle):.6g}" for angle in wire.lay_angles),
        f"{1e3 * wire.wall:.6g}",
        "compressed" if wire.is_compressed else "hexagonal",
    )


def _in_braces(entries: Mapping[str, object]) -> str:
    """Write a mapping in one line of YAML."""
    return "{" + ", ".join(f"{key}: {value}" for key, value in entries.items()) + "}"


def _millimetres(length: float) -> str:
    return f"{1e3 * length:.10g} mm"
