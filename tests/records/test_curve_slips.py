from __future__ import annotations

from dataclasses import FrozenInstanceError

import pytest

from labpipe.records.curve import Interval, Slip, SlipDecision


def slip() -> Slip:
    near, about = Interval(0.0099, 0.0101), Interval(1.8, 2.2)
    return Slip(0.01, 2.0, near, about, SlipDecision.REPAIRED, 100, 102)


def test_slips_are_values() -> None:
    assert slip() == slip()
    assert len({slip(), slip()}) == 1
    with pytest.raises(FrozenInstanceError):
        slip().drop = 1.0  # type: ignore[misc]


def test_a_decision_is_its_word() -> None:
    assert [str(each) for each in SlipDecision] == ["marked", "repaired", "cut"]
    assert SlipDecision("cut") is SlipDecision.CUT
    with pytest.raises(ValueError, match="'mended' is not a valid SlipDecision"):
        SlipDecision("mended")
