"""Slack, and what it does to numbers that count from it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from labpipe.process.curve_corrections import correct_curve
from labpipe.protocol.schema import CurveBlock
from labpipe.records.arrays import Floats
from labpipe.records.causes import SLACK, ZERO_OF_DISPLACEMENT, ZERO_OF_FORCE
from labpipe.records.curve import Branch, Direction
from labpipe.records.estimates import Failure
from labpipe.records.quality import Reason
from labpipe.results.cycles import PeakDisplacement
from labpipe.results.evidence import Evidence
from labpipe.results.taut_curves import counted_from_taut, slack_of
from labpipe.uncertainty.intervals import Measured, measure
from labpipe.uncertainty.readings import Reading, Trace
from tests.builders.pulls import NOISE, pull, pulled

slack = partial(slack_of, start_share=0.1, stop_share=0.3)
PATH = np.linspace(0.0, 0.02, 401)
PULL: Floats = 5000.0 * np.maximum(PATH - 0.002, 0.0)
TRACE = Trace(
    time=np.arange(401.0),
    displacement=PATH,
    force=PULL,
    branches=(Branch(0, 401, 1, Direction.LOADING, 0.0, 400.0),),
)


def taut(**errors: float) -> Evidence:
    """A pull of 5 N/mm with 3 mm of slack, whose zeros are known so well, counted from taut."""
    test, _ = pulled(*pull(slack=0.003))
    raw, filtered = dict(test.signals.raw), dict(test.signals.filtered)
    for name, error in errors.items():
        raw[name] = replace(raw[name], zero_error=error)
        filtered[name] = replace(filtered[name], zero_error=error)
    test = replace(test, signals=replace(test.signals, raw=raw, filtered=filtered))
    block = CurveBlock.model_validate(
        {"force": "force", "displacement": "displacement", "slack": {"from": "10 %", "to": "30 %"}}
    )
    return correct_curve(test, block)[0]


def shares(found: Measured | Failure | None) -> dict[str, float]:
    assert isinstance(found, Measured)
    return {each.cause: abs(each.change) for each in found.budget}


def peak(test: Evidence) -> dict[str, float]:
    (number,) = PeakDisplacement().compute(test).numbers
    assert isinstance(number.outcome, Measured)
    return shares(number.outcome)


def test_slack_is_the_zero_of_the_line() -> None:
    reading = slack(TRACE)
    assert isinstance(reading, Reading)
    shifted = replace(TRACE, force=np.array([PULL, PULL - 5.0, 2.0 * PULL]))
    np.testing.assert_allclose(reading.numbers(shifted)[0], [0.002, 0.003, 0.002], atol=1e-12)
    assert reading.n == 72


def test_slack_is_looked_for_up_to_the_failure() -> None:
    """It breaks at 30 N of 90 N: 10 to 30 % are 3 to 9 N of that."""
    reading = slack(replace(TRACE, failed_at=160))
    assert isinstance(reading, Reading)
    assert reading.n == 24


def test_why_there_is_no_slack() -> None:
    late = slack(replace(TRACE, force=PULL + 40.0))
    assert isinstance(late, Failure)
    assert late.code == "not_reached"


def test_noise_of_the_slack_is_that_of_the_line() -> None:
    """20 mN over 5 N/mm, at the distance of zero force from the middle of the region."""
    test = taut()
    found = shares(test.slack)
    d = np.arange(0.0, 0.02, 2e-5)
    force = 5000.0 * (d - 0.003)
    region = d[(force >= 0.1 * force.max()) & (force <= 0.3 * force.max())]
    lever = np.sum((region - region.mean()) ** 2)
    expected = NOISE / 5000.0 * np.sqrt(1 / len(region) + (region.mean() - 0.003) ** 2 / lever)
    assert list(found) == ["noise", "sampling step"]
    assert found["noise"] == pytest.approx(expected, rel=0.2)
    assert abs(found["sampling step"]) < 0.5 * found["noise"]  # by what the region ends at samples
    both = np.hypot(found["noise"], found["sampling step"])
    assert peak(test)[SLACK] == pytest.approx(both, rel=0.03)


def test_a_zero_of_the_displacement_is_in_the_slack_and_in_nothing_behind() -> None:
    test = taut(displacement=1e-4)
    assert shares(test.slack)[ZERO_OF_DISPLACEMENT] == pytest.approx(1e-4, rel=1e-6)
    assert ZERO_OF_DISPLACEMENT not in peak(test)


def test_a_zero_of_the_force_moves_what_counts_from_the_slack() -> None:
    """0.05 N over 5000 N/m are 10 um, of the slack and of every displacement.

    The region is chosen anew with the force, and the smooth curve is not quite straight behind a
    kink.
    """
    test = taut(force=0.05)
    found = shares(test.slack)[ZERO_OF_FORCE]
    assert found == pytest.approx(1e-5, rel=0.1)
    assert peak(test)[ZERO_OF_FORCE] == pytest.approx(found, rel=1e-6)


def test_each_curve_counts_from_its_own_slack() -> None:
    """So that the slack of what is counted from there is none, whatever noise and zeros do."""
    test = taut(force=0.05, displacement=1e-4)
    assert test.replicates is not None
    assert isinstance(test.slack, Measured)
    found = measure(test.replicates, slack)
    assert not isinstance(found, Failure)
    assert found[0].value == pytest.approx(0.0, abs=1e-9)
    assert found[0].error < 0.02 * shares(test.slack)["noise"]


def test_a_slack_that_was_not_measured_is_refused() -> None:
    test = taut()
    assert test.replicates is not None
    assert isinstance(test.slack, Measured)
    never = partial(slack_of, start_share=0.2, stop_share=0.2)
    with pytest.raises(ValueError, match="expected a slack that was measured, found 0 samples"):
        counted_from_taut(test.replicates, never, test.slack)


def _always(reading: Reading, trace: Trace) -> Reading:
    del trace
    return reading


def test_what_counts_from_a_doubtful_slack_is_doubtful() -> None:
    """What moves with the displacement, and not the force."""
    test = taut(displacement=1e-4)
    assert test.replicates is not None
    assert isinstance(test.slack, Measured)
    why = Reason("slow_noise", "it remembers")
    doubted = replace(test.slack, doubts=(("force", why),))
    made = counted_from_taut(test.replicates, slack, doubted)
    for name, codes in (("displacement", ["slow_noise"]), ("force", [])):

        def last(trace: Trace, name: str = name) -> tuple[Floats]:
            values: Floats = getattr(trace, name)
            return (values[..., 300],)

        found = measure(made, partial(_always, Reading(last, 1)))
        assert isinstance(found, tuple)
        assert [reason.code for _, reason in found[0].doubts] == codes
        if codes:
            assert found[0].doubts[0][1].message.endswith("slack that is doubtful: it remembers")
