"""What is taken of a string at rest: as the protocol states it, or as the evidence has it."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import Literal

from labpipe.pipeline.string_at_rest import SLACK, AtRest, State
from labpipe.protocol.overrides import in_test_sheet
from labpipe.records.quality import QualityNote, Severity


@dataclass(frozen=True, slots=True)
class Held:
    """What is taken of the string at rest.

    Parameters
    ----------
    state : ``taut``: it carried all of the counterweight; ``slack``: nothing, and the wire hung;
        ``off the wire``: nothing, and the wire did not hang all the same; ``part``: some of it, as
        measured; ``unknown``: the test does not tell
    tension : N, in the string at rest
    weight : N, that hangs at the tip
    other : N, another tension at rest that is in the intervals; None where there is none
    why : in words, with the numbers
    """

    state: State
    tension: float
    weight: float
    other: float | None
    why: str

    @property
    def note(self) -> QualityNote:
        """To be kept with the results."""
        severity = Severity.WARNING if self.state == "unknown" else Severity.INFO
        return QualityNote("string_at_rest", severity, "rig.string", self.why)


def held(rest: AtRest) -> Held:
    """Decide by the evidence what the string carried at rest.

    Parameters
    ----------
    rest : what the test says

    Returns
    -------
    Tension, weight, and the alternative where the evidence does not tell.
    """
    weight, state = rest.weight, rest.state
    said = f"{1e3 * weight:.3g} mN"
    if state == "taut":
        why = f"the string was taut at rest and carried the counterweight of {said}"
        return Held(state, weight, weight, None, f"{why}: {rest.facts}")
    if state == "slack":
        why = f"the string carried nothing at rest: the wire hung under the counterweight of {said}"
        return Held(state, 0.0, weight, None, f"{why}: {rest.facts}")
    if state == "off the wire":
        why = (
            "the string carried nothing at rest, yet the wire did not hang: the counterweight is "
            "taken not to pull at it"
        )
        return Held(state, 0.0, 0.0, None, f"{why}: {rest.facts}")
    if state == "part":
        tension = rest.carries
        why = f"the string carried {1e3 * tension:.3g} mN of the counterweight of {said} at rest"
        other = tension - sqrt(3.0) * rest.error  # a rectangle counts by 1 / sqrt(3)
        return Held(state, tension, weight, other, f"{why}: {rest.facts}")
    taken, other = (0.0, weight) if rest.ahead > SLACK else (weight, 0.0)
    why = (
        f"it is not known whether the string carried the counterweight of {said} at rest; it is "
        f"taken to have carried {'nothing' if taken == 0.0 else 'all of it'}, and the other is in "
        f"the intervals: {rest.facts}. If you know, write "
        f"{in_test_sheet('rig.string.at_rest', 'taut')}, or slack"
    )
    return Held(state, taken, weight, other, why)


def stated(at_rest: Literal["taut", "slack"], weight: float) -> Held:
    """Take a string at rest as the protocol states it.

    Parameters
    ----------
    at_rest : key of ``rig.string``
    weight : N, of the counterweight
    """
    tension = weight if at_rest == "taut" else 0.0
    carried = "the counterweight" if at_rest == "taut" else "nothing"
    return Held(
        at_rest,
        tension,
        weight,
        None,
        f"the string was {at_rest} at rest and carried {carried}: so rig.string.at_rest states it",
    )
