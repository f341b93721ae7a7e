"""Measure the failure of a specimen, its final loss of force, and the peak force over its limit.

Displacement and energy are measured in the loading branch in which the specimen fails. The limit is
the smallest force that a standard or the lab allows for a conductor.
"""

from __future__ import annotations

import re
from bisect import bisect
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from math import inf, isclose
from typing import Annotated, Any, ClassVar, TypeAlias

import numpy as np

from labpipe.errors import Fault
from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.curve import Branch, Curve, Direction, Interval
from labpipe.records.declarations import Area, Force, Needs, Output, ShippedCard, WholeNumber
from labpipe.records.estimates import Failure, UnavailableError
from labpipe.records.quality import Reason
from labpipe.records.result import Result, Status
from labpipe.records.signals import Stretch
from labpipe.results import cycles
from labpipe.results.curves import Quantity, SampleNoise, find_finite_samples
from labpipe.results.cycles import WORK_QUANTITIES, CycleKind, PeakForce
from labpipe.results.kinds import FailurePoint, Kind, MeasuredItem, ReducedTest
from labpipe.statistics.lots import FORCE_LIMIT, PEAK_OVER_LIMIT, judge_sample
from labpipe.uncertainty.autocorrelation import estimate_fast_noise
from labpipe.uncertainty.replicates import Extractor, Trace
from labpipe.units import parse_quantity


@dataclass(frozen=True, slots=True)
class LossOfForce:
    """Criteria for the final loss of force at a break.

    Parameters
    ----------
    force_below : fraction of the largest force below which the specimen has failed
    loss : smallest sudden loss, as a fraction of the largest force
    within : s, longest duration of a sudden loss; one sampling step if that is longer
    at_end_below : fraction of the largest force; a record that ends below it ends with the break.
        None if the end of a record does not count as a break
    """

    force_below: float
    loss: float
    within: float
    at_end_below: float | None = None


def find_loss_start(
    time: Floats, force: Floats, criteria: LossOfForce, is_unloading: Flags | None = None
) -> int | Failure:
    """Find the sample at which the final loss of force begins.

    Parameters
    ----------
    time, force : shape (n,), s (or numbers of rows) and N; unfiltered; NaN are ignored
    criteria : criteria for the loss
    is_unloading : shape (n,), whether the sample is in unloading, where a falling force is not a
        loss; None without unloading

    Returns
    -------
    Index of the sample; or a failure: ``no_break`` if the force is not lost, or if it is lost
    slowly or in unloading; ``no_tension`` if the force is never above zero.

    Notes
    -----
    The search begins at the last sample with at least `force_below` of the largest force. It
    continues backwards in time while the force falls by at least `loss` of the largest force within
    the time `within`. A smooth decrease before the loss, such as the necking of a wire, is not part
    of the loss. In a slow recording, the whole loss may lie within one sampling step.
    """
    finite_samples = np.flatnonzero(~np.isnan(force))
    t, f = time[finite_samples], force[finite_samples]
    if not len(f) or not f.max() > 0.0:
        return Failure.of("results.no_tension", largest=float(f.max()) + 0.0 if len(f) else 0.0)
    peak = float(f.max())
    last_above = int(np.flatnonzero(f >= criteria.force_below * peak)[-1])
    if last_above == len(f) - 1:
        facts = {"end": f[-1], "share": f[-1] / peak, "force_below": criteria.force_below}
        return Failure.of("results.no_break", peak=peak, **facts)
    if is_unloading is not None and is_unloading[finite_samples[last_above]]:
        return Failure.of("results.goes_back")
    loss_stop = int(np.searchsorted(t, t[last_above] + criteria.within, side="right"))
    drop = f[last_above] - float(f[last_above + 1 : max(loss_stop, last_above + 2)].min())
    first = _extend_loss_back(t, f, last_above, criteria, peak)
    if first == last_above and drop < criteria.loss * peak:
        facts = {"force_below": criteria.force_below, "peak": peak, "loss": criteria.loss}
        return Failure.of("results.lost_slowly", **facts, within=1e3 * criteria.within)
    return int(finite_samples[first])


