"""What the package predicts of the drawn lines: calibration of synthetic tests, then bands."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from labpipe.mechanics.rod import bands as line_bands
from labpipe.mechanics.rod.path import RodPath
from labpipe.mechanics.studies.harness_line import (
    LOG_MASS_FACTOR,
    LOG_MOMENT_FACTOR,
    LOG_TORSION_FACTOR,
    SectionFunction,
    make_section_function,
)
from labpipe.mechanics.wire.calibration.calibrate_wire import (
    Settings,
    calibrate,
    find_tested_curvature,
)
from labpipe.mechanics.wire.calibration.measured_curves import MeasuredCurve
from labpipe.mechanics.wire.calibration.objective import Wire
from labpipe.mechanics.wire.cantilever import StringRig
from labpipe.mechanics.wire.wire_table import build_wire
from labpipe.records.wire import PARAMETERS, Calibration, WireSpec
from labpipe.units import GRAVITY
from tests.coverage.drawn_lines import (
    FREEDOM,
    SPREAD,
    WIRES,
    Drawn,
    LineKind,
    draw,
    wire_drawn,
)
from tests.coverage.true_lines import PreparedLine, TrueLine, held_at, true_line
from tests.judges.foreign import wire_section as foreign

SAMPLES, POINTS, DEEPEST = 3, 272, 0.05
NOISE, GAIN = 2e-3, 0.005
"""N, of a point; of the load cell, in logarithms."""
LENGTH_FACTOR = "length_factor"
_INPUTS = {
    "spool": LOG_MOMENT_FACTOR,
    "mass_factor": LOG_MASS_FACTOR,
    "torsion_factor": LOG_TORSION_FACTOR,
    "length_factor": LENGTH_FACTOR,
}
_STILL = 1e-9
"""m: a band that is narrower is that of a node that is held."""


@cache
def spec_of(name: str) -> WireSpec:
    """The wire as a sheet has it."""
    made = foreign.BUILDS[name]
    counts = (1, *(6 * ring for ring in range(1, len(made.lays) + 1)))
    nominal = foreign.Truth()
    return WireSpec(
        name=name,
        wire_diameter=made.diameter,
        layer_counts=counts,
        strand_diameters=(made.strand,) * len(counts),
        lay_angles=tuple(float(np.radians(lay)) for lay in made.lays),
        insulation_thickness=made.wall,
        insulation_modulus=nominal.modulus,
        friction_strand=nominal.strand,
        friction_insulation=nominal.tube,
        radial_force=nominal.friction / (nominal.strand + nominal.tube),
        layout="compressed" if made.is_compressed else "auto",
    )


@cache
def wire_of(name: str) -> Wire:
    """The same, to be calibrated."""
    spec = spec_of(name)
    built = build_wire(spec)
    weight = GRAVITY * built.mass_per_length
    return Wire(built.section, built.contacts, self_weight=weight)


def tests_of(seed: int) -> tuple[MeasuredCurve, ...]:
    """Three cantilever tests of the wire of a seed, bent by the second simulator."""
    name, truth, chance = wire_drawn(seed)
    long, weight = 1e-3 * WIRES[name], wire_of(name).self_weight
    bent = foreign.loading(name, long, truth)
    deflection = np.linspace(0.0, DEEPEST, POINTS)
    exact = PchipInterpolator(bent.deflection, bent.force)(deflection)
    gain = float(np.exp(GAIN * chance.normal()))
    rig = StringRig(foreign.STRING, foreign.COUNTERWEIGHT, long, foreign.STRING)
    curves = []
    for number in range(1, SAMPLES + 1):
        factor = gain * np.exp(SPREAD["specimen"] * chance.normal())
        force = factor * exact + NOISE * chance.normal(size=POINTS)
        label = f"{name}-{number}"
        about = (name, label, label, long, deflection, force, NOISE, rig)
        curves.append(MeasuredCurve(*about, self_weight=weight))
    return tuple(curves)


@dataclass(frozen=True, slots=True, eq=False)
class KnownFacts:
    """What is known of a wire: its calibration, and how far its tests went, 1/m."""

    calibration: Calibration
    tested_curvature: float


@lru_cache(maxsize=4)
def known_of(seed: int) -> KnownFacts:
    """Calibrate the wire of a seed.

    Raises
    ------
    RuntimeError
        If that fails.
    """
    wire, curves = wire_of(wire_drawn(seed)[0]), tests_of(seed)
    found = calibrate(wire, curves, Settings(gain=GAIN))
    if not isinstance(found, Calibration):
        message = f"{found.code}: {found.message}"
        raise RuntimeError(message)
    return KnownFacts(found, find_tested_curvature(wire, found.solutions[0].values, curves[:1]))


def beliefs_of(
    kind: LineKind, drawn: Drawn, found: Calibration
) -> tuple[line_bands.InputDistribution, ...]:
    """What is known of the line's inputs, for each solution."""
    stated = [
        line_bands.build_t_distribution(
            _INPUTS.get(name, name),
            deviation,
            freedom=FREEDOM.get(name.removesuffix("_1").removesuffix("_2"), np.inf),
            cause=name,
        )
        for name, deviation in drawn.stated.items()
        if name != "specimen"
    ]
    calibrated = line_bands.build_calibration_distributions(
        found.solutions, found.widening, specimen=LOG_MOMENT_FACTOR
    )
    return tuple(line_bands.join_distributions([each, *stated]) for each in calibrated)


