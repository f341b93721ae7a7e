"""From a number, or the reason why there is none, to a result with its status."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from labpipe.pipeline.bench import Bench
from labpipe.records.curve import Interval, SlipDecision
from labpipe.records.estimates import Estimate, Failure, widened
from labpipe.records.quality import Reason
from labpipe.records.result import Result, Status

CURVE = ("force", "displacement", "clock")
"""What a number rests on that is read from the curve."""
NO_BRANCH = Failure("no_cycle", "the motion has no loading branch")


@dataclass(frozen=True, slots=True)
class Asked:
    """What is said of a result whether or not it can be had.

    Parameters
    ----------
    name, unit, method : of the result
    quantities : that it rests on; what is doubtful of one of them makes the result doubtful
    needs : branches of a cycle that must have been recorded to their end
    reads : what of a cycle it is read from, from and to, counted in branches: 0.9 is when nine
        tenths of the loading are over, 1 its end, 2 the end of unloading
    made_of : name of the result that it is made of; empty for none
    """

    name: str
    unit: str
    quantities: tuple[str, ...]
    method: str
    needs: int = 0
    reads: tuple[float, float] = (0.0, 2.0)
    made_of: str = ""


_TO_THE_TOP = frozenset({"peak_force", "failure_force", "energy", "energy_to_break"})
"""Numbers that a repaired slip anywhere on the way has raised."""


_BOTH_SIGNS: tuple[str, ...] = ("force_sign", "displacement_sign")
_SIGNED = {"N": _BOTH_SIGNS[:1], "m": _BOTH_SIGNS[1:]}
"""What more a number rests on that changes its sign when force and displacement both do."""
_MAY_BE_WHY = frozenset(
    {
        *("frozen_channel", "saturation", "force_reversed", "displacement_reversed"),
        "begins_under_load",
    }
)
"""Doubts that may well be why there is no number: the curve itself is wrong."""
_CUT_SHORT = frozenset({"not_reached", "no_travel"})
"""Failures that such a doubt explains: it comes first."""


def blocked_or(bench: Bench, otherwise: Failure) -> Failure:
    """Why no number can be had: what stopped the test, or else what is given."""
    return bench.blocked or otherwise


def to_result(
    bench: Bench,
    asked: Asked,
    outcome: Estimate | Failure,
    *,
    part: str = "",
    doubts: Iterable[Reason | None] = (),
    during: tuple[float, float] | None = None,
) -> Result:
    """Word an outcome as a result, with what makes it doubtful.

    Parameters
    ----------
    bench : knows the doubts
    asked : what was asked for
    outcome : the number with its error, or why there is none; without an interval of its own it
        gets the normal one
    part : of the name, such as ``.1``
    doubts : more reasons to doubt it; None where there is none
    during : s, on the clock of the curve, the stretch that the number was read from; None for all
    """
    name = asked.name + part
    if isinstance(outcome, Estimate) and not np.isfinite([outcome.value, outcome.error]).all():
        outcome = Failure("not_finite", f"value {outcome.value}, standard error {outcome.error}")
    signs = _BOTH_SIGNS if isinstance(outcome, Failure) else _SIGNED.get(asked.unit, ())
    found = [
        why for each in (*asked.quantities, *signs) for why in bench.why_doubtful(each, during)
    ]
    if isinstance(outcome, Failure):
        why = [each for each in found if each.code in _MAY_BE_WHY]
        told = [*why, outcome] if outcome.code in _CUT_SHORT else [outcome, *why]
        reasons = tuple(dict.fromkeys(told))
        return Result(name, None, asked.unit, None, Status.FAILED, reasons, asked.method, 0)
    found += [each for each in doubts if each is not None]
    return Result(
        name=name,
        value=outcome.value,
        unit=asked.unit,
        interval=outcome.interval or Interval.normal_95(outcome.value, outcome.error),
        status=Status.DOUBTFUL if found else Status.OK,
        reasons=tuple(dict.fromkeys(found)),
        method=asked.method,
        n=outcome.n,
        made_of=asked.made_of,
        remark=_added_back(bench) if asked.name in _TO_THE_TOP else "",
    )


def _added_back(bench: Bench) -> str:
    """What repaired slips have added to the force, to be said of what rests on it."""
    drops = [slip.drop for slip in bench.slips if slip.decision is SlipDecision.REPAIRED]
    return f"{sum(drops):.3g} N of slips added back" if drops else ""


def while_loading(
    bench: Bench, low: float = -np.inf, high: float = np.inf
) -> tuple[float, float] | None:
    """Tell when the first loading went from one displacement to another.

    Parameters
    ----------
    bench : with a curve
    low, high : m

    Returns
    -------
    s, on the clock of the curve: when it first was at `low`, and when it first was beyond `high`,
    which is its end where it never was. None without a curve or a branch.
    """
    curve = bench.curve
    if curve is None or not curve.branches:
        return None
    branch = curve.branches[0]
    path = curve.displacement[branch.start : branch.stop]
    at, beyond = (np.flatnonzero(each) for each in (path >= low, path > high))
    start = curve.time[branch.start + int(at[0])] if len(at) else branch.start_time
    stop = curve.time[branch.start + int(beyond[0])] if len(beyond) else branch.stop_time
    return float(start), float(stop)


def with_force_scale(bench: Bench, estimate: Estimate) -> Estimate:
    """Add the uncertainty of the scale of the force.

    Parameters
    ----------
    bench : knows the relative standard error of its force
    estimate : in proportion to the force
    """
    return widened(estimate, bench.raw[bench.force].relative_error * abs(estimate.value))


def slack_error(bench: Bench) -> float:
    """Standard error of the slack that was taken off the displacement, m; 0 where none was."""
    return bench.slack.error if isinstance(bench.slack, Estimate) else 0.0
