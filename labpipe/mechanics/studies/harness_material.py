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
from labpipe.mechanics.wire.wire_table import (
    ISOTROPIC_SHARE,
    LAW_FACTOR,
    MASS_FACTOR,
    TORSION_FACTOR,
    UNKNOWN_SHARE,
    LawFamily,
    apply_values,
    make_law_family,
    wire_table,
)
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
    sections = tuple(partial(_fix, section, material.best) for section in material.sections)
    return replace(material, sections=sections, distributions=())


def _fix(section: SectionAt, inputs: Mapping[str, float], _: Mapping[str, float]) -> Section:
    return section(inputs)


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
    stated = [(LAW_FACTOR, block.stiffness_uncertainty or 0.0, "stiffness as stated")]
    if harness.line.spool is not None:
        spread = harness.line.spool.spread
        stated += [(name, spread, "curl of the spool") for name in FREE_CURVATURES]
    parts = tuple(
        build_stated_distribution(name, deviation, cause=cause)
        for name, deviation, cause in stated
        if deviation > 0.0
    )
    return replace(material, distributions=_join_all(material.distributions, parts))


def _join_all(
    distributions: tuple[InputDistribution, ...], parts: tuple[InputDistribution, ...]
) -> tuple[InputDistribution, ...]:
    """Join the distribution of each solution of a calibration with further ones."""
    if not parts:
        return distributions
    rows = [(distribution, *parts) for distribution in distributions] or [parts]
    return tuple(map(join_distributions, rows))


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
    specs = [spec]
    if calibrated is not None:
        allowed = [row for row, solution in enumerate(calibrated.solutions) if solution.is_allowed]
        specs = [apply_values(spec, calibrated.values(row)) for row in allowed]
    try:
        table, families = wire_table(specs[0]), [make_law_family(spec) for spec in specs]
    except ValueError as error:
        expected = "a wire whose law can be fitted by sliders"
        raise build_wire_error(sheet, spec, expected, error) from error
    limits = {"its table": float(table.curvature[-1]), _INSULATION_LIMIT: table.doubtful_curvature}
    if calibrated is not None and np.isfinite(calibrated.tested_curvature):
        limits["the tests of its calibration"] = calibrated.tested_curvature
    name = spec.name
    if calibrated is not None and calibrated.wire != name:
        name = f"{name} (calibrated as {calibrated.wire})"
    return Material(
        name,
        tuple(partial(_build_section, family, spec.wire_diameter) for family in families),
        *_find_lowest(limits),
        files=tuple(files),
        notes=table.notes,
        distributions=_build_distributions(spec, calibrated),
        has_unknown_share=spec.isotropic_share is None
        and (calibrated is None or calibrated.share is None),
        stretch_limit=1e-3,  # copper yields beyond it
    )


def _find_lowest(limits: Mapping[str, float]) -> tuple[float, str]:
    """Return the lowest limit and its source."""
    source = min(limits, key=lambda name: limits[name])
    return limits[source], source


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
    return _join_all(distributions, (share,))


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
        stiffnesses, slips = (
            np.array(deck[name], dtype=np.float64) for name in ("stiffnesses", "slip_curvatures")
        )
        first, last = map(float, deck["range"]["curvature"])
        error = float(deck.get("error", 0.0))
        section = Section(
            SliderLaw(float(deck["stiffness"]), stiffnesses, slips, first, last, error),
            float(deck["torsional_stiffness"]),
            block.axial_stiffness or np.inf,
            mass_per_length=float(deck.get("mass_per_length") or 0.0),
            diameter=block.diameter or 0.0,
        )
        doubtful = float(deck.get("doubtful_beyond") or np.inf)
        strands, (low, high) = _read_hardening(deck.get("growing"))
    except (KeyError, TypeError, ValueError, IndexError) as cause:
        fault = f"none under {cause}" if isinstance(cause, KeyError) else f"this: {cause}"
        raise ReadError.about("mechanics.studies.deck_without_law", path, fault=fault) from cause
    distributions: tuple[InputDistribution, ...] = ()
    if low < high:
        share = build_uniform_distribution(ISOTROPIC_SHARE, low, high, cause=_HARDENING)
        distributions = (share,)
    return Material(
        str(deck.get("wire", path.stem)),
        (partial(_build_deck_section, section, strands, low if low == high else 0.0),),
        *_find_lowest({"the range of the deck": section.law.last, _INSULATION_LIMIT: doubtful}),
        files=(describe_file("sliders", path),),
        distributions=distributions,
        has_unknown_share=bool(distributions),
    )


def _read_hardening(
    block: Mapping[str, Any] | None,
) -> tuple[GrowingSlider | None, tuple[float, float]]:
    """Read the hardening of the strands of a deck.

    Returns
    -------
    The growing slider that holds the whole of it, None if the copper follows Masing's rule; and the
    ends of the interval of the isotropic share, which are equal if it is known.
    """
    if block is None:
        return None, (0.0, 0.0)
    slid, limits = (np.array(block[name], dtype=np.float64) for name in ("slid", "limits"))
    slider = GrowingSlider(float(block["stiffness"]), slid, limits)
    low, high = map(float, block["share_interval"])
    require("share_interval", (low, high), "from 0 to 1, rising", holds=0.0 <= low <= high <= 1.0)
    share = float(block["isotropic_share"])
    require("isotropic_share", share, "above 0 and at most 1", holds=0.0 < share <= 1.0)
    return slider.scaled(1.0 / share), (low, high)


def _build_deck_section(
    section: Section, strands: GrowingSlider | None, known: float, inputs: Mapping[str, float]
) -> Section:
    """Return the section of a deck with its isotropic share and the factors of the inputs."""
    if strands is not None:
        share = min(max(inputs.get(ISOTROPIC_SHARE, known), 0.0), 1.0)
        section = replace(section, law=share_hardening(section.law, strands, share))
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
