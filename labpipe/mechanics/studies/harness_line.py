"""Prepare the line of a harness for the rod solver: material, nodes, shape at rest, boundaries.

A line is a cable or wire of the harness. Its section is a function of uncertain inputs. Each
position along the line that is named in the file becomes a node.

The path of a boundary has a row for the start and a row for each step. At the start, the line has
its shape at rest, and all boundaries are on the line. Boundaries move on straight lines from one
pose to the next. The frame of a boundary rotates about the axis normal to the old and the new
direction, and then about the line. A ring starts at the point of the line nearest to the position
of the ring. The anchor of a string that is too short starts as near to its target position as the
string allows.
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
    replace_parameters,
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

LOG_LENGTH_FACTOR = "length_factor"
"""Name of an input: logarithm of the factor on the length of the line."""
REST_CURVATURE_CHANGES = ("free_curvature_1", "free_curvature_2")
"""Names of inputs: changes of the curvature at rest, 1/m, towards the spool and normal to it."""
Inputs = Mapping[str, float]
"""Values of inputs, keyed by name."""


class PreparedLine(NamedTuple):
    """A line with all its boundaries, ready to be solved.

    Parameters
    ----------
    line : line in its shape at rest
    boundaries : boundaries in the order of the file; gravity, if any, is last
    """

    line: Line
    boundaries: tuple[rod.Boundary, ...]


def prepare_line(harness: HarnessFile, section: Section, inputs: Inputs) -> PreparedLine:
    """Prepare the line of a harness.

    Parameters
    ----------
    harness : harness as described by its file
    section : section of the line
    inputs : values of `LOG_LENGTH_FACTOR` and `REST_CURVATURE_CHANGES`. A missing input is 0. Other
        inputs are ignored

    Returns
    -------
    The line with its boundaries.

    Raises
    ------
    ValueError
        If the direction towards a spool is parallel to the line.
    """
    stations = _compute_stations(harness)
    length_factor = float(np.exp(inputs.get(LOG_LENGTH_FACTOR, 0.0)))
    line = _build_line(harness, section, stations * length_factor)
    curvature_changes = np.array([inputs.get(name, 0.0) for name in REST_CURVATURE_CHANGES])
    if np.any(curvature_changes):
        rest_curvature = line.rest_curvature.copy()
        rest_curvature[:, :2] += curvature_changes @ _compute_unit_curls(line, harness.line.spool)
        line = replace(line, rest_curvature=rest_curvature)
    return PreparedLine(line, tuple(_build_boundaries(harness, line, stations)))


def _compute_unit_curls(line: Line, spool: Spool | None) -> Floats:
    """Return the curvature vectors of two unit curls, in the axes d1 and d2.

    The first curl bends the line towards the spool, and the second normal to it. A line that curls
    towards a unit vector t turns about d3 x t, where d3 is the axis along the line. Without a
    spool, t of the first curl is d1.

    Returns
    -------
    Curvature of each curl, shape (2 curls, 2 axes), 1/m.
    """
    axes = to_matrices(line.frames[0])
    t = np.array([1.0, 0.0])  # components along d1 and d2
    if spool is not None:
        t = (_compute_spool_normal(spool, axes[:, 2]) @ axes)[:2]
    return np.array([[-t[1], t[0]], [-t[0], -t[1]]])  # d3 x t, and -t


def _compute_stations(harness: HarnessFile) -> Floats:
    """Compute the arc lengths of nodes, m; elements between named positions are equally long."""
    length = harness.line.length
    positions = (getattr(boundary, "at", 0.0) for boundary in harness.boundaries)
    named_stations = sorted({0.0, length, *(min(position, length) for position in positions)})
    n_elements = harness.line.elements
    segments = [
        np.linspace(start, stop, 1 + max(1, round(n_elements * (stop - start) / length)))[1:]
        for start, stop in pairwise(named_stations)
    ]
    return np.concatenate([[0.0], *segments])


def _build_line(harness: HarnessFile, section: Section, stations: Floats) -> Line:
    """Build the line in its shape at rest: straight, or an arc with the curvature of the spool."""
    max_z = 0.9  # of the unit direction; the axis d1 of a steeper line is along x instead of z
    start, direction = (np.array(vector) for vector in get_line_start(harness))
    spool = harness.line.spool
    if spool is None:
        positions = start + stations[:, None] * direction
        up = np.array([1.0, 0.0, 0.0] if abs(direction[2]) > max_z else [0.0, 0.0, 1.0])
        return build_line(positions, section, up=up)
    side = _compute_spool_normal(spool, direction)
    angles = 0.5 * spool.curvature * (stations[1:] + stations[:-1])
    tangents = np.cos(angles)[:, None] * direction + np.sin(angles)[:, None] * side
    arc = np.cumsum(np.diff(stations)[:, None] * tangents, axis=0)
    return build_line(start + np.vstack([np.zeros(3), arc]), section, up=side, is_rest_shape=True)


def _compute_spool_normal(spool: Spool, direction: Floats) -> Floats:
    """Compute the unit vector normal to the line that points towards the spool.

    Raises
    ------
    ValueError
        If the direction towards the spool is parallel to the line.
    """
    min_norm = 1e-6
    spool_direction = np.array(spool.towards)
    normal = spool_direction - (spool_direction @ direction) * direction
    if np.linalg.norm(normal) < min_norm:
        raise ValueError(format_sentence("mechanics.studies.spool_side", towards=spool.towards))
    return np.asarray(normalise(normal))


def _build_boundaries(harness: HarnessFile, line: Line, stations: Floats) -> Iterator[rod.Boundary]:
    """Yield the boundaries of a line.

    Parameters
    ----------
    harness : harness as described by its file
    line : line in its shape at rest
    stations : arc lengths of the nodes before the length factor is applied, m
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
                # The path starts at the nearest point of the line.
                target = np.array(boundary.position)
                node = int(np.argmin(np.linalg.norm(line.positions - target, axis=1)))
                parameter = rod.find_nearest_parameter(line.positions, target, float(node))
                path = compute_path(boundary, rod.evaluate_curve(line.positions, parameter), steps)
                yield rod.Ring(path, np.array(boundary.direction), name=name)
            case String():
                path = compute_path(boundary, line.positions[node], steps)
                yield rod.String(node, path, boundary.length, name=name)
            case Load():
                last_step = boundary.by or steps
                force = _build_ramp(last_step, steps)[:, None] * np.array(boundary.force)
                yield rod.Load(node, force, name=name)
            case Plane():
                point, normal = np.array(boundary.point), np.array(boundary.normal)
                yield rod.Plane(point, normal, boundary.friction, name=name)
    if any(harness.gravity) and line.section.mass_per_length > 0.0:
        yield rod.Gravity(_build_gravity(harness), name="weight")


