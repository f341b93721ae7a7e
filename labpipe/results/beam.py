"""Results of beams and harness bundles: kink, plateau, bending stiffness from a stiffness."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, ClassVar, Literal

import numpy as np

from labpipe.errors import Fault
from labpipe.fits.beam_stiffness import Rollers, beam_factor, stiffness_ratio
from labpipe.fits.plateau import Tangents
from labpipe.records.arrays import Floats
from labpipe.records.causes import TANGENT
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
from labpipe.records.estimates import Failure
from labpipe.records.quality import Finding, Reason, info_note
from labpipe.records.result import Result
from labpipe.results.curve_replicates import loading_of, traced
from labpipe.results.cycles import cut_short
from labpipe.results.kinds import (
    NO_LOADING,
    CalibrationFit,
    Computed,
    Kind,
    Number,
    blocked_or,
    marked_slips,
    to_result,
)
from labpipe.results.reduced_test import ReducedTest, Stiffness
from labpipe.results.stiffness import OfStiffness
from labpipe.uncertainty.extractors import Decide, Reading, Trace, combine
from labpipe.uncertainty.intervals import Measured, measure
from labpipe.uncertainty.replicates import Input, Replicates


@dataclass(frozen=True, slots=True, eq=False)
class _Corner:
    """Change with shorter tangents, and its noise.

    Half of it is in the estimate, so half of its noise is in the interval.

    Parameters
    ----------
    size : shape (2,), m and N, less noise
    share : shape (2,), of the observed change
    base : shape (2,), of the smooth curve, plus the mean effect of noise
    """

    size: Floats
    share: Floats
    base: Floats

    @classmethod
    def none(cls) -> _Corner:
        """Return no corner."""
        return cls(np.zeros(2), np.zeros(2), np.zeros(2))

    @classmethod
    def of(cls, seen: Floats, base: Floats, noise: Floats) -> _Corner:
        """Remove noise from a corner.

        Parameters
        ----------
        seen, base : shape (2,), of the measured and of the smooth curve
        noise : shape (2, replicates), effect of noise on it

        Notes
        -----
        On average noise adds its variance to the square of a corner, which is subtracted: a share
        s = sqrt(1 - v / c^2) of a corner c remains, or none if noise explains all of it.
        """
        average, variance = np.nanmean(noise, axis=1), np.nanvar(noise, axis=1)
        clear = seen - average
        by_noise = np.divide(variance, clear**2, out=np.ones(2), where=clear != 0.0)
        share = np.sqrt(np.maximum(1.0 - by_noise, 0.0))
        return cls(share * clear, share, base + average)

    def in_noise(self, corners: Floats) -> Floats:
        """Return the effect of noise on the estimate through the corner, shape (2, ...)."""
        return 0.5 * self.share[:, None] * (corners - self.base[:, None])


@dataclass(frozen=True, slots=True, kw_only=True)
class Plateau(Kind):
    """``end_slope`` (1), ``plateau_displacement`` (m), ``plateau_force``: where it levels off."""

    result: ClassVar = "plateau"
    outputs: ClassVar = (
        Output("end_slope", "1", "End slope", can_be_negative=True),
        Output("plateau_displacement", "m", "Displacement at the plateau"),
        Output("plateau_force", "N", "Plateau force"),
    )
    slope_below: Annotated[Share, "Share of the initial slope, such as 10 %"]
    of: Annotated[StiffnessName, "Name of the stiffness above that is the initial slope"] = (
        "initial_stiffness"
    )
    over: Annotated[Length, "Stretch that a tangent is read from"] = 0.005

    def compute(self, test: ReducedTest) -> Computed:
        """Compute the slope at the end of the first loading, and the onset of a plateau."""
        initial = test.stiffnesses.get(self.of)
        method = f"slope over the last {1e3 * self.over:g} mm of first loading / {self.of}"
        if initial is None:
            missing = Failure("no_stiffness", f"{self.of} is not available")
            return Computed((self.number(blocked_or(test, missing), method),))
        outcome = test.measure(partial(self._decide_end, initial=initial.decide))
        begun = self._begun(traced(test), initial.decide)
        if isinstance(outcome, Failure):
            return Computed((self.number(outcome, method),))
        if isinstance(begun, Failure):
            return Computed((self.number(begun, method),))
        first = test.cycles[0][:1]
        doubts = (
            marked_slips(test, initial.bends_with)
            or cut_short(test, first, CURVE)
            or _missing_end(test, first[0])
        )
        number = self.number(outcome[0], method, during=test.while_loading(), doubts=doubts)
        onset, findings = self._onset(test, initial, to_result(test, number))
        tangents, (_, f) = begun[0], _loading(traced(test))
        start, stop = tangents.ends
        slope, level = float(tangents.slope_at_end(f)), tangents.level_at(start, f)
        line = FittedLine("slope_at_end", slope, level, start, stop)
        return Computed((number, *onset), lines=(line,), findings=findings)

    def _begun(self, trace: Trace, initial: Decide) -> tuple[Tangents, Reading] | Failure:
        """Return the tangents of the first loading, and the slope at its start."""
        slope = initial(trace)
        if isinstance(slope, Failure):
            return slope
        value = float(slope.numbers(trace)[0])
        if value <= 0.0:
            return Failure("no_stiffness", f"the slope at the start is {value:.4g} N/m")
        tangents = Tangents.of(*_loading(trace), over=self.over)
        return tangents if isinstance(tangents, Failure) else (tangents, slope)

    def _decide_end(self, trace: Trace, *, initial: Decide) -> Reading | Failure:
        """Choose the samples for the slope at the end over that at the start."""
        begun = self._begun(trace, initial)
        if isinstance(begun, Failure):
            return begun
        tangents, slope = begun
        steeper = self._one_step_on(trace, tangents)

        def numbers(trace: Trace) -> tuple[Floats]:
            end = tangents.slope_at_end(*reversed(_loading(trace))) + trace.beyond * steeper
            return (np.asarray(end / slope.numbers(trace)[0], dtype=np.float64),)

        return Reading(numbers, len(tangents.last), is_cut=slope.is_cut)

    def _one_step_on(self, trace: Trace, tangents: Tangents) -> float:
        """Return the change of the slope at the end with one more sampling step, N/m.

        From the step before: the machine turned somewhere between two samples.
        """
        d, f = _loading(trace)
        before = Tangents.of(d[:-1], f[:-1], over=self.over)
        if isinstance(before, Failure):
            return 0.0
        return float(tangents.slope_at_end(f) - before.slope_at_end(f[:-1]))

    def _decide_onset(
        self, trace: Trace, *, initial: Decide, corner: _Corner | None = None
    ) -> Reading | Failure:
        """Choose the samples for the onset of the plateau and its force.

        With the error from the length of the tangents.
        """
        begun = self._begun(trace, initial)
        if isinstance(begun, Failure):
            return begun
        tangents, slope = begun

        def plain(trace: Trace) -> tuple[Floats, Floats]:
            (d, f), begin = _loading(trace), slope.numbers(trace)[0]
            return tangents.onset(f, begin, d, slope_below=self.slope_below)

        if np.isnan(plain(trace)[1]):
            return Failure("no_plateau", "never steeper, or too few samples around the onset")
        if corner is None:
            return Reading(plain, len(tangents.last))

        def numbers(trace: Trace) -> tuple[Floats, Floats]:
            (place, level), shorter = plain(trace), trace.sizes.get(TANGENT, 0.0)
            return place + shorter * corner.size[0], level + shorter * corner.size[1]

        def in_noise(trace: Trace) -> tuple[Floats, Floats]:
            by = corner.in_noise(self._corners(trace, begun))
            return tuple(value + more for value, more in zip(plain(trace), by, strict=True))

        return Reading(numbers, len(tangents.last), in_noise)

    def _corners(self, trace: Trace, begun: tuple[Tangents, Reading]) -> Floats:
        """Return the largest error of the onset from the length of tangents, m and N, (2, ...)."""
        # In multiples of the change with tangents of half the length. A corner is smeared in
        # proportion to the length, so it is twice that change away; a smooth bend in proportion to
        # its square, so it is 4/3 of it away.
        smearing_factor = 3.0
        cut_factor = 2.0  # the force from half the length loses once or a third of its change
        (tangents, slope), (d, f) = begun, _loading(trace)
        initial = slope.numbers(trace)[0]
        place, _ = tangents.onset(f, initial, d, slope_below=self.slope_below)
        smeared, cut, beyond = tangents.corners(f, place, self.slope_below * initial, d)
        moved = smearing_factor * smeared
        return np.stack([moved, cut_factor * cut + moved * beyond])

    def _corner(self, replicates: Replicates, initial: Decide) -> _Corner:
        """Return that error for the measured curve, less noise.

        The smooth curve may have no corners of this size.
        """
        begun, smooth = (
            self._begun(curve, initial) for curve in (replicates.measured, replicates.smooth)
        )
        if isinstance(begun, Failure):
            return _Corner.none()
        seen = self._corners(replicates.measured, begun)
        if isinstance(smooth, Failure):
            return _Corner(seen, np.zeros(2), np.zeros(2))
        base = self._corners(replicates.smooth, smooth)
        noise = [self._corners(trace, smooth) - base[:, None] for trace in replicates.traces()]
        return _Corner.of(seen, base, np.concatenate(noise, axis=1))

    def _onset(
        self, test: ReducedTest, initial: Stiffness, end: Result
    ) -> tuple[tuple[Number, ...], tuple[Finding, ...]]:
        """Return the onset of the plateau, or a note if there is none, which is not a failure."""
        surely = end.interval is not None and end.interval.upper < self.slope_below
        outcomes = self._measured_onset(test, initial) if surely else None
        if outcomes is None or isinstance(outcomes, Failure):
            return (), (self._no_plateau(test, end),)
        below = f"{1e2 * self.slope_below:g} % of {self.of}"
        method = f"tangents over {1e3 * self.over:g} mm, below {below} up to the end of first"
        doubts = marked_slips(test, initial.bends_with) or _missing_end(test, test.cycles[0][0])
        during, method = test.while_loading(), f"{method} loading"
        return tuple(
            self.number(finding, method, output=place, during=during, doubts=doubts)
            for place, finding in enumerate(outcomes, start=1)
        ), ()

    def _measured_onset(
        self, test: ReducedTest, initial: Stiffness
    ) -> tuple[Measured, ...] | Failure:
        """Measure the onset, with the length of the tangents as a further input."""
        replicates = test.replicates
        if replicates is None:
            return NO_LOADING
        length = Input(TANGENT, _shortened, law="step")
        more = replace(replicates, inputs=(*replicates.inputs, length))
        decide = partial(self._decide_onset, initial=initial.decide)
        if isinstance(failed := decide(replicates.measured), Failure):
            return failed
        return measure(more, partial(decide, corner=self._corner(replicates, initial.decide)))

    def _no_plateau(self, test: ReducedTest, end: Result) -> Finding:
        reached = float(np.nanmax(test.known_curve.displacement[test.loading_stretch]))
        interval = end.interval
        between = (
            f" ({1e2 * interval.lower:.3g} % to {1e2 * interval.upper:.3g} %)" if interval else ""
        )
        message = (
            f"the slope over the last {1e3 * self.over:g} mm is {1e2 * (end.value or 0.0):.3g} % "
            f"of {self.of}{between}, not surely below {1e2 * self.slope_below:g} %: no plateau up "
            f"to {1e3 * reached:.4g} mm"
        )
        return info_note("no_plateau", test.signals.force, message)


def _loading(trace: Trace) -> tuple[Floats, Floats]:
    """Return displacement and force of the first loading."""
    stretch = loading_of(trace)
    return trace.displacement[..., stretch], trace.force[..., stretch]


def _shortened(trace: Trace, x: float) -> Trace:
    """Mark a trace for tangents shorter by a share of their length."""
    return replace(trace, sizes={**trace.sizes, TANGENT: x})


def _missing_end(test: ReducedTest, branch: Branch) -> tuple[Reason, ...]:
    """Return a doubt if the force was not recorded up to the end of a loading branch."""
    curve = test.known_curve
    d, f = (point[branch.start : branch.stop] for point in (curve.displacement, curve.force))
    finite = np.flatnonzero(np.isfinite(f) & np.isfinite(d))
    if not len(finite) or finite[-1] >= len(d) - 3:  # lost when two clocks are joined
        return ()
    end = 1e3 * float(d[finite[-1]])
    message = (
        f"force and displacement are known up to {end:.4g} mm of the first loading alone, "
        f"{len(d) - 1 - finite[-1]} samples before its end"
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
        """Key of the length in the formula."""
        return _FORMULAS[self.support][0]

    @staticmethod
    def between(entry: Mapping[str, object]) -> Iterator[Fault]:
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

    def compute(self, test: ReducedTest) -> Computed:
        """Apply the beam formula, with optional corrections for large deflection and rollers."""
        key, formula = _FORMULAS[self.support]
        method = f"{self.of} x {formula}, L = specimen.{key}"
        stiffness = test.stiffnesses.get(self.of)
        length = test.setup.length if key == "length" else test.setup.span
        if stiffness is None:
            return self.not_available(self.missing(test), method)
        outcome: CalibrationFit
        remark = ""
        if length is None:
            outcome = Failure(
                f"no_{key}",
                f"specimen.{key} is missing: write it into the test sheet, such as "
                f"'{key}: {_EXAMPLES[key]}'",
            )
        else:
            outcome, remark = self._measured(test, stiffness)
        doubts = marked_slips(test, stiffness.bends_with)
        number = self.number(outcome, method, during=stiffness.during, doubts=doubts, remark=remark)
        return Computed((number,))

    def _measured(self, test: ReducedTest, stiffness: Stiffness) -> tuple[CalibrationFit, str]:
        """Measure, with the effect of each correction in words."""
        ratio, remark = self._ratio(test.setup.span, test.setup.section, stiffness.window)
        if isinstance(ratio, Failure):
            return ratio, ""
        decide = combine(partial(self._of_trace, window=stiffness.window), stiffness.decide)
        outcome = test.measure(decide)
        return outcome if isinstance(outcome, Failure) else outcome[0], remark

    def _of_trace(self, trace: Trace, stiffness: Floats, *, window: tuple[float, float]) -> Floats:
        """Return the bending stiffness of curves; NaN beyond the deflection of an elastic beam."""
        ratio, _ = self._ratio(trace.sizes.get("span"), trace.sizes, window)
        length = trace.sizes[_FORMULAS[self.support][0]]
        whole = stiffness * beam_factor(length, self.support)
        return np.asarray(whole / (np.nan if isinstance(ratio, Failure) else ratio))

    def _ratio(
        self, span: float | None, section: Mapping[str, float], window: tuple[float, float]
    ) -> tuple[float | Failure, str]:
        """Return the effect of the supports on 48 EI / span^3 over the window of the stiffness.

        With the effect of each correction in words; a failure if the window is beyond the
        deflection of an elastic beam.
        """
        if not self.corrections or span is None:
            return 1.0, ""
        ratio, corrections = 1.0, []
        for number, name in enumerate(_ORDER):
            if name not in self.corrections:
                continue
            taken = [name for name in _ORDER[: number + 1] if name in self.corrections]
            rollers = self._rollers(taken, span, section.get("outer_diameter", 0.0))
            next_ratio = stiffness_ratio(rollers, low=window[0], high=window[1])
            if isinstance(next_ratio, Failure):
                return next_ratio, ""
            corrections.append(f"{name} {1e2 * (ratio / next_ratio - 1.0):+.3g} %")
            ratio = next_ratio
        return ratio, f"corrected as an elastic beam: {', '.join(corrections)}"

    def _rollers(self, taken: Sequence[str], span: float, depth: float) -> Rollers:
        radius = friction = 0.0
        if "roller-radius" in taken and self.roller is not None:
            radius = 0.5 * ((self.roller.diameter or 0.0) + depth)
        if "roller-friction" in taken and self.roller is not None:
            friction = self.roller.friction or 0.0
        return Rollers(span, radius, friction)


KINDS = (Plateau, BendingStiffness)
