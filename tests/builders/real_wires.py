"""Two wires that others hung as loops and photographed: what was measured, and fits of an elastica.

The files are in the folder of real exports (`rods`) and are not shipped. A photograph is scaled so
that the line drawn over the wire is 1.5 m long, and cut into equal pieces: points have a share of
the length, and no marks on the wire.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labpipe.records.arrays import Floats
from tests.judges.hung_wires import GRAVITY, HungElastica
from tests.judges.rod_fits import Estimate, Hang, HangFit, mean_stiffness

LENGTH = 1.5
"""m, between the clamps."""
APART = 0.12
"""m, of the clamps, as built."""


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

    def hangs(self, folder: Path) -> list[Hang]:
        """The photographs of the hangs, in the plane of x and z."""
        seen = photographed(folder / "rods" / f"adapteddlo_{self.name}_hangs.csv")
        return [hang_of(each, self.mass) for each in seen]

    def stiffness_of(self, hangs: list[Hang], fits: list[HangFit]) -> Estimate:
        """Mean stiffness, with the scale and the mass as uncertain as they are.

        Clamps 0.12 m apart are 0.123 to 0.126 m apart in photographs that are scaled by the length
        of the wire: one of the two is off. Any scale between is as likely.
        """
        apart = float(np.mean([np.linalg.norm(each.points[-1]) for each in hangs]))
        scale, mass = (1 - APART / apart) / np.sqrt(3), self.mass_width / np.sqrt(3)
        return mean_stiffness(fits, length_error=float(scale), mass_error=float(mass))


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


def hang_of(points: Floats, mass: float) -> Hang:
    """A photograph between level clamps: points to the right and up, shape (points, 2), m."""
    across = np.zeros(len(points))
    places = np.column_stack([points[:, 0], across, points[:, 1]])
    level = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    return Hang(places, np.linspace(0.0, 1.0, len(points)), level, LENGTH, mass)


def mean_hang(hangs: list[Hang]) -> Hang:
    """All hangs of a wire as one."""
    points = np.mean([each.points for each in hangs], axis=0)
    return hang_of(points[:, [0, 2]], hangs[0].mass_per_length)


def elastica_of(
    hang: Hang, stiffness: float, natural: tuple[float, ...] = (), *, pieces: int = 400
) -> HungElastica:
    """The elastica between the same clamps."""
    x, _, z = hang.points[-1]
    weight = hang.mass_per_length * GRAVITY
    return HungElastica(hang.length, weight, stiffness, (x, z), natural, pieces=pieces)


def by_elastica(hang: Hang, stiffness: float, natural: tuple[float, ...]) -> Floats:
    """Places of the elastica at the shares of a hang, shape (points, 3)."""
    x, z = elastica_of(hang, stiffness, natural).at(hang.shares).T
    return np.column_stack([x, np.zeros(len(x)), z])
