"""Where the wires of a bundle lie."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labpipe.records.arrays import Floats, Ints
from labpipe.records.bundle import STATED, Bundle, BundleLayout
from labpipe.wire.bundle.kinds import by_chance, evenly, on_one_side
from labpipe.wire.bundle.sites import sites
from labpipe.wire.bundle.tightening import drawn_together, holding_circle

N_SHUFFLES = 8
"""Shuffles of the kinds of a packed bundle, of which the densest is kept."""
OVERLAP = 0.01
"""Overlap of stated positions that is let pass, as a share of the smaller wire's diameter:
the test sheet lets as much pass."""

_EQUAL = 1e-9


def arrange(
    bundle: Bundle, diameters: Sequence[float], stiffness: Sequence[float], *, seed: int = 0
) -> BundleLayout:
    """Lay out the wires of a bundle.

    Parameters
    ----------
    bundle : its positions, if it states any, go before its arrangement
    diameters : m, over the insulation, of each kind of wire
    stiffness : N, axial stiffness of each kind; says which lies on top of an asymmetric bundle
    seed : of what is left to chance; same seed, same layout

    Returns
    -------
    Wires in the order of `bundle.wires`, about the centroid of their areas.

    Raises
    ------
    ValueError
        If stated positions are not one for each wire, or wires at them overlap by more than 1 % of
        the smaller diameter.

    Notes
    -----
    The kinds are spread over sites of equal wires, see `wire.bundle.sites`. Wires of unequal
    diameters are then drawn together from there until they touch, see `wire.bundle.tightening`.
    """
    kind = np.repeat(np.arange(len(bundle.wires)), [wire.number for wire in bundle.wires])
    diameter = np.asarray(diameters, dtype=np.float64)[kind]
    if bundle.positions:
        centres = _stated(bundle, diameter)
        return _layout(STATED, centres, kind, diameter)
    centres = _arranged(bundle, np.asarray(diameters, dtype=np.float64), stiffness, seed)
    return _layout(bundle.arrangement, centres, kind, diameter)


def _stated(bundle: Bundle, diameter: Floats) -> Floats:
    centres = np.asarray(bundle.positions, dtype=np.float64)
    if len(centres) != len(diameter):
        message = f"{len(centres)} positions for {len(diameter)} wires: allowed is one for each"
        raise ValueError(message)
    first, second = np.triu_indices(len(diameter), 1)
    distance = np.hypot(*(centres[first] - centres[second]).T)
    depth = 0.5 * (diameter[first] + diameter[second]) - distance
    allowed = OVERLAP * np.minimum(diameter[first], diameter[second])
    if np.any(depth > allowed):
        at = int(np.argmax(depth - allowed))
        message = (
            f"wires {first[at] + 1} and {second[at] + 1} overlap by {1e3 * depth[at]:.3g} mm, "
            f"allowed is {1e3 * allowed[at]:.2g} mm"
        )
        raise ValueError(message)
    return centres


def _arranged(bundle: Bundle, diameters: Floats, stiffness: Sequence[float], seed: int) -> Floats:
    """Centres of the wires, kind by kind, m."""
    places = sites(bundle.number, seed=seed)
    counts = [wire.number for wire in bundle.wires]
    if len(counts) == 1 or np.ptp(diameters) <= _EQUAL * diameters.max():
        kind = _spread(bundle.arrangement, places, counts, stiffness, seed)[0]
        return _by_kind(diameters.max() * places, kind)
    tried = [
        drawn_together(_by_kind(diameters.max() * places, kind), np.repeat(diameters, counts))
        for kind in _spread(bundle.arrangement, places, counts, stiffness, seed)
    ]
    each = np.repeat(diameters, counts)
    return min(tried, key=lambda centres: holding_circle(centres, each)[1])


def _spread(
    arrangement: str, places: Floats, counts: Sequence[int], stiffness: Sequence[float], seed: int
) -> list[Ints]:
    """Kinds of the wires on the sites: one way of an arrangement, some of chance."""
    match arrangement:
        case "asymmetric":
            return [on_one_side(places, counts, stiffness)]
        case "symmetric":
            return [evenly(places, counts, seed=seed)]
        case _:
            rng = np.random.default_rng(seed)
            return [by_chance(counts, rng) for _ in range(N_SHUFFLES)]


def _by_kind(centres: Floats, kind: Ints) -> Floats:
    return np.asarray(centres[np.argsort(kind, kind="stable")])


def _layout(name: str, centres: Floats, kind: Ints, diameter: Floats) -> BundleLayout:
    about = centres - np.average(centres, axis=0, weights=diameter**2)
    radius = float(np.max(np.hypot(*about.T) + diameter / 2.0))
    return BundleLayout(name, about[:, 0], about[:, 1], kind, diameter, radius)
