"""Whether the string held a wire straight before its test, as a first loading from straight needs.

The model of a first loading takes the wire straight at rest and the string taut, carrying the
counterweight. A string that is slack, or only just spans, leaves the counterweight to the wire: it
hangs and has been bent one way before it is bent the other. Two things tell: the clamp is ahead of
the tip by the slack once the string pulls, and the tip stands below the axis of the clamp at rest.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Flags, Floats
from labpipe.records.curve import Aligned, Branch, Curve, Shape
from labpipe.records.quality import QualityNote, Severity
from labpipe.statistics.block_means import block_means

EARLY = (0.5e-3, 3e-3)
"""Deflections, m, over which it is seen how far the clamp is ahead of the tip."""
SLACK = 0.2e-3
"""m; a clamp that is ahead by more had travelled before the string pulled."""
HANGS, LEANS = 0.5, 0.1
"""Shares of the deflection that the counterweight gives the wire: a tip that stands lower than the
first hung, one that stands lower than the second is told, for wires are not quite straight."""
_BLOCKS = 100


@dataclass(frozen=True, slots=True)
class AtRest:
    """What a test says of its string and wire at rest.

    Parameters
    ----------
    ahead : m, by which the clamp is ahead of the tip early in the first loading; NaN where the
        test has no travel of the clamp
    sag : m, of the tip below the axis of the clamp at rest; NaN where the test has no shape
    reach : m, deflection at which the force is that of the counterweight, or the largest
    weight : N, of the counterweight
    """

    ahead: float
    sag: float
    reach: float
    weight: float

    @property
    def is_known(self) -> bool:
        """Whether anything is known."""
        return bool(np.isfinite(self.ahead) or np.isfinite(self.sag))

    @property
    def why_not_straight(self) -> str:
        """Why the test is no first loading from straight, with the numbers; empty where it is."""
        below = "" if np.isnan(self.sag) else f", its tip {1e3 * self.sag:.3g} mm below"
        weight = f"{1e3 * self.weight:.3g} mN"
        if self.ahead > SLACK:
            return (
                f"its string was slack at rest: the clamp travels {1e3 * self.ahead:.3g} mm before "
                f"the tip follows, and until then the wire hung under the counterweight of "
                f"{weight}{below}; a first loading begins with a straight wire that the string "
                "holds"
            )
        if self.sag > HANGS * self.reach:
            return (
                f"its wire hung at rest: the tip stood {1e3 * self.sag:.3g} mm below the axis of "
                f"the clamp, where the counterweight of {weight} bends the wire by about "
                f"{1e3 * self.reach:.3g} mm; a first loading begins with a straight wire that the "
                "string holds"
            )
        return ""


def at_rest(
    aligned: Aligned | None, shape: Shape | None, curve: Curve, first: Branch, weight: float
) -> AtRest:
    """Look at the string and the wire before a test.

    Parameters
    ----------
    aligned, shape : None where the test has none
    curve, first : of the test, and its first loading branch
    weight : N, of the counterweight
    """
    part = slice(first.start, first.stop)
    deflection = block_means(curve.displacement[part], _BLOCKS)
    force = block_means(curve.force[part], _BLOCKS)
    reached = deflection[force >= weight]
    reach = float(reached[0]) if len(reached) else float(np.nanmax(deflection))
    return AtRest(_ahead(aligned, curve, part), _sag(shape, first), reach, weight)


def notes_of(test: str, rest: AtRest) -> Iterator[QualityNote]:
    """Say what is doubtful about a wire at rest that is taken to have been straight."""
    if not rest.is_known:
        message = (
            "the test has neither the travel of the clamp nor a shape, so it is not known whether "
            "the string held the wire straight at rest; it is taken to have done so"
        )
        yield QualityNote("rest_unknown", Severity.WARNING, test, message)
    elif rest.sag > LEANS * rest.reach:
        message = (
            f"at rest the tip stood {1e3 * rest.sag:.3g} mm below the axis of the clamp: the wire "
            "is taken as straight, and its string as carrying all of the counterweight"
        )
        yield QualityNote("wire_not_straight", Severity.WARNING, test, message)


def _ahead(aligned: Aligned | None, curve: Curve, part: slice) -> float:
    """How far the clamp is ahead of the tip where the string has begun to pull, m."""
    travel = None if aligned is None else aligned.series.get("travel")
    if travel is None or len(travel.values) != len(curve.displacement):
        return float("nan")
    deflection = curve.displacement[part]
    is_early = (deflection > EARLY[0]) & (deflection < EARLY[1])
    return _median((travel.values[part] - deflection)[is_early])


def _sag(shape: Shape | None, first: Branch) -> float:
    """How far the pull point stands below the clamped end before the first loading, m."""
    if shape is None or not len(shape.names):
        return float("nan")
    is_rest: Flags = np.asarray(shape.time < first.start_time, dtype=np.bool_)
    return -_median((shape.positions[:, -1, 1] - shape.positions[:, 0, 1])[is_rest])


def _median(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float("nan")
