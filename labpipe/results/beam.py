"""Results of beams and harness bundles: kink, plateau, bending stiffness from a stiffness."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, ClassVar, Literal, TypeVar

import numpy as np

from labpipe.errors import Fault
from labpipe.fits.beam_stiffness import Rollers, beam_factor, stiffness_ratio
from labpipe.fits.plateau import find_onset, fit_end_slope
from labpipe.fits.two_segments import fit_kink
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, FittedLine
from labpipe.records.declarations import (
    CURVE,
    Distance,
    Length,
    Output,
    Ratio,
    Share,
    Snake,
    StiffnessName,
)
from labpipe.records.estimates import Estimate, Failure
from labpipe.records.quality import Finding, Reason, worth_knowing
from labpipe.records.result import Result
from labpipe.results.cycles import cut_short, rectangle
from labpipe.results.evidence import Evidence, Stiffness
from labpipe.results.kinds import (
    Computed,
    Errors,
    Found,
    Kind,
    Number,
    blocked_or,
    force_scale,
    marked_slips,
    to_result,
)
from labpipe.results.stiffness import OfStiffness, Window, in_first_loading
from labpipe.uncertainty.readings import Trace, combined

_LOST = 3
"""Samples at the end of a branch that the joining of two clocks may cost."""
_Found = TypeVar("_Found")


def _with_other(
    test: Evidence, fit: Callable[[Floats | None], _Found | Failure]
) -> tuple[_Found, _Found] | Failure:
    """Fit with the displacement, and with that of another assumption where there is one."""
    found, other = fit(None), test.displacement.alternative
    if isinstance(found, Failure):
        return found
    moved = found if other is None else fit(other)
    return found, found if isinstance(moved, Failure) else moved


def _place_errors(test: Evidence, found: Estimate, other: Estimate) -> Errors:
    return {
        **rectangle(found, other),
        "zero of the displacement": test.displacement.zero_error,
        "slack": test.slack_error,
    }


def _level_errors(test: Evidence, found: Estimate, other: Estimate) -> Errors:
    return {
        **rectangle(found, other),
        "zero of the force": test.raw_force.zero_error,
        **force_scale(test, found),
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class Kink(Window):
    """``kink_displacement`` (m) and ``kink_force`` (N): where first loading gets less steep."""

    result: ClassVar = "kink"
    outputs: ClassVar = (
        Output("kink_displacement", "m", "Displacement at the kink"),
        Output("kink_force", "N", "Kink force"),
    )

    def compute(self, test: Evidence) -> Computed:
        """Where the slope of the first loading falls."""
        method = f"two segments that meet, {self.in_words}, all breaks tried"
        fits = _with_other(test, lambda other: self.fitted(test, fit_kink, other))
        if isinstance(fits, Failure):
            return self.not_available(fits, method)
        found, moved = fits
        at = found.displacement.value
        before = found.force.value - found.first.value * (at - found.start)
        doubts = marked_slips(test, (found.start, found.stop))
        during = test.while_loading(found.start, found.stop)
        place = self.number(
            found.displacement,
            method,
            _place_errors(test, found.displacement, moved.displacement),
            during=during,
            doubts=doubts,
        )
        level = self.number(
            found.force,
            method,
            _level_errors(test, found.force, moved.force),
            output=1,
            during=during,
            doubts=doubts,
        )
        return Computed(
            (place, level),
            lines=(
                FittedLine("before_kink", found.first.value, before, found.start, at),
                FittedLine("behind_kink", found.second.value, found.force.value, at, found.stop),
            ),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Plateau(Kind):
    """``end_slope`` (1), ``plateau_displacement`` (m), ``plateau_force``: where it levels off."""

    result: ClassVar = "plateau"
    outputs: ClassVar = (
        Output("end_slope", "1", "End slope"),
        Output("plateau_displacement", "m", "Displacement at the plateau"),
        Output("plateau_force", "N", "Plateau force"),
    )
    slope_below: Annotated[Share, "Share of the initial slope, such as 10 %"]
    of: Annotated[StiffnessName, "Name of the stiffness above that is the initial slope"] = (
        "initial_stiffness"
    )
    over: Annotated[Length, "Stretch that a tangent is read from"] = 0.005

    def compute(self, test: Evidence) -> Computed:
        """Slope at the end of the first loading, and where it levels off."""
        initial = test.stiffnesses.get(self.of)
        method = f"slope over the last {1e3 * self.over:g} mm of first loading / {self.of}"
        if initial is None:
            missing = Failure("no_stiffness", f"{self.of} is not available")
            return Computed((self.number(blocked_or(test, missing), method),))
        fit = partial(fit_end_slope, initial=initial.estimate, over=self.over)
        fits = _with_other(test, lambda other: in_first_loading(test, fit, other))
        if isinstance(fits, Failure):
            return Computed((self.number(fits, method),))
        end, moved = fits
        first = test.cycles[0][:1]
        doubts = (
            marked_slips(test, initial.bends_with)
            or cut_short(test, first, CURVE)
            or _unseen_end(test, first[0])
        )
        errors = rectangle(end.share, moved.share)
        during = test.while_loading()
        number = self.number(end.share, method, errors, during=during, doubts=doubts)
        onset, findings = self._onset(test, initial, to_result(test, number))
        line = FittedLine("slope_at_end", end.slope, end.level, end.start, end.stop)
        return Computed((number, *onset), lines=(line,), findings=findings)

    def _onset(
        self, test: Evidence, initial: Stiffness, end: Result
    ) -> tuple[tuple[Number, ...], tuple[Finding, ...]]:
        """Where the plateau begins; a note where there is none, which is a finding, no failure."""
        fit = partial(
            find_onset, initial=initial.estimate, over=self.over, slope_below=self.slope_below
        )
        fits = _with_other(test, lambda other: in_first_loading(test, fit, other))
        surely = end.interval is not None and end.interval.upper < self.slope_below
        if isinstance(fits, Failure) or not surely:
            return (), (self._no_plateau(test, end),)
        onset, moved = fits
        below = f"{1e2 * self.slope_below:g} % of {self.of}"
        method = f"tangents over {1e3 * self.over:g} mm, below {below} up to the end of first"
        doubts = marked_slips(test, initial.bends_with) or _unseen_end(test, test.cycles[0][0])
        found = (
            (onset.displacement, _place_errors(test, onset.displacement, moved.displacement)),
            (onset.force, _level_errors(test, onset.force, moved.force)),
        )
        during, method = test.while_loading(), f"{method} loading"
        return tuple(
            self.number(outcome, method, errors, output=place, during=during, doubts=doubts)
            for place, (outcome, errors) in enumerate(found, start=1)
        ), ()

    def _no_plateau(self, test: Evidence, end: Result) -> Finding:
        reached = float(np.nanmax(test.known_curve.displacement[test.loading_stretch]))
        known = end.interval
        between = f" ({1e2 * known.lower:.3g} % to {1e2 * known.upper:.3g} %)" if known else ""
        message = (
            f"the slope over the last {1e3 * self.over:g} mm is {1e2 * (end.value or 0.0):.3g} % "
            f"of {self.of}{between}, not surely below {1e2 * self.slope_below:g} %: no plateau up "
            f"to {1e3 * reached:.4g} mm"
        )
        return worth_knowing("no_plateau", test.signals.force, message)


def _unseen_end(test: Evidence, branch: Branch) -> tuple[Reason, ...]:
    """Why the end of a loading branch is doubtful: its force was not recorded up to there."""
    curve = test.known_curve
    d, f = (each[branch.start : branch.stop] for each in (curve.displacement, curve.force))
    known = np.flatnonzero(np.isfinite(f) & np.isfinite(d))
    if not len(known) or known[-1] >= len(d) - _LOST:
        return ()
    end = 1e3 * float(d[known[-1]])
    message = (
        f"force and displacement are known up to {end:.4g} mm of the first loading alone, "
        f"{len(d) - 1 - known[-1]} samples before its end"
    )
    return (Reason("gap", message),)


@dataclass(frozen=True, slots=True, kw_only=True)
class Roller:
    """The rollers of two supports."""

    diameter: Length | None = None
    friction: Annotated[Ratio | None, "Coefficient, of rollers that do not turn"] = None


_ORDER = ("large-deflection", "roller-radius", "roller-friction")
_FORMULAS = {"cantilever": ("length", "L^3 / 3"), "three-point": ("span", "L^3 / 48")}
_EXAMPLES = {"length": "114.3 mm", "span": "152.4 mm"}


@dataclass(frozen=True, slots=True, kw_only=True)
class BendingStiffness(OfStiffness):
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
        """Key of the specimen's size that the formula takes."""
        return _FORMULAS[self.support][0]

    @staticmethod
    def between(entry: Mapping[str, object]) -> Iterator[Fault]:
        """Refuse a correction without what it is made of."""
        said = entry.get("corrections")
        names = said if isinstance(said, list | tuple) else []
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

    def compute(self, test: Evidence) -> Computed:
        """Beam formula, corrected for large deflection and rollers where asked."""
        key, formula = _FORMULAS[self.support]
        method = f"{self.of} x {formula}, L = specimen.{key}"
        stiffness = test.stiffnesses.get(self.of)
        length = test.setup.length if key == "length" else test.setup.span
        if stiffness is None:
            return self.not_available(self.missing(test), method)
        outcome: Found
        said = ""
        if length is None:
            outcome = Failure(
                f"no_{key}",
                f"specimen.{key} is missing: write it into the test sheet, such as "
                f"'{key}: {_EXAMPLES[key]}'",
            )
        else:
            outcome, said = self._measured(test, stiffness)
        doubts = marked_slips(test, stiffness.bends_with)
        number = self.number(outcome, method, during=stiffness.during, doubts=doubts, remark=said)
        return Computed((number,))

    def _measured(self, test: Evidence, stiffness: Stiffness) -> tuple[Found, str]:
        """Measure, with what each correction changed, in words."""
        ratio, said = self._ratio(test.setup.span, test.setup.section, stiffness.window)
        if isinstance(ratio, Failure):
            return ratio, ""
        decide = combined(partial(self._of_trace, window=stiffness.window), stiffness.decide)
        found = test.measure(decide)
        return found if isinstance(found, Failure) else found[0], said

    def _of_trace(self, trace: Trace, stiffness: Floats, *, window: tuple[float, float]) -> Floats:
        """Bending stiffness of curves, from their stiffnesses; NaN where no beam bends so far."""
        ratio, _ = self._ratio(trace.sizes.get("span"), trace.sizes, window)
        length = trace.sizes[_FORMULAS[self.support][0]]
        whole = stiffness * beam_factor(length, self.support)
        return np.asarray(whole / (np.nan if isinstance(ratio, Failure) else ratio))

    def _ratio(
        self, span: float | None, section: Mapping[str, float], window: tuple[float, float]
    ) -> tuple[float | Failure, str]:
        """What the supports make of 48 EI / span^3 over the window of the stiffness.

        With what each correction changed, in words; a failure where the window is beyond what an
        elastic beam can do.
        """
        if not self.corrections or span is None:
            return 1.0, ""
        ratio, said = 1.0, []
        for number, name in enumerate(_ORDER):
            if name not in self.corrections:
                continue
            taken = [each for each in _ORDER[: number + 1] if each in self.corrections]
            rollers = self._rollers(taken, span, section.get("outer_diameter", 0.0))
            found = stiffness_ratio(rollers, low=window[0], high=window[1])
            if isinstance(found, Failure):
                return found, ""
            said.append(f"{name} {1e2 * (ratio / found - 1.0):+.3g} %")
            ratio = found
        return ratio, f"corrected as an elastic beam: {', '.join(said)}"

    def _rollers(self, taken: Sequence[str], span: float, depth: float) -> Rollers:
        radius = friction = 0.0
        if "roller-radius" in taken and self.roller is not None:
            radius = 0.5 * ((self.roller.diameter or 0.0) + depth)
        if "roller-friction" in taken and self.roller is not None:
            friction = self.roller.friction or 0.0
        return Rollers(span, radius, friction)


KINDS = (Kink, Plateau, BendingStiffness)
