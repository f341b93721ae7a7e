"""Suggest overrides in a test sheet that make a number available, with values that were tried."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import product
from math import ceil, floor, log10

import numpy as np

from labpipe.errors import in_test_sheet
from labpipe.process.curve_corrections import find_final_loss, measure_slack
from labpipe.protocol.schema import CurveBlock, Protocol
from labpipe.records.estimates import Failure
from labpipe.records.result import Result, Status
from labpipe.results.curve_replicates import loading_of, traced
from labpipe.results.cycles import sense_of
from labpipe.results.failures import LossOfForce
from labpipe.results.kinds import Kind
from labpipe.results.reduced_test import ReducedTest
from labpipe.results.slack_and_slips import slack_of
from labpipe.results.stiffness import Window

_PERCENTAGES = range(5, 100, 5)

Values = Mapping[str, str]
"""Values by dotted key, as a test sheet writes them."""


def with_remedy(result: Result, entry: Kind, test: ReducedTest, protocol: Protocol) -> Result:
    """Add a remedy to the reasons of a result that is not available.

    Parameters
    ----------
    result : of an entry of the protocol
    entry : the entry
    test : with all findings
    protocol : of the test

    Returns
    -------
    The result. If its window, the slack or the failure is the reason, the message names the keys to
    change, with values that make the number available for this test.
    """
    block = protocol.curve
    if result.status is not Status.FAILED or block is None or not test.cycles:
        return result
    needed = entry.needs.correction
    key = partial(_key, protocol=protocol)

    def remedy(reason: Failure) -> str:
        if isinstance(entry, Window) and reason.code in {"not_reached", "too_few_samples"}:
            condition, candidates = "if that range is acceptable", _windows(entry, test, key(entry))
        elif needed == "slack" and reason == test.slack:
            condition, candidates = "if the curve is straight up to there", _regions(test, block)
        elif needed == "failure" and reason.code == "no_break":
            condition, candidates = "if it broke there", _losses(test, block)
        else:
            return ""
        values = next(candidates, None)
        if values is None:
            entries = [
                other
                for other in protocol.results
                if other is entry or other.needs.correction == needed != ""
            ]
            blocks = ["curve.slack"] if needed == "slack" else []
            values = dict.fromkeys([*blocks, *map(key, entries)], "null")
            condition = "if this test cannot give it"
        (first, value), *more = values.items()
        return f"; {condition}, write {in_test_sheet(first, value, **dict(more))}"

    reasons = [
        replace(reason, message=reason.message + remedy(reason)) for reason in result.reasons
    ]
    return replace(result, reasons=tuple(reasons))


def _key(entry: Kind, protocol: Protocol) -> str:
    """Return the dotted key of an entry: its name if unique, else its number."""
    names = [getattr(result, "name", result.result) for result in protocol.results]
    number = protocol.results.index(entry)
    return f"results.{names[number] if names.count(names[number]) == 1 else number}"


def _windows(entry: Window, test: ReducedTest, key: str) -> Iterator[Values]:
    """Yield windows near the stated one that hold enough samples and give the number."""
    # Samples to try: two more than a line needs, exactly that, and enough for two lines.
    sample_counts = (10, 8, 20, 40)
    trace = traced(test)
    places = trace.displacement[loading_of(trace)]
    places = places[np.isfinite(places)]
    low = max(entry.start, _rounded(float(places[0]), ceil)) if len(places) else np.inf
    above = np.sort(places[places >= low])
    for count in (count for count in sample_counts if count <= len(above)):
        high = min(entry.stop, _rounded(float(above[-1]), floor))
        high = max(high, _rounded(float(above[count - 1]), ceil))
        results = replace(entry, start=low, stop=high).compute(test).results if low < high else ()
        if any(result.value is not None for result in results):
            ends = (("from", entry.start, low), ("to", entry.stop, high))
            yield {f"{key}.{end}": f"{1e3 * new:g} mm" for end, old, new in ends if new != old}


def _rounded(length: float, rounding: Callable[[float], int]) -> float:
    """Round a length (m) to three digits."""
    step = 10.0 ** (floor(log10(abs(length))) - 2) if length else 1.0
    return float(f"{rounding(length / step) * step:.6g}")


def _regions(test: ReducedTest, block: CurveBlock) -> Iterator[Values]:
    """Yield ends of the linear region with which it holds enough samples."""
    slack = block.slack
    if slack is None or not isinstance(test.slack, Failure) or test.slack.code != "too_few_samples":
        return
    for stop in (percent for percent in _PERCENTAGES if percent > 100.0 * slack.stop):
        decide = partial(slack_of, start_share=slack.start, stop_share=stop / 100.0)
        if not isinstance(measure_slack(test, decide), Failure):
            yield {"curve.slack.to": f"{stop} %"}


def _losses(test: ReducedTest, block: CurveBlock) -> Iterator[Values]:
    """Yield definitions of failure with which this record has one."""
    # s
    loss_times = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0, 60.0)
    rule, curve = block.failure, test.known_curve
    if rule is None:
        return
    force = sense_of(curve, curve.force) * curve.force[np.isfinite(curve.force)]
    least = max(rule.force_below, float(force[-1] / force.max()))  # the force ends above others
    shares = (percent / 100.0 for percent in _PERCENTAGES if percent > 100.0 * least)
    times = (time for time in loss_times if time > rule.within)
    for within, share in product((rule.within, *times), (rule.force_below, *shares)):
        if isinstance(find_final_loss(test, LossOfForce(share, rule.loss, within)), int):
            values = {"force_below": f"{100.0 * share:.0f} %"} if share != rule.force_below else {}
            values |= {"within": f"{within:g} s"} if within != rule.within else {}
            yield {f"curve.failure.{name}": value for name, value in values.items()}
