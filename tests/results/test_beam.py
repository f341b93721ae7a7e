"""Plateau and bending stiffness of loadings whose numbers are known."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.errors import ProtocolError
from labpipe.protocol.load import parse_protocol
from labpipe.records.arrays import Floats
from labpipe.records.causes import TANGENT
from labpipe.records.result import Result
from labpipe.results.kinks_and_plateaus import _CornerError
from tests.builders.pulls import pull, pulled
from tests.builders.three_point import CONDUIT, BendingRecord
from tests.builders.three_point import reduced as reduced_bending


def cornered(over: str) -> tuple[Floats, Floats, dict[str, Result]]:
    """5 N/mm up to a corner at 12 mm, 0.1 N/mm behind it; the tangent falls below a fifth there."""
    travel, force = pull()
    flat = force - 4900.0 * np.maximum(travel - 0.012, 0.0)
    line = "stiffness, from: 1 mm, to: 3 mm"
    tangents = f"plateau, slope_below: 20 %, of: stiffness, over: {over}"
    return travel, flat, pulled(travel, flat, results=[line, tangents])[1]


def change_of_tangent(result: Result) -> float:
    return next(row.change for row in result.budget if row.cause == TANGENT)


@pytest.mark.parametrize("over", ["1 mm", "5 mm"])
def test_a_corner_that_tangents_smear_is_in_the_interval(over: str) -> None:
    *_, results = cornered(over)
    for name, true in (("plateau_displacement", 0.012), ("plateau_force", 60.0)):
        result = results[name]
        assert result.interval is not None
        assert result.estimate is not None
        assert result.value is not None
        assert result.interval.lower < true < result.interval.upper
        assert max(result.budget, key=lambda row: abs(row.change)).cause == TANGENT
        if name == "plateau_displacement":  # a quarter is left
            assert result.value - true > 3.0 * abs(result.estimate - true)


def test_a_corner_before_the_first_tangent_is_no_onset() -> None:
    travel, force = pull()
    flat = force - 4900.0 * np.maximum(travel - 0.001, 0.0)
    tangents = "plateau, slope_below: 20 %, of: stiffness, over: 5 mm"
    results = pulled(travel, flat, results=["stiffness, from: 0.2 mm, to: 0.9 mm", tangents])[1]
    assert results["plateau_force"].codes == results["plateau_displacement"].codes
    assert "no_plateau" in results["plateau_force"].codes


def test_what_is_left_of_a_corner_when_noise_is_taken_off() -> None:
    """5 mm seen, 3 mm of noise and 1 mm more on average; 2 N seen, all of which is noise."""
    noise = np.array([[1e-3 + 3e-3, 1e-3 - 3e-3], [-4.0, 4.0]])
    corner = _CornerError.of(np.array([6e-3, 2.0]), np.array([1e-3, 0.5]), noise)
    assert corner.error == pytest.approx([4e-3, 0.0])  # 5^2 - 3^2 = 4^2
    assert corner.noise_free_ratio == pytest.approx([0.8, 0.0])
    drawn = corner.compute_noise_effect(np.array([[1e-3 + 4e-3], [7.0]]))
    assert drawn[:, 0] == pytest.approx([0.5 * 0.8 * 3e-3, 0.0])
    nothing = _CornerError.of(np.zeros(2), np.zeros(2), np.zeros((2, 5)))
    assert nothing.error == pytest.approx([0.0, 0.0])


def test_the_doubt_about_a_corner_by_hand() -> None:
    """Lines over half the tangent leave half the smear: up to three times what they change."""
    travel, flat, results = cornered("2 mm")
    places = np.arange(0.0113, 0.0133, 1e-5)

    def onset(over: float) -> float:
        slopes = []
        for at in places:
            near = np.abs(travel - at) <= 0.5 * over
            slopes.append(np.polyfit(travel[near] - at, flat[near], 2)[1])
        return float(places[np.flatnonzero(np.array(slopes) >= 1000.0)[-1]])

    change = onset(0.001) - onset(0.002)
    by_hand = abs(change) * 3.0 / 2.0  # none or all of it
    in_place = change_of_tangent(results["plateau_displacement"])
    assert abs(in_place) == pytest.approx(by_hand, rel=0.06)

    at = results["plateau_displacement"].value
    assert at is not None
    short, whole = (
        float(np.polynomial.Polynomial.fit(travel[near], flat[near], 2)(at))
        for near in (np.abs(travel - at) <= 0.5e-3, np.abs(travel - at) <= 1e-3)
    )
    by_hand = 2.0 * (short - whole) - 3.0 * abs(change) * 100.0  # 0.1 N/mm behind the corner
    in_force = change_of_tangent(results["plateau_force"])
    assert in_force == pytest.approx(by_hand / 2.0, rel=0.06)


OLD = "corrections: [large-deflection, roller-radius], roller: {diameter: 10 mm}"
WINDOW = ("initial-stiffness, from: 0.2 mm, to: 5 mm", "initial-stiffness, from: 2 mm, to: 15 mm")


def stiffness(corrections: str) -> Result:
    change = (WINDOW, (OLD, corrections))
    return reduced_bending(BendingRecord(), without=("markers",), change=change)[1][
        "bending_stiffness"
    ]


def test_corrections_give_the_true_value_back_and_say_their_sizes() -> None:
    exact = stiffness("corrections: [large-deflection]")
    assert exact.value == pytest.approx(0.02, rel=0.01)
    assert exact.interval is not None
    assert exact.interval.lower < 0.02 < exact.interval.upper
    more = "corrections: [large-deflection, roller-radius, roller-friction]"
    result = stiffness(f"{more}, roller: {{diameter: 10 mm, friction: 0.2}}")
    assert result.full_method.endswith(f"; {result.remark}")
    parts = result.remark.partition("corrected as an elastic beam: ")[2].split(", ")
    names, sizes = zip(*(part.split()[:2] for part in parts), strict=True)
    assert names == ("large-deflection", "roller-radius", "roller-friction")
    large, radius, friction = (float(size) for size in sizes)
    assert large > 5.0
    assert radius < 0.0
    assert friction < 0.0


@pytest.mark.parametrize(
    ("corrections", "message"),
    [
        ("[roller-radius], roller: {diameter: 10 mm}", "'large-deflection' beside 'roller-radius'"),
        (
            "[large-deflection, roller-friction], roller: {diameter: 10 mm}",
            "'roller.friction' for 'roller-friction'",
        ),
        (
            "[large-deflection], support: cantilever",
            "corrections for 'three-point' alone, found 'cantilever'",
        ),
    ],
)
def test_corrections_without_what_they_need(corrections: str, message: str) -> None:
    text = CONDUIT.read_text(encoding="utf-8")
    if "cantilever" in corrections:
        text = text.replace("support: three-point,", "")
    with pytest.raises(ProtocolError, match=f"expected {message}"):
        parse_protocol(text.replace(OLD, f"corrections: {corrections}"), "p.yaml")
