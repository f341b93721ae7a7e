from __future__ import annotations

import pytest

from labpipe.protocol.stress_curve import StressPoint, curve_fault, curve_of


def points(*pairs: tuple[float, float]) -> list[StressPoint]:
    return [StressPoint.model_validate({"strain": str(a), "stress_mpa": str(b)}) for a, b in pairs]


def test_a_curve_in_si_without_its_zero() -> None:
    curve = points((0.0, 0.0), (0.001, 110.0), (0.1, 150.0))
    assert curve_fault(curve, "stress_table") is None
    assert curve_of(curve) == ((0.001, 0.1), (110e6, 150e6))


@pytest.mark.parametrize(
    ("pairs", "number", "expected", "found"),
    [
        ([(0.002, 110), (0.001, 120)], 1, "a strain above 0.002", "0.001"),
        ([(0.001, 110), (0.002, 100)], 1, "a stress of 110 MPa or more, and more", "100 MPa"),
        ([(0.001, 0), (0.002, 100)], 0, "a stress of 0 MPa or more, and more", "0 MPa"),
        ([(0.001, 50), (0.002, 150)], 1, "a slope up to the first, 50 GPa", "100 GPa"),
        ([(0, 0)], 0, "a point beyond zero", "none"),
        ([(0, 0), (0.2, 110)], 1, "a first slope of 1 to 1000 GPa", "0.55 GPa"),
        ([(1e-5, 90000)], 0, "a first slope of 1 to 1000 GPa", "9e+06 GPa"),
    ],
)
def test_points_that_make_no_curve(
    pairs: list[tuple[float, float]], number: int, expected: str, found: str
) -> None:
    wrong = curve_fault(points(*pairs), "stress_table")
    assert wrong is not None
    assert (wrong[0], wrong[1].found) == (number, found)
    assert wrong[1].expected.startswith(expected)


def test_insulation_is_softer_and_must_not_soften() -> None:
    assert curve_fault(points((0.01, 10), (0.3, 20)), "insulation_table") is None
    wrong = curve_fault(points((0.01, 10), (0.05, 18), (0.1, 16)), "insulation_table")
    assert wrong is not None
    assert wrong[0] == 2
    assert wrong[1].expected == "a stress of 18 MPa or more, and more than zero"
    stiff = curve_fault(points((0.001, 110), (0.3, 200)), "insulation_table")
    assert stiff is not None
    assert stiff[1].expected == "a first slope of 0.0001 to 10 GPa"
