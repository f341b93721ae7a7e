"""What large deflection and rollers change in the bending stiffness of a beam on two supports."""

from __future__ import annotations

from collections.abc import Sequence

from labpipe.fits.beam_stiffness import Rollers, stiffness_ratio
from labpipe.pipeline.bench import Bench
from labpipe.protocol.results import BendingStiffness, ResultEntry
from labpipe.protocol.schema import SpecimenBlock
from labpipe.records.estimates import Estimate, Failure, scaled

_ORDER = ("large-deflection", "roller-radius", "roller-friction")


def corrected(
    bench: Bench,
    entry: BendingStiffness,
    uncorrected: Estimate,
    specimen: SpecimenBlock,
    results: Sequence[ResultEntry],
) -> tuple[Estimate | Failure, str]:
    """Divide a bending stiffness by what the supports make of 48 EI / span^3 over its window.

    Parameters
    ----------
    bench : knows the lines that stiffnesses were read from
    entry : its corrections and its roller
    uncorrected : N m^2, by K L^3 / 48
    specimen : its span, and its outer diameter where it is given
    results : of the protocol, among them the stiffness that it is made of

    Returns
    -------
    The bending stiffness, and for its method what each correction changed, in words; a failure
    where the window is not known or beyond what an elastic beam can do.
    """
    if not entry.corrections or specimen.span is None:
        return uncorrected, ""
    window = _window(bench, entry.of, results)
    if window is None:
        return Failure("no_window", f"nobody knows over which deflections {entry.of} was read"), ""
    ratio, said = 1.0, []
    for number, name in enumerate(_ORDER):
        if name not in entry.corrections:
            continue
        taken = [each for each in _ORDER[: number + 1] if each in entry.corrections]
        found = stiffness_ratio(
            _rollers(taken, entry, specimen, specimen.span), low=window[0], high=window[1]
        )
        if isinstance(found, Failure):
            return found, ""
        said.append(f"{name} {1e2 * (ratio / found - 1.0):+.3g} %")
        ratio = found
    return scaled(uncorrected, 1.0 / ratio), f"; corrected as an elastic beam: {', '.join(said)}"


def _rollers(
    taken: Sequence[str], entry: BendingStiffness, specimen: SpecimenBlock, span: float
) -> Rollers:
    radius = friction = 0.0
    if "roller-radius" in taken and entry.roller is not None:
        section = specimen.section
        depth = section.outer_diameter if section is not None else None
        radius = 0.5 * ((entry.roller.diameter or 0.0) + (depth or 0.0))
    if "roller-friction" in taken and entry.roller is not None:
        friction = entry.roller.friction or 0.0
    return Rollers(span, radius, friction)


def _window(bench: Bench, of: str, results: Sequence[ResultEntry]) -> tuple[float, float] | None:
    """Deflections between which a stiffness was read, m."""
    for line in bench.lines:
        if line.result == of:
            return max(line.start, 0.0), line.stop
    for each in results:
        name = {"initial-stiffness": "initial_stiffness"}.get(
            each.result, getattr(each, "name", "")
        )
        if name == of and hasattr(each, "start") and hasattr(each, "stop"):
            return each.start, each.stop
    return None
