"""Harness bundles for the virtual lab: wires that bend together until they slip.

All wires share one curvature. The moment of a bundle is that of its wires, each bent about its own
axis, and that of their axial forces, which neighbours and tape hold:

    M(kappa) = sum M_i(kappa) + sum |y_i| min(h EA_i |y_i| kappa, T_i)
                              + g min(kappa, e / R) sum over the outer wires EA_i y_i^2

y_i is the distance of a wire from the neutral axis, EA_i the axial stiffness of its copper, h and g
the shares of it that take part: wires are held by neighbours and glue that give way, far from
rigidly. Neighbours hold by friction, up to T_i = h EA_i c kappa_s, c the root of the mean square of
y and kappa_s the curvature at which a wire at that distance slips (a wire twice as far slips at
half of it). That is the kink. The tape's glue holds the outer wires until the strain kappa R at the
bundle's radius R is e; then the tape slides on all of them at once, being one piece. That is the
plateau: what is left of the tangent is that of the wires. The lever of a bundle that bends far gets
shorter, which alone lets the force grow by 1 % with every millimetre; but a tape that slides holds
the bundle together less well: all moments at which something gives way are multiplied by
1 - q (kappa_max R / e - 1), kappa_max being the largest curvature anywhere so far. Where the glue
outlasts the test there is none of this.

Coulomb sliders side by side are plays one after the other, and their loops follow Masing's rule, so
all of it is one `PlayLaw`. Wires that slid lock: from the second cycle on all moments at which
something gives way, and the curvatures with them, are `locking` times as large.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from labpipe.law.play_fits import polygon_law
from labpipe.law.plays import PlayLaw, corners_of
from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.harness_bundle import ARRANGEMENTS, NONE
from labpipe.virtual_lab.specimens import WIRES, StrandedWire, scaled_law
from labpipe.wire.materials import ANNEALED_COPPER

_PACKED, _SYMMETRIC, _ASYMMETRIC = ARRANGEMENTS
_SHELL = 1e-6  # of the pitch: wires this close in distance from the centre are of one shell
_DISTINCT = 1e-6  # of a curvature: closer corners are one
_N_PLAYS = 24
_LEAST_HELD = 0.5


@dataclass(frozen=True, slots=True)
class BundleModel:
    """A bundle by what it is made of.

    Parameters
    ----------
    wires : name in `specimens.WIRES` and number, of each kind
    arrangement : one of `records.bundle.ARRANGEMENTS`; of two kinds, ``asymmetric`` has the second
        on the side towards the pull, the others spread it over the section
    friction_share : h, of the axial stiffness that friction holds
    slip_curvature : kappa_s, 1/m
    glue_share : g, of the axial stiffness of the outer wires that the tape's glue holds
    glue_strain : e, at which the tape slides on the wires; None where it never does
    slide_loss : q, share of what holds the wires that is lost while the curvature goes from that at
        which the tape slides to twice as much, and so on; half is left in the end
    locking : factor on slip from the second cycle on, at least 1
    conduit_stiffness : N m^2, of a conduit around the bundle, elastic
    tape, taping, conduit : words of `records.bundle.Bundle` for the test sheet
    conduit_bore : m, for the test sheet; None without a conduit
    factor : of this sample on all moments at given curvatures
    """

    wires: tuple[tuple[str, int], ...] = (("B1", 19),)
    arrangement: str = _PACKED
    friction_share: float = 0.14
    slip_curvature: float = 0.42
    glue_share: float = 0.018
    glue_strain: float | None = 0.028
    slide_loss: float = 0.08
    locking: float = 1.05
    conduit_stiffness: float = 0.0
    tape: str = "PVC"
    taping: str = "half-lap"
    conduit: str = NONE
    conduit_bore: float | None = None
    factor: float = 1.0

    @property
    def number(self) -> int:
        """Number of wires."""
        return sum(number for _, number in self.wires)

    @property
    def radius(self) -> float:
        """Radius of the smallest circle around the centre that holds all wires, m."""
        layout = lay_wires(self)
        return float(np.max(np.hypot(layout.x, layout.y) + 0.5 * layout.diameter))

    def law(self, cycle: int = 1, bent: float = 0.0) -> PlayLaw:
        """Moment against curvature, with its loops.

        Parameters
        ----------
        cycle : counted from 1; plays under one law are a history for the next one's
        bent : 1/m, largest curvature anywhere so far

        Raises
        ------
        ValueError
            If the wires do not make a bundle.
        """
        plain = _plain_law(replace(self, factor=1.0))
        grown = self.held(bent) * (1.0 if cycle == 1 else self.locking)
        return scaled_law(plain, self.factor, grown)

    def held(self, bent: float) -> float:
        """What is left of all moments at which something gives way, at a largest curvature, 1/m."""
        if self.glue_strain is None:
            return 1.0
        slid = max(0.0, bent * self.radius / self.glue_strain - 1.0)
        return max(_LEAST_HELD, 1.0 - self.slide_loss * slid)

    @property
    def mass_per_length(self) -> float:
        """Mass per length of the wires, kg/m; tape and conduit are left out."""
        return sum(number * WIRES[name].mass_per_length for name, number in self.wires)

    def scaled(self, factor: float) -> BundleModel:
        """The same bundle with all moments at a given curvature multiplied by `factor`."""
        return replace(self, factor=self.factor * factor)

    @property
    def stiffnesses(self) -> Mapping[str, float]:
        """Where the bending stiffness at first loading comes from, N m^2, of this sample.

        ``wires`` each about its own axis; ``friction`` and ``glue`` between them; ``conduit``;
        ``initial`` all of it; ``rigid`` if the wires were one piece.
        """
        wires = sum(number * _wire(name).law().stiffness for name, number in self.wires)
        rigid, outer = (float(np.sum(each)) for each in _axial(lay_wires(self)))
        parts = {
            "wires": float(wires),
            "friction": self.friction_share * rigid,
            "glue": self.glue_share * outer,
            "conduit": self.conduit_stiffness,
        }
        whole = {"initial": sum(parts.values()), "rigid": parts["wires"] + rigid}
        return {name: self.factor * value for name, value in (parts | whole).items()}


@dataclass(frozen=True, slots=True, eq=False)
class WirePlaces:
    """Where the wires of a bundle lie; arrays of shape (wires,), in the order of its kinds.

    Parameters
    ----------
    x, y : m, from the neutral axis of the bundle, y in the direction of bending
    diameter : m
    axial : N, axial stiffness of the copper
    is_outer : whether the tape touches the wire
    """

    x: Floats
    y: Floats
    diameter: Floats
    axial: Floats
    is_outer: Flags


def lay_wires(bundle: BundleModel) -> WirePlaces:
    """Lay the wires on the densest lattice, about a wire or in between three, in shells.

    Parameters
    ----------
    bundle : its wires; the pitch of the lattice is the diameter of the thickest

    Raises
    ------
    ValueError
        If the wires are unknown or more than two kinds, or the shells do not come out full.
    """
    _check(bundle)
    pitch = max(WIRES[name].diameter for name, _ in bundle.wires)
    places, is_outer = _shells(bundle.number)
    order = _in_order_of_kind(places, bundle)
    x, y = pitch * places[order].T
    kinds = [name for name, number in bundle.wires for _ in range(number)]
    diameter = np.array([WIRES[name].diameter for name in kinds])
    copper = [WIRES[name].n_strands * 0.25 * np.pi * WIRES[name].strand ** 2 for name in kinds]
    axial = ANNEALED_COPPER.modulus * np.array(copper)
    neutral = [float(axial @ each / np.sum(axial)) for each in (x, y)]
    return WirePlaces(x - neutral[0], y - neutral[1], diameter, axial, is_outer[order])


def _check(bundle: BundleModel) -> None:
    if any(name not in WIRES for name, _ in bundle.wires) or len(bundle.wires) not in (1, 2):
        message = f"wires={bundle.wires}: allowed are one or two kinds of {', '.join(WIRES)}"
        raise ValueError(message)
    if bundle.arrangement not in ARRANGEMENTS or bundle.locking < 1.0:
        message = (
            f"arrangement={bundle.arrangement!r}, locking={bundle.locking!r}: allowed are "
            f"{', '.join(ARRANGEMENTS)} and numbers >= 1"
        )
        raise ValueError(message)


def _shells(number: int) -> tuple[Floats, Flags]:
    """Places of full shells, in pitches, shape (number, 2), and whether each is on the outside."""
    for centre in (np.zeros(2), np.array([0.5, 0.5 / np.sqrt(3.0)])):
        i, j = np.meshgrid(np.arange(-9, 10), np.arange(-9, 10))
        lattice = np.column_stack([(i + 0.5 * j).ravel(), (0.5 * np.sqrt(3.0) * j).ravel()])
        places = lattice - centre
        distance = np.hypot(*places.T)
        order = np.lexsort((np.arctan2(places[:, 1], places[:, 0]), np.round(distance, 6)))
        first, last = distance[order[number - 1 : number + 1]]
        if last - first > _SHELL:
            inside = places[order[:number]]
            return inside, _neighbours(inside) < 6
    message = f"{number} wires: allowed are numbers that fill shells, such as 3, 7, 12, 19, 27"
    raise ValueError(message)


def _neighbours(places: Floats) -> Ints:
    gaps = np.hypot(*(places[:, None, :] - places[None]).transpose(2, 0, 1))
    touching: Ints = np.sum(np.abs(gaps - 1.0) < _SHELL, axis=1)
    return touching


def _in_order_of_kind(places: Floats, bundle: BundleModel) -> Ints:
    """Which place each wire takes, the wires of the first kind first."""
    first = bundle.wires[0][1]
    around = np.argsort(places[:, 1] + 1e-3 * places[:, 0], kind="stable")
    if len(bundle.wires) == 1 or bundle.arrangement == _ASYMMETRIC:
        return around
    # From shell to shell and around, the second kind as evenly as it goes, so that both are
    # everywhere.
    share = (len(places) - first) / len(places)
    is_second = np.diff(np.floor(share * np.arange(len(places) + 1) + 0.5)) > 0.0
    return np.concatenate([np.flatnonzero(~is_second), np.flatnonzero(is_second)])


def _wire(name: str) -> StrandedWire:
    return replace(WIRES[name], n_plays=_N_PLAYS)


def _axial(layout: WirePlaces) -> tuple[Floats, Floats]:
    """EA y^2 of each wire, and of those that the tape touches, N m^2."""
    rigid = layout.axial * layout.y**2
    return rigid, rigid * layout.is_outer


@lru_cache(maxsize=64)
def _plain_law(bundle: BundleModel) -> PlayLaw:
    """The law of the first cycle: a polygon with a corner wherever a wire or a slider has one."""
    limits, stiffnesses = _sliders(bundle)
    wires = [(number, _wire(name).law()) for name, number in bundle.wires]
    last = min(_wire(name).largest_curvature for name, _ in bundle.wires)
    knots = _distinct([*(corners_of(law)[1] for _, law in wires), limits], last)
    moment = bundle.conduit_stiffness * knots
    for number, law in wires:
        moment += number * _moment(law, knots)
    moment += np.minimum(knots[:, None], limits) @ stiffnesses
    return polygon_law(knots, moment)


def _sliders(bundle: BundleModel) -> tuple[Floats, Floats]:
    """Curvatures at which the sliders slip, 1/m, and what they add before, N m^2."""
    layout = lay_wires(bundle)
    rigid, outer = _axial(layout)
    off_axis = np.abs(layout.y) > _SHELL * np.max(layout.diameter)
    distance = np.abs(layout.y[off_axis])
    mean = float(np.sqrt(np.mean(distance**2)))
    limits = bundle.slip_curvature * mean / distance
    stiffnesses = bundle.friction_share * rigid[off_axis]
    glue = np.inf if bundle.glue_strain is None else bundle.glue_strain / bundle.radius
    held = bundle.glue_share * float(np.sum(outer))
    return np.append(limits, glue), np.append(stiffnesses, held)


def _moment(law: PlayLaw, curvature: Floats) -> Floats:
    """Moment of first loading, N m; beyond its last corner a law goes on straight."""
    moment, bent, slopes = corners_of(law)
    beyond = np.maximum(curvature - bent[-1], 0.0) / slopes[-1]
    found: Floats = np.interp(curvature, bent, moment) + beyond
    return found


def _distinct(corners: list[Floats], last: float) -> Floats:
    """All corners in order up to the last curvature, 1/m, those that coincide once."""
    found = np.unique(np.append(np.concatenate(corners), last))
    inside: Floats = found[(found > 0.0) & (found <= last)]
    distinct: Floats = inside[np.diff(inside, prepend=0.0) > _DISTINCT * inside]
    return distinct


_PVC = BundleModel()


_PET = replace(_PVC, glue_strain=None, tape="PET")


TAPED_TYPES = {
    "TWB-B1-7-PVC": replace(_PVC, wires=(("B1", 7),)),
    "TWB-B1-12-PVC": replace(_PVC, wires=(("B1", 12),)),
    "TWB-B1-19-PVC": replace(_PVC, wires=(("B1", 19),)),
    "TWB-B2-7-PVC": replace(_PVC, wires=(("B2", 7),)),
    "TWB-B2-12-PVC": replace(_PVC, wires=(("B2", 12),)),
    "TWB-B2-19-PVC": replace(_PVC, wires=(("B2", 19),)),
    "TWB-MX-sym-PVC": replace(_PVC, wires=(("B1", 9), ("B2", 10)), arrangement="symmetric"),
    "TWB-MX-asym-PVC": replace(_PVC, wires=(("B1", 10), ("B2", 9)), arrangement="asymmetric"),
    "TWB-B1-19-PET": replace(_PET, wires=(("B1", 19),)),
    "TWB-B2-7-PET": replace(_PET, wires=(("B2", 7),)),
    "TWB-B2-19-PET": replace(_PET, wires=(("B2", 19),)),
}
"""The taped bundles of the source's Table 4.1; PET tape never slides."""
