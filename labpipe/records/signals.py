"""Define the signals of a test between recording and curve, and the relations of their clocks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol, TypeAlias

import numpy as np

from labpipe.records.arrays import Floats, Ints
from labpipe.records.causes import CLOCK_DRIFT, CLOCK_OFFSET
from labpipe.records.curve import ClockFit, Time


class FilterFunction(Protocol):
    """Function that filters evenly spaced samples."""

    def __call__(self, values: Floats, /) -> Floats:
        """Filter values of shape (..., n) along the last axis, without a shift in time."""

    def scale_step(self, ratio: float) -> FilterFunction:
        """Return the same filter for a sampling step that is `ratio` times as large."""


Filter: TypeAlias = tuple[FilterFunction, int]
"""Filter, and stride of the samples that are kept after it."""
Stretch: TypeAlias = tuple[float, float]
"""Start and end of a stretch of the record, s."""


@dataclass(frozen=True, slots=True, eq=False)
class Signal:
    """One quantity on its own clock.

    Parameters
    ----------
    time : shape (n,), in `time_unit`, times of the samples
    values : shape (n,), in `unit`, values of the quantity
    unit : SI unit of the values
    clock : name of the clock of `time`
    relative_error : relative standard uncertainty of the scale, from the protocol
    zero_error : standard error of the zero, in `unit`
    zero_drift : standard uncertainty of the change of the zero until the end of the test, as a
        fraction of the largest value, from the protocol
    variants : values of shape (n,), in `unit`, for one input that is larger by its standard
        uncertainty, keyed by the cause of that uncertainty (``grip offset``)
    time_unit : ``s``; ``1`` if the export has no time, and `time` counts its rows
    """

    time: Floats
    values: Floats
    unit: str
    clock: str
    relative_error: float = 0.0
    zero_error: float = 0.0
    zero_drift: float = 0.0
    variants: Mapping[str, Floats] = field(default_factory=dict)
    time_unit: str = "s"

    @property
    def has_time(self) -> bool:
        """Whether the samples have times, not only row numbers."""
        return self.time_unit == "s"

    def map_values(self, change: Callable[[Floats], Floats]) -> Signal:
        """Apply a function to the values and to their variants.

        Parameters
        ----------
        change : function that converts an array of shape (n,) to one of the same shape
        """
        variants = {cause: change(values) for cause, values in self.variants.items()}
        return replace(self, values=change(self.values), variants=variants)


@dataclass(frozen=True, slots=True, eq=False)
class Signals:
    """Signals of one test, with their filters and zeros; all mappings are keyed by signal name.

    Parameters
    ----------
    force, displacement : names of the signals of the curve
    raw : calibrated and zeroed signals, without smoothing
    filtered : signals after all steps; those of the curve are later smoothed branch by branch
    filters : filters of each signal, in the order of the steps; `raw` is later filtered again in
        pieces between its corners
    zero_stretches : stretch at rest whose mean is the zero, s on the clock of the signal
    moving_zero_stretches : stretch of a zero in which the machine may already move, s on the clock
        of the signal
    subtracted_levels : level that was subtracted as the zero, in the unit of the signal
    """

    force: str = "force"
    displacement: str = "displacement"
    raw: Mapping[str, Signal] = field(default_factory=dict)
    filtered: Mapping[str, Signal] = field(default_factory=dict)
    filters: Mapping[str, tuple[Filter, ...]] = field(default_factory=dict)
    zero_stretches: Mapping[str, Stretch] = field(default_factory=dict)
    moving_zero_stretches: Mapping[str, Stretch] = field(default_factory=dict)
    subtracted_levels: Mapping[str, float] = field(default_factory=dict)

    @property
    def quantities(self) -> dict[str, str]:
        """Quantity of each of the two signals of the curve, keyed by signal name."""
        return {self.force: "force", self.displacement: "displacement"}

    def is_zeroed(self, name: str) -> bool:
        """Return whether a step has subtracted the zero of a signal."""
        return name in {*self.zero_stretches, *self.moving_zero_stretches}

    def add_signal(self, name: str, signal: Signal) -> Signals:
        """Return the signals with a signal added or replaced, both raw and filtered."""
        raw, filtered = {**self.raw, name: signal}, {**self.filtered, name: signal}
        return replace(self, raw=raw, filtered=filtered)

    def replace_filtered(self, name: str, signal: Signal, *filter_steps: Filter) -> Signals:
        """Return the signals with a filtered signal replaced, and filters added to its list.

        Parameters
        ----------
        name, signal : name of the signal, and its filtered values
        filter_steps : filters that were applied in addition to the earlier ones
        """
        filters = {**self.filters, name: (*self.filters.get(name, ()), *filter_steps)}
        filtered = {**self.filtered, name: signal}
        return replace(self, filtered=filtered, filters=filters if filter_steps else self.filters)

    def subtract_level(self, name: str, level: float, error: float) -> Signals:
        """Return the signals with a level subtracted from a signal, both raw and filtered.

        Parameters
        ----------
        name : name of the signal
        level : level to subtract, in the unit of the signal
        error : standard error of the level, which becomes the error of the zero, in the same unit
        """

        def subtract(signal: Signal) -> Signal:
            return replace(signal.map_values(lambda values: values - level), zero_error=error)

        raw, filtered = self.raw[name], self.filtered[name]
        zeroed = subtract(raw)
        levels = {**self.subtracted_levels, name: self.subtracted_levels.get(name, 0.0) + level}
        return replace(
            self,
            raw={**self.raw, name: zeroed},
            filtered={**self.filtered, name: zeroed if filtered is raw else subtract(filtered)},
            subtracted_levels=levels,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Clocks:
    """Relations between the clocks of a test.

    Parameters
    ----------
    curve_clock : name of the clock of the curve, which is that of the displacement
    force_fit : relation of the clock of the force to that of the curve; None for one clock, or
        before the clocks are joined
    other_fits : relation of each further clock to that of the curve, keyed by the name of the
        clock: time on this clock = offset + (1 + drift) x time of the curve
    """

    curve_clock: str = ""
    force_fit: ClockFit | None = None
    other_fits: Mapping[str, ClockFit] = field(default_factory=dict)

    @property
    def offset_error(self) -> float:
        """Standard error of the offset between force and motion, s; 0 for one clock."""
        if self.force_fit is None:
            return 0.0
        return float(np.sqrt(1.0 / np.sum(self.force_fit.event_errors**-2.0)))

    @property
    def drift_error(self) -> float:
        """Standard error of the clock drift; 0 for one clock or one event.

        The interval of the drift is NaN for one event, which does not determine the drift.
        """
        error = 0.0 if self.force_fit is None else self.force_fit.drift_interval.standard_error
        return error if np.isfinite(error) else 0.0

    @property
    def mean_event_time(self) -> float:
        """Weighted mean time of the fitted events, s on the clock of the curve; 0 for one clock.

        The errors of offset and drift are independent at this time.
        """
        fit = self.force_fit
        if fit is None:
            return 0.0
        return float(np.average(fit.event_times_motion, weights=fit.event_errors**-2.0))

    @property
    def variants(self) -> dict[str, Clocks]:
        """Clocks with an offset or drift that is larger by its standard error, keyed by cause.

        The offset shifts all times of the force by `offset_error`. The drift stretches them by
        `drift_error` about `mean_event_time`.
        """
        fit = self.force_fit
        if fit is None:
            return {}
        shifted_fit = replace(fit, offset=fit.offset + self.offset_error)
        variants = {CLOCK_OFFSET: replace(self, force_fit=shifted_fit)}
        if drift_error := self.drift_error:
            offset = fit.offset - drift_error * self.mean_event_time
            stretched_fit = replace(fit, offset=offset, drift=fit.drift + drift_error)
            variants[CLOCK_DRIFT] = replace(self, force_fit=stretched_fit)
        return variants

    def to_curve(self, time: Time, clock: str) -> Time:
        """Convert times to the clock of the curve, s; unchanged before clocks are joined.

        Parameters
        ----------
        time, clock : times, s, and the name of their clock
        """
        fit = self._find_fit(clock)
        return time if fit is None else fit.to_marker_time(time)

    def from_curve(self, time: Time, clock: str) -> Time:
        """Convert times of the curve to another clock, s; unchanged before clocks are joined.

        Parameters
        ----------
        time, clock : times on the clock of the curve, s, and the name of the other clock
        """
        fit = self._find_fit(clock)
        return time if fit is None else fit.to_force_time(time)

    def interpolate(self, signal: Signal, time: Floats) -> Floats:
        """Interpolate a signal at times on the clock of the curve.

        Parameters
        ----------
        signal : signal on any clock
        time : shape (n,), s, times on the clock of the curve

        Returns
        -------
        Shape (n,), in the unit of the signal; NaN outside the times of its samples.
        """
        signal_time = self.from_curve(time, signal.clock)
        if len(time) == len(signal.time) and np.array_equal(signal_time, signal.time):
            return signal.values
        # `interp` copies its arrays; only the samples next to these times are passed to it.
        stops = np.searchsorted(signal.time, signal_time, side="right")
        indices: Ints = np.sort(np.clip([stops - 1, stops], 0, len(signal.time) - 1), axis=None)
        if not len(indices):  # `interp` refuses an empty record
            return np.zeros(0)
        times, values = signal.time[indices], signal.values[indices]
        return np.interp(signal_time, times, values, left=np.nan, right=np.nan)

    def to_force_times(self, time: Floats) -> Floats:
        """Convert times of the curve to the clock of the force, shape (n,), s."""
        return time if self.force_fit is None else self.force_fit.to_force_time(time)

    def _find_fit(self, clock: str) -> ClockFit | None:
        """Find the relation of a clock to that of the curve; None for the clock of the curve."""
        is_curve_clock = clock in ("", self.curve_clock)
        return None if is_curve_clock else self.other_fits.get(clock, self.force_fit)
