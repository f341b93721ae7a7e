"""Cards of other people's measurements (`cards/*.toml`), and what labpipe's models say of them.

Each model takes what is given and one choice of what is open, and returns the least and the largest
value, in SI units: bounds from slip to stick, or twice the same number. Over all corners of what is
open they make the interval that a measured value is compared with.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from labpipe.mechanics.wire.bending_law import (
    Contacts,
    compute_moment_curve,
    compute_slip_stiffness,
    compute_stick_stiffness,
)
from labpipe.mechanics.wire.bundle_model import compute_stick_tensor
from labpipe.mechanics.wire.cross_section import (
    CrossSection,
    Insulation,
    Layer,
    compute_strand_diameter,
    compute_stretch_torsion,
    lay_up,
    place_hexagon,
    place_rings,
    place_sectors,
)
from labpipe.mechanics.wire.materials import ANNEALED_COPPER, Material
from labpipe.records.arrays import Floats
from tests.builders.stranded_wires import elastic

Values = Mapping[str, Any]
Bounds = tuple[float, float]
RINGS = {7: 1, 19: 2, 37: 3, 61: 4}
"""Rings around the core of a lattice, by the number of strands."""


def interval(model: str, given: Values, ranges: Mapping[str, Bounds]) -> Bounds:
    """Least and largest value over all corners of the ranges; what is given is not varied."""
    varied = {name: ends for name, ends in ranges.items() if name not in given}
    found = [
        MODELS[model]({**given, **dict(zip(varied, corner, strict=True))})
        for corner in product(*varied.values())
    ]
    return min(low for low, _ in found), max(high for _, high in found)


def mass(of: Values) -> Bounds:
    """Insulated wire of seven round strands, or of pressed ones without gaps, kg/m."""
    area = of["area_mm2"] * of["copper_share"] * 1e-6
    outer = (of["diameter_mm"] - of["thinner_mm"]) / 2e3
    layers = lay_up(
        7, compute_strand_diameter(area, 7), [np.radians(of["lay_deg"])], ANNEALED_COPPER
    )
    found = []
    for layout, bore in (
        (place_hexagon, 1.5 * layers[0].diameter),
        (place_sectors, (area / np.pi) ** 0.5),
    ):
        section = layout(layers, Insulation(bore, outer - bore, 1e7))
        found.append(section.compute_mass_per_length(insulation_density=of["density"]))
    return min(found), max(found)


def _strand(of: Values) -> CrossSection:
    """Bare strand of rings that touch; a material that is not counted weighs next to nothing."""
    layers, radius, outer = [], 0.0, 0.0
    for ring in of["rings"]:
        diameter, material = ring["diameter_mm"] * 1e-3, ring["material"]
        radius = outer + diameter / 2.0 if outer else 0.0
        outer = radius + diameter / 2.0
        length = of[ring["lay"]] * 2.0 * outer if "lay" in ring else ring.get("lay_mm", 0.0) * 1e-3
        angle = np.arctan2(2.0 * np.pi * radius, length) if radius else 0.0
        counts = material == of.get("counted", material)
        modulus = of[f"modulus_{material}_gpa"] * 1e9 if counts else 1.0
        layers.append(Layer(ring["count"], diameter, float(angle), elastic(modulus), 0.3))
    return place_rings(tuple(layers))


def axial(of: Values) -> Bounds:
    """EA of a strand that does not turn, N."""
    found = compute_stretch_torsion(_strand(of)).axial_stiffness
    return found, found


def modulus(of: Values) -> Bounds:
    """EA over the area of the metal, or the area that the source states, Pa."""
    section = _strand(of)
    own = sum(layer.count * layer.area for layer in section.layers)
    found = compute_stretch_torsion(section).axial_stiffness / (
        of["area_mm2"] * 1e-6 if "area_mm2" in of else own
    )
    return found, found


def modulus_share(of: Values) -> Bounds:
    """Modulus of the strand over that of its wire."""
    found = modulus(of)[0] / (of["modulus_wire_gpa"] * 1e9)
    return found, found


def strand_mass(of: Values) -> Bounds:
    """Mass of a bare strand by the densities of its materials, kg/m."""
    found = 0.0
    for kind in {ring["material"] for ring in of["rings"]}:
        every = _strand({**of, "counted": kind, f"modulus_{kind}_gpa": 1.0})
        own = [layer for layer in every.layers if layer.material.modulus > 1.0]
        length = sum(layer.count * layer.area / np.cos(layer.lay_angle) for layer in own)
        found += of[f"density_{kind}"] * float(length)
    return found, found


def _wire(of: Values, outer: float, material: Material) -> CrossSection:
    """Lattice of strands in a tube up to the radius `outer`, m."""
    count = int(of["strands"])
    diameter = compute_strand_diameter(of["copper_mm2"] * 1e-6, count)
    angle = np.radians(of["lay_deg"])
    angles = [angle * (-1.0) ** ring for ring in range(RINGS[count])]
    bore = diameter * (RINGS[count] + 0.5)
    tube = Insulation(bore, outer - bore, of["modulus_insulation_mpa"] * 1e6)
    return place_hexagon(lay_up(count, diameter, angles, material), tube)


def bending(of: Values) -> Bounds:
    """Insulated wire from slip to stick, N m^2; at a curvature, with copper that yields there."""
    outer = of["diameter_mm"] / 2e3
    section = _wire(of, outer, elastic(of["modulus_copper_gpa"] * 1e9))
    low = compute_slip_stiffness(section)
    if "curvature" in of:
        yielding = _wire(of, outer, ANNEALED_COPPER)
        none = (0.0,) * (len(yielding.layers) - 1)
        law = compute_moment_curve(yielding, Contacts(none, none), np.array([of["curvature"]]))
        low = min(low, float(law.tangent_stiffness[0]))
    return low, compute_stick_stiffness(section)


def six_wires(of: Values) -> Bounds:
    """Six wires on a circle, N m^2: each for itself, to all sticking to each other."""
    low, high = bending(of)
    wire = _wire(of, of["diameter_mm"] / 2e3, elastic(of["modulus_copper_gpa"] * 1e9))
    angle = np.pi / 3.0 * np.arange(6)
    x, y = of["circle_mm"] * 1e-3 * np.array([np.cos(angle), np.sin(angle)])
    pull = np.full(6, compute_stretch_torsion(wire).axial_stiffness)
    stuck = compute_stick_tensor(x, y, np.full(6, high), pull).principal[1]
    inner, outer = (each * 1e-3 for each in of.get("sheath_mm", (0.0, 0.0)))
    sheath = of["modulus_insulation_mpa"] * 1e6 * np.pi / 64.0 * (outer**4 - inner**4)
    return 6.0 * low + sheath, stuck + sheath


def _cord(of: Values) -> CrossSection:
    """A flexible cable of which the mass alone is known."""
    mass_si = of["mass_g_per_m"] * 1e-3
    copper = of["copper_mass_share"] * mass_si
    area = copper / 8960.0 * np.cos(np.radians(of["lay_deg"]))
    count = int(of["strands"])
    bore = compute_strand_diameter(area, count) * (RINGS[count] + 0.5)
    outer = (bore**2 + (mass_si - copper) / of["density"] / np.pi) ** 0.5
    return _wire({**of, "copper_mm2": area * 1e6}, outer, elastic(of["modulus_copper_gpa"] * 1e9))


def cord(of: Values) -> Bounds:
    """The same from slip to stick, N m^2."""
    section = _cord(of)
    return compute_slip_stiffness(section), compute_stick_stiffness(section)


def cord_torsion(of: Values) -> Bounds:
    """Its torsional over its bending stiffness: free to lengthen over stick, to fixed over slip."""
    section = _cord(of)
    pair = compute_stretch_torsion(section)
    return (
        pair.free_torsional_stiffness / compute_stick_stiffness(section),
        pair.torsional_stiffness / compute_slip_stiffness(section),
    )


MODELS: dict[str, Callable[[Values], Bounds]] = {
    six_wire.__name__: six_wire
    for six_wire in (
        *(mass, axial, modulus, modulus_share, strand_mass),
        *(bending, six_wires, cord, cord_torsion),
    )
}
FOLDER = Path(__file__).resolve().parent / "cards"
UNITS = {"g/m": 1e-3, "kg/m": 1.0, "MN": 1e6, "GPa": 1e9, "N mm2": 1e-6, "1": 1.0}
"""In SI units."""
KEYS = {"title", "source", "read", "licence", "specimen", "method", "open", "number"}
"""Of a card; `open` is what a source leaves open: ranges, and why they are that wide."""


@dataclass(frozen=True)
class Number:
    """A measured value; `miss` says why it lies outside the model's interval, where it does."""

    name: str
    quantity: str
    unit: str
    value: float
    model: str
    given: Mapping[str, Any] = field(default_factory=dict)
    bent: Mapping[str, Any] = field(default_factory=dict)
    points: Mapping[str, Any] = field(default_factory=dict)
    miss: str = ""
    ranges: Mapping[str, Bounds] = field(default_factory=dict)

    @cached_property
    def interval(self) -> Bounds:
        """What the model says, in the number's own unit."""
        low, high = interval(self.model, self.given, self.ranges)
        return low / UNITS[self.unit], high / UNITS[self.unit]

    @property
    def is_inside(self) -> bool:
        low, high = self.interval
        return low <= self.value <= high