def find_slow_loss(displacement: Floats, force: Floats, criteria: LossOfForce) -> int | None:
    """Find the last sample with at least `force_below` of the peak before a slow loss of force.

    Parameters
    ----------
    displacement, force : shape (n,), m, N, positive in the direction of loading; NaN are ignored
    criteria : criteria for the loss

    Returns
    -------
    Index of the sample. None if the force at the end is not below this fraction, or if the motion
    stops or reverses during the loss, as for a specimen that relaxes.
    """
    finite_samples = find_finite_samples(displacement, force)
    d, f = displacement[finite_samples], force[finite_samples]
    last_above = int(find_last_above(f, criteria.force_below))
    if last_above >= len(f) - 1:
        return None
    # The travel increases by at least 1 %, and more than half of its steps are forwards.
    is_longer = d[-1] - d[last_above] >= 0.01 * (d[last_above] - d[0])
    is_forward = (np.diff(d[last_above:]) >= 0.0).mean() > 0.5
    return int(finite_samples[last_above]) if is_longer and is_forward else None


def find_last_above(force: Floats, fraction: float) -> Ints:
    """Find the last sample with at least a fraction of the largest force in each row (..., n)."""
    return cycles.find_last_flagged(force >= fraction * np.max(force, axis=-1, keepdims=True))


def _extend_loss_back(t: Floats, f: Floats, sample: int, criteria: LossOfForce, peak: float) -> int:
    """Find the first sample of a loss, backwards from one of its samples, by its amount or rate."""
    required_loss = criteria.loss * peak
    while sample > 0:
        begin = int(np.searchsorted(t, t[sample] - criteria.within))
        higher_samples = np.flatnonzero(f[begin:sample] - f[sample] >= required_loss)
        step = float(t[sample] - t[sample - 1])
        if len(higher_samples):
            sample = begin + int(higher_samples[-1])
        elif f[sample - 1] - f[sample] >= required_loss * min(1.0, step / criteria.within):
            sample -= 1
        else:
            break
    return sample


def measure_earlier_loss(time: Floats, force: Floats, criteria: LossOfForce) -> float:
    """Measure the largest sudden and permanent loss of force before the failure.

    Parameters
    ----------
    time, force : shape (n,), s and N, up to the start of the final loss; NaN are ignored
    criteria : criteria for the loss

    Returns
    -------
    The loss as a fraction of the largest force; 0 without a loss that meets the criteria.
    """
    is_finite = ~np.isnan(force) & ~np.isnan(time)
    time, force = time[is_finite], force[is_finite]
    peak = float(force.max(initial=0.0))
    end_samples = np.searchsorted(time, time[:-1] + criteria.within, side="right") - 1
    end_samples = np.maximum(end_samples, np.arange(1, len(force)))
    largest_after = np.maximum.accumulate(force[::-1])[::-1][end_samples]
    is_sudden = force[:-1] - force[end_samples] >= criteria.loss * peak
    permanent_losses = (force[:-1] - largest_after)[is_sudden]
    loss_fraction = float(permanent_losses.max(initial=0.0)) / (peak or inf)
    return loss_fraction if loss_fraction >= criteria.loss else 0.0


