"""Campaigns of cantilever tests that the study of calibrations draws, by kind and seed.

Three samples of one wire on one length, 272 points to 50 mm, each with its own factor on the force
and white noise, read by one load cell. The wire has weight and is bent either by the second
simulator (`tests.judges.foreign.wire_section`, which shares no code with the package) or by the
package's own path station by station, which shares the law of the wire with the calibration.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from labpipe.mechanics.wire.bending_law import fit_play_law, make_contacts
from labpipe.mechanics.wire.calibration.calibrate_wire import Settings, calibrate, predict
from labpipe.mechanics.wire.calibration.measured_curves import MeasuredCurve
from labpipe.mechanics.wire.calibration.objective import Wire
from labpipe.mechanics.wire.cantilever import StringRig, bend_to_travel, make_straight
from labpipe.mechanics.wire.cross_section import Insulation, lay_up, place_hexagon, place_sectors
from labpipe.mechanics.wire.materials import ANNEALED_COPPER
from labpipe.records.arrays import Floats
from labpipe.records.wire import PARAMETERS, CalibratedParameter, Calibration
from tests.judges.foreign import wire_section as foreign

SAMPLES, POINTS, DEEPEST = 3, 272, 0.05
SCATTER, GAIN = 0.03, 0.005
AT = np.array([0.005, 0.02, 0.05])
"""m, deflections at which the band of another length is looked at."""
_BETWEEN = tuple(1.04 * DEEPEST * np.linspace(0.0125, 1.0, 80) ** 1.8)
"""m, where a curve is solved besides: beyond the deepest, for the clamp goes farther."""


@dataclass(frozen=True, slots=True, order=True)
class WireKind:
    """What is drawn again and again.

    Parameters
    ----------
    model : ``foreign`` or ``own``: which simulator bends the wire
    wire : name, of Tables 2.1 and 3.4 of the source
    length : mm
    noise : mN, of a point
    campaigns : how many
    """

    model: str
    wire: str
    length: int
    noise: float
    campaigns: int

    @property
    def name(self) -> str:
        """Such as ``foreign A2 85 mm 2 mN``."""
        return f"{self.model} {self.wire} {self.length} mm {self.noise:g} mN"

    @property
    def other(self) -> int:
        """mm, the length that is predicted."""
        return 85 if self.length == 100 else 100

    @property
    def seeds(self) -> range:
        """Of its campaigns."""
        return range(FIRST_SEED, FIRST_SEED + self.campaigns)


FIRST_SEED = 31000
"""Never changed."""
BAND = "band"
"""First word of the names of bands."""
MAIN = (("A2", 85), ("A3", 120), ("C5", 120), ("B1", 100))
OTHERS = (
    *(("A1", length) for length in (85, 120)),
    *(("A2", 120), ("A3", 85), ("B1", 85), ("B2", 85), ("B2", 100)),
    *((f"C{number}", length) for number in range(1, 5) for length in (85, 120)),
    ("C5", 85),
)
KINDS = (
    *(WireKind("foreign", *wire, 2.0, 200) for wire in MAIN),
    *(WireKind("own", *wire, 2.0, 200) for wire in MAIN),
    *(WireKind("foreign", *wire, 0.1, 60) for wire in MAIN),
    *(WireKind("foreign", *other, 2.0, 60) for other in OTHERS),
    *(WireKind("own", *other, 2.0, 60) for other in OTHERS),
)
TRUTH = foreign.Truth()
_VALUES = dict(zip(PARAMETERS, (TRUTH.friction, TRUTH.modulus, TRUTH.copper), strict=True))


@lru_cache
def wire_of(name: str) -> Wire:
    """The wire as a sheet has it."""
    build = foreign.BUILDS[name]
    lays = [float(np.radians(lay)) for lay in build.lays]
    layers = lay_up(build.strands, build.strand, lays, ANNEALED_COPPER)
    tube = Insulation(build.diameter / 2.0 - build.wall, build.wall, TRUTH.modulus)
    section = (place_sectors if build.is_compressed else place_hexagon)(layers, tube)
    radial = TRUTH.friction / (TRUTH.strand + TRUTH.tube)
    contacts = make_contacts(
        len(lays), strand=TRUTH.strand, insulation=TRUTH.tube, radial_force=radial
    )
    return Wire(section, contacts, self_weight=foreign.weight_of(build))


def rig_of(length: float) -> StringRig:
    """String and counterweight over the tip."""
    return StringRig(foreign.STRING, foreign.COUNTERWEIGHT, length, foreign.STRING)


@lru_cache
def true_curve(model: str, wire: str, length: int, at: tuple[float, ...]) -> PchipInterpolator:
    """Force over deflection from rest, N and m, of a sample without scatter.

    Parameters
    ----------
    model, wire, length : as of a kind
    at : m, deflections that grow; the curve is solved there, for between points that are a fifth of
        a millimetre apart the corners where strands begin to slip come to a tenth of a millinewton
    """
    goals, long = sorted({*at, *_BETWEEN}), 1e-3 * length
    if model == "foreign":
        bent = foreign.loading(wire, long, TRUTH, goals=tuple(goal for goal in goals if goal > 0.0))
        return PchipInterpolator(bent.deflection, bent.force)
    made, rig = wire_of(wire), rig_of(long)
    law = fit_play_law(made.section, made.contacts, largest_curvature=80.0, n_plays=200)
    state = make_straight(law, self_weight=made.self_weight)
    rest = bend_to_travel(law, state, long, rig, 0.0)
    deflections, forces, state = [0.0], [0.0], rest.state
    for goal in goals:  # travel is a little more than deflection, and later much more
        if goal > 0.0:
            shape = bend_to_travel(law, state, long, rig, float(goal))
            deflections.append(float(shape.y[-1] - rest.y[-1]))
            forces.append(shape.tension - rest.tension)
            state = shape.state
    return PchipInterpolator(deflections, forces)


def campaign(kind: WireKind, seed: int) -> tuple[float, tuple[MeasuredCurve, ...]]:
    """Gain of the load cell, as a factor, and what was measured."""
    chance = np.random.default_rng([seed, kind.length, *kind.wire.encode(), len(kind.model)])
    gain = float(np.exp(GAIN * chance.normal()))
    deflection = np.linspace(0.0, DEEPEST, POINTS)
    exact = true_curve(kind.model, kind.wire, kind.length, tuple(deflection))(deflection)
    noise, weight = 1e-3 * kind.noise, foreign.weight_of(foreign.BUILDS[kind.wire])
    curves = []
    for number in range(1, SAMPLES + 1):
        factor = gain * np.exp(SCATTER * chance.normal())
        force = factor * exact + noise * chance.normal(size=POINTS)
        long, label = 1e-3 * kind.length, f"{kind.wire}-{number}"
        curves.append(
            MeasuredCurve(
                *(kind.wire, label, label, long, deflection, force, noise, rig_of(long)),
                self_weight=weight,
            )
        )
    return gain, tuple(curves)


def rows(kind: WireKind, seed: int) -> dict[str, Any]:
    """What a calibration says of a campaign, beside the truth.

    Returns
    -------
    rows : of each parameter, and of the band of the mean sample on another length at each of `AT`:
        truth, value, ends; of a parameter the verdict as status, and parts of its interval if it
        has several
    about : how many solutions are in the 95 % set; or why there is none
    """
    gain, curves = campaign(kind, seed)
    found = calibrate(wire_of(kind.wire), curves, Settings(gain=GAIN))
    if not isinstance(found, Calibration):
        return {"about": {"failed": found.code}}
    parameters = [_row(parameter) for parameter in found.parameters]
    solutions = sum(solution.is_allowed for solution in found.solutions)
    return {"rows": parameters + _bands(kind, found, gain), "about": {"solutions": solutions}}


def _row(parameter: CalibratedParameter) -> dict[str, Any]:
    parts = [[part.lower, part.upper] for part in parameter.intervals]
    row = {
        "name": parameter.name,
        "truth": _VALUES[parameter.name],
        "value": parameter.value,
        "lower": parts[0][0],
        "upper": parts[-1][1],
        "status": str(parameter.verdict),
    }
    return row if len(parts) == 1 else {**row, "parts": parts}


def _bands(kind: WireKind, found: Calibration, gain: float) -> list[dict[str, Any]]:
    truth = gain * _at(kind)
    band = predict(found, wire_of(kind.wire), 1e-3 * kind.other, AT, rig=rig_of(1e-3 * kind.other))
    columns = AT, truth, band.force, band.lower_mean, band.upper_mean
    return [
        {
            "name": f"{BAND} {1e3 * at:g} mm",
            "truth": truth,
            "value": value,
            "lower": low,
            "upper": up,
        }
        for at, truth, value, low, up in np.transpose(columns).tolist()
    ]


def _at(kind: WireKind) -> Floats:
    return np.asarray(true_curve(kind.model, kind.wire, kind.other, tuple(AT))(AT))
