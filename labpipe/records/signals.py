"""Define the signals of a test between recording and curve, and the relation of their clocks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol, TypeAlias

import numpy as np

from labpipe.records.arrays import Floats, Ints
from labpipe.records.causes import CLOCK_DRIFT, CLOCK_OFFSET
from labpipe.records.curve import ClockFit, Time


class FilterFunction(Protocol):
    """A filter of evenly spaced samples."""

    def __call__(self, values: Floats, /) -> Floats:
        """Filter along the last axis: shape (..., n), without a shift in time."""

    def scale_step(self, ratio: float) -> FilterFunction:
        """Return the same filter for a sampling step `ratio` times as large."""


Filter: TypeAlias = tuple[FilterFunction, int]
"""A filter, and the stride of the samples that it keeps."""
Stretch: TypeAlias = tuple[float, float]
"""Start and end, s."""


@dataclass(frozen=True, slots=True, eq=False)
class Signal:
    """One quantity on its own clock.

    Parameters
    ----------
    time, values : shape (n,), s and `unit`
    unit : SI
    clock : name of the clock of `time`
    relative_error : relative standard uncertainty of the scale, from the protocol
    zero_error : standard error of the zero, in `unit`
    zero_drift : standard uncertainty of the change of the zero until the end of the test, as a
        share of the largest value, from the protocol
    perturbed : by cause (``grip offset``, ``shape of the wire``), shape (n,), in `unit`: the signal
        with only this input one standard uncertainty larger
    time_unit : ``s``; ``1`` where the export has no time and `time` counts its rows
    """

    time: Floats
    values: Floats
    unit: str
    clock: str
    relative_error: float = 0.0
    zero_error: float = 0.0
    zero_drift: float = 0.0
    perturbed: Mapping[str, Floats] = field(default_factory=dict)
    time_unit: str = "s"

    @property
    def has_time(self) -> bool:
        """Return whether the samples have times, not only row numbers."""
        return self.time_unit == "s"

    def map_values(self, change: Callable[[Floats], Floats]) -> Signal:
        """Apply a function to the values and to the perturbed values.

        Parameters
        ----------
        change : returns an array of the same shape
        """
        perturbed = {cause: change(values) for cause, values in self.perturbed.items()}
        return replace(self, values=change(self.values), perturbed=perturbed)


@dataclass(frozen=True, slots=True, eq=False)
class Signals:
    """The signals of one test by name, with their filters and zeros.

    Parameters
    ----------
    force, displacement : names of the signals of the curve
    raw : signals by name, calibrated and zeroed but not smoothed
    filtered : signals by name, after all steps; those of the curve are later smoothed by branches
    filters : filters of the steps by name; `raw` is filtered again in pieces between its corners
    zero_stretches : stretch at rest of each zero, s on the clock of the signal, by name
    moving_zero_stretches : as `zero_stretches`, for zeros in which the machine may already move
    subtracted_levels : level of each zero in the export, in SI, by name
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
        """Return the quantities of the two signals of the curve, by name."""
        return {self.force: "force", self.displacement: "displacement"}

    def add_signal(self, name: str, signal: Signal) -> Signals:
        """Add or replace a signal, both raw and filtered."""
        raw, filtered = {**self.raw, name: signal}, {**self.filtered, name: signal}
        return replace(self, raw=raw, filtered=filtered)

    def with_filtered(self, name: str, signal: Signal, *filter_steps: Filter) -> Signals:
        """Replace a filtered signal, and add filters to its list.

        Parameters
        ----------
        name, signal : name of the signal, and its filtered values
        filter_steps : filters that were applied in addition to the earlier ones
        """
        filters = {**self.filters, name: (*self.filters.get(name, ()), *filter_steps)}
        return replace(
            self,
            filtered={**self.filtered, name: signal},
            filters=filters if filter_steps else self.filters,
        )

    def subtract_level(self, name: str, level: float, error: float) -> Signals:
        """Subtract a level from a signal, both raw and filtered.

        Parameters
        ----------
        name : name of the signal
        level, error : level in its unit, and standard error, which becomes that of its zero
        """

        def subtract(signal: Signal) -> Signal:
            return replace(signal.map_values(lambda values: values - level), zero_error=error)

        raw, filtered = self.raw[name], self.filtered[name]
        zeroed = subtract(raw)
        return replace(
            self,
            raw={**self.raw, name: zeroed},
            filtered={**self.filtered, name: zeroed if filtered is raw else subtract(filtered)},
            subtracted_levels={
                **self.subtracted_levels,
                name: self.subtracted_levels.get(name, 0.0) + level,
            },
        )


