"""Define what a kind of result is: its settings, outputs and needs, and how it is measured.

A kind of result is a frozen dataclass: its fields are the settings of its entry in a protocol, its
class variables are its name, outputs and needs, and `measure` returns the numbers of a test.
Grammar, cross-checks, JSON Schema, descriptions and the reference page derive from the list
`labpipe.results.KINDS`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, TypeAlias

import numpy as np

from labpipe.records.causes import FIT, SCALE_OF_FORCE, make_contribution
from labpipe.records.curve import FittedLine, Interval, SlipDecision
from labpipe.records.declarations import Needs, Output
from labpipe.records.estimates import Estimate, Failure, UnavailableError, add_errors
from labpipe.records.quality import Finding, Reason
from labpipe.records.result import Contribution, Result, Status
from labpipe.records.signals import Stretch
from labpipe.results.reduced_test import ReducedTest, Stiffness
from labpipe.uncertainty.intervals import Measured

Outcome: TypeAlias = Measured | Estimate | Failure
Errors: TypeAlias = Mapping[str, float]
"""Standard errors from outside the fit, in the unit of the number, by cause."""


@dataclass(frozen=True, slots=True)
class Computed:
    """Results of one entry of a protocol.

    Parameters
    ----------
    results : in the order of the summary
    stiffnesses : by name, for later entries
    lines : straight lines of the stiffnesses
    findings : notes on the test
    """

    results: tuple[Result, ...]
    stiffnesses: Mapping[str, Stiffness] = field(default_factory=dict)
    lines: tuple[FittedLine, ...] = ()
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind(ABC):
    """A kind of result; its fields are the settings of an entry in a protocol.

    ``method`` describes how the outputs are measured, ``methods`` each of them if they differ. It
    may have settings as fields; ``over_mm`` is the setting ``over`` in millimetres.
    """

    result: ClassVar[str]
    outputs: ClassVar[tuple[Output, ...]]
    needs: ClassVar[Needs] = Needs(branches=True)
    method: ClassVar[str] = ""
    methods: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def measure(self, test: ReducedTest) -> Computed:
        """Measure the numbers of a test.

        Parameters
        ----------
        test : the test, with the stiffnesses of earlier entries

        Raises
        ------
        UnavailableError
            If the test has none of the outputs.
        """

    def list_methods(self, test: ReducedTest) -> tuple[str, ...]:
        """Return the method of each output."""
        del test
        return self.methods or (self.method,) * len(self.outputs)

    def compute(self, test: ReducedTest) -> Computed:
        """Measure the numbers of a test, or return all outputs as not available.

        Parameters
        ----------
        test : the test, with the stiffnesses of earlier entries
        """
        try:
            return self.measure(test)
        except UnavailableError as error:
            parts = ["" if output.first is None else f".{output.first}" for output in self.outputs]
            return Computed(
                tuple(
                    self.make_result(test, error.failure, output=place, part=part)
                    for place, part in enumerate(parts)
                )
            )

    def make_results(
        self, test: ReducedTest, outcomes: Iterable[Outcome], *, first: int = 0, **common: Any
    ) -> tuple[Result, ...]:
        """Make the results of several outputs in order, from the `first`, as `make_result`."""
        return tuple(
            self.make_result(test, outcome, output=place, **common)
            for place, outcome in enumerate(outcomes, start=first)
        )

    def make_result(
        self,
        test: ReducedTest,
        outcome: Outcome,
        errors: Errors | None = None,
        *,
        output: int = 0,
        method: str = "",
        during: Stretch | None = None,
        doubts: tuple[Reason, ...] = (),
        part: str = "",
        remark: str = "",
    ) -> Result:
        """Make the result of one output: name, interval, status and reasons.

        Parameters
        ----------
        test : with its doubts
        outcome : the value with the standard error of its fit, or why it is not available; one
            without an interval gets the normal one
        errors : further standard errors
        output : place in `outputs`; settings are filled into its name
        method : by default that of `Kind.list_methods`
        during : s, on the clock of the curve, the interval that it was read from; None for all
        doubts : further reasons to doubt it
        part : of the name, such as ``.1``
        remark : on the number of this test
        """
        settings = {field.name: getattr(self, field.name) for field in fields(self)}
        lengths = {f"{name}_mm": 1e3 * x for name, x in settings.items() if isinstance(x, float)}
        declared = self.outputs[output]
        name, made_of = declared.name.format_map(settings) + part, settings.get("of", "")
        method = method or self.list_methods(test)[output].format_map(settings | lengths)
        outcome, budget = _widen_estimate(outcome, errors or {})
        if isinstance(outcome, Failure):
            found_doubts = test.collect_doubts((*declared.rests_on, *_SIGN_QUANTITIES), during)
            why = [doubt for doubt in found_doubts if doubt.code in _CURVE_ERRORS]
            reasons_in_order = (
                [*why, outcome] if outcome.code in _EXPLAINED_FAILURES else [outcome, *why]
            )
            reasons, failed = tuple(dict.fromkeys(reasons_in_order)), Status.FAILED
            return Result(name, None, declared.unit, None, failed, reasons, method, made_of=made_of)
        signs = {"N": _SIGN_QUANTITIES[:1], "m": _SIGN_QUANTITIES[1:]}.get(declared.unit, ())
        own_doubts = outcome.doubts if isinstance(outcome, Measured) else ()
        own = [reason for quantity, reason in own_doubts if quantity in ("", *declared.rests_on)]
        found_doubts = test.collect_doubts((*declared.rests_on, *signs), during)
        reasons = tuple(dict.fromkeys([*found_doubts, *doubts, *own]))
        drops = [slip.drop for slip in test.slips if slip.decision is SlipDecision.REPAIRED]
        added = f"{sum(drops):.3g} N of slips added back"
        remarks = remark, added if drops and declared.is_raised_by_slips else ""
        return Result(
            name,
            value=outcome.value,
            unit=declared.unit,
            interval=outcome.interval or Interval.normal_95(outcome.value, outcome.error),
            status=Status.DOUBTFUL if reasons else Status.OK,
            reasons=reasons,
            method=method,
            n=outcome.n,
            made_of=made_of,
            remark="; ".join(filter(None, remarks)),
            estimate=outcome.estimate if isinstance(outcome, Measured) else None,
            budget=budget,
        )


def compute_scale_error(test: ReducedTest, outcome: Outcome) -> Errors:
    """Return the error from the scale of the force, for a number proportional to the force."""
    if isinstance(outcome, Failure):
        return {}
    return {SCALE_OF_FORCE: test.raw_force.relative_error * abs(outcome.value)}


_SIGN_QUANTITIES: tuple[str, ...] = ("force_sign", "displacement_sign")
"""Quantities of doubts about signs: the first for numbers in newtons, the second in metres."""
_CURVE_ERRORS = frozenset(
    ["frozen_channel", "saturation", "force_reversed", "displacement_reversed", "begins_under_load"]
)
"""Codes of doubts that may explain a failure, because the curve itself is wrong."""
_EXPLAINED_FAILURES = frozenset({"not_reached", "no_travel"})
"""Codes of failures that such a doubt explains, so that the doubt is listed first."""


def _widen_estimate(outcome: Outcome, errors: Errors) -> tuple[Outcome, tuple[Contribution, ...]]:
    """Add errors to an estimate; return it with its budget, or a failure if it is not finite."""
    budget = outcome.budget if isinstance(outcome, Measured) else ()
    if isinstance(outcome, Estimate):
        fit = outcome.error if outcome.interval is None else outcome.interval.standard_error
        changes = {FIT: fit, **errors}
        if np.isfinite(list(changes.values())).all():
            budget = tuple(make_contribution(*change) for change in changes.items() if change[1])
        outcome = add_errors(outcome, *errors.values())
    if not isinstance(outcome, Failure) and not np.isfinite([outcome.value, outcome.error]).all():
        reason = Failure.of("results.not_finite", value=outcome.value, error=outcome.error)
        return reason, ()
    return outcome, budget


def find_marked_slips(test: ReducedTest, stretch: tuple[float, float] | None) -> tuple[Reason, ...]:
    """Return a doubt if a stretch has a slip that was only marked.

    Parameters
    ----------
    test : with its slip ledger
    stretch : m, its ends; None if slips have no effect
    """
    marked = [slip for slip in test.slips if slip.decision is SlipDecision.MARKED]
    inside = [slip for slip in marked if stretch and stretch[0] <= slip.position <= stretch[1]]
    if not inside:
        return ()
    places = ", ".join(f"{1e3 * slip.position:.4g} mm" for slip in inside)
    return (Reason.of("results.slip_in_window", places=places),)


def find_machine_compliance(test: ReducedTest, stiffness: float) -> tuple[Reason, ...]:
    """Return a doubt if the displacement may be that of frame and grips.

    Parameters
    ----------
    test : with the limits of the lab
    stiffness : N/m
    """
    limits = test.setup.limits
    share = limits.machine_compliance * stiffness
    if test.setup.compliance_stated or not share > limits.machine_share:
        return ()
    usual = 1e6 * limits.machine_compliance
    return (Reason.of("results.machine_compliance", usual=usual, share=share),)


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockResult(Kind):
    """``clock_offset`` (s), ``clock_drift`` (1): clock of the force against that of the motion."""

    result: ClassVar = "clock"
    outputs: ClassVar = (
        Output("clock_offset", "s", "Offset of the clocks", ("clock",), can_be_negative=True),
        Output("clock_drift", "1", "Drift of the clocks", ("clock",), can_be_negative=True),
    )
    needs: ClassVar = Needs(clocks=True)
    method: ClassVar = "method by which the clocks of force and motion were joined"

    def measure(self, test: ReducedTest) -> Computed:
        """Return offset and drift of force time against marker time."""
        fit = test.clocks.force
        if fit is None:
            raise test.make_error(Failure.of("results.one_clock"))
        events = len(fit.event_times_motion)
        offset = Estimate(fit.offset, fit.offset_interval.standard_error, events)
        drift: Outcome = Estimate(fit.drift, fit.drift_interval.standard_error, events)
        if np.isnan(fit.drift_interval.lower):
            drift = Failure.of("results.one_event")
        return Computed(self.make_results(test, (offset, drift), method=fit.method))
