"""What to write in a test sheet where a number is not available: keys, with values tried before."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import product
from math import ceil, floor, log10

import numpy as np

from labpipe.errors import in_test_sheet
from labpipe.fits.failure_point import LossOfForce
from labpipe.process.curve_corrections import final_loss_of, slack_by
from labpipe.protocol.schema import CurveBlock, Protocol
from labpipe.records.estimates import Failure
from labpipe.records.result import Result, Status
from labpipe.results.curve_replicates import loading_of, traced
from labpipe.results.kinds import Kind
from labpipe.results.reduced_test import ReducedTest
from labpipe.results.slack_correction import slack_of
from labpipe.results.stiffness import Window

_ENOUGH = (10, 8, 20, 40)
"""Samples that a window is tried with: two more than a line needs, just that, and for two lines."""
_PERCENT = range(5, 100, 5)
_TIMES = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0, 60.0)
"""s, in which a force may be lost."""

Values = Mapping[str, str]
"""By dotted key, as a test sheet writes them."""


def with_remedy(result: Result, entry: Kind, test: ReducedTest, protocol: Protocol) -> Result:
    """Add to a result that is not available what would make it so.

    Parameters
    ----------
    result : of an entry of the protocol
    entry : the entry
    test : with all that was found
    protocol : of the test

    Returns
    -------
    The result. Where its window, the slack or the failure is why it is not available, its reason
    names the keys to change, with values that give the number of this test.
    """
    block = protocol.curve
    if result.status is not Status.FAILED or block is None or not test.cycles:
        return result
    needed = entry.needs.correction
    key = partial(_key, protocol=protocol)

    def remedy(why: Failure) -> str:
        if isinstance(entry, Window) and why.code in {"not_reached", "too_few_samples"}:
            condition, tried = "if that stretch will do", _windows(entry, test, key(entry))
        elif needed == "slack" and why == test.slack:
            condition, tried = "if the curve is straight up to there", _regions(test, block)
        elif needed == "failure" and why.code == "no_break":
            condition, tried = "if it broke there", _losses(test, block)
        else:
            return ""
        found = next(tried, None)
        if found is None:
            alike = [
                x for x in protocol.results if x is entry or x.needs.correction == needed != ""
            ]
            blocks = ["curve.slack"] if needed == "slack" else []
            found = dict.fromkeys([*blocks, *map(key, alike)], "null")
            condition = "if this test cannot give it"
        (first, value), *more = found.items()
        return f"; {condition}, write {in_test_sheet(first, value, **dict(more))}"

    reasons = [
        replace(reason, message=reason.message + remedy(reason)) for reason in result.reasons
    ]
    return replace(result, reasons=tuple(reasons))


def _key(entry: Kind, protocol: Protocol) -> str:
    """Dotted key of an entry: by its name or word where no other has it, else by its number."""
    called = [getattr(result, "name", result.result) for result in protocol.results]
    number = protocol.results.index(entry)
    return f"results.{called[number] if called.count(called[number]) == 1 else number}"


def _windows(entry: Window, test: ReducedTest, key: str) -> Iterator[Values]:
    """Windows near the one asked for that hold enough samples, and give the number."""
    trace = traced(test)
    places = trace.displacement[loading_of(trace)]
    places = places[np.isfinite(places)]
    low = max(entry.start, _rounded(float(places[0]), ceil)) if len(places) else np.inf
    above = np.sort(places[places >= low])
    for count in (each for each in _ENOUGH if each <= len(above)):
        high = min(entry.stop, _rounded(float(above[-1]), floor))
        high = max(high, _rounded(float(above[count - 1]), ceil))
        numbers = replace(entry, start=low, stop=high).compute(test).numbers if low < high else ()
        if any(not isinstance(number.outcome, Failure) for number in numbers):
            ends = (("from", entry.start, low), ("to", entry.stop, high))
            yield {f"{key}.{end}": f"{1e3 * new:g} mm" for end, old, new in ends if new != old}


def _rounded(length: float, way: Callable[[float], int]) -> float:
    """A length (m) to three digits."""
    step = 10.0 ** (floor(log10(abs(length))) - 2) if length else 1.0
    return float(f"{way(length / step) * step:.6g}")


def _regions(test: ReducedTest, block: CurveBlock) -> Iterator[Values]:
    """Ends of the linear region up to which it holds enough samples."""
    slack = block.slack
    if slack is None or not isinstance(test.slack, Failure) or test.slack.code != "too_few_samples":
        return
    for stop in (each for each in _PERCENT if each > 100.0 * slack.stop):
        decide = partial(slack_of, start_share=slack.start, stop_share=stop / 100.0)
        if not isinstance(slack_by(test, decide), Failure):
            yield {"curve.slack.to": f"{stop} %"}


def _losses(test: ReducedTest, block: CurveBlock) -> Iterator[Values]:
    """Rules by which the force is lost for good in this record."""
    rule = block.failure
    if rule is None:
        return
    shares = (each / 100.0 for each in _PERCENT if each > 100.0 * rule.force_below)
    times = (time for time in _TIMES if time > rule.within)
    for within, share in product((rule.within, *times), (rule.force_below, *shares)):
        if isinstance(final_loss_of(test, LossOfForce(share, rule.loss, within)), int):
            found = {"force_below": f"{100.0 * share:.0f} %"} if share != rule.force_below else {}
            found |= {"within": f"{within:g} s"} if within != rule.within else {}
            yield {f"curve.failure.{name}": value for name, value in found.items()}
