from __future__ import annotations

import pytest

from labpipe.records.quality import Reason
from labpipe.records.result import Result, Status


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
