"""Prepare the line of a harness for the rod solver: material, nodes, shape at rest, boundaries.

The section of the line is a function of uncertain inputs. Each position along the line that the
file names becomes a node.

The path of a boundary has a row for the start and one for each step. At the start, the line has its
shape at rest, and all boundaries are on the line. Boundaries move on straight lines from one pose
to the next. Their direction turns about the axis normal to the old and the new direction, and is
then rotated about the line. A ring starts at the nearest point of the line. The anchor of a string
that is too short starts as near to its goal as the string allows.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from labpipe.errors import ReadError
from labpipe.mechanics.law.loss_card import fit_wire_sliders
from labpipe.mechanics.law.plays import require
from labpipe.mechanics.law.sliders import GrowingSlider, SliderLaw, make_linear_law, split_hardening
from labpipe.mechanics.rod import boundaries as rod
from labpipe.mechanics.rod.bands import (
    InputDistribution,
    build_calibration_distributions,
    build_t_distribution,
    build_uniform_distribution,
    join_distributions,
)
from labpipe.mechanics.rod.line import Line, Section, build_line
from labpipe.mechanics.rod.rotations import (
    compute_shortest_rotations,
    from_rotation_vectors,
    multiply,
    normalise,
    to_matrices,
    to_rotation_vectors,
)
from labpipe.mechanics.studies.calibration_file import StoredCalibration, read_calibration
from labpipe.mechanics.studies.wire_sheets import build_wire_error, read_wire_sheet
from labpipe.mechanics.wire.bending_law import make_strand_slider
from labpipe.mechanics.wire.cross_section import compute_stretch_torsion
from labpipe.mechanics.wire.wire_table import (
    DEFAULT_SHARE_RANGE,
    build_wire,
    compute_chord_ratio,
    compute_hull_slopes,
    set_parameters,
    tabulate_wire,
)
from labpipe.messages import format_sentence
from labpipe.protocol.model_files import (
    Clip,
    Grip,
    HarnessFile,
    Holder,
    Load,
    Pin,
    Plane,
    Ring,
    SectionBlock,
    Spool,
    String,
    Waypoint,
    compute_path,
    get_line_start,
    resolve_file_name,
)
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote
from labpipe.records.result import InputFile
from labpipe.records.wire import PARAMETERS, WireSpec

LENGTH_FACTOR = "length_factor"
"""Logarithm of the factor on the length of the line."""
FREE_CURVATURES = ("free_curvature_1", "free_curvature_2")
"""Additions to the curvature at rest, 1/m: towards the side of the spool, and across it."""
Inputs = Mapping[str, float]


class PreparedLine(NamedTuple):
    """A line with all its boundaries, ready to be solved.

    Parameters
    ----------
    line : line in its shape at rest
    boundaries : boundaries in the order of the file; the weight, if there is any, is last
    """

    line: Line
    boundaries: tuple[rod.Boundary, ...]


def prepare_line(harness: HarnessFile, section: Section, inputs: Inputs) -> PreparedLine:
    """Prepare the line of a harness.

    Parameters
    ----------
    harness : harness as described by its file
    section : section of the line
    inputs : `LENGTH_FACTOR` and `FREE_CURVATURES`; missing inputs are 0, others are ignored

    Raises
    ------
    ValueError
        If the section is out of its range, or a spool is in the direction of the line.
    """
    stations = _place_nodes(harness)
    line = _build_line(harness, section, stations * float(np.exp(inputs.get(LENGTH_FACTOR, 0.0))))
    free_curvatures = np.array([inputs.get(name, 0.0) for name in FREE_CURVATURES])
    if np.any(free_curvatures):
        rest_curvature = line.rest_curvature.copy()
        rest_curvature[:, :2] += free_curvatures @ _compute_bend_axes(line, harness.line.spool)
        line = replace(line, rest_curvature=rest_curvature)
    return PreparedLine(line, tuple(_build_boundaries(harness, line, stations)))


def _compute_bend_axes(line: Line, spool: Spool | None) -> Floats:
    """Compute the curvatures about the axes d1 and d2 of curls of 1 1/m towards and across a spool.

    A line that curls to a side t turns about d3 x t, where d3 is the axis along the line. Without a
    spool, the side is d1.

    Returns
    -------
    Curvatures of each curl, shape (2 curls, 2 axes), 1/m.
    """
    axes = to_matrices(line.frames[0])
    side = np.array([1.0, 0.0])
    if spool is not None:
        side = (_compute_side(spool, axes[:, 2]) @ axes)[:2]
    return np.array([[-side[1], side[0]], [-side[0], -side[1]]])


def _place_nodes(harness: HarnessFile) -> Floats:
    """Compute the stations of the nodes, m; elements between named positions have equal lengths."""
    length = harness.line.length
    positions = (getattr(boundary, "at", 0.0) for boundary in harness.boundaries)
    named_stations = sorted({0.0, length, *(min(position, length) for position in positions)})
    n_elements = harness.line.elements
    segments = [
        np.linspace(low, high, 1 + max(1, round(n_elements * (high - low) / length)))[1:]
        for low, high in pairwise(named_stations)
    ]
    return np.concatenate([[0.0], *segments])


def _build_line(harness: HarnessFile, section: Section, stations: Floats) -> Line:
    """Build the line in its shape at rest: straight, or an arc with the curvature of the spool."""
    steep_rise = 0.9  # z of the unit direction; the axis d1 of a steeper line does not point up
    start, direction = (np.array(vector) for vector in get_line_start(harness))
    spool = harness.line.spool
    if spool is None:
        positions = start + stations[:, None] * direction
        is_steep = abs(direction[2]) > steep_rise
        up = np.array([1.0, 0.0, 0.0] if is_steep else [0.0, 0.0, 1.0])
        return build_line(positions, section, up=up)
    side = _compute_side(spool, direction)
    angles = 0.5 * spool.curvature * (stations[1:] + stations[:-1])
    tangents = np.cos(angles)[:, None] * direction + np.sin(angles)[:, None] * side
    arc = np.cumsum(np.diff(stations)[:, None] * tangents, axis=0)
    return build_line(start + np.vstack([np.zeros(3), arc]), section, up=side, is_rest_shape=True)


def _compute_side(spool: Spool, direction: Floats) -> Floats:
    """Compute the unit vector normal to a direction, on the side of a spool.

    Raises
    ------
    ValueError
        If the spool is in the direction of the line.
    """
    min_norm = 1e-6
    towards = np.array(spool.towards)
    normal = towards - (towards @ direction) * direction
    if np.linalg.norm(normal) < min_norm:
        raise ValueError(format_sentence("mechanics.studies.spool_side", towards=spool.towards))
    return np.asarray(normalise(normal))


def _build_boundaries(harness: HarnessFile, line: Line, stations: Floats) -> Iterator[rod.Boundary]:
    """Yield the boundaries of a line.

    Parameters
    ----------
    harness : harness as described by its file
    line : line in its shape at rest
    stations : positions of the nodes along the line with the length in the file, m
    """
    steps = harness.steps
    for boundary in harness.boundaries:
        name = boundary.name
        station = min(getattr(boundary, "at", 0.0), stations[-1])
        node = int(np.argmin(np.abs(stations - station)))
        match boundary:
            case Clip() | Pin() | Grip():
                path = compute_path(boundary, line.positions[node], steps)
                frames = _interpolate_frames(boundary, line.compute_clamp_frame(node), steps)
                yield rod.Held(node, path, frames, boundary.release, name)
            case Ring():
                # the path starts at the nearest point of the line
                target = np.array(boundary.position)
                node = int(np.argmin(np.linalg.norm(line.positions - target, axis=1)))
                parameter = rod.find_nearest_parameter(line.positions, target, float(node))
                path = compute_path(boundary, rod.evaluate_curve(line.positions, parameter), steps)
                yield rod.Ring(path, np.array(boundary.direction), name=name)
            case String():
                path = compute_path(boundary, line.positions[node], steps)
                yield rod.String(node, path, boundary.length, name=name)
            case Load():
                force = _build_ramp(boundary.by or steps, steps)[:, None] * np.array(boundary.force)
                yield rod.Load(node, force, name=name)
            case Plane():
                point, normal = np.array(boundary.point), np.array(boundary.normal)
                yield rod.Plane(point, normal, boundary.friction, name=name)
    if any(harness.gravity) and line.section.mass_per_length > 0.0:
        yield rod.Gravity(_build_gravity(harness), name="weight")


def _build_gravity(harness: HarnessFile) -> Floats:
    """Build the acceleration of gravity in each step, m/s^2.

    If the line is held at two positions, the acceleration increases over the first fifth of the
    steps, because an inextensible line that starts taut cannot carry its whole weight.
    """
    acceleration = np.array(harness.gravity)
    if sum(isinstance(boundary, Holder) for boundary in harness.boundaries) < 2:
        return acceleration
    ramp = _build_ramp(max(1, harness.steps // 5), harness.steps)
    return np.asarray(ramp[:, None] * acceleration)


def _build_ramp(last_step: int, steps: int) -> Floats:
    """Build a ramp from 0 at the start to 1 at its last step, then constant, shape (steps + 1,)."""
    return np.minimum(1.0, np.arange(steps + 1) / last_step)


def _interpolate_frames(boundary: Clip | Pin | Grip, start: Floats, steps: int) -> Floats | None:
    """Interpolate the frames of a path: rotations without twist, then rotations about the line.

    The result is None if the boundary holds only the position.
    """
    if isinstance(boundary, Pin) or (isinstance(boundary, Grip) and boundary.holds != "pose"):
        return None
    frames, turns = [start], {0: 0.0}
    points = boundary.path if isinstance(boundary, Grip) else (boundary,)
    for point in points:
        step = point.step if isinstance(point, Waypoint) else point.by or steps
        n_steps = step - len(frames) + 1
        start_direction = to_matrices(frames[-1])[:, 2]
        direction = start_direction if point.direction is None else np.array(point.direction)
        rotation = to_rotation_vectors(compute_shortest_rotations(start_direction, direction))
        fractions = np.arange(1, n_steps + 1) / n_steps
        partial_rotations = from_rotation_vectors(fractions[:, None] * rotation)
        frames += list(multiply(partial_rotations, np.tile(frames[-1], (n_steps, 1))))
        turns[step] = turns[step - n_steps] if point.turn is None else point.turn
    frames += [frames[-1]] * (steps + 1 - len(frames))
    turn_vectors = np.zeros((steps + 1, 3))
    turn_vectors[:, 2] = np.interp(np.arange(steps + 1), list(turns), list(turns.values()))
    return np.asarray(multiply(np.array(frames), from_rotation_vectors(turn_vectors)))


LAW_FACTOR, TORSION_FACTOR, MASS_FACTOR = "law_factor", "torsion_factor", "mass_factor"
FACTORS = (LAW_FACTOR, TORSION_FACTOR, MASS_FACTOR)
"""Inputs that are logarithms of factors on moments, on torsional stiffness and on mass.