def _build_gravity(harness: HarnessFile) -> Floats:
    """Build the acceleration of gravity in each step, m/s^2.

    If the line is held at two or more positions, the acceleration increases over the first fifth of
    the steps, because an inextensible line that starts taut has no equilibrium under its full
    weight. Otherwise one acceleration is returned, which is that of all steps.
    """
    acceleration = np.array(harness.gravity)
    if sum(isinstance(boundary, Holder) for boundary in harness.boundaries) < 2:
        return acceleration
    ramp = _build_ramp(max(1, harness.steps // 5), harness.steps)
    return np.asarray(ramp[:, None] * acceleration)


def _build_ramp(last_step: int, steps: int) -> Floats:
    """Build a ramp from 0 at the start to 1 at `last_step`, then constant, shape (steps + 1,)."""
    return np.minimum(1.0, np.arange(steps + 1) / last_step)


def _interpolate_frames(boundary: Clip | Pin | Grip, start: Floats, steps: int) -> Floats | None:
    """Interpolate the frames of a path: rotations without twist, then rotations about the line.

    Return quaternions, shape (steps + 1, 4); None if the boundary holds only the position. `start`
    is the frame at the start.
    """
    if isinstance(boundary, Pin) or (isinstance(boundary, Grip) and boundary.holds != "pose"):
        return None
    frames, twist_angles = [start], {0: 0.0}  # angles, rad, keyed by step
    waypoints = boundary.path if isinstance(boundary, Grip) else (boundary,)
    for point in waypoints:
        last_step = point.step if isinstance(point, Waypoint) else point.by or steps
        previous_step = len(frames) - 1
        n_steps = last_step - previous_step
        start_direction = to_matrices(frames[-1])[:, 2]
        direction = start_direction if point.direction is None else np.array(point.direction)
        rotation = to_rotation_vectors(compute_shortest_rotations(start_direction, direction))
        fractions = np.arange(1, n_steps + 1) / n_steps
        partial_rotations = from_rotation_vectors(fractions[:, None] * rotation)
        frames += list(multiply(partial_rotations, np.tile(frames[-1], (n_steps, 1))))
        twist_angles[last_step] = twist_angles[previous_step] if point.turn is None else point.turn
    frames += [frames[-1]] * (steps + 1 - len(frames))
    twists = np.zeros((steps + 1, 3))
    twists[:, 2] = np.interp(np.arange(steps + 1), [*twist_angles], [*twist_angles.values()])
    return np.asarray(multiply(np.array(frames), from_rotation_vectors(twists)))


LOG_FACTORS = ("law_factor", "torsion_factor", "mass_factor")
"""Names of inputs: logarithms of factors on moments, on torsional stiffness and on mass.

The factor on moments represents the scatter between specimens and spools.
"""
LOG_MOMENT_FACTOR, LOG_TORSION_FACTOR, LOG_MASS_FACTOR = LOG_FACTORS
ISOTROPIC_SHARE = "isotropic_share"
"""Name of an input: isotropic share of the hardening (docs/explanations/measurements.md)."""
DEFAULT_SHEET = "wires.xlsx"
"""Name of the wire sheet if the harness file names none."""
_HARDENING = "hardening of the copper"
_INSULATION_SOURCE = "the linear range of the insulation"

SectionFunction = Callable[[Inputs], Section]
"""Section of a line as a function of inputs."""


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """Section of a line as a function of inputs, with its limits of validity.

    Parameters
    ----------
    name : name of the wire, or a description
    sections : section for each solution of a calibration, as a function of inputs; the best
        solution is first. A missing input has the value of the calibration, of the wire sheet or of
        the slider file; a missing factor is 1
    curvature_limit : largest curvature for which the section is valid, 1/m
    limit_source : source of `curvature_limit`, for messages
    files : files from which the section was read
    notes : quality notes of the law
    distributions : distribution of the inputs for each solution of a calibration; empty if the
        uncertainty of the law is unknown
    stretch_limit : largest axial strain for which the axial stiffness is valid
    share_range : range of the isotropic share of the strands; None if the share is given
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
        """Return the outer diameter, m."""
        return self.sections[0](self.best_inputs).diameter

    @property
    def varies_only_share(self) -> bool:
        """Return whether the isotropic share is the only input with a distribution."""
        names = {name for distribution in self.distributions for name in distribution.names}
        return names == {ISOTROPIC_SHARE}

    @property
    def best_inputs(self) -> Mapping[str, float]:
        """Return the best values of the inputs that have a distribution."""
        return self.distributions[0].to_inputs() if self.distributions else {}


def read_material(harness: HarnessFile, file: Path, wires: Path | None = None) -> Material:
    """Read the material of the line of a harness.

    Parameters
    ----------
    harness : harness as described by its file
    file : path of the harness file; other files are relative to its folder
    wires : path of a wire sheet to use instead of the one that the file names; None to use that one

    Raises
    ------
    LabpipeError
        If a file cannot be used, or the sheet does not have the wire.
    """
    block = harness.line.section
    if block.wire is not None:
        material = _read_wire_material(block, file, wires)
    elif block.sliders is not None:
        material = _read_slider_file_material(block, resolve_file_name(block.sliders, file))
    else:
        material = _build_linear_material(block)
    # Each row has the name of the input, its standard deviation and the cause.
    deviations = [(LOG_MOMENT_FACTOR, block.stiffness_uncertainty or 0.0, "stiffness as stated")]
    if harness.line.spool is not None:
        spread = harness.line.spool.spread
        deviations += [(name, spread, "curl of the spool") for name in REST_CURVATURE_CHANGES]
    common_distributions = tuple(
        build_t_distribution(name, deviation, cause=cause)
        for name, deviation, cause in deviations
        if deviation > 0.0
    )
    return replace(material, distributions=_join_each(material.distributions, common_distributions))


def _join_each(
    distributions: tuple[InputDistribution, ...], common: tuple[InputDistribution, ...]
) -> tuple[InputDistribution, ...]:
    """Join the distribution of each solution of a calibration with common distributions."""
    if not common:
        return distributions
    groups = [(distribution, *common) for distribution in distributions] or [common]
    return tuple(map(join_distributions, groups))


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
    """Read the material of a wire in a sheet, with a calibration if the file names one."""
    max_stretch = 1e-3  # copper yields beyond this strain
    sheet_path = wires or resolve_file_name(block.sheet or DEFAULT_SHEET, file)
    spec = read_wire_sheet(sheet_path).find_wire(str(block.wire), f"{file}, line.section.wire")
    files = [describe_file("wires", sheet_path)]
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
        table = tabulate_wire(replace_parameters(spec, values_by_solution[0]))
        sections = [make_section_function(spec, values) for values in values_by_solution]
    except ValueError as error:
        expected = "a wire whose law can be fitted by sliders"
        raise build_wire_error(sheet_path, spec, expected, error) from error
    limits = {"the table of the wire": float(table.curvature[-1])}
    limits[_INSULATION_SOURCE] = table.doubtful_curvature
    if calibration is not None and np.isfinite(calibration.tested_curvature):
        limits["the tests of the calibration"] = calibration.tested_curvature
    name = spec.name
    if calibration is not None and calibration.wire != name:
        name = f"{name} (calibrated as {calibration.wire})"
    is_share_given = spec.isotropic_share is not None or (calibration and calibration.share)
    limit_source = min(limits, key=lambda source: limits[source])
    return Material(
        name=name,
        sections=tuple(sections),
        curvature_limit=limits[limit_source],
        limit_source=limit_source,
        files=tuple(files),
        notes=table.notes,
        distributions=_build_distributions(spec, calibration),
        share_range=None if is_share_given else DEFAULT_SHARE_RANGE,
        stretch_limit=max_stretch,
    )


def _build_distributions(
    spec: WireSpec, calibration: StoredCalibration | None
) -> tuple[InputDistribution, ...]:
    """Build the distributions of a calibration, and of a share that the sheet does not give."""
    distributions: tuple[InputDistribution, ...] = ()
    if calibration is not None:
        distributions = build_calibration_distributions(
            calibration.solutions, calibration.widening, specimen=LOG_MOMENT_FACTOR
        )
    if spec.isotropic_share is not None:
        return distributions
    if calibration is not None and calibration.share is not None:
        value, error = calibration.share
        share = build_t_distribution(ISOTROPIC_SHARE, error, centre=value, cause=_HARDENING)
    else:
        share = build_uniform_distribution(ISOTROPIC_SHARE, *DEFAULT_SHARE_RANGE, cause=_HARDENING)
    return _join_each(distributions, (share,))


def make_section_function(spec: WireSpec, values: Mapping[str, float]) -> SectionFunction:
    """Make the function that builds sections of a wire, all with the same slip curvatures.

    Parameters
    ----------
    spec : specification of the wire in its sheet
    values : values of `PARAMETERS` for which the slip curvatures are chosen, such as those of a
        calibration; the sheet gives the values of parameters that are missing or NaN

    Returns
    -------
    Function that builds the section for given inputs: logarithms of `PARAMETERS`, by default those
    of `values` or the sheet; `LOG_FACTORS`, by default 0; and `ISOTROPIC_SHARE`, by default that of
    the sheet, or 0. The function ignores other names. It raises a `ValueError` if the parameters
    are inconsistent.

    Raises
    ------
    ValueError
        If the law cannot be tabulated, or cannot be fitted by sliders.

    Notes
    -----
    If the law were fitted separately for each set of parameters, the slip curvatures would change,
    and the response of a rod would be discontinuous. Therefore the sliders keep their slip
    curvatures. Their stiffnesses are the decreases in slope of the new law, which are smooth in all
    parameters. The error is largest where strands begin to slip. With twice the friction, the error
    is up to 30 % of the moment near 0.03 1/m, and at most 1.5 % at curvatures above 1 1/m.
    """
    min_slider_stiffness = 1e-9  # lower bound, relative to the first slope of the law
    table = tabulate_wire(replace_parameters(spec, values))
    base_law = fit_wire_sliders(table)
    chord_ratio = compute_chord_ratio(base_law, table)
    corners = np.concatenate([[0.0], base_law.slip_curvatures, [base_law.max_curvature]])

    def build_section(inputs: Inputs) -> Section:
        """Build the section of a line for given inputs."""
        new_values = {name: float(np.exp(inputs[name])) for name in PARAMETERS if name in inputs}
        wire = build_wire(replace_parameters(spec, {**values, **new_values}))
        slopes = chord_ratio * compute_hull_slopes(corners, wire.compute_curve(corners).moment)
        stiffnesses = np.maximum(-np.diff(slopes), min_slider_stiffness * slopes[0])
        law = replace(base_law, spring_stiffness=float(slopes[-1]), slider_stiffnesses=stiffnesses)
        share = inputs.get(ISOTROPIC_SHARE, spec.isotropic_share or 0.0)
        strand_slider = None
        if share > 0.0:
            strand_slider = make_strand_slider(wire.section.layers, corners[1:], factor=chord_ratio)
        stretch_torsion = compute_stretch_torsion(wire.section)
        section = Section(
            law,
            torsional_stiffness=stretch_torsion.torsional_stiffness,
            axial_stiffness=stretch_torsion.axial_stiffness,
            coupling=stretch_torsion.coupling,
            mass_per_length=wire.mass_per_length,
            diameter=spec.wire_diameter,
        )
        return _adjust_section(section, strand_slider, share, inputs)

    return build_section


def _build_linear_material(block: SectionBlock) -> Material:
    """Build the material of a line with constant stiffnesses, as stated in the harness file."""
    stiffness, max_curvature = block.bending_stiffness or 0.0, block.largest_curvature or 0.0
    section = Section(
        make_linear_law(stiffness, max_curvature),
        block.torsional_stiffness or 0.0,
        block.axial_stiffness or np.inf,
        mass_per_length=block.mass_per_length or 0.0,
        diameter=block.diameter or 0.0,
    )
    name = f"stiffness {1e6 * stiffness:.6g} N mm^2"
    source = "'largest_curvature' of the file"
    return Material(name, (partial(_adjust_section, section, None, 0.0),), max_curvature, source)


def _read_slider_file_material(block: SectionBlock, path: Path) -> Material:
    """Read the material of a line from a file of sliders (``<wire>.sliders.json``)."""
    content = _read_slider_file(path)
    try:
        stiffnesses, slip_curvatures = (
            np.array(content[name], dtype=np.float64) for name in ("stiffnesses", "slip_curvatures")
        )
        min_curvature, max_curvature = map(float, content["range"]["curvature"])
        spring_stiffness, law_error = float(content["stiffness"]), float(content.get("error", 0.0))
        law = SliderLaw(
            spring_stiffness, stiffnesses, slip_curvatures, min_curvature, max_curvature, law_error
        )
        section = Section(
            law,
            float(content["torsional_stiffness"]),
            block.axial_stiffness or np.inf,
            mass_per_length=float(content.get("mass_per_length") or 0.0),
            diameter=block.diameter or 0.0,
        )
        doubtful_curvature = float(content.get("doubtful_beyond") or np.inf)
        strand_slider, (low_share, high_share) = _read_hardening(content.get("growing"))
    except (KeyError, TypeError, ValueError, IndexError) as error:
        fault = f"no key {error}" if isinstance(error, KeyError) else f"an invalid value: {error}"
        raise ReadError.about("mechanics.studies.deck_without_law", path, fault=fault) from error
    default_share, distributions = low_share, tuple[InputDistribution, ...]()
    if low_share < high_share:
        default_share = 0.0
        share = build_uniform_distribution(ISOTROPIC_SHARE, low_share, high_share, cause=_HARDENING)
        distributions = (share,)
    range_source = "the range of the slider file"
    return Material(
        name=str(content.get("wire", path.stem)),
        sections=(partial(_adjust_section, section, strand_slider, default_share),),
        curvature_limit=min(max_curvature, doubtful_curvature),
        limit_source=range_source if max_curvature <= doubtful_curvature else _INSULATION_SOURCE,
        files=(describe_file("sliders", path),),
        distributions=distributions,
        share_range=(low_share, high_share) if distributions else None,
    )


def _read_hardening(
    entry: Mapping[str, Any] | None,
) -> tuple[GrowingSlider | None, tuple[float, float]]:
    """Read the hardening of the strands from the entry ``growing`` of a slider file.

    Returns
    -------
    slider : growing slider at an isotropic share of 1; None if the copper follows Masing's rule
    share_interval : ends of the interval of the isotropic share, which are equal if the share is
        known
    """
    if entry is None:
        return None, (0.0, 0.0)
    slid_curvatures, limits = (np.array(entry[name], dtype=float) for name in ("slid", "limits"))
    slider = GrowingSlider(float(entry["stiffness"]), slid_curvatures, limits)
    low, high = map(float, entry["share_interval"])
    is_valid = 0.0 <= low <= high <= 1.0
    require("share_interval", (low, high), "from 0 to 1, not decreasing", holds=is_valid)
    share = float(entry["isotropic_share"])
    require("isotropic_share", share, "above 0 and at most 1", holds=0.0 < share <= 1.0)
    return slider.scale(1.0 / share), (low, high)


def _adjust_section(
    section: Section,
    strand_slider: GrowingSlider | None,
    default_share: float,
    inputs: Inputs,
) -> Section:
    """Apply the isotropic share and the factors of the inputs to a section."""
    law = section.law
    if strand_slider is not None:
        share = min(max(inputs.get(ISOTROPIC_SHARE, default_share), 0.0), 1.0)
        law = split_hardening(law, strand_slider, share)
    factors = [math.exp(inputs.get(name, 0.0)) for name in LOG_FACTORS]
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


def _read_slider_file(path: Path) -> dict[str, Any]:
    """Read the content of a file of sliders.

    Raises
    ------
    ReadError
        If the file is damaged or of another kind, or if it states only why sliders were not fitted.
    """
    max_bytes = 64 * 2**20
    try:
        content = json.loads(path.read_bytes()) if path.stat().st_size < max_bytes else None
    except (OSError, ValueError, RecursionError) as error:
        raise ReadError.about("mechanics.studies.damaged_deck", path, error=error) from error
    if not isinstance(content, dict):
        raise ReadError.about("mechanics.studies.no_deck", path)
    if "reason" in content:
        raise ReadError.about("mechanics.studies.deck_of_reason", path, reason=content["reason"])
    return content
