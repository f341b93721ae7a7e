"""Write test sheets and the sheet of the wires, as filled in at the bench.

A test sheet states the nominal gain of the load cell, never the true one, and overrides the shipped
protocol only where the scenario's rig differs from it.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from datetime import date
from io import StringIO
from math import degrees
from pathlib import Path
from typing import TypeAlias

import yaml

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
_HEAD = "# A synthetic test, made by labpipe's virtual lab. Its truth stands in truth.json.\n"

_WIRE_VALUES: Mapping[str, object] = {
    "sources.force.calibration.gain": "0.5 N/V",
    "sources.force.calibration.gain_uncertainty": "0.2 %",
    "rig.crosshead_speed": "1 mm/s",
    "rig.stroke": "53 mm",
    "rig.cycles": 3,
    "rig.string.length": "760 mm",
    "rig.string.counterweight": "2.7 g",
    "markers.grip_offset": "6 mm",
    "markers.pull_offset": "4 mm",
    "markers.centre_offset": "0.8 mm",
}
PROTOCOL_VALUES: Mapping[str, Mapping[str, object]] = {
    "wire-cantilever": _WIRE_VALUES,
    # A cell of 2 lb, markers 0.5 in apart on a bundle of nineteen wires of 1.1 mm.
    "taped-bundle": {
        **_WIRE_VALUES,
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
    sheet: dict[str, object] = {
        "test": scenario.name,
        "protocol": scenario.protocol,
        "specimen": _specimen(scenario),
        "date": date.fromisoformat(scenario.date),
        "operator": "virtual lab",
        "files": {
            role: names[0] if len(names) == 1 else list(names) for role, names in files.items()
        },
    }
    if overrides := _overrides(scenario):
        sheet["overrides"] = overrides
    return _HEAD + yaml.safe_dump(
        sheet, sort_keys=False, allow_unicode=True, default_flow_style=None, width=200
    )


def _specimen(scenario: Scenario) -> dict[str, object]:
    entries: dict[str, object] = {
        "type": scenario.specimen_type,
        "spool": scenario.spool,
        "sample": scenario.sample,
    }
    match scenario:
        case TensileScenario():
            return entries | {"length": _millimetres(scenario.length)}
        case ConduitScenario():
            span = _millimetres(scenario.test.span)
            return entries | {"span": span, "bundle": _bundle_entries(scenario.bundle)}
        case CantileverScenario():
            test = scenario.mechanics
            entries["length"] = _millimetres(test.length)
            if test.mass_per_length:
                entries["mass_per_length"] = f"{1e3 * test.mass_per_length:.6g} g/m"
            if isinstance(test.wire, BundleModel):
                entries["bundle"] = _bundle_entries(test.wire)
            return entries


def _bundle_entries(bundle: BundleModel) -> dict[str, object]:
    """Return the block ``bundle`` of a specimen; with two kinds of wires, also their places."""
    entries: dict[str, object] = {
        "wires": {
            name: {"number": number, "diameter": _millimetres(WIRES[name].diameter)}
            for name, number in bundle.wires
        },
        "number": bundle.number,
        "arrangement": bundle.arrangement,
    }
    if len(bundle.wires) > 1:
        layout = lay_wires(bundle)
        places = zip(layout.x, layout.y, strict=True)
        entries["positions"] = [[f"{1e3 * x:.4f} mm", f"{1e3 * y:.4f} mm"] for x, y in places]
    covers = {"tape": bundle.tape, "taping": bundle.taping, "conduit": bundle.conduit}
    entries |= {key: value for key, value in covers.items() if value != NONE}
    if bundle.conduit_bore is not None:
        entries["conduit_bore"] = _millimetres(bundle.conduit_bore)
    return entries


def _overrides(scenario: Scenario) -> dict[str, dict[str, object]]:
    """Return the differences from the protocol with their reasons, by key."""
    match scenario:
        case TensileScenario():
            return _tensile_changes(scenario)
        case ConduitScenario():
            length, rig = scenario.test.stroke, _conduit_values(scenario)
        case CantileverScenario():
            length, rig = scenario.mechanics.stroke, _cantilever_values(scenario)
    cell = scenario.load_cell
    values = {
        "sources.force.calibration.gain": f"{cell.gain:.10g} N/V",
        "sources.force.calibration.gain_uncertainty": f"{100 * cell.gain_uncertainty:.10g} %",
        "rig.crosshead_speed": f"{1e3 * scenario.speed:.10g} mm/s",
        "rig.stroke": _millimetres(length),
        "markers.centre_offset": _millimetres(scenario.markers.centre_offset),
        **rig,
    }
    usual = PROTOCOL_VALUES[scenario.protocol]
    return {
        key: {"value": values[key], "because": "the virtual rig is set so"}
        for key, protocol_value in usual.items()
        if values[key] != protocol_value
    }


def _tensile_changes(scenario: TensileScenario) -> dict[str, dict[str, object]]:
    """Return differences from the protocol: certificate of the load cell, another size of tube."""
    sizes: dict[str, dict[str, object]] = {
        f"specimen.section.{name}": {
            "value": _millimetres(size),
            "because": "a tube of another size",
        }
        for name, size in scenario.section
    }
    # the shipped protocols of the other tensile tests state the uncertainty of both load cells
    if scenario.protocol != "stiff-bar" and scenario.instruments.gain_uncertainty == 0.0025:
        return sizes
    certificate = f"{100.0 * scenario.instruments.gain_uncertainty:.10g} %"
    key = "sources.frame.channels.force.scale_uncertainty"
    return {key: {"value": certificate, "because": "certificate of the load cell"}, **sizes}


def _cantilever_values(scenario: CantileverScenario) -> dict[str, object]:
    mechanics, markers = scenario.mechanics, scenario.markers
    return {
        "rig.cycles": mechanics.cycles,
        "rig.string.length": _millimetres(mechanics.string_length),
        "rig.string.counterweight": f"{1e3 * mechanics.counterweight:.10g} g",
        "markers.grip_offset": _millimetres(-markers.pivot[0]),
        "markers.pull_offset": _millimetres(markers.pull_offset),
    }


def _conduit_values(scenario: ConduitScenario) -> dict[str, object]:
    return {"specimen.section.outer_diameter": _millimetres(2.0 * scenario.test.outer_radius)}


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


def _millimetres(length: float) -> str:
    return f"{1e3 * length:.10g} mm"
