from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest

from labpipe.campaign.workers import Died, in_processes


def test_outcomes_come_in_the_order_of_the_calls() -> None:
    calls = [partial(max, number, 0) for number in range(7)]
    assert list(in_processes(calls, jobs=3)) == list(range(7))
    assert list(in_processes(calls[:1], jobs=3)) == [0]
    assert list(in_processes([], jobs=3)) == []


@pytest.mark.skipif(os.name == "nt", reason="signals are another matter on Windows")
@pytest.mark.parametrize("jobs", [1, 2])
def test_a_process_that_dies_costs_its_call_alone(jobs: int) -> None:
    calls: list[Callable[[], Any]] = [
        partial(int, "1"),
        partial(signal.raise_signal, signal.SIGTERM),
        partial(signal.raise_signal, signal.SIGKILL),
        partial(int, "4"),
        partial(os._exit, 3),
        partial(int, "6"),
    ]
    found = list(in_processes(calls, jobs=jobs))
    died = Died(-signal.SIGTERM), Died(-signal.SIGKILL), Died(3)
    assert found == [1, died[0], died[1], 4, died[2], 6]
    assert [each.how for each in died] == [
        "by the signal SIGTERM",
        "by the signal SIGKILL",
        "with exit code 3",
    ]
    assert Died(-63).how == "by the signal 63"


def test_what_a_call_raises_is_raised() -> None:
    found = in_processes([partial(int, "1"), partial(int, "x"), partial(int, "3")], jobs=2)
    assert next(found) == 1
    with pytest.raises(ValueError, match="invalid literal"):
        next(found)


def test_calls_that_were_begun_are_waited_for() -> None:
    calls: list[Callable[[], Any]] = [partial(int, "1"), *[partial(time.sleep, 0.5)] * 9]
    found = in_processes(calls, jobs=2)
    assert next(found) == 1
    start = time.monotonic()
    found.close()
    assert time.monotonic() - start < 4.0  # nine of them, two at a time, take longer