@dataclass(frozen=True, slots=True, eq=False)
class Clocks:
    """The relation of the clocks of a test.

    Parameters
    ----------
    curve : name of the clock of the curve, which is that of the displacement
    force : fit of the clock of the force to it; None for one clock, or before they are joined
    others : fits of further clocks by name: their time = offset + (1 + drift) x time of the curve
    """

    curve: str = ""
    force: ClockFit | None = None
    others: Mapping[str, ClockFit] = field(default_factory=dict)

    @property
    def error(self) -> float:
        """Return the standard error of the offset between force and motion, s; 0 for one clock."""
        if self.force is None:
            return 0.0
        return float(np.sqrt(1.0 / np.sum(self.force.event_errors**-2.0)))

    @property
    def drift_error(self) -> float:
        """Return the standard error of the clock drift; 0 for one clock or one event.

        One event does not determine the drift: the interval of the fit is then NaN.
        """
        error = 0.0 if self.force is None else self.force.drift_interval.standard_error
        return error if np.isfinite(error) else 0.0

    @property
    def middle(self) -> float:
        """Return the weighted mean time of the events of the fit, s on the clock of the curve.

        With the weights of the fit, the errors of offset and drift about it are independent. 0 for
        one clock.
        """
        fit = self.force
        if fit is None:
            return 0.0
        return float(np.average(fit.event_times_motion, weights=fit.event_errors**-2.0))

    @property
    def perturbed(self) -> dict[str, Clocks]:
        """Return the clocks with one input a standard uncertainty larger, by cause.

        The offset shifts all times of the force by `error`; the drift stretches them by
        `drift_error` about the `middle` of the events.
        """
        fit = self.force
        if fit is None:
            return {}
        shifted = replace(fit, offset=fit.offset + self.error)
        variants = {CLOCK_OFFSET: replace(self, force=shifted)}
        if drift_error := self.drift_error:
            drifted = replace(
                fit, offset=fit.offset - drift_error * self.middle, drift=fit.drift + drift_error
            )
            variants[CLOCK_DRIFT] = replace(self, force=drifted)
        return variants

    def to_curve(self, time: Time, clock: str) -> Time:
        """Convert times of a clock to that of the curve; unchanged before they are joined."""
        fit = self._fit(clock)
        return time if fit is None else fit.to_marker_time(time)

    def from_curve(self, time: Time, clock: str) -> Time:
        """Convert times of the curve to another clock; unchanged before they are joined."""
        fit = self._fit(clock)
        return time if fit is None else fit.to_force_time(time)

    def interpolate(self, signal: Signal, time: Floats) -> Floats:
        """Interpolate a signal at times of the curve's clock.

        Parameters
        ----------
        signal : on any clock
        time : shape (n,), s, on the clock of the curve

        Returns
        -------
        Shape (n,), in the unit of the signal; NaN beyond its ends.
        """
        time = self.from_curve(time, signal.clock)
        if len(time) == len(signal.time) and np.array_equal(time, signal.time):
            return signal.values
        # Of a long signal, only the neighbours of these times: `interp` copies its arrays.
        right = np.searchsorted(signal.time, time, side="right")
        used: Ints = np.sort(np.clip([right - 1, right], 0, len(signal.time) - 1), axis=None)
        if not len(used):  # `interp` refuses an empty record
            return np.zeros(0)
        return np.interp(time, signal.time[used], signal.values[used], left=np.nan, right=np.nan)

    def to_force_times(self, time: Floats) -> Floats:
        """Convert times of the curve to the clock of the force, shape (n,), s."""
        return time if self.force is None else self.force.to_force_time(time)

    def _fit(self, clock: str) -> ClockFit | None:
        return None if clock in ("", self.curve) else self.others.get(clock, self.force)
