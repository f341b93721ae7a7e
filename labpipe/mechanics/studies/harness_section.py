"""Material of a harness line: sections as functions of uncertain inputs, with their valid range."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from labpipe.errors import ReadError, UsageError, sort_by_likeness
from labpipe.mechanics.law.plays import require
from labpipe.mechanics.law.sliders import GrowingSlider, SliderLaw, make_linear_law, share_hardening
from labpipe.mechanics.rod.input_distributions import (
    InputDistribution,
    build_calibrated_distributions,
    build_stated_distribution,
    build_uniform_distribution,
    join_distributions,
)
from labpipe.mechanics.rod.line import Section
from labpipe.mechanics.studies.calibration_file import CalibratedFile, read_calibrated
from labpipe.mechanics.studies.harness_line import FREE_CURVATURES
from labpipe.mechanics.studies.wire_sheets import build_wire_error, read_wire_sheet
from labpipe.mechanics.wire.law_family import (
    ISOTROPIC_SHARE,
    LAW_FACTOR,
    MASS_FACTOR,
    TORSION_FACTOR,
    UNKNOWN_SHARE,
    LawFamily,
    apply_values,
    make_law_family,
)
from labpipe.mechanics.wire.wire_table import wire_table
from labpipe.protocol.harness_file import HarnessFile, SectionBlock, find_named_file
from labpipe.records.quality import QualityNote
from labpipe.records.result import InputFile
from labpipe.records.wire import WireSpec

FACTORS = (LAW_FACTOR, TORSION_FACTOR, MASS_FACTOR)
"""Inputs that are logarithms of factors: on moments, torsional stiffness and mass."""
DEFAULT_SHEET = "wires.xlsx"
_HARDENING = "hardening of the copper"
_INSULATION_LIMIT = "the straight line of its insulation"


SectionAt = Callable[[Mapping[str, float]], Section]
"""Section as a function of named inputs."""


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """Material of a line.

    Parameters
    ----------
    name : of the wire, or a description
    sections : functions of named inputs such as ``law_factor``, of which a missing one is 0; one
        function for each solution of a calibration, the best first
    limit : 1/m, largest curvature for which the law is supported
    limit_source : what sets this limit
    has_unknown_share : whether the isotropic share of the strands is unknown and varied in a range
    stretch_limit : largest strain along the line for which its axial stiffness is supported
    files : from which it was read
    notes : quality notes of the law
    distributions : of the inputs, one for each solution of a calibration; empty if the uncertainty
        of the law is unknown
    """

    name: str
    sections: tuple[SectionAt, ...]
    limit: float
    limit_source: str
    files: tuple[InputFile, ...] = ()
    notes: tuple[QualityNote, ...] = ()
    distributions: tuple[InputDistribution, ...] = ()
    stretch_limit: float = np.inf
    has_unknown_share: bool = False

    @property
    def diameter(self) -> float:
        """Return the outer diameter, m."""
        return self.sections[0](self.best).diameter

    @property
    def knows_only_share(self) -> bool:
        """Return whether no input but the isotropic share has a distribution."""
        names = {name for distribution in self.distributions for name in distribution.names}
        return names == {ISOTROPIC_SHARE}

    @property
    def best(self) -> Mapping[str, float]:
        """Return the best inputs."""
        return self.distributions[0].inputs() if self.distributions else {}


def fix_inputs(material: Material) -> Material:
    """Return a material at its best inputs, without distributions.

    Parameters
    ----------
    material : of a line
    """
    best = material.best

    def fix(section: SectionAt) -> SectionAt:
        return lambda _: section(best)

    sections = tuple(map(fix, material.sections))
    return replace(material, sections=sections, distributions=())


def read_material(harness: HarnessFile, file: Path, wires: Path | None = None) -> Material:
    """Read the material of the line of a harness.

    Parameters
    ----------
    harness : as read
    file : its YAML; other files are relative to its folder
    wires : wire sheet in place of the one that the file names

    Raises
    ------
    LabpipeError
        If a file cannot be used, or the sheet has no such wire.
    """
    block = harness.line.section
    if block.wire is not None:
        material = _read_wire_material(block, file, wires)
    elif block.sliders is not None:
        material = _read_deck_material(block, find_named_file(block.sliders, file))
    else:
        material = _build_stiffness_material(block)
    return replace(material, distributions=_add_stated(material.distributions, harness))


def _add_stated(
    distributions: tuple[InputDistribution, ...], harness: HarnessFile
) -> tuple[InputDistribution, ...]:
    """Join the distributions of a calibration with the uncertainties that the file states."""
    inputs = {
        LAW_FACTOR: (harness.line.section.stiffness_uncertainty or 0.0, "stiffness as stated")
    }
    if harness.line.spool is not None:
        inputs |= dict.fromkeys(FREE_CURVATURES, (harness.line.spool.spread, "curl of the spool"))
    stated = [
        build_stated_distribution(name, deviation, cause=cause)
        for name, (deviation, cause) in inputs.items()
        if deviation > 0.0
    ]
    if not stated:
        return distributions
    if not distributions:
        return (join_distributions(stated),)
    return tuple(join_distributions([calibrated, *stated]) for calibrated in distributions)


def describe_file(role: str, path: Path) -> InputFile:
    """Return name, hash and size of an input file.

    Parameters
    ----------
    role : of the file
    path : of the file
    """
    content = path.read_bytes()
    return InputFile(role, path.name, hashlib.sha256(content).hexdigest(), len(content))


def find_wire(name: str, sheet: Path, *, where: str) -> WireSpec:
    """Find a wire in a sheet.

    Parameters
    ----------
    name : of the wire
    sheet : of wires
    where : file and key that name the wire, for messages

    Raises
    ------
    LabpipeError
        If the sheet has faults, or no such wire.
    """
    specs = {spec.name: spec for spec in read_wire_sheet(sheet).specs}
    if name in specs:
        return specs[name]
    similar_names = ", ".join(sort_by_likeness(name, list(specs)))
    raise UsageError.about(
        "mechanics.studies.no_such_wire", where, sheet=sheet, near=similar_names, name=name
    )


def _read_wire_material(block: SectionBlock, file: Path, wires: Path | None) -> Material:
    sheet = wires or find_named_file(block.sheet or DEFAULT_SHEET, file)
    spec = find_wire(str(block.wire), sheet, where=f"{file}, line.section.wire")
    files = [describe_file("wires", sheet)]
    calibrated = None
    if block.calibration is not None:
        path = find_named_file(block.calibration, file)
        calibrated = read_calibrated(path)
        files.append(describe_file("calibration", path))
    specs = _build_solution_specs(spec, calibrated)
    try:
        table, families = wire_table(specs[0]), [make_law_family(spec) for spec in specs]
    except ValueError as error:
        expected = "a wire whose law can be fitted by sliders"
        raise build_wire_error(sheet, spec, expected, error) from error
    limits = {"its table": float(table.curvature[-1]), _INSULATION_LIMIT: table.doubtful_curvature}
    if calibrated is not None and np.isfinite(calibrated.tested_curvature):
        limits["the tests of its calibration"] = calibrated.tested_curvature
    source = min(limits, key=lambda limit: limits[limit])
    name = spec.name
    if calibrated is not None and calibrated.wire != name:
        name = f"{name} (calibrated as {calibrated.wire})"
    return Material(
        name,
        tuple(partial(_build_section, family, spec.wire_diameter) for family in families),
        *(limits[source], source),
        files=tuple(files),
        notes=table.notes,
        distributions=_build_distributions(spec, calibrated),
        has_unknown_share=spec.isotropic_share is None
        and (calibrated is None or calibrated.share is None),
        stretch_limit=1e-3,  # copper yields beyond it
    )


def _build_distributions(
    spec: WireSpec, calibrated: CalibratedFile | None
) -> tuple[InputDistribution, ...]:
    """Return the distributions of a calibration, joined with that of an unknown isotropic share."""
    distributions: tuple[InputDistribution, ...] = ()
    if calibrated is not None:
        distributions = build_calibrated_distributions(
            calibrated.solutions, calibrated.widening, specimen=LAW_FACTOR
        )
    if spec.isotropic_share is not None:
        return distributions
    if calibrated is not None and calibrated.share is not None:
        value, error = calibrated.share
        share = build_stated_distribution(ISOTROPIC_SHARE, error, centre=value, cause=_HARDENING)
    else:
        share = build_uniform_distribution(ISOTROPIC_SHARE, *UNKNOWN_SHARE, cause=_HARDENING)
    return tuple(join_distributions([other, share]) for other in distributions) or (share,)


def _build_solution_specs(spec: WireSpec, calibrated: CalibratedFile | None) -> list[WireSpec]:
    """Return the wire with the parameters of each allowed solution; unchanged if not calibrated."""
    if calibrated is None:
        return [spec]
    return [
        apply_values(spec, calibrated.values(number))
        for number, solution in enumerate(calibrated.solutions)
        if solution.is_allowed
    ]


def _build_section(family: LawFamily, diameter: float, inputs: Mapping[str, float]) -> Section:
    member = family.at(inputs)
    return Section(
        *(member.law, member.torsional_stiffness, member.axial_stiffness, member.coupling),
        mass_per_length=member.mass_per_length,
        diameter=diameter,
    )


def _scale_section(section: Section, inputs: Mapping[str, float]) -> Section:
    """Multiply moments, torsion and mass of a section by the factors of the inputs."""
    bending, torsion, mass = (math.exp(inputs.get(name, 0.0)) for name in FACTORS)
    law = section.law
    return replace(
        section,
        law=replace(
            law,
            stiffness=bending * law.stiffness,
            stiffnesses=bending * law.stiffnesses,
            growing=tuple(slider.scaled(bending) for slider in law.growing),
        ),
        torsional_stiffness=torsion * section.torsional_stiffness,
        mass_per_length=mass * section.mass_per_length,
    )


def _build_stiffness_material(block: SectionBlock) -> Material:
    stiffness, limit = block.bending_stiffness or 0.0, block.largest_curvature or 0.0
    section = Section(
        make_linear_law(stiffness, limit),
        block.torsional_stiffness or 0.0,
        block.axial_stiffness or np.inf,
        mass_per_length=block.mass_per_length or 0.0,
        diameter=block.diameter or 0.0,
    )
    name = f"stiffness {1e6 * stiffness:.6g} N mm^2"
    source = "'largest_curvature' of the file"
    return Material(name, (partial(_scale_section, section),), limit, source)


def _read_deck_material(block: SectionBlock, path: Path) -> Material:
    deck = _read_deck(path)
    try:
        first, last = map(float, deck["range"]["curvature"])
        doubtful = float(deck.get("doubtful_beyond") or np.inf)
        law = SliderLaw(
            float(deck["stiffness"]),
            np.array(deck["stiffnesses"], dtype=np.float64),
            np.array(deck["slip_curvatures"], dtype=np.float64),
            first,
            last,
            float(deck.get("error", 0.0)),
        )
        hardening = _read_hardening(deck)
        section = Section(
            law,
            float(deck["torsional_stiffness"]),
            block.axial_stiffness or np.inf,
            mass_per_length=float(deck.get("mass_per_length") or 0.0),
            diameter=block.diameter or 0.0,
        )
    except (KeyError, TypeError, ValueError, IndexError) as error:
        fault = f"none under {error}" if isinstance(error, KeyError) else f"this: {error}"
        raise ReadError.about("mechanics.studies.deck_without_law", path, fault=fault) from error
    limits = {"the range of the deck": law.last, _INSULATION_LIMIT: doubtful}
    distributions: tuple[InputDistribution, ...] = ()
    if hardening is not None and not hardening.is_known:
        distributions = (
            build_uniform_distribution(ISOTROPIC_SHARE, *hardening.shares, cause=_HARDENING),
        )
    source = min(limits, key=lambda limit: limits[limit])
    return Material(
        *(str(deck.get("wire", path.stem)), (partial(_build_deck_section, section, hardening),)),
        *(limits[source], source),
        files=(describe_file("sliders", path),),
        distributions=distributions,
        has_unknown_share=bool(distributions),
    )


@dataclass(frozen=True, slots=True)
class _Hardening:
    """Hardening of the strands of a deck.

    Parameters
    ----------
    strands : growing slider that holds the whole of it
    shares : ends of the interval of the isotropic share; equal if it is known
    """

    strands: GrowingSlider
    shares: tuple[float, float]

    @property
    def is_known(self) -> bool:
        """Return whether the share is known."""
        return self.shares[0] == self.shares[1]


def _read_hardening(deck: Mapping[str, Any]) -> _Hardening | None:
    """Read the growing slider of a deck; None if it has none, so that its copper follows Masing."""
    block = deck.get("growing")
    if block is None:
        return None
    slid, limits = (np.array(block[name], dtype=np.float64) for name in ("slid", "limits"))
    slider = GrowingSlider(float(block["stiffness"]), slid, limits)
    low, high = map(float, block["share_interval"])
    require("share_interval", (low, high), "from 0 to 1, rising", holds=0.0 <= low <= high <= 1.0)
    share = float(block["isotropic_share"])
    require("isotropic_share", share, "above 0 and at most 1", holds=0.0 < share <= 1.0)
    return _Hardening(slider.scaled(1.0 / share), (low, high))


def _build_deck_section(
    section: Section, hardening: _Hardening | None, inputs: Mapping[str, float]
) -> Section:
    """Return the section of a deck with its isotropic share and the factors of the inputs."""
    if hardening is not None:
        stated = hardening.shares[0] if hardening.is_known else 0.0
        share = min(max(inputs.get(ISOTROPIC_SHARE, stated), 0.0), 1.0)
        section = replace(section, law=share_hardening(section.law, hardening.strands, share))
    return _scale_section(section, inputs)


def _read_deck(path: Path) -> dict[str, Any]:
    max_bytes = 1 << 26
    try:
        deck = json.loads(path.read_bytes()) if path.stat().st_size < max_bytes else None
    except (OSError, ValueError, RecursionError) as error:
        raise ReadError.about("mechanics.studies.damaged_deck", path, error=error) from error
    if not isinstance(deck, dict):
        raise ReadError.about("mechanics.studies.no_deck", path)
    if "reason" in deck:
        raise ReadError.about("mechanics.studies.deck_of_reason", path, reason=deck["reason"])
    return deck
