"""Results of two straight lines that meet: slopes and break point."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np

from labpipe.fits.two_segments import (
    Hinges,
    Segments,
    why_break_is_doubtful,
    why_no_bend,
    why_no_kink,
)
from labpipe.records.arrays import Floats
from labpipe.records.curve import FittedLine
from labpipe.records.declarations import Output
from labpipe.records.estimates import Failure
from labpipe.records.signals import Stretch
from labpipe.results.curve_replicates import loading_of, traced
from labpipe.results.kinds import NO_LOADING, Computed, blocked_or, marked_slips
from labpipe.results.reduced_test import ReducedTest, Stiffness
from labpipe.results.stiffness import Window
from labpipe.uncertainty.extractors import Reading, Trace
from labpipe.uncertainty.intervals import Measured


@dataclass(frozen=True, slots=True)
class _TwoLineFit:
    """Two lines of a test, with their uncertainty."""

    first: Measured
    second: Measured
    break_point: Measured
    level: Measured
    hinges: Hinges
    smooth: Segments

    @property
    def measured(self) -> Segments:
        """The lines of the curve itself."""
        return Segments(*(np.asarray(number.value) for number in self._numbers))

    @property
    def drawn(self) -> Segments:
        """The lines of its replicates, around those of the smooth curve."""
        smooth = self.smooth
        base = (smooth.break_point, smooth.first, smooth.second, smooth.level)
        return Segments(*(at + number.off for at, number in zip(base, self._numbers, strict=True)))

    @property
    def _numbers(self) -> tuple[Measured, ...]:
        return self.break_point, self.first, self.second, self.level


@dataclass(frozen=True, slots=True, kw_only=True)
class _TwoLines(Window):
    """A kind of result from two lines through a range of the first loading."""

    @property
    def method(self) -> str:
        """With the range."""
        return f"two segments that meet, {self.in_words}, all breaks tried"

    def fit(self, test: ReducedTest) -> _TwoLineFit | Failure:
        """Fit two lines to the curve of a test.

        Parameters
        ----------
        test : the test
        """
        if not test.cycles:
            return blocked_or(test, NO_LOADING)
        numbers, places = test.measure(self.decide), self._places(traced(test))
        if isinstance(numbers, Failure):
            return numbers
        if isinstance(places, Failure):
            return places
        first, second, at, level = numbers
        return _TwoLineFit(first, second, at, level, places[1], self._smooth(test, numbers))

    def _smooth(self, test: ReducedTest, numbers: tuple[Measured, ...]) -> Segments:
        """Return the lines of the smooth curve, or else those of the curve itself."""
        trace = None if test.replicates is None else test.replicates.smooth
        reading = None if trace is None else self.decide(trace)
        if trace is None or not isinstance(reading, Reading):
            first, second, at, level = (np.asarray(number.value) for number in numbers)
        else:
            first, second, at, level = reading.numbers(trace)
        return Segments(at, first, second, level)

    def decide(self, trace: Trace) -> Reading | Failure:
        """Choose the places at which the lines may meet.

        Parameters
        ----------
        trace : one curve

        Returns
        -------
        A reading of first and second slope, break, and force there.
        """
        places = self._places(trace)
        if isinstance(places, Failure):
            return places
        part, hinges = places

        def numbers(trace: Trace) -> tuple[Floats, ...]:
            segments = hinges.fitted(trace.force[..., part], trace.displacement[..., part])
            return segments.first, segments.second, segments.break_point, segments.level

        return Reading(numbers, len(hinges.scan.d), is_cut=True, feels_corners=True)

    def one_of(self, trace: Trace, *, number: int) -> Reading | Failure:
        """Choose the places for one of the numbers.

        Parameters
        ----------
        trace : one curve
        number : place in the reading of `decide`
        """
        reading = self.decide(trace)
        if isinstance(reading, Failure):
            return reading
        return replace(reading, numbers=lambda trace: (reading.numbers(trace)[number],))

    def _places(self, trace: Trace) -> tuple[slice, Hinges] | Failure:
        """Return the samples of the range, and the places in it."""
        stretch = loading_of(trace)
        window = self.inside(trace.displacement[stretch])
        if isinstance(window, Failure):
            return window
        stop = stretch.stop if window.stop is None else stretch.start + window.stop
        part = slice(stretch.start + window.start, stop)
        hinges = Hinges.of(trace.displacement[part], trace.force[part])
        return hinges if isinstance(hinges, Failure) else (part, hinges)


@dataclass(frozen=True, slots=True, kw_only=True)
class TwoSegments(_TwoLines):
    """``segment_stiffness_first``, ``segment_stiffness_second``, ``break_point``: two lines."""

    result: ClassVar = "two-segments"
    outputs: ClassVar = (
        Output("segment_stiffness_first", "N/m", "Stiffness, first fitted segment"),
        Output("segment_stiffness_second", "N/m", "Stiffness, second fitted segment"),
        Output("break_point", "m", "Break point of the two segments"),
    )

    def compute(self, test: ReducedTest) -> Computed:
        """Fit the best two segments that meet."""
        fit = self.fit(test)
        if isinstance(fit, Failure):
            return self.not_available(fit, self.method)
        straight = why_no_bend(fit.measured, fit.smooth, fit.drawn, fit.hinges)
        if straight is not None:
            return self.not_available(straight, self.method)
        start, stop = read = fit.hinges.ends
        at, during = fit.break_point.value, test.while_loading(*read)
        doubts = marked_slips(test, read)  # one bends both
        one, other = (output.name for output in self.outputs[:2])
        level, first, second = fit.level.value, fit.first.value, fit.second.value
        left = level - first * (at - start)
        wide = why_break_is_doubtful(fit.break_point.interval, fit.hinges)
        all_doubts = (doubts, doubts, doubts if wide is None else (*doubts, wide))
        return Computed(
            tuple(
                self.number(
                    value, self.method, output=place, during=during, doubts=all_doubts[place]
                )
                for place, value in enumerate((fit.first, fit.second, fit.break_point))
            ),
            {
                one: self._side(0, fit.first, during, (max(start, 0.0), at), read),
                other: self._side(1, fit.second, during, (max(at, 0.0), stop), read),
            },
            (
                FittedLine(one, first, left, start, at),
                FittedLine(other, second, level, at, stop),
            ),
        )

    def _side(
        self,
        number: int,
        slope: Measured,
        during: Stretch | None,
        window: tuple[float, float],
        read: tuple[float, float],
    ) -> Stiffness:
        """Return one of the slopes for later entries."""
        return Stiffness(
            partial(self.one_of, number=number), slope.as_estimate, during, window, read
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Kink(_TwoLines):
    """``kink_displacement`` (m) and ``kink_force`` (N): where first loading gets less steep."""

    result: ClassVar = "kink"
    outputs: ClassVar = (
        Output("kink_displacement", "m", "Displacement at the kink"),
        Output("kink_force", "N", "Kink force"),
    )

    def compute(self, test: ReducedTest) -> Computed:
        """Find the decrease of the slope of the first loading."""
        fit = self.fit(test)
        if isinstance(fit, Failure):
            return self.not_available(fit, self.method)
        none = why_no_kink(fit.measured, fit.smooth, fit.drawn, fit.hinges)
        if none is not None:
            return self.not_available(none, self.method)
        start, stop = fit.hinges.ends
        at, level, first = fit.break_point.value, fit.level.value, fit.first.value
        before = level - first * (at - start)
        wide = why_break_is_doubtful(fit.break_point.interval, fit.hinges)
        doubts = (*marked_slips(test, (start, stop)), *([] if wide is None else [wide]))
        during = test.while_loading(start, stop)
        return Computed(
            tuple(
                self.number(value, self.method, output=place, during=during, doubts=doubts)
                for place, value in enumerate((fit.break_point, fit.level))
            ),
            lines=(
                FittedLine("before_kink", first, before, start, at),
                FittedLine("behind_kink", fit.second.value, level, at, stop),
            ),
        )


KINDS = (TwoSegments, Kink)