def path_of(
    kind: LineKind, drawn: Drawn, build_section: SectionFunction, inputs: Mapping[str, float]
) -> RodPath:
    """Follow a line for named inputs, with the laws of one solution."""
    law = build_section(inputs)
    laid = PreparedLine(
        *(law.law, law.torsional_stiffness, law.mass_per_length),
        drawn.length * float(np.exp(inputs.get(LENGTH_FACTOR, 0.0))),
        (inputs.get("free_curvature_1", 0.0), inputs.get("free_curvature_2", 0.0)),
        inputs,
    )
    return laid.follow(kind, drawn)


def predicted(kind: LineKind, drawn: Drawn, what: KnownFacts) -> line_bands.LineBands | None:
    """The line with bands, held and on its way back."""
    values = [
        dict(zip(PARAMETERS, solution.values.tolist(), strict=True))
        for solution in what.calibration.solutions
        if solution.is_allowed
    ]
    return line_bands.predict_line_bands(
        [
            partial(path_of, kind, drawn, make_section_function(spec_of(drawn.wire), own))
            for own in values
        ],
        beliefs_of(kind, drawn, what.calibration),
        steps=(held_at(kind), -1),
        tested_curvature=what.tested_curvature,
    )


def asked(drawn: Drawn, truth: TrueLine, bands: line_bands.LineBands) -> Iterator[dict[str, Any]]:
    """Numbers that are looked at, with their bands: one of each sort, chosen with the line."""
    (held, back), which = bands.states, drawn.asked
    node, turned = (which["node"], which["axis"]), which["moment axis"]
    free = which["free node"], which["free axis"]
    numbers: tuple[tuple[str, float, line_bands.Band, tuple[int, ...]], ...] = (
        ("shape", float(truth.held[node]), held.positions, node),
        ("moment", float(truth.moment[turned]), held.reaction_moments, (0, turned)),
        ("bend radius", truth.bend_radius, held.smallest_bend_radius, ()),
        ("shape on the way back", float(truth.back[free]), back.positions, free),
    )
    for name, number, band, place in numbers:
        value, lower, upper = (float(edge[place]) for edge in (band.value, band.lower, band.upper))
        yield {"name": name, "truth": number, "value": value, "lower": lower, "upper": upper}


def shares_inside(truth: TrueLine, bands: line_bands.LineBands) -> dict[str, float]:
    """Share of all nodes and components inside; what is held is left out."""
    found = {}
    for name, places, state in zip(
        ("shape", "shape on the way back"), (truth.held, truth.back), bands.states, strict=True
    ):
        band = state.positions
        moves = band.upper - band.lower > _STILL
        inside = (places >= band.lower) & (places <= band.upper)
        found[name] = float(inside[moves].mean())
    return found


def rows(kind: LineKind, seed: int) -> dict[str, Any]:
    """What is predicted of a line, beside what it does.

    Returns
    -------
    rows : by number asked: truth, value, ends of the band
    about : the wire, and
        notes : what makes the bands doubtful
        inside : share of all nodes and components inside, by shape
        shares : of each cause in the bend radius
        failed : without a prediction
    """
    drawn, what = draw(kind, seed), known_of(seed)
    truth = true_line(
        kind, drawn, make_section_function(spec_of(drawn.wire), {})({}).torsional_stiffness
    )
    bands = predicted(kind, drawn, what)
    if bands is None:
        return {"about": {"wire": drawn.wire, "failed": "no_equilibrium"}}
    return {
        "rows": list(asked(drawn, truth, bands)),
        "about": {
            "wire": drawn.wire,
            "notes": [note.code for note in bands.notes],
            "inside": shares_inside(truth, bands),
            "shares": dict(bands.states[0].variance_fractions["smallest_bend_radius"]),
        },
    }