class FailureResult(Kind):
    """``failure_displacement`` (m) and ``failure_force`` (N), at which the specimen fails."""

    result: ClassVar = "failure"
    outputs: ClassVar = (
        Output("failure_displacement", "m", "Displacement at failure", ("displacement", "force")),
        Output("failure_force", "N", "Force at failure", ("force",), is_raised_by_slips=True),
    )
    needs: ClassVar = Needs(branches=True, correction="failure")

    methods: ClassVar = (
        "first sample of the final loss of force; the interval reaches to the next one",
        "force at the first sample of the final loss",
    )

    def measure(self, test: ReducedTest) -> Iterator[MeasuredItem]:
        """Measure displacement and force at the failure; a slow loss has other methods."""
        (start, stop), doubts = _describe_failure(test)
        numbers = test.measure_numbers(partial(_choose_failure_samples, test))
        methods, slow_loss_limit = self.methods, test.require(test.failure).slow_loss_limit
        if slow_loss_limit is not None:
            sample = f"last sample with {slow_loss_limit:.0%} of the peak, which is lost slowly"
            methods = sample, f"force at the {sample}"
        for output, period in enumerate(((stop, stop), (start, stop))):
            context: dict[str, Any] = {"method": methods[output], "period": period}
            yield self.make_result(test, numbers[output], output=output, doubts=doubts, **context)


def _choose_failure_samples(test: ReducedTest, trace: Trace) -> Extractor:
    """Choose the samples for displacement and force at the failure.

    The specimen fails within one sampling step after the sample of the failure. For a sample that
    has already lost force, it fails in the step before that sample. The force at the failure is
    then that of the previous sample, or larger by up to the usual change of the force in one step.
    """
    sample, failure = test.require(trace.failed_at), test.require(test.failure)
    if failure.slow_loss_limit is not None:
        select = partial(find_last_above, fraction=failure.slow_loss_limit)
        finite_samples = np.flatnonzero(~np.isnan(trace.force))
        return _choose_selected(test, trace, sample, finite_samples, select, is_break=True)
    draw_noise = _make_noise_function(test, trace, sample)
    displacement_step = _measure_next_step(trace, sample)
    force_step = _measure_usual_step(trace.force, sample)
    loss = _measure_loss(test, failure)

    def compute_numbers(trace: Trace) -> tuple[Floats, Floats]:
        displacement = trace.displacement[..., sample] + trace.steps_to_event * displacement_step
        return displacement, trace.force[..., sample] + trace.steps_to_event * force_step

    def compute_with_noise(noisy_trace: Trace) -> tuple[Floats, Floats]:
        displacement, force = compute_numbers(noisy_trace)
        displacement = displacement + draw_noise("displacement", force.shape)
        return displacement, force - loss + draw_noise("force", force.shape)

    return Extractor(compute_numbers, 1, compute_with_noise)


Selector: TypeAlias = Callable[[Floats], Ints]
"""Function of forces, shape (..., n), N, positive in loading, that returns the index of a sample of
each row, shape (...)."""


def _choose_selected(
    test: ReducedTest, trace: Trace, sample: int, samples: Ints, select: Selector, *, is_break: bool
) -> Extractor:
    """Choose displacement and force at the sample that a function selects in each curve.

    Parameters
    ----------
    test, trace : the test, and one of its curves
    sample : sample selected in that curve
    samples : indices of the samples with a force
    select : function that selects one of these samples
    is_break : whether the specimen breaks within one sampling step after the selected sample
    """
    sign = cycles.find_loading_sign(trace, trace.force)
    draw_noise = _make_noise_function(test, trace, sample)

    def compute_numbers(trace: Trace) -> tuple[Floats, ...]:
        displacement, force = trace.displacement[..., samples], trace.force[..., samples]
        index = np.asarray(select(sign * force))[..., np.newaxis]
        step = np.gradient(displacement, axis=-1)
        displacement = displacement + step * trace.steps_to_event * is_break
        return tuple(np.take_along_axis(x, index, axis=-1)[..., 0] for x in (displacement, force))

    def compute_with_noise(noisy_trace: Trace) -> tuple[Floats, ...]:
        noise = draw_noise("force", noisy_trace.force.shape)
        return compute_numbers(replace(noisy_trace, force=noisy_trace.force + noise))

    return Extractor(compute_numbers, 1, compute_with_noise)


