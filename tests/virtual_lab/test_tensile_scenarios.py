"""What cannot be is refused when it is said."""

from __future__ import annotations

from dataclasses import replace

import pytest

from labpipe.virtual_lab.tensile_scenarios import BilinearLaw, GripSlip, corrugated_tube, twist_tube


def test_foot_is_where_the_first_line_meets_zero_force() -> None:
    law = BilinearLaw(2e3, 1e3, 10e-3, slack=1e-3, toe=0.6e-3)
    assert law.foot == pytest.approx(1.3e-3)


@pytest.mark.parametrize(
    ("first", "second", "told"),
    [(0.0, 1.0, "stiffness_first=0.0 must be above"), (1.0, -1.0, "stiffness_second=-1.0 not")],
)
def test_stiffness_of_the_wrong_sign(first: float, second: float, told: str) -> None:
    with pytest.raises(ValueError, match=told):
        BilinearLaw(first, second, 10e-3)


def test_negative_slack() -> None:
    with pytest.raises(ValueError, match=r"slack=-0\.001, toe=0\.0: not negative"):
        BilinearLaw(2e3, 1e3, 10e-3, slack=-1e-3)


def test_toe_and_knee_overlap() -> None:
    with pytest.raises(ValueError, match=r"break_point=0\.01 m: toe and knee overlap"):
        BilinearLaw(2e3, 1e3, 10e-3, toe=11e-3, knee=10e-3)


def test_slips_out_of_order() -> None:
    slips = (GripSlip(30e-3, 0.5), GripSlip(20e-3, 0.5))
    with pytest.raises(ValueError, match=r"slips at \[0\.03, 0\.02\] m: must be in order"):
        replace(corrugated_tube("CT-10-1"), slips=slips)


def test_slip_after_the_end() -> None:
    with pytest.raises(ValueError, match=r"before 0\.05 m"):
        replace(corrugated_tube("CT-10-1"), slips=(GripSlip(60e-3, 0.5),))


def test_failure_beyond_the_stroke() -> None:
    tube = twist_tube("1a")
    with pytest.raises(ValueError, match=r"must lie within the stroke of 0\.01 m"):
        replace(tube, frame=replace(tube.frame, stroke=10e-3))


def test_failed_specimen_is_not_unloaded() -> None:
    tube = twist_tube("1a")
    with pytest.raises(ValueError, match="a specimen that has failed is not unloaded"):
        replace(tube, frame=replace(tube.frame, unloads=True))
