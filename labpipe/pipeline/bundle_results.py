"""Results of harness bundles: kink, plateau, stiffness of each cycle, hardening, EI of a beam.

Each function gives the results of one entry of a protocol's list.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TypeVar

import numpy as np

from labpipe.fits.beam_stiffness import beam_stiffness
from labpipe.fits.plateau import EndSlope, Onset, find_onset, fit_end_slope
from labpipe.fits.slack import find_take_up
from labpipe.fits.two_segments import Kink, fit_kink
from labpipe.pipeline.beam_corrections import corrected
from labpipe.pipeline.bench import Bench
from labpipe.pipeline.corrections import loading_stretch
from labpipe.pipeline.cycle_numbers import curve_of, stiffness_over
from labpipe.pipeline.cycle_results import broken_off, per_cycle, with_shape_error
from labpipe.pipeline.outcomes import (
    CURVE,
    NO_BRANCH,
    Asked,
    blocked_or,
    slack_error,
    to_result,
    while_loading,
    with_force_scale,
)
from labpipe.pipeline.stiffness_results import doubt_of, marked_slip, window_of
from labpipe.protocol.results import BendingStiffness, Plateau
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, FittedLine
from labpipe.records.estimates import Estimate, Failure, scaled, widened
from labpipe.records.quality import Reason, Severity
from labpipe.records.result import Result

_LOST = 3
"""Samples at the end of a branch that the joining of two clocks may cost."""
_NO_LENGTH = Failure(
    "no_length",
    "nobody says specimen.length: write it into the test sheet, such as 'length: 114.3 mm'",
)
_NO_SPAN = Failure(
    "no_span",
    "nobody says specimen.span: write it into the test sheet, such as 'span: 152.4 mm'",
)
_Found = TypeVar("_Found")
_Fit = Callable[[Floats, Floats], _Found | Failure]
"""What is found in displacement and force of the first loading."""


def kink_results(bench: Bench, *, low: float, high: float) -> list[Result]:
    """``kink_displacement`` (m) and ``kink_force`` (N): where the slope of first loading falls."""
    method = f"two segments that meet, from {1e3 * low:g} mm to {1e3 * high:g} mm, all breaks tried"
    place = Asked("kink_displacement", "m", CURVE, method)
    level = Asked("kink_force", "N", CURVE, method)
    found, other = _both(bench, partial(_kink, low=low, high=high))
    if isinstance(found, Failure):
        return [to_result(bench, each, found) for each in (place, level)]
    before = found.force.value - found.first.value * (found.displacement.value - found.start)
    at = found.displacement.value
    bench.lines += [
        FittedLine("before_kink", found.first.value, before, found.start, at),
        FittedLine("behind_kink", found.second.value, found.force.value, at, found.stop),
    ]
    moved = other if isinstance(other, Kink) else found
    doubts = [marked_slip(bench, found.start, found.stop)]
    during = while_loading(bench, found.start, found.stop)
    outcomes = (
        _place(bench, found.displacement, moved.displacement),
        _level(bench, found.force, moved.force),
    )
    return [
        to_result(bench, each, outcome, doubts=doubts, during=during)
        for each, outcome in zip((place, level), outcomes, strict=True)
    ]


def _kink(displacement: Floats, force: Floats, low: float, high: float) -> Kink | Failure:
    window = window_of(displacement, low, high)
    if isinstance(window, Failure):
        return window
    return fit_kink(displacement[window], force[window])


def plateau_results(bench: Bench, entry: Plateau) -> list[Result]:
    """``end_slope`` (1); ``plateau_displacement`` (m), ``plateau_force`` (N) if there is one."""
    over = 1e3 * entry.over
    how = f"slope over the last {over:g} mm of first loading / {entry.of}"
    share = Asked("end_slope", "1", CURVE, how, made_of=entry.of)
    initial = bench.stiffnesses.get(entry.of)
    if initial is None:
        why = blocked_or(bench, Failure("no_stiffness", f"{entry.of} could not be had"))
        return [to_result(bench, share, why)]
    fit = partial(fit_end_slope, initial=initial, over=entry.over)
    end, other = _both(bench, fit)
    if isinstance(end, Failure):
        return [to_result(bench, share, end)]
    bench.lines.append(FittedLine("slope_at_end", end.slope, end.level, end.start, end.stop))
    moved = other if isinstance(other, EndSlope) else end
    first = bench.cycles()[0][:1]
    doubts = [
        doubt_of(bench, entry.of) or broken_off(bench, first, CURVE) or _unseen_end(bench, first[0])
    ]
    during = while_loading(bench)
    found = to_result(bench, share, _changed(end.share, moved.share), doubts=doubts, during=during)
    return [found, *_onset_results(bench, entry, initial, found)]


def _unseen_end(bench: Bench, branch: Branch) -> Reason | None:
    """Why the end of a loading branch is doubtful: its force was not recorded up to there."""
    curve = curve_of(bench)
    d, f = (each[branch.start : branch.stop] for each in (curve.displacement, curve.force))
    known = np.flatnonzero(np.isfinite(f) & np.isfinite(d))
    if not len(known) or known[-1] >= len(d) - _LOST:
        return None
    end = 1e3 * float(d[known[-1]])
    message = (
        f"force and displacement are known up to {end:.4g} mm of the first loading alone, "
        f"{len(d) - 1 - known[-1]} samples before its end"
    )
    return Reason("gap", message)


def _onset_results(bench: Bench, entry: Plateau, initial: Estimate, end: Result) -> list[Result]:
    """Where the plateau begins; a note where there is none, which is a finding and no failure."""
    below = f"{1e2 * entry.slope_below:g} % of {entry.of}"
    method = f"tangents over {1e3 * entry.over:g} mm, below {below} up to the end of first loading"
    fit = partial(find_onset, initial=initial, over=entry.over, slope_below=entry.slope_below)
    onset, other = _both(bench, fit)
    surely = end.interval is not None and end.interval.upper < entry.slope_below
    if isinstance(onset, Failure) or not surely:
        bench.note("no_plateau", Severity.INFO, bench.force, _no_plateau(bench, entry, end))
        return []
    moved = other if isinstance(other, Onset) else onset
    place = _place(bench, onset.displacement, moved.displacement)
    level = _level(bench, onset.force, moved.force)
    first = bench.cycles()[0][0]
    doubts = [doubt_of(bench, entry.of) or _unseen_end(bench, first)]
    asked = (
        Asked("plateau_displacement", "m", CURVE, method, made_of=entry.of),
        Asked("plateau_force", "N", CURVE, method, made_of=entry.of),
    )
    during = while_loading(bench)
    return [
        to_result(bench, each, outcome, doubts=doubts, during=during)
        for each, outcome in zip(asked, (place, level), strict=True)
    ]


def _no_plateau(bench: Bench, entry: Plateau, end: Result) -> str:
    reached = float(np.nanmax(curve_of(bench).displacement[loading_stretch(bench)]))
    interval = end.interval
    between = f" ({1e2 * interval.lower:.3g} % to {1e2 * interval.upper:.3g} %)" if interval else ""
    return (
        f"the slope over the last {1e3 * entry.over:g} mm is {1e2 * (end.value or 0.0):.3g} % of "
        f"{entry.of}{between}, not surely below {1e2 * entry.slope_below:g} %: no plateau up to "
        f"{1e3 * reached:.4g} mm"
    )


def loading_stiffness_results(bench: Bench, *, over: float) -> list[Result]:
    """``loading_stiffness.<cycle>`` (N/m): slope once the force has taken up, in each cycle."""
    method = f"line over {1e3 * over:g} mm from where the force takes up, time as instrument"
    number = partial(_taken_up_stiffness, over=over)

    def in_newtons(bench: Bench, branches: list[Branch], displacement: Floats) -> _Number:
        found = number(bench, branches, displacement)
        return found if isinstance(found, Failure) else with_force_scale(bench, found)

    asked = Asked("loading_stiffness", "N/m", CURVE, method, reads=(0, 1))
    return per_cycle(bench, asked, in_newtons)


_Number = Estimate | Failure


def _taken_up_stiffness(
    bench: Bench, branches: list[Branch], displacement: Floats, over: float
) -> _Number:
    """Stiffness over the first stretch behind the take-up, N/m, scale taken as exact."""
    part = bench.within(branches[0])
    zero = bench.raw[bench.force].zero_error
    start = find_take_up(displacement[part], curve_of(bench).force[part], zero_error=zero)
    if isinstance(start, Failure):
        return start
    taut = replace(branches[0], start=branches[0].start + start.sample)
    found, later = (
        stiffness_over(bench, taut, displacement, low, low + over)
        for low in (start.displacement.value, start.displacement.value + start.displacement.error)
    )
    if isinstance(found, Failure) or isinstance(later, Failure):
        return found
    return widened(found, later.value - found.value)


def hardening_results(bench: Bench, *, over: float) -> list[Result]:
    """``hardening.<cycle>`` (1): ``loading_stiffness`` of a later cycle over that of the first."""
    method = f"slope over {1e3 * over:g} mm from the take-up / that of cycle 1, scale cancelled"
    asked, cycles = Asked("hardening", "1", CURVE, method), bench.cycles()
    if not cycles:
        return [to_result(bench, asked, blocked_or(bench, NO_BRANCH), part=".2")]
    number = partial(_hardening, first=cycles[0], over=over)
    return [
        to_result(
            bench,
            asked,
            with_shape_error(bench, later, number),
            part=f".{later[0].cycle}",
            during=(cycles[0][0].start_time, later[0].stop_time),
        )
        for later in cycles[1:]
    ]


def _hardening(
    bench: Bench, later: list[Branch], displacement: Floats, first: list[Branch], over: float
) -> _Number:
    before = _taken_up_stiffness(bench, first, displacement, over)
    after = _taken_up_stiffness(bench, later, displacement, over)
    if isinstance(after, Failure):
        return after
    if isinstance(before, Failure):
        return Failure("no_stiffness", f"that of cycle 1 could not be had: {before.message}")
    if before.value <= 3.0 * before.error:
        return Failure("no_stiffness", f"{before.value:.4g} N/m in cycle 1 is no more than noise")
    more = abs(after.value) * before.error / before.value
    return scaled(after, 1.0 / before.value, more=more)


def beam_results(bench: Bench, entry: BendingStiffness, protocol: Protocol) -> list[Result]:
    """Bending stiffness (N m^2) of a beam, from a stiffness above and the length of the sheet."""
    specimen = protocol.specimen
    key = "length" if entry.support == "cantilever" else "span"
    formula = "L^3 / 3" if entry.support == "cantilever" else "L^3 / 48"
    how = f"{entry.of} x {formula}, L = specimen.{key}"
    asked = Asked(entry.name, "N*m^2", CURVE, how, made_of=entry.of)
    stiffness = bench.stiffnesses.get(entry.of)
    length = specimen.length if key == "length" else specimen.span
    outcome: _Number
    if stiffness is None:
        outcome = blocked_or(bench, Failure("no_stiffness", f"{entry.of} could not be had"))
    elif length is None:
        outcome = _NO_LENGTH if key == "length" else _NO_SPAN
    else:
        outcome = beam_stiffness(
            with_force_scale(bench, stiffness),
            length=length,
            length_error=entry.length_uncertainty,
            support=entry.support,
        )
        outcome, said = corrected(bench, entry, outcome, specimen, protocol.results)
        asked = replace(asked, method=f"{asked.method}{said}")
    doubts, during = [doubt_of(bench, entry.of)], bench.windows.get(entry.of)
    return [to_result(bench, asked, outcome, doubts=doubts, during=during)]


def _both(bench: Bench, fit: _Fit[_Found]) -> tuple[_Found | Failure, _Found | Failure | None]:
    """What is found in the first loading, and with the displacement of another assumption."""
    if not bench.cycles():
        return blocked_or(bench, NO_BRANCH), None
    curve, stretch = curve_of(bench), loading_stretch(bench)
    other = bench.signals[bench.displacement].alternative
    found = fit(curve.displacement[stretch], curve.force[stretch])
    return found, None if other is None else fit(other[stretch], curve.force[stretch])


def _changed(found: Estimate, other: Estimate) -> Estimate:
    """Widened by what a displacement under another assumption changes: a rectangle."""
    return widened(found, abs(other.value - found.value) / np.sqrt(3.0))


def _place(bench: Bench, found: Estimate, other: Estimate) -> Estimate:
    zero = bench.signals[bench.displacement].zero_error
    return widened(_changed(found, other), zero, slack_error(bench))


def _level(bench: Bench, found: Estimate, other: Estimate) -> Estimate:
    zero = bench.raw[bench.force].zero_error
    return with_force_scale(bench, widened(_changed(found, other), zero))
