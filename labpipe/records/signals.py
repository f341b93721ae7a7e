"""Signals on their way from a recording to a curve, and the clocks of a test."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol, TypeAlias

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.causes import CLOCK_DRIFT, CLOCK_OFFSET
from labpipe.records.curve import ClockFit, Time


class FilterFunction(Protocol):
    """What a filter does to evenly spaced samples."""

    def __call__(self, values: Floats, /) -> Floats:
        """Filter along the last axis: shape (..., n), no shift in time."""

    def coarser(self, ratio: float) -> FilterFunction:
        """Make the same filter for samples `ratio` times as far apart."""


Filter: TypeAlias = tuple[FilterFunction, int]
"""What a filter does to evenly spaced samples, and every how many-th of them it keeps."""
Stretch: TypeAlias = tuple[float, float]
"""Begin and end, s."""


@dataclass(frozen=True, slots=True, eq=False)
class Signal:
    """One quantity on its own clock.

    Parameters
    ----------
    time, values : shape (n,), s and `unit`
    unit : SI
    clock : name of the clock that `time` belongs to
    relative_error : standard uncertainty of the scale, from the protocol
    zero_error : standard error of the zero, in `unit`
    zero_drift : standard uncertainty of how far the zero has moved by the end of the test, as a
        share of the largest value, from the protocol
    perturbed : by cause (``grip offset``, ``shape of the wire``), shape (n,): the signal as it is
        with that input one standard uncertainty higher, and all others as they are taken
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
        """Return whether the samples have times, not just numbers."""
        return self.time_unit == "s"

    def map_values(self, change: Callable[[Floats], Floats]) -> Signal:
        """Do the same to the values and to all that they may have been.

        Parameters
        ----------
        change : gives as many samples of everything
        """
        moved = {cause: change(values) for cause, values in self.perturbed.items()}
        return replace(self, values=change(self.values), perturbed=moved)


@dataclass(frozen=True, slots=True, eq=False)
class Signals:
    """The signals of one test by name, and what was done to them.

    Parameters
    ----------
    force, displacement : names of the signals that make the curve
    raw : calibrated and zeroed but not smoothed
    filtered : the same after all steps
    filters : what the steps did to a signal; done again piece by piece where its corners are
    zero_stretches : the stretch (s, on its own clock) at rest that the zero of a signal was taken
        from
    moving_zero_stretches : as `zero_stretches`, a stretch in which the machine may have moved
        already
    subtracted_levels : the level that the zero of a signal is at in the export, in SI
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
        """Return what the two signals of the curve are, by name."""
        return {self.force: "force", self.displacement: "displacement"}

    def add_signal(self, name: str, signal: Signal) -> Signals:
        """Add a signal, or replace it, with all that was filtered of it."""
        return replace(
            self, raw={**self.raw, name: signal}, filtered={**self.filtered, name: signal}
        )

    def with_filtered(self, name: str, signal: Signal, *filter_steps: Filter) -> Signals:
        """Replace what was filtered of a signal.

        Parameters
        ----------
        name, signal : of it
        made : the filter that did it, if it is one more
        """
        filters = {**self.filters, name: (*self.filters.get(name, ()), *filter_steps)}
        return replace(
            self,
            filtered={**self.filtered, name: signal},
            filters=filters if filter_steps else self.filters,
        )

    def subtract_level(self, name: str, level: float, error: float) -> Signals:
        """Take a level off a signal, raw and filtered.

        Parameters
        ----------
        name : of the signal
        level, error : in its unit; the standard error becomes that of its zero
        """

        def less(signal: Signal) -> Signal:
            return replace(signal.map_values(lambda values: values - level), zero_error=error)

        raw, filtered = self.raw[name], self.filtered[name]
        zeroed = less(raw)
        return replace(
            self,
            raw={**self.raw, name: zeroed},
            filtered={**self.filtered, name: zeroed if filtered is raw else less(filtered)},
            subtracted_levels={
                **self.subtracted_levels,
                name: self.subtracted_levels.get(name, 0.0) + level,
            },
        )


@dataclass(frozen=True, slots=True, eq=False)
class Clocks:
    """How the clocks of a test lie to each other.

    Parameters
    ----------
    curve : name of the clock of the curve, which is that of the displacement
    force : the clock of the force against it; None while they are not joined, or are one
    others : by name, a third clock against that of the curve: its time = offset + (1 + drift) x
        time of the curve
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

        One event gives no drift, and the fit says NaN of its interval.
        """
        error = 0.0 if self.force is None else self.force.drift_interval.standard_error
        return error if np.isfinite(error) else 0.0

    @property
    def middle(self) -> float:
        """Return the mean time of the joining events, s on the clock of the curve.

        Weighted as they weigh in the fit, so that the errors of offset and drift about it are
        independent; 0 for one clock.
        """
        fit = self.force
        if fit is None:
            return 0.0
        return float(np.average(fit.event_times_motion, weights=fit.event_errors**-2.0))

    @property
    def perturbed(self) -> dict[str, Clocks]:
        """Return the clocks with one input a standard uncertainty higher, by cause.

        The offset moves all times of the force by `error`; the drift turns them by `drift_error`
        about the `middle` of the events.
        """
        fit = self.force
        if fit is None:
            return {}
        later = replace(fit, offset=fit.offset + self.error)
        variants = {CLOCK_OFFSET: replace(self, force=later)}
        if turn := self.drift_error:
            faster = replace(fit, offset=fit.offset - turn * self.middle, drift=fit.drift + turn)
            variants[CLOCK_DRIFT] = replace(self, force=faster)
        return variants

    def to_curve(self, time: Time, clock: str) -> Time:
        """Return times of a clock on that of the curve; as they are while they are not joined."""
        fit = self._fit(clock)
        return time if fit is None else fit.to_marker_time(time)

    def from_curve(self, time: Time, clock: str) -> Time:
        """Return times of the curve on another clock; as they are while they are not joined."""
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
        Shape (n,), in the unit of the signal; NaN beyond its ends, nothing is extrapolated.
        """
        time = self.from_curve(time, signal.clock)
        if len(time) == len(signal.time) and np.array_equal(time, signal.time):
            return signal.values
        return np.interp(time, signal.time, signal.values, left=np.nan, right=np.nan)

    def to_force_times(self, time: Floats) -> Floats:
        """Return the times of the clock of the force at times of the curve, shape (n,), s."""
        return time if self.force is None else self.force.to_force_time(time)

    def _fit(self, clock: str) -> ClockFit | None:
        return None if clock in ("", self.curve) else self.others.get(clock, self.force)