def read_numbers(path: Path) -> list[Number]:
    """Measured values of a card; an unknown or missing key, model or unit is an error."""
    card = tomllib.loads(path.read_text(encoding="utf-8"))
    assert card.keys() - {"shared", "files"} == KEYS, path.name
    assert all(own.keys() == {"low", "high", "why"} for own in card["open"].values()), path.name
    ranges = {name: (own["low"], own["high"]) for name, own in card["open"].items()}
    shared = card.get("shared", {})
    numbers = [
        Number(**{**own, "given": {**shared, **own.get("given", {})}, "ranges": ranges})
        for own in card["number"]
    ]
    assert {number.model for number in numbers} <= MODELS.keys(), path.name
    assert {number.unit for number in numbers} <= UNITS.keys(), path.name
    return numbers


NUMBERS = [number for path in sorted(FOLDER.glob("*.toml")) for number in read_numbers(path)]
WINDOWS = {"first": (1.0 / 200.0, 1.0 / 50.0), "later": (1.0 / 20.0, 1.0 / 10.0)}
"""Deflection over span."""


def stiffness(folder: Path, bent: Any) -> float:
    """Mean of the tests' slope x span^3 / 48, N mm2."""
    span = float(bent["span_mm"])
    first, last = (share * span for share in WINDOWS[bent["window"]])
    slopes = []
    for name in bent["tests"]:
        deflection, load = _columns(folder / "lloyd_nexygen" / name)
        inside = (deflection >= first) & (deflection <= last)
        slopes.append(np.polyfit(deflection[inside], load[inside], 1)[0])
    return float(np.mean(slopes)) * span**3 / 48.0


def _columns(path: Path) -> tuple[Floats, Floats]:
    """Deflection, mm, and load, N, where both stand in a row."""
    lines = path.read_bytes().decode("utf-16-le").lstrip("\ufeff").splitlines()
    names = lines[0].split("\t")
    wanted = [names.index("Machine Extension (mm)"), names.index("Load (N)")]
    rows = [line.split("\t") for line in lines[1:] if line.strip()]
    found = [[row[i] for i in wanted] for row in rows if len(row) > max(wanted)]
    values = np.array([[float(cell) for cell in row] for row in found if all(row)])
    return values[:, 0], values[:, 1]