The factor on moments is the scatter of specimens and spools.
"""
ISOTROPIC_SHARE = "isotropic_share"
"""Isotropic share of the hardening of the strands (docs/explanations/measurements.md)."""
DEFAULT_SHEET = "wires.xlsx"
_HARDENING = "hardening of the copper"
_INSULATION_LIMIT = "the straight line of its insulation"

SectionFunction = Callable[[Mapping[str, float]], Section]
"""Section of a line as a function of named inputs."""


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """Material of a line.

    Parameters
    ----------
    name : name of the wire, or a description
    sections : section for each solution of a calibration, as a function of named inputs such as
        ``law_factor``; the best solution is first, and missing inputs are 0
    curvature_limit : largest curvature that tests or tables of the law cover, 1/m
    limit_source : description of the origin of this limit
    share_range : range of the isotropic share of the strands; None if the share is known
    stretch_limit : largest axial strain for which the axial stiffness is valid
    files : files from which the material was read
    notes : quality notes of the law
    distributions : distribution of the inputs for each solution of a calibration; empty if the
        uncertainty of the law is unknown
    """

    name: str
    sections: tuple[SectionFunction, ...]
    curvature_limit: float
    limit_source: str
    files: tuple[InputFile, ...] = ()
    notes: tuple[QualityNote, ...] = ()
    distributions: tuple[InputDistribution, ...] = ()
    stretch_limit: float = np.inf
    share_range: tuple[float, float] | None = None

    @property
    def diameter(self) -> float:
        """Outer diameter, m."""
        return self.sections[0](self.best_inputs).diameter

    @property
    def varies_only_share(self) -> bool:
        """Whether the isotropic share is the only input with a distribution."""
        names = {name for distribution in self.distributions for name in distribution.names}
        return names == {ISOTROPIC_SHARE}

    @property
    def best_inputs(self) -> Mapping[str, float]:
        """Best values of the inputs with a distribution."""
        return self.distributions[0].to_inputs() if self.distributions else {}


def read_material(harness: HarnessFile, file: Path, wires: Path | None = None) -> Material:
    """Read the material of the line of a harness.

    Parameters
    ----------
    harness : harness as described by its file
    file : path of the YAML file; other files are relative to its folder
    wires : wire sheet that replaces the one that the file names; None to keep it

    Raises
    ------
    LabpipeError
        If a file cannot be used, or the sheet does not have the wire.
    """
    block = harness.line.section
    if block.wire is not None:
        material = _read_wire_material(block, file, wires)
    elif block.sliders is not None:
        material = _read_deck_material(block, resolve_file_name(block.sliders, file))
    else:
        material = _build_stiffness_material(block)
    deviations = [(LAW_FACTOR, block.stiffness_uncertainty or 0.0, "stiffness as stated")]
    if harness.line.spool is not None:
        spread = harness.line.spool.spread
        deviations += [(name, spread, "curl of the spool") for name in FREE_CURVATURES]
    stated_distributions = tuple(
        build_t_distribution(name, deviation, cause=cause)
        for name, deviation, cause in deviations
        if deviation > 0.0
    )
    return replace(material, distributions=_join_all(material.distributions, stated_distributions))


def _join_all(
    distributions: tuple[InputDistribution, ...], common: tuple[InputDistribution, ...]
) -> tuple[InputDistribution, ...]:
    """Join the distribution of each solution of a calibration with common distributions."""
    if not common:
        return distributions
    parts_by_solution = [(distribution, *common) for distribution in distributions] or [common]
    return tuple(map(join_distributions, parts_by_solution))


def describe_file(role: str, path: Path) -> InputFile:
    """Describe an input file by its role, name, hash and size.

    Parameters
    ----------
    role : role of the file
    path : path of the file
    """
    content = path.read_bytes()
    return InputFile(role, path.name, hashlib.sha256(content).hexdigest(), len(content))


def _read_wire_material(block: SectionBlock, file: Path, wires: Path | None) -> Material:
    """Read the material of a wire of a sheet, with its calibration if the file names one."""
    max_stretch = 1e-3  # copper yields beyond this strain
    sheet = wires or resolve_file_name(block.sheet or DEFAULT_SHEET, file)
    spec = read_wire_sheet(sheet).find_wire(str(block.wire), f"{file}, line.section.wire")
    files = [describe_file("wires", sheet)]
    calibration = None
    if block.calibration is not None:
        path = resolve_file_name(block.calibration, file)
        calibration = read_calibration(path)
        files.append(describe_file("calibration", path))
    values_by_solution: list[dict[str, float]] = [{}]
    if calibration is not None:
        values_by_solution = [
            dict(zip(PARAMETERS, solution.values.tolist(), strict=True))
            for solution in calibration.solutions
            if solution.is_allowed
        ]
    try:
        table = tabulate_wire(set_parameters(spec, values_by_solution[0]))
        sections = [make_section_function(spec, values) for values in values_by_solution]
    except ValueError as error:
        expected = "a wire whose law can be fitted by sliders"
        raise build_wire_error(sheet, spec, expected, error) from error
    limits = {"its table": float(table.curvature[-1]), _INSULATION_LIMIT: table.doubtful_curvature}
    if calibration is not None and np.isfinite(calibration.tested_curvature):
        limits["the tests of its calibration"] = calibration.tested_curvature
    name = spec.name
    if calibration is not None and calibration.wire != name:
        name = f"{name} (calibrated as {calibration.wire})"
    return Material(
        name,
        tuple(sections),
        *_find_lowest_limit(limits),
        files=tuple(files),
        notes=table.notes,
        distributions=_build_distributions(spec, calibration),
        share_range=None
        if spec.isotropic_share is not None or (calibration and calibration.share)
        else DEFAULT_SHARE_RANGE,
        stretch_limit=max_stretch,
    )


def _find_lowest_limit(limits: Mapping[str, float]) -> tuple[float, str]:
    """Find the lowest limit of the curvature, 1/m, and its source.

    Parameters
    ----------
    limits : limits of the curvature, 1/m, keyed by description of their sources
    """
    source = min(limits, key=lambda name: limits[name])
    return limits[source], source


def _build_distributions(
    spec: WireSpec, calibration: StoredCalibration | None
) -> tuple[InputDistribution, ...]:
    """Build the distributions of a calibration and of an isotropic share that is not stated."""
    distributions: tuple[InputDistribution, ...] = ()
    if calibration is not None:
        distributions = build_calibration_distributions(
            calibration.solutions, calibration.widening, specimen=LAW_FACTOR
        )
    if spec.isotropic_share is not None:
        return distributions
    if calibration is not None and calibration.share is not None:
        value, error = calibration.share
        share = build_t_distribution(ISOTROPIC_SHARE, error, centre=value, cause=_HARDENING)
    else:
        share = build_uniform_distribution(ISOTROPIC_SHARE, *DEFAULT_SHARE_RANGE, cause=_HARDENING)
    return _join_all(distributions, (share,))


def make_section_function(spec: WireSpec, values: Mapping[str, float]) -> SectionFunction:
    """Make the function that builds sections of a wire, all with the same slip curvatures.

    Parameters
    ----------
    spec : wire as described by its sheet
    values : values of `PARAMETERS` for which the slip curvatures are chosen, such as those of a
        calibration; the sheet gives the values of parameters that are missing or NaN

    Returns
    -------
    Function that builds the section for other inputs: logarithms of `PARAMETERS`, by default those
    of `values` or the sheet; `FACTORS`, by default 0; and `ISOTROPIC_SHARE`, by default that of the
    sheet, or 0. Other names are ignored. It raises a `ValueError` if no wire has these parameters.

    Raises
    ------
    ValueError
        If the law cannot be tabulated, or cannot be fitted by sliders.

    Notes
    -----
    If the law were fitted separately for each set of parameters, the sliders would move, and the
    response of a rod would jump. Therefore the sliders keep their slip curvatures, and their
    stiffnesses are the drops of slope of the changed law, which are smooth in all parameters. The
    error is largest where strands begin to slip. With twice the friction, it is up to 30 % of the
    moment at a few hundredths of 1/m, and at most 1.5 % from 1 1/m upwards.
    """
    # A slider that a changed law does not use keeps this stiffness relative to the first one.
    min_slider_stiffness = 1e-9
    table = tabulate_wire(set_parameters(spec, values))
    base_law = fit_wire_sliders(table)
    chord_scale = compute_chord_ratio(base_law, table)
    corners = np.concatenate([[0.0], base_law.slip_curvatures, [base_law.max_curvature]])

    def build_section(inputs: Mapping[str, float]) -> Section:
        """Build the section of a line for other inputs."""
        changed = {name: float(np.exp(inputs[name])) for name in PARAMETERS if name in inputs}
        wire = build_wire(set_parameters(spec, {**values, **changed}))
        slopes = chord_scale * compute_hull_slopes(corners, wire.compute_curve(corners).moment)
        sliders = np.maximum(-np.diff(slopes), min_slider_stiffness * slopes[0])
        law = replace(base_law, spring_stiffness=float(slopes[-1]), slider_stiffnesses=sliders)
        share = inputs.get(ISOTROPIC_SHARE, spec.isotropic_share or 0.0)
        layers, factor = wire.section.layers, chord_scale
        strands = make_strand_slider(layers, corners[1:], factor=factor) if share > 0.0 else None
        matrix = compute_stretch_torsion(wire.section)
        stiffnesses = matrix.torsional_stiffness, matrix.axial_stiffness, matrix.coupling
        section = Section(law, *stiffnesses, wire.mass_per_length, spec.wire_diameter)
        return _adjust_section(section, strands, share, inputs)

    return build_section


def _build_stiffness_material(block: SectionBlock) -> Material:
    """Build the material of a line with constant stiffnesses, as stated in the harness file."""
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
    return Material(name, (partial(_adjust_section, section, None, 0.0),), limit, source)


def _read_deck_material(block: SectionBlock, path: Path) -> Material:
    """Read the material of a line from a deck of sliders."""
    deck = _read_deck(path)
    try:
        stiffnesses, slip_curvatures = (
            np.array(deck[name], dtype=np.float64) for name in ("stiffnesses", "slip_curvatures")
        )
        first_curvature, last_curvature = map(float, deck["range"]["curvature"])
        range_and_error = first_curvature, last_curvature, float(deck.get("error", 0.0))
        section = Section(
            SliderLaw(float(deck["stiffness"]), stiffnesses, slip_curvatures, *range_and_error),
            float(deck["torsional_stiffness"]),
            block.axial_stiffness or np.inf,
            mass_per_length=float(deck.get("mass_per_length") or 0.0),
            diameter=block.diameter or 0.0,
        )
        doubtful_curvature = float(deck.get("doubtful_beyond") or np.inf)
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
        (partial(_adjust_section, section, strands, low if low == high else 0.0),),
        *_find_lowest_limit(
            {"the range of the deck": last_curvature, _INSULATION_LIMIT: doubtful_curvature}
        ),
        files=(describe_file("sliders", path),),
        distributions=distributions,
        share_range=(low, high) if distributions else None,
    )


def _read_hardening(
    block: Mapping[str, Any] | None,
) -> tuple[GrowingSlider | None, tuple[float, float]]:
    """Read the hardening of the strands of a deck.

    Returns
    -------
    slider : growing slider at an isotropic share of 1; None if the copper follows Masing's rule
    share_interval : ends of the interval of the isotropic share, which are equal if it is known
    """
    if block is None:
        return None, (0.0, 0.0)
    slid, limits = (np.array(block[name], dtype=np.float64) for name in ("slid", "limits"))
    slider = GrowingSlider(float(block["stiffness"]), slid, limits)
    low, high = map(float, block["share_interval"])
    require("share_interval", (low, high), "from 0 to 1, rising", holds=0.0 <= low <= high <= 1.0)
    share = float(block["isotropic_share"])
    require("isotropic_share", share, "above 0 and at most 1", holds=0.0 < share <= 1.0)
    return slider.scale(1.0 / share), (low, high)


def _adjust_section(
    section: Section,
    strands: GrowingSlider | None,
    default_share: float,
    inputs: Mapping[str, float],
) -> Section:
    """Apply the isotropic share and the factors of the inputs to a section."""
    law = section.law
    if strands is not None:
        share = min(max(inputs.get(ISOTROPIC_SHARE, default_share), 0.0), 1.0)
        law = split_hardening(law, strands, share)
    factors = [math.exp(inputs.get(name, 0.0)) for name in FACTORS]
    moment_factor, torsion_factor, mass_factor = factors
    return replace(
        section,
        law=replace(
            law,
            spring_stiffness=moment_factor * law.spring_stiffness,
            slider_stiffnesses=moment_factor * law.slider_stiffnesses,
            growing_sliders=tuple(slider.scale(moment_factor) for slider in law.growing_sliders),
        ),
        torsional_stiffness=torsion_factor * section.torsional_stiffness,
        mass_per_length=mass_factor * section.mass_per_length,
    )


def _read_deck(path: Path) -> dict[str, Any]:
    """Read a deck of sliders; refuse a damaged file, and a deck that only states a reason."""
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
