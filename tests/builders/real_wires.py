"""Two wires that others hung as loops and photographed: what was measured, and fits of an elastica.

The files are in the folder of real exports (`rods`) and are not shipped. A photograph is scaled so
that the line drawn over the wire is 1.5 m long, and cut into equal pieces: points have a share of
the length, and no marks on the wire.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import t

from labpipe.records.arrays import Flags, Floats
from tests.builders.hung_wires import GRAVITY, HungElastica
from tests.builders.twisted_loops import TwistedLoop

LENGTH = 1.5
"""m, between the clamps."""
APART = 0.12
"""m, of the clamps, as built."""
BLOCKS = 5
"""Parts of the line that are left out in turn."""
_PIECES = (60, 90)
"""Of twisted loops, whose turn is of second order."""
_RATIOS = {"white": (0.95, 1.05), "black": (1.5, 1.7)}
"""Torsional over bending stiffness: two to go on from."""
_SOFTER = 0.9


@dataclass(frozen=True, slots=True)
class RealWire:
    """What the repository says about a wire.

    Parameters
    ----------
    name : as in the names of the files
    mass : kg/m
    mass_width : share of it, half of the range within which its authors' own numbers lie
    snaps : turns of a clamp at which the loop left its plane, degrees
    authors : bending stiffness of the five hangs by their rod, N m^2
    authors_torsion : torsional over bending stiffness by their rod
    cable, cable_torsion : mean stiffness and that ratio by MuJoCo's cable, found by the authors
    plain : stiffness of the five hangs by a plain elastica of 60 segments, N m^2
    """

    name: str
    mass: float
    mass_width: float
    snaps: tuple[float, ...]
    authors: tuple[float, ...]
    authors_torsion: float
    cable: float
    cable_torsion: float
    plain: tuple[float, ...]

    def hangs(self, folder: Path) -> Floats:
        """Points of the hangs, shape (hangs, points, 2), to the right and up, m."""
        return photographed(folder / "rods" / f"adapteddlo_{self.name}_hangs.csv")


WHITE = RealWire(
    "white",
    mass=0.087 / 5.0,
    mass_width=0.006,
    snaps=(970.0, 970.0, 980.0, 975.0, 980.0),
    authors=(1.263e-4, 1.260e-4, 1.142e-4, 1.147e-4, 1.272e-4),
    authors_torsion=0.823,
    cable=1.418e-4,
    cable_torsion=0.724,
    plain=(0.92e-4, 0.91e-4, 0.84e-4, 0.85e-4, 0.95e-4),
)
BLACK = RealWire(
    "black",
    mass=0.081 / 2.98,
    mass_width=0.025,
    snaps=(470.0, 500.0, 480.0, 470.0, 490.0),
    authors=(1.431e-3, 1.135e-3, 1.293e-3, 0.945e-3, 1.178e-3),
    authors_torsion=1.462,
    cable=1.251e-3,
    cable_torsion=1.409,
    plain=(1.04e-3, 0.85e-3, 0.96e-3, 0.66e-3, 0.89e-3),
)


def photographed(file: Path) -> Floats:
    """Loops of a file of hangs, or of twists: shape (loops, points, 2), to the right and up, m."""
    rows = np.genfromtxt(file, delimiter=",", skip_header=1)
    return np.asarray(rows[:, 1:].reshape(len(rows), -1, 2))


@dataclass(frozen=True, slots=True, eq=False)
class HangFit:
    """A loop fitted to a photograph.

    Parameters
    ----------
    stiffness : of bending, N m^2
    natural : free curvature, 1/m, as in `HungElastica`
    model : shape (points, 2), m, the loop at the shares of the length of the points
    off : shape (points, 2), m, model less photograph
    blocks : stiffness with a fifth of the line left out, one after the other
    """

    stiffness: float
    natural: tuple[float, ...]
    model: Floats
    off: Floats
    blocks: tuple[float, ...] = ()

    @property
    def distances(self) -> Floats:
        """m, from each point to the place of the model with the same share of the length."""
        return np.asarray(np.hypot(*self.off.T))

    @property
    def alike(self) -> float:
        """Correlation of what is left over at neighbouring points."""
        return float(np.sum(self.off[1:] * self.off[:-1]) / np.sum(self.off**2))


Hanging: TypeAlias = Callable[[RealWire, Floats, float, tuple[float, ...]], Floats]
"""Points of a loop, of its wire, the photograph (for clamps and shares), stiffness and set."""


def by_elastica(
    wire: RealWire, points: Floats, stiffness: float, natural: tuple[float, ...]
) -> Floats:
    """Points of the planar elastica."""
    weight = wire.mass * GRAVITY
    chord = (float(points[-1, 0]), float(points[-1, 1]))
    hung = HungElastica(LENGTH, weight, stiffness, chord, natural, pieces=400)
    return hung.at(np.linspace(0, 1, len(points)))


def fit_hang(
    wire: RealWire,
    points: Floats,
    terms: int,
    *,
    hanging: Hanging = by_elastica,
    has_blocks: bool = False,
) -> HangFit:
    """Fit stiffness and free curvature to a photograph, least squares of distances.

    Parameters
    ----------
    wire : what is known of it
    points : shape (points, 2), m
    terms : of the free curvature
    hanging : what makes loops
    has_blocks : whether to fit without a fifth of the line as well, five times
    """
    everywhere = np.ones(len(points), dtype=bool)
    stiffness, natural, model = _fitted(wire, points, terms, hanging, everywhere)
    blocks: tuple[float, ...] = ()
    if has_blocks:
        block = np.arange(len(points)) * BLOCKS // len(points)
        kept = (block != each for each in range(BLOCKS))
        blocks = tuple(_fitted(wire, points, terms, hanging, each)[0] for each in kept)
    return HangFit(stiffness, natural, model, model - points, blocks)


def _fitted(
    wire: RealWire, points: Floats, terms: int, hanging: Hanging, kept: Flags
) -> tuple[float, tuple[float, ...], Floats]:
    start = float(np.mean(wire.plain))

    def off(x: Floats) -> Floats:
        try:
            model = hanging(wire, points, start * float(np.exp(x[0])), tuple(x[1:]))
        except ArithmeticError:
            model = points + 1.0
        return np.asarray(1e3 * (model - points)[kept].ravel())

    scales = np.array([0.1] + [5.0] * terms)
    found = least_squares(off, np.zeros(1 + terms), x_scale=scales, xtol=1e-5, ftol=1e-5)
    stiffness, natural = start * float(np.exp(found.x[0])), tuple(map(float, found.x[1:]))
    return stiffness, natural, hanging(wire, points, stiffness, natural)


@dataclass(frozen=True, slots=True)
class Interval:
    """A mean with what makes it uncertain, each as a standard uncertainty with its freedom.

    Parameters
    ----------
    value : mean over the hangs
    parts : by name: standard uncertainty, degrees of freedom
    """

    value: float
    parts: dict[str, tuple[float, float]]

    @property
    def half_width(self) -> float:
        """Of the 95 % interval (GUM G.4.1: effective degrees of freedom)."""
        size = np.sqrt(sum(each**2 for each, _ in self.parts.values()))
        freedom = size**4 / sum(each**4 / free for each, free in self.parts.values())
        return float(t.ppf(0.975, freedom) * size)

    @property
    def bounds(self) -> tuple[float, float]:
        """Of the 95 % interval."""
        return self.value - self.half_width, self.value + self.half_width


def stiffness_of(wire: RealWire, hangs: Floats, fits: list[HangFit]) -> Interval:
    """Mean stiffness over the hangs, with scatter, model, scale and weight.

    - scatter: hang to hang.
    - model: what is left over is alike along the line (0.9 from point to point) and in every hang,
      so that neither points nor hangs count as independent; the mean moves as fifths of the line
      are left out (jackknife over blocks).
    - scale: clamps 0.12 m apart are 0.123 to 0.126 m apart in photographs scaled by the length. Any
      scale between these two is as likely; stiffness goes with its cube.
    - weight: the range of the authors' own numbers.
    """
    values = np.array([each.stiffness for each in fits])
    mean, count = float(values.mean()), len(values)
    blocks = np.mean([each.blocks for each in fits], axis=0)
    spread = np.sqrt((BLOCKS - 1) / BLOCKS * np.sum((blocks - blocks.mean()) ** 2))
    apart = float(np.mean(np.abs(hangs[:, -1, 0])))
    shrunk = 3 * (1 - APART / apart) / np.sqrt(3)
    parts = {
        "scatter": (float(values.std(ddof=1)) / np.sqrt(count), count - 1.0),
        "model": (float(spread), BLOCKS - 1.0),
        "scale": (mean * shrunk, np.inf),
        "weight": (mean * wire.mass_width / np.sqrt(3), np.inf),
    }
    return Interval(mean, parts)


def scatter_of(values: Floats) -> Interval:
    """A mean with the scatter of its values only."""
    size = float(values.std(ddof=1)) / np.sqrt(len(values))
    return Interval(float(values.mean()), {"scatter": (size, len(values) - 1.0)})


def snap_turn(wire: RealWire, points: Floats, stiffness: float, ratio: float) -> float:
    """Turn of a clamp at which the loop snaps over, degrees, for pieces of no length.

    Parameters
    ----------
    wire : what is known of it
    points : a hang, for the place of the clamps
    stiffness : of bending, N m^2
    ratio : torsional over bending stiffness
    """
    found = {}
    for pieces in _PIECES:
        chord = (float(points[-1, 0]), float(points[-1, 1]))
        weight = wire.mass * GRAVITY
        hung = HungElastica(LENGTH, weight, stiffness, chord, pieces=pieces)
        found[pieces] = float(np.degrees(TwistedLoop(hung, ratio * stiffness).snap()[0]))
    coarse, fine = _PIECES
    return found[fine] + (found[fine] - found[coarse]) / ((fine / coarse) ** 2 - 1)


@dataclass(frozen=True, slots=True)
class SnapLine:
    """Turn at which a loop snaps over as a power of both stiffnesses, near a ratio that was tried.

    Parameters
    ----------
    ratio : torsional over bending stiffness, at which it snaps as measured
    by_ratio : change of log(turn) with log(ratio)
    by_stiffness : change of log(turn) with log(stiffness), at the same ratio
    """

    ratio: float
    by_ratio: float
    by_stiffness: float


def snap_line(wire: RealWire, points: Floats, stiffness: float) -> SnapLine:
    """Find the ratio at which the loop snaps over as measured."""
    measured = float(np.mean(wire.snaps))
    low, high = _RATIOS[wire.name]
    turns = np.log([snap_turn(wire, points, stiffness, each) for each in (low, high)])
    by_ratio = float(np.diff(turns)[0] / np.log(high / low))
    ratio = low * float(np.exp((np.log(measured) - turns[0]) / by_ratio))
    softer = np.log(snap_turn(wire, points, _SOFTER * stiffness, low))
    return SnapLine(ratio, by_ratio, float((softer - turns[0]) / np.log(_SOFTER)))


def torsion_of(wire: RealWire, line: SnapLine, stiffness: Interval) -> Interval:
    """Torsional over bending stiffness, with what makes it uncertain.

    Scale and weight change nothing: the shape fixes weight length^3 / stiffness, and so does the
    turn. What is left is the scatter of the turns, and scatter and model of the stiffness.
    """
    turns = scatter_of(np.array(wire.snaps))
    size, freedom = turns.parts["scatter"]
    share = line.ratio / abs(line.by_ratio)
    parts = {"turns": (share * size / turns.value, freedom)}
    for name in ("scatter", "model"):
        size, freedom = stiffness.parts[name]
        parts[name] = (share * abs(line.by_stiffness) * size / stiffness.value, freedom)
    return Interval(line.ratio, parts)
