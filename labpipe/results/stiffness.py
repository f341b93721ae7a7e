"""Stiffnesses of the first loading and what is made of them: lines, segments, per force, moduli."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np

from labpipe.fits.straight_lines import (
    annulus_area,
    fit_compliance,
    fit_line,
    modulus,
    rectangle_area,
    stiffness_per_peak_force,
    thin_wall_area,
)
from labpipe.fits.two_segments import TwoSegments as FittedSegments
from labpipe.fits.two_segments import fit_two_segments
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, FittedLine
from labpipe.records.declarations import (
    Above,
    Distance,
    Force,
    Key,
    Needs,
    Output,
    Snake,
    StiffnessName,
)
from labpipe.records.estimates import Estimate, Failure, widened
from labpipe.records.quality import Reason
from labpipe.results.cycle_stiffness import stiffness_over
from labpipe.results.cycles import cut_short, other_shape, rectangle
from labpipe.results.evidence import Evidence, Stiffness
from labpipe.results.kinds import (
    NO_CYCLE,
    NO_LOADING,
    Computed,
    Errors,
    Kind,
    Outcome,
    blocked_or,
    force_scale,
    marked_slips,
)
from labpipe.results.peaks import peak_of_cycle


@dataclass(frozen=True, slots=True, kw_only=True)
class Window(Kind):
    """A kind of result that is read from a stretch of displacement."""

    start: Annotated[Distance, Key("from")]
    stop: Annotated[Distance, Key("to"), Above("start")]

    @property
    def in_words(self) -> str:
        """The stretch in millimetres."""
        return f"from {1e3 * self.start:g} mm to {1e3 * self.stop:g} mm"

    def inside(self, displacement: Floats) -> slice | Failure:
        """Samples from the first one at the begin to the last one before the end, in time order.

        Parameters
        ----------
        displacement : shape (n,), m, of a loading branch

        Returns
        -------
        Where they are, or a failure ``not_reached``.
        """
        low, high = self.start, self.stop
        known = displacement[~np.isnan(displacement)]
        if not len(known) or known.max() < high:
            reached = float(known.max()) if len(known) else float("nan")
            found = f"the branch reaches {1e3 * reached:.4g} mm, {1e3 * high:.4g} mm is asked"
            return Failure("not_reached", found)
        if known[0] > low + 0.02 * (high - low):
            found = f"the branch begins at {1e3 * known[0]:.4g} mm, {1e3 * low:.4g} mm is asked"
            return Failure("not_reached", found)
        stop = int(np.argmax(displacement > high)) or None
        return slice(int(np.argmax(displacement >= low)), stop)


def _seen_by_cameras(kind: Window, test: Evidence, name: str) -> Computed:
    """Slope between two displacements that come from a shape, time as instrument."""
    method = (
        f"line from {kind.start:g} m to {kind.stop:g} m of the first loading, time as instrument"
    )
    if not test.cycles:
        return kind.not_available(blocked_or(test, NO_CYCLE), method)
    branches = test.cycles[0]
    found = _secant(test, branches, test.displacement.values, kind)
    if isinstance(found, Failure):
        return kind.not_available(found, method)

    def again(test: Evidence, branches: list[Branch], displacement: Floats) -> Outcome:
        return _secant(test, branches, displacement, kind)

    during = test.while_loading(kind.start, kind.stop)
    shaped = widened(found, *other_shape(test, branches, again, found).values())
    number = kind.number(
        kind.outputs[0], shaped, method, force_scale(test, found.value), during=during
    )
    made = Stiffness(shaped, during, (kind.start, kind.stop))
    return Computed((number,), {name: made})


def _secant(
    test: Evidence, branches: list[Branch], displacement: Floats, window: Window
) -> Outcome:
    return stiffness_over(test, branches[0], displacement, window.start, window.stop)


@dataclass(frozen=True, slots=True, kw_only=True)
class InitialStiffness(Window):
    """``initial_stiffness`` (N/m): slope at the start of the first loading."""

    result: ClassVar = "initial-stiffness"
    outputs: ClassVar = (Output("initial_stiffness", "N/m", "Initial stiffness"),)

    def compute(self, test: Evidence) -> Computed:
        """Slope between two displacements, time as instrument."""
        return _seen_by_cameras(self, test, "initial_stiffness")


@dataclass(frozen=True, slots=True, kw_only=True)
class LineStiffness(Window):
    """A straight line (N/m) over a window of the first loading, under a name of its own."""

    result: ClassVar = "stiffness"
    outputs: ClassVar = (Output("{name}", "N/m"),)
    name: Annotated[Snake, "Such as stiffness_first"] = "stiffness"

    def compute(self, test: Evidence) -> Computed:
        """Straight line by least squares, its interval for correlated noise."""
        if test.shape is not None:
            return _seen_by_cameras(self, test, self.name)
        method = (
            f"straight line {self.in_words} of the first loading, interval for correlated noise"
        )
        if not test.cycles:
            return self.not_available(blocked_or(test, NO_LOADING), method)
        curve, stretch = test.known_curve, test.loading_stretch
        displacement, force = curve.displacement[stretch], curve.force[stretch]
        window = self.inside(displacement)
        if isinstance(window, Failure):
            return self.not_available(window, method)
        line = fit_line(displacement[window], force[window])
        if isinstance(line, Failure):
            return self.not_available(line, method)
        errors = _of_another_displacement(test, stretch, window, line.slope)
        slope = widened(line.slope, *errors.values())
        level = line.intercept.value + line.slope.value * line.start
        during = test.while_loading(line.start, line.stop)
        doubts = _falls(slope) + marked_slips(test, (line.start, line.stop))
        number = self.number(
            self.outputs[0],
            slope,
            method,
            force_scale(test, slope.value),
            during=during,
            doubts=doubts,
        )
        read = (line.start, line.stop)
        made_of = Stiffness(slope, during, (max(line.start, 0.0), line.stop), bends_with=read)
        drawn = FittedLine(self.name, slope.value, level, line.start, line.stop)
        return Computed((number,), {self.name: made_of}, (drawn,))


def _falls(slope: Estimate) -> tuple[Reason, ...]:
    if slope.value > 0.0:
        return ()
    return (Reason("negative_slope", "the force falls where the frame pulls"),)


def _of_another_displacement(
    test: Evidence, stretch: slice, window: slice, slope: Estimate
) -> Errors:
    """Error from what a displacement under another assumption changes."""
    other = test.displacement.alternative
    if other is None:
        return {}
    line = fit_line(other[stretch][window], test.known_curve.force[stretch][window])
    return {} if isinstance(line, Failure) else rectangle(slope, line.slope)


@dataclass(frozen=True, slots=True, kw_only=True)
class TwoSegments(Window):
    """``segment_stiffness_first``, ``segment_stiffness_second`` (N/m) and ``break_point`` (m)."""

    result: ClassVar = "two-segments"
    outputs: ClassVar = (
        Output("segment_stiffness_first", "N/m", "Stiffness, first fitted segment"),
        Output(
            "segment_stiffness_second",
            "N/m",
            "Stiffness, second fitted segment",
        ),
        Output("break_point", "m", "Break point of the two segments"),
    )

    def compute(self, test: Evidence) -> Computed:
        """Best two segments that meet."""
        method = f"two segments that meet, {self.in_words}, all breaks tried"
        fit = self._fit(test)
        if isinstance(fit, Failure):
            return self.not_available(fit, method)
        first, second, at = fit.first, fit.second, fit.break_point
        during = test.while_loading(fit.start, fit.stop)  # one break bends both
        zero = test.displacement.zero_error
        errors: tuple[Errors, ...] = (
            force_scale(test, first.value),
            force_scale(test, second.value),
            {"zero of the displacement": zero, "slack": test.slack_error},
        )
        doubts, read = marked_slips(test, (fit.start, fit.stop)), (fit.start, fit.stop)
        names = [each.name for each in self.outputs]
        left = fit.level - first.value * (at.value - fit.start)
        return Computed(
            tuple(
                self.number(output, outcome, method, error, during=during, doubts=doubts)
                for output, outcome, error in zip(
                    self.outputs, (first, second, at), errors, strict=True
                )
            ),
            {
                names[0]: Stiffness(first, during, (max(fit.start, 0.0), at.value), read),
                names[1]: Stiffness(second, during, (max(at.value, 0.0), fit.stop), read),
            },
            (
                FittedLine(names[0], first.value, left, fit.start, at.value),
                FittedLine(names[1], second.value, fit.level, at.value, fit.stop),
            ),
        )

    def _fit(self, test: Evidence) -> FittedSegments | Failure:
        if not test.cycles:
            return blocked_or(test, NO_LOADING)
        curve, stretch = test.known_curve, test.loading_stretch
        displacement, force = curve.displacement[stretch], curve.force[stretch]
        window = self.inside(displacement)
        if isinstance(window, Failure):
            return window
        return fit_two_segments(displacement[window], force[window])


@dataclass(frozen=True, slots=True, kw_only=True)
class OfStiffness(Kind):
    """A kind of result that is made of a stiffness above it in the list."""

    of: Annotated[StiffnessName, "Name of a stiffness above, such as stiffness_first"]

    def missing(self, test: Evidence) -> Failure:
        """Why there is no number where there is no stiffness."""
        return blocked_or(test, Failure("no_stiffness", f"{self.of} is not available"))


@dataclass(frozen=True, slots=True, kw_only=True)
class NormalisedStiffness(OfStiffness):
    """``<of>_per_peak_force`` (1/m): a stiffness over the largest force of the same sample."""

    result: ClassVar = "normalised-stiffness"
    outputs: ClassVar = (Output("{of}_per_peak_force", "1/m"),)
    needs: ClassVar = Needs()

    def compute(self, test: Evidence) -> Computed:
        """A gain error cancels."""
        method = f"{self.of} / peak force of the same sample, errors independent, scale error"
        method += " cancelled"
        stiffness, cycles = test.stiffnesses.get(self.of), test.cycles
        if stiffness is None:
            return self.not_available(self.missing(test), method)
        window = stiffness.during
        during = (window[0], max(window[1], cycles[-1][0].stop_time)) if window else None
        doubts = marked_slips(test, stiffness.bends_with) + cut_short(test, cycles[-1][:1])
        outcome = _per_peak(test, stiffness.estimate)
        return Computed(
            (self.number(self.outputs[0], outcome, method, during=during, doubts=doubts),)
        )


def _per_peak(test: Evidence, stiffness: Estimate) -> Outcome:
    peaks = [peak_of_cycle(test, branches) for branches in test.cycles]
    known = [peak for peak in peaks if isinstance(peak, Estimate)]
    if not known:
        return next(peak for peak in peaks if isinstance(peak, Failure))
    largest = max(known, key=lambda peak: peak.value)
    peak = widened(largest, test.raw_force.zero_error)
    if peak.value <= 3.0 * peak.error:
        return Failure("no_peak_force", f"a peak of {peak.value:.3g} N is no more than its noise")
    return stiffness_per_peak_force(stiffness, peak)


@dataclass(frozen=True, slots=True, kw_only=True)
class Modulus(OfStiffness):
    """``<name>`` (Pa): stiffness x gauge length / area."""

    result: ClassVar = "modulus"
    outputs: ClassVar = (Output("{name}", "Pa"),)
    needs: ClassVar = Needs()
    area: Annotated[
        Literal["stated", "rectangle", "annulus", "thin-wall"],
        "Which area of specimen.section it refers to",
    ]
    name: Annotated[Snake, "Such as modulus_annulus"] = "modulus"

    def compute(self, test: Evidence) -> Computed:
        """Sizes are taken as exact."""
        method = f"{self.of} x specimen.length / area ({self.area}); sizes taken as exact"
        stiffness, area = test.stiffnesses.get(self.of), _area(self.area, test.setup.section)
        if stiffness is None:
            return self.not_available(self.missing(test), method)
        outcome: Outcome
        if test.setup.length is None:
            outcome = Failure("no_length", "specimen.length, the gauge length, is not given")
        elif isinstance(area, Failure):
            outcome = area
        else:
            scaled = widened(
                stiffness.estimate, *force_scale(test, stiffness.estimate.value).values()
            )
            outcome = modulus(scaled, gauge_length=test.setup.length, area=area)
        doubts = marked_slips(test, stiffness.bends_with)
        number = self.number(
            self.outputs[0], outcome, method, during=stiffness.during, doubts=doubts
        )
        return Computed((number,))


def _area(kind: str, section: Mapping[str, float]) -> float | Failure:
    """Area of a name from the sizes that it takes."""
    needs = {
        "stated": ("area",),
        "rectangle": ("width", "thickness"),
        "annulus": ("outer_diameter", "inner_diameter"),
        "thin-wall": ("outer_diameter", "wall"),
    }[kind]
    sizes = [section[name] for name in needs if name in section]
    if len(sizes) < len(needs):
        wanted = " and ".join(f"specimen.section.{name}" for name in needs)
        return Failure("no_area", f"{wanted} not given")
    areas = {"rectangle": rectangle_area, "annulus": annulus_area, "thin-wall": thin_wall_area}
    area = sizes[0] if kind == "stated" else areas[kind](*sizes)
    if not area > 0.0:
        return Failure("no_area", f"the {kind} area comes out as {area:.4g} m^2")
    return area


@dataclass(frozen=True, slots=True, kw_only=True)
class ComplianceResult(Kind):
    """``compliance`` (m/N) of frame and grips, from a test of a stiff bar."""

    result: ClassVar = "compliance"
    outputs: ClassVar = (Output("compliance", "m/N", "Compliance of frame and grips"),)
    start: Annotated[Force, Key("from")]
    stop: Annotated[Force, Key("to"), Above("start")]

    def compute(self, test: Evidence) -> Computed:
        """Displacement against force, the bar taken for rigid."""
        method = (
            f"displacement against force from {self.start:g} N to {self.stop:g} N, the bar taken "
            "for rigid"
        )
        if not test.cycles:
            return self.not_available(blocked_or(test, NO_LOADING), method)
        curve, stretch = test.known_curve, test.loading_stretch
        displacement, force = curve.displacement[stretch], curve.force[stretch]
        found = fit_compliance(displacement, force, start=self.start, stop=self.stop)
        errors = {} if isinstance(found, Failure) else force_scale(test, found.value)
        number = self.number(self.outputs[0], found, method, errors, during=test.while_loading())
        return Computed((number,))


KINDS = (
    InitialStiffness,
    LineStiffness,
    TwoSegments,
    NormalisedStiffness,
    Modulus,
    ComplianceResult,
)