def _find_largest(force: Floats) -> Ints:
    """Find the index of the largest force of each row; of several equal ones, the middle index."""
    is_largest = force == np.max(force, axis=-1, keepdims=True)
    return np.asarray((is_largest.argmax(axis=-1) + cycles.find_last_flagged(is_largest)) // 2)


def _make_noise_function(
    test: ReducedTest, trace: Trace, sample: int
) -> Callable[[Quantity, tuple[int, ...]], Floats]:
    """Make a function that draws the noise of a quantity in the loading up to a sample."""
    loading = slice(find_loading_before(trace, sample).start, sample + 1)
    select_noise = cache(partial(SampleNoise.select, test, trace, allowed=loading, centre=sample))

    def draw_noise(quantity: Quantity, shape: tuple[int, ...]) -> Floats:
        noise = select_noise(quantity)
        return np.zeros(shape) if noise is None else noise.draw_deviations(shape)

    return draw_noise


def _measure_usual_step(force: Floats, sample: int) -> float:
    """Measure the median change of the force in the last one to six steps before a sample, N."""
    n_steps = min(max(sample // 8, 1), 6)  # fewer in a short record, whose slope changes quickly
    steps = np.diff(force[:sample][~np.isnan(force[:sample])][-1 - n_steps :])
    return float(np.median(steps)) if len(steps) else 0.0


def _measure_loss(test: ReducedTest, failure: FailurePoint) -> float:
    """Measure the loss of force in the step to a failure, N.

    The loss is counted from the usual change of the force in a step, because the force of a
    specimen that necks also falls in earlier steps. A loss shows that the final loss began in this
    step. The loss is 0 if it is below six standard deviations of the noise, or if fewer than eight
    samples, too few to estimate the noise, precede the failure.
    """
    curve, sample = test.required_curve, failure.sample
    force = curve.force[:sample][~np.isnan(curve.force[:sample])]
    if len(force) < 8:
        return 0.0
    loss = force[-1] + _measure_usual_step(curve.force, sample) - curve.force[sample]
    signed_loss = cycles.find_loading_sign(curve, curve.force) * loss
    return float(loss) if signed_loss > 6.0 * estimate_fast_noise(force) else 0.0


def _measure_next_step(trace: Trace, sample: int) -> float:
    """Measure the change of the displacement in the step after a sample, m; 0 if it decreases."""
    changes = trace.displacement[sample + 1 :] - trace.displacement[sample]
    changes, sign = changes[~np.isnan(changes)], cycles.find_loading_sign(trace, trace.displacement)
    return sign * max(sign * float(changes[0]), 0.0) if len(changes) else 0.0


def _describe_failure(test: ReducedTest) -> tuple[Stretch, tuple[Reason, ...]]:
    """Return the period of the loading up to the failure, s, and the doubts about the failure.

    A failure is doubtful if a part of the force was suddenly lost before it.
    """
    failure, curve = test.require(test.failure), test.required_curve
    start = find_loading_before(curve, failure.sample).start
    doubts = (Reason.of("results.lost_in_steps"),) if failure.earlier_loss else ()
    return (float(curve.time[start]), float(curve.time[failure.sample])), doubts


def find_loading_before(curve: Curve | Trace, sample: int) -> Branch:
    """Find the last loading that begins at or before a sample, or else the first loading."""
    loadings = [branch for branch in curve.branches if branch.direction is Direction.LOADING]
    return ([loading for loading in loadings if loading.start <= sample] or loadings[:1])[-1]


class PeakForceDisplacement(CycleKind):
    """``displacement_at_peak_force.<cycle>`` (m), at the largest force of a cycle."""

    result: ClassVar = "displacement-at-peak-force"
    outputs: ClassVar = (
        Output("displacement_at_peak_force", "m", "Displacement at peak force", first=1),
    )
    n_complete_branches: ClassVar = 1
    branch_range: ClassVar = (0.0, 1.25)
    peak_quantity: ClassVar = "force"
    method: ClassVar = (
        "displacement at the largest force of the cycle, in the sense of loading; between"
        " the first and the last of several equal ones"
    )

    def choose_samples(self, test: ReducedTest, trace: Trace, cycle: int) -> Extractor:
        """Choose the displacement at the largest force.

        With noise, a neighbouring sample may have the largest force. If the specimen breaks there,
        the peak lies within one sampling step after the sample.
        """
        cycle_samples = cycles.find_cycle_samples(trace, cycle)
        d, f = trace.displacement[cycle_samples], trace.force[cycle_samples]
        samples = cycle_samples.start + find_finite_samples(d, f)
        if not len(samples):
            raise UnavailableError.of("results.no_sample")
        displacement, force = (
            cycles.find_loading_sign(trace, values) * values[samples]
            for values in (trace.displacement, trace.force)
        )
        peak = int(_find_largest(force))
        rise = cycles.estimate_rise_beyond_peak(force, displacement)
        is_break, sample = rise > 0.5 * (force[peak] - force[peak - 1]), int(samples[peak])
        extractor = _choose_selected(test, trace, sample, samples, _find_largest, is_break=is_break)
        return replace(extractor, n=len(samples))


class EnergyToBreak(Kind):
    """``energy_to_break`` (J): work done up to the failure."""

    result: ClassVar = "energy-to-break"
    outputs: ClassVar = (
        Output("energy_to_break", "J", "Energy to break", WORK_QUANTITIES, is_raised_by_slips=True),
    )
    needs: ClassVar = Needs(branches=True, correction="failure")

    method: ClassVar = "integral of force up to the failure, trapezoids"

    def measure(self, test: ReducedTest) -> Iterator[MeasuredItem]:
        """Integrate the force up to the failure."""
        period, doubts = _describe_failure(test)
        outcome = test.measure_number(partial(_choose_work_to_break, test))
        yield self.make_result(test, outcome, period=period, doubts=doubts)


def _choose_work_to_break(test: ReducedTest, trace: Trace) -> Extractor:
    """Choose the samples for the work up to the failure."""
    sample = test.require(trace.failed_at)
    loading = slice(find_loading_before(trace, sample).start, sample + 1)
    work = cycles.choose_work_samples(trace, loading)
    displacement_step = _measure_next_step(trace, sample)

    def compute_numbers(trace: Trace) -> tuple[Floats]:
        last_work = trace.steps_to_event * displacement_step * trace.force[..., sample]
        return (np.asarray(work.compute_numbers(trace)[0] + last_work, dtype=np.float64),)

    return Extractor(compute_numbers, work.n)


CONDUCTOR_LABEL = "conductor"
"""Name of the label of a specimen that states the cross-section of its conductor."""
MAX_SECTION_DEVIATION = 0.005
"""Largest relative difference of a stated section, or gauge, from that of its row in a card."""
_AWG = re.compile(r"awg\s*(\d+)|(\d+)\s*awg", re.IGNORECASE)


@dataclass(frozen=True, slots=True, kw_only=True)
class CardRow:
    """Limits for one section of a conductor."""

    awg: Annotated[int, WholeNumber(0, 60), "American wire gauge"]
    section: Area
    limits: Annotated[
        dict[str, Force], "Limits by column; a limit that the source does not give is absent"
    ]

    def __str__(self) -> str:
        return f"AWG {self.awg} ({1e6 * self.section:.4g} mm^2)"


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitCard:
    """Smallest allowed forces by section and column, with the document that states them."""

    source: Annotated[str, "Document that prints the limits"]
    rows: tuple[CardRow, ...]

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns in the order of the rows."""
        return tuple(dict.fromkeys(name for row in self.rows for name in row.limits))


class ForceLimit(Kind):
    """``force_limit`` (N) and ``peak_over_limit`` (1): largest force over the smallest allowed."""

    result: ClassVar = "force-limit"
    outputs: ClassVar = (
        Output(FORCE_LIMIT, "N", "Smallest force allowed", ()),
        Output(PEAK_OVER_LIMIT, "1", "Peak force over its limit", ("force", "observation")),
    )
    methods: ClassVar = "stated by the protocol", "largest force over the smallest force allowed"
    card: Annotated[
        LimitCard | None, ShippedCard(), "A shipped card by its name, or one that is written out"
    ] = None
    column: Annotated[str, "Column of the card"] = ""
    at_least: Annotated[Force | None, "Limit of the lab, in place of a card"] = None
    conductor: Annotated[str, "Section that `at_least` applies to, such as AWG 20"] = ""

    def find_value_faults(self) -> Iterator[Fault]:
        """Find a limit that is missing or stated twice, and a card without a column."""
        if (self.card is None) == (self.at_least is None):
            found = "neither" if self.card is None else "both"
            yield Fault.of("protocol.one_limit", found=found)
        elif self.card is not None and not self.column:
            yield Fault.of("protocol.no_card_column", ("card",))

    def measure(self, test: ReducedTest) -> Iterator[MeasuredItem]:
        """Divide the largest force by the limit for the conductor of the test sheet."""
        limit, section = self._find_limit(test.setup.labels.get(CONDUCTOR_LABEL, ""))
        peak = max(PeakForce().compute_results(test), key=lambda peak: peak.value or -inf)
        doubts = test.collect_doubts(("observation",), None)
        reasons = tuple(dict.fromkeys([*peak.reasons, *doubts]))
        status = Status.DOUBTFUL if doubts and peak.status is Status.OK else peak.status
        ratio = replace(
            peak,
            name=PEAK_OVER_LIMIT,
            value=None if peak.value is None else peak.value / limit,
            unit="1",
            interval=peak.interval
            and Interval(peak.interval.lower / limit, peak.interval.upper / limit),
            status=status,
            reasons=reasons,
            method=self.methods[1],
            estimate=None if peak.estimate is None else peak.estimate / limit,
            budget=tuple(replace(x, change=x.change / limit) for x in peak.budget),
        )
        source = self.methods[0]
        if self.card is not None:
            source = f"column {self.column} of a card: {self.card.source}"
        yield Result(FORCE_LIMIT, limit, "N", method=source, remark=section)
        yield replace(ratio, remark=judge_sample(ratio).text)

    def _find_limit(self, conductor: str) -> tuple[float, str]:
        """Find the limit for a conductor, N, and the section to which it applies."""
        if self.at_least is not None:
            if self.conductor and _parse_section(self.conductor) != _parse_section(conductor):
                sections = {"stated": self.conductor, "found": conductor or "none"}
                raise UnavailableError.of("results.other_section", **sections)
            return self.at_least, self.conductor
        if self.card is None:
            raise UnavailableError.of("results.no_limit_stated")
        row = _find_row(self.card, conductor)
        if self.column not in row.limits:
            facts = {"row": row, "column": self.column, "names": ", ".join(row.limits)}
            raise UnavailableError.of("results.limit_not_given", **facts)
        return row.limits[self.column], str(row)


def _parse_section(conductor: str) -> tuple[str, float]:
    """Parse a section such as ``AWG 20`` or ``0.519 mm^2``: unit (AWG or mm^2) and number."""
    if match := _AWG.fullmatch(conductor.strip()):
        return "AWG", float(match[1] or match[2])
    try:
        return "mm^2", 1e6 * parse_quantity(conductor, "m^2")
    except ValueError as error:
        found = repr(conductor) if conductor else "none"
        raise UnavailableError.of("results.no_conductor", found=found) from error


def _find_row(card: LimitCard, conductor: str) -> CardRow:
    """Find the row of a section; a section between two rows is an error."""
    unit, section = _parse_section(conductor)
    row_by_section = {row.awg if unit == "AWG" else 1e6 * row.section: row for row in card.rows}
    for row_section, row in row_by_section.items():
        if isclose(row_section, section, rel_tol=MAX_SECTION_DEVIATION):
            return row
    sections = sorted(row_by_section)
    index = bisect(sections, section)
    rows = " and ".join(str(row_by_section[x]) for x in sections[max(index - 1, 0) : index + 1])
    raise UnavailableError.of("results.section_not_in_card", conductor=conductor, rows=rows)
