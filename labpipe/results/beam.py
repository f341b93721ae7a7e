"""Compute the bending stiffness of a beam from a stiffness, with corrections for rollers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Final, Literal

import numpy as np

from labpipe.errors import Fault
from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats
from labpipe.records.declarations import Distance, Length, Output, Ratio, Snake, StiffnessName
from labpipe.records.estimates import Failure, UnavailableError, return_failure
from labpipe.results.kinds import Outcome
from labpipe.results.reduced_test import ReducedTest, Stiffness
from labpipe.results.stiffness import FromStiffness
from labpipe.uncertainty.extractors import Trace, combine_numbers

DIVISORS: Final = MappingProxyType({"cantilever": 3.0, "three-point": 48.0})
"""Divisors of L^3: end load on a cantilever, central load on a span."""


def compute_beam_factor(length: float, support: str) -> float:
    """Return the bending stiffness EI of a straight uniform beam over its stiffness, m^3.

    Parameters
    ----------
    length : m, free length of a cantilever, or span between two supports
    support : one of `DIVISORS`

    Returns
    -------
    L^3 / 3 or L^3 / 48.

    Raises
    ------
    ValueError
        For another support, or a length not above zero.

    Notes
    -----
    Euler-Bernoulli beam, slopes small, no shear (Young and Budynas, Roark's Formulas for Stress and
    Strain, 7th ed. 2002, table 8.1, cases 1a and 1e). A relative error of the length is
    tripled.

    Examples
    --------
    >>> round(480.0 * compute_beam_factor(0.1, "three-point"), 9)
    0.01
    """
    if support not in DIVISORS:
        raise ValueError(
            format_sentence("results.bad_support", known=", ".join(DIVISORS), found=support)
        )
    if not length > 0.0:
        raise ValueError(format_sentence("results.bad_length", length=length))
    return length**3 / DIVISORS[support]


def compute_prop_force(self_weight: float, length: float) -> float:
    """Return the force that supports the tip of a level specimen at rest, N: 3 w L / 8.

    Parameters
    ----------
    self_weight : N/m
    length : m

    Notes
    -----
    For a small sag and a linear law; the laws of stranded wires change it by at most 0.03 % (A2 at
    85 mm, B1 at 100 mm, A3 at 120 mm). A freely hanging specimen has the same tip deflection as
    under this force alone.
    """
    return 0.375 * self_weight * length


@dataclass(frozen=True, slots=True)
class Rollers:
    """Two roller supports.

    Parameters
    ----------
    span : m, between the centres of the rollers
    radius : m, from the centre of a roller to the axis of the specimen; 0 for knife edges
    friction : coefficient of fixed rollers; 0 for turning ones
    """

    span: float
    radius: float = 0.0
    friction: float = 0.0


def compute_roller_load(rollers: Rollers) -> tuple[Floats, Floats]:
    """Compute deflection and load of an elastic beam of EI = 1 N m^2 on rollers.

    Parameters
    ----------
    rollers : the supports

    Returns
    -------
    deflection : shape (n,), m, movement of the load towards the supports, from 0
    load : shape (n,), N, for EI = 1 N m^2

    Notes
    -----
    Half the beam reaches from mid-span (slope 0) to the roller (slope a). It touches the roller
    where a radius of the roller is normal to the beam. The roller pushes with N along that normal
    and, because the beam slides inwards over it, with mu N outwards along the beam. It exerts no
    moment. The first integral of the
    elastica (Love, A Treatise on the Mathematical Theory of Elasticity, 4th ed. 1927, secs.
    260-263) with p = a - slope is then

    EI (d slope / ds)^2 / 2 = N (sin p + mu (1 - cos p)).

    Its integral over the horizontal must be span / 2 - radius sin a, which gives N; the load is
    2 N (cos a + mu sin a), the deflection the rise over that half plus radius (1 - cos a). Gauss
    quadrature in sqrt(p). In this model friction acts at the axis. Friction at the surface of a
    specimen of depth h has an effect of the other sign, of the order of mu h / span at small
    deflections. The correction of ASTM D790 (sec. 12, large span-to-depth ratios) is for the stress
    in the outer fibre, not for the stiffness.
    """
    n_nodes = 48
    n_slopes = 600
    # rad, at the supports: 77 deg
    max_slope = 1.35
    angle = np.linspace(0.0, max_slope, n_slopes + 1)[1:, None]
    node, weight = np.polynomial.legendre.leggauss(n_nodes)
    root = 0.5 * np.sqrt(angle) * (node + 1.0)
    p = root**2
    mu = rollers.friction
    bend = np.sqrt(np.sin(p) + mu * (1.0 - np.cos(p)))
    step = 0.5 * np.sqrt(angle) * weight * 2.0 * root / bend
    along = np.sum(step * np.cos(angle - p), axis=1)
    rise = np.sum(step * np.sin(angle - p), axis=1)
    a = angle[:, 0]
    scale = (0.5 * rollers.span - rollers.radius * np.sin(a)) / along
    push = 0.5 / scale**2
    load = 2.0 * push * (np.cos(a) + mu * np.sin(a))
    deflection = scale * rise + rollers.radius * (1.0 - np.cos(a))
    return np.append(0.0, deflection), np.append(0.0, load)


def compute_stiffness_ratio(rollers: Rollers, *, low: float, high: float) -> float:
    """Return the slope of the load over a range of deflection, as a multiple of 48 EI / span^3.

    Parameters
    ----------
    rollers : the supports
    low, high : m, ends of the range of the least-squares line

    Returns
    -------
    The ratio.

    Raises
    ------
    UnavailableError
        ``beyond_elastica`` if the beam would slip through, or is less than half as stiff as at
        first.

    Examples
    --------
    >>> round(compute_stiffness_ratio(Rollers(0.1), low=0.0, high=0.001), 4)
    0.9991
    """
    window_samples = 200
    # Below this share of the stiffness at small deflections, geometry has more effect than the
    # specimen.
    min_ratio = 0.5
    deflection, load = compute_roller_load(rollers)
    falling = np.flatnonzero(np.diff(deflection) <= 0.0)
    last = int(falling[0]) if len(falling) else len(deflection) - 1
    if high > deflection[last]:
        at, high = 1e3 * deflection[last], 1e3 * high
        raise UnavailableError.of("results.slips_through", at=at, high=high)
    deflections = np.linspace(low, high, window_samples)
    loads = np.interp(deflections, deflection[: last + 1], load[: last + 1])
    slope = float(np.polynomial.Polynomial.fit(deflections, loads, 1).convert().coef[1])
    ratio = slope * rollers.span**3 / 48.0
    if ratio < min_ratio:
        low, high = 1e3 * low, 1e3 * high
        raise UnavailableError.of(
            "results.beyond_elastica", low=low, high=high, ratio=ratio, needed=min_ratio
        )
    return ratio


@dataclass(frozen=True, slots=True, kw_only=True)
class Roller:
    """The rollers of two supports."""

    diameter: Length | None = None
    friction: Annotated[Ratio | None, "Coefficient, of rollers that do not turn"] = None


_ORDER = ("large-deflection", "roller-radius", "roller-friction")


_FORMULAS = {"cantilever": ("length", "L^3 / 3"), "three-point": ("span", "L^3 / 48")}


@dataclass(frozen=True, slots=True, kw_only=True)
class BendingStiffness(FromStiffness):
    """``<name>`` (N m^2): bending stiffness EI of a beam, from a stiffness and its length."""

    result: ClassVar = "bending-stiffness"
    outputs: ClassVar = (Output("{name}", "N*m^2"),)
    of: Annotated[StiffnessName, "Name of a stiffness above, such as initial_stiffness"]
    support: Annotated[
        Literal["cantilever", "three-point"],
        "cantilever: K L^3 / 3, L specimen.length; three-point: K L^3 / 48, L the span",
    ]
    length_uncertainty: Annotated[
        Distance | None, "Standard uncertainty of L, where specimen.uncertainty does not say it"
    ] = None
    name: Annotated[Snake, "Such as bending_stiffness_at_start"] = "bending_stiffness"
    corrections: Annotated[
        tuple[Literal["large-deflection", "roller-radius", "roller-friction"], ...],
        "Of three-point: what an exactly bent elastic beam does otherwise",
    ] = ()
    roller: Roller | None = None

    @property
    def length(self) -> str:
        """Return the key of the length in the formula."""
        return _FORMULAS[self.support][0]

    @staticmethod
    def find_contradictions(entry: Mapping[str, object]) -> Iterator[Fault]:
        """Refuse a correction without its inputs."""
        corrections = entry.get("corrections")
        names = corrections if isinstance(corrections, list | tuple) else []
        if names and entry.get("support") == "cantilever":
            expected = "corrections for 'three-point' alone"
            yield Fault(("corrections",), expected, "'cantilever'", "Remove them.")
            return
        roller = entry.get("roller")
        for name, key in (("roller-radius", "diameter"), ("roller-friction", "friction")):
            if name not in names:
                continue
            if "large-deflection" not in names:
                remedy = "Add 'large-deflection' to the corrections."
                expected = f"'large-deflection' beside {name!r}"
                yield Fault(("corrections",), expected, "none", remedy)
            if not isinstance(roller, Mapping) or roller.get(key) is None:
                remedy = f"Add 'roller: {{{key}: ...}}'."
                yield Fault(("corrections",), f"'roller.{key}' for {name!r}", "none", remedy)

    def list_methods(self, test: ReducedTest) -> tuple[str]:
        """Return the formula with its length."""
        del test
        key, formula = _FORMULAS[self.support]
        return (f"{self.of} x {formula}, L = specimen.{key}",)

    def measure_number(self, test: ReducedTest, stiffness: Stiffness) -> Outcome:
        """Measure the bending stiffness from a stiffness and its length."""
        key, sizes = _FORMULAS[self.support][0], test.setup.sizes
        if key not in sizes:
            is_span = key == "span"
            raise UnavailableError.of("results.no_span" if is_span else "results.no_length")
        self._compute_ratio(sizes, stiffness.window)
        return test.measure_one(
            combine_numbers(
                partial(self._compute_rigidity, window=stiffness.window), stiffness.decide
            )
        )

    def find_context(self, test: ReducedTest, stiffness: Stiffness) -> dict[str, Any]:
        """Name the corrections with their sizes."""
        ratio = return_failure(self._compute_ratio)(test.setup.sizes, stiffness.window)
        return {"remark": "" if isinstance(ratio, Failure) else ratio[1]}

    def _compute_rigidity(
        self, trace: Trace, stiffness: Floats, *, window: tuple[float, float]
    ) -> Floats:
        """Return the bending stiffness of curves; NaN beyond the deflection of an elastic beam."""
        ratio = return_failure(self._compute_ratio)(trace.sizes, window)
        length = trace.sizes[_FORMULAS[self.support][0]]
        beam_stiffness = stiffness * compute_beam_factor(length, self.support)
        return np.asarray(beam_stiffness / (np.nan if isinstance(ratio, Failure) else ratio[0]))

    def _compute_ratio(
        self, sizes: Mapping[str, float], window: tuple[float, float]
    ) -> tuple[float, str]:
        """Return the stiffness of an elastic beam as a multiple of the formula, and a remark."""
        span = sizes.get("span")
        if not self.corrections or span is None:
            return 1.0, ""
        ratio, corrections = 1.0, []
        for number, name in enumerate(_ORDER):
            if name not in self.corrections:
                continue
            active_corrections = [name for name in _ORDER[: number + 1] if name in self.corrections]
            rollers = self._make_rollers(active_corrections, span, sizes.get("outer_diameter", 0.0))
            next_ratio = compute_stiffness_ratio(rollers, low=window[0], high=window[1])
            corrections.append(f"{name} {1e2 * (ratio / next_ratio - 1.0):+.3g} %")
            ratio = next_ratio
        return ratio, f"corrected as an elastic beam: {', '.join(corrections)}"

    def _make_rollers(
        self, active_corrections: Sequence[str], span: float, depth: float
    ) -> Rollers:
        radius = friction = 0.0
        if "roller-radius" in active_corrections and self.roller is not None:
            radius = 0.5 * ((self.roller.diameter or 0.0) + depth)
        if "roller-friction" in active_corrections and self.roller is not None:
            friction = self.roller.friction or 0.0
        return Rollers(span, radius, friction)
