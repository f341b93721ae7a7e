from __future__ import annotations

import pytest

from labpipe.records.curve import Interval
from labpipe.records.quality import Reason
from labpipe.records.result import Contribution, Result, Status


def test_a_number_without_more_is_ok() -> None:
    assert Result("energy.1", 1.0, "J").status is Status.OK


@pytest.mark.parametrize(
    ("value", "status"), [(None, Status.OK), (None, Status.DOUBTFUL), (1.0, Status.FAILED)]
)
def test_failed_exactly_without_a_value(value: float | None, status: Status) -> None:
    with pytest.raises(ValueError, match=r"energy.1: a result is failed exactly when it has no"):
        Result("energy.1", value, "J", status=status, reasons=(Reason("gap", "x"),))


@pytest.mark.parametrize(("value", "status"), [(None, Status.FAILED), (1.0, Status.DOUBTFUL)])
def test_must_say_why(value: float | None, status: Status) -> None:
    with pytest.raises(ValueError, match=f"energy.1: a {status} result must say why"):
        Result("energy.1", value, "J", status=status)
    assert (
        Result("energy.1", value, "J", status=status, reasons=(Reason("gap", "x"),)).why == "gap: x"
    )


def test_shares_of_the_variance() -> None:
    budget = (Contribution("noise", 1.0), Contribution("scale of the force", -2.0, is_common=True))
    found = Result("energy.1", 1.0, "J", budget=(*budget, Contribution("slack", 2.0)))
    assert found.shares == pytest.approx((1 / 9, 4 / 9, 4 / 9))
    assert found.largest_share == ("scale of the force", found.shares[1])
    still = Result("energy.1", 1.0, "J", budget=(Contribution("noise", 0.0),))
    assert (still.shares, still.largest_share) == ((0.0,), None)
    assert Result("energy.1", 1.0, "J").largest_share is None


@pytest.mark.parametrize(
    ("estimate", "is_apart"),
    [(None, False), (8.9, True), (9.1, False), (10.9, False), (11.1, True)],
)
def test_an_estimate_apart_from_its_value(estimate: float | None, is_apart: bool) -> None:
    interval = Interval(7.0, 11.0)
    found = Result("energy.1", 10.0, "J", interval, estimate=estimate)
    assert found.apart == (estimate if is_apart else None)


def test_an_estimate_without_an_interval_says_nothing() -> None:
    assert Result("energy.1", 10.0, "J", estimate=3.0).apart is None
