from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from labpipe.process.curve_corrections import correct_curve
from labpipe.protocol.schema import CurveBlock
from labpipe.records.arrays import Floats
from labpipe.records.causes import SLACK, ZERO_OF_DISPLACEMENT, ZERO_OF_FORCE
from labpipe.records.curve import Branch, Curve, Direction, PointFlag, Shape
from labpipe.records.estimates import Estimate, Failure, return_failure
from labpipe.records.quality import Reason
from labpipe.records.result import Result
from labpipe.records.signals import Signals
from labpipe.results.bending import TipTravel, _measure_at_turn, _SpanFrames
from labpipe.results.cycles import PeakDisplacement
from labpipe.results.kinds import ReducedTest, SpanBend
from labpipe.results.slack_and_slips import choose_slack_samples, subtract_slack
from labpipe.uncertainty.intervals import MeasuredNumber, measure_numbers
from labpipe.uncertainty.replicates import Extractor, Trace
from tests.builders.noise_rows import flicker
from tests.builders.pulls import NOISE, pull, pulled

FRAMES = 100


def shape(positions: np.ndarray) -> Shape:
    """Clamped end and tip alone."""
    count = len(positions)
    return Shape(
        time=np.arange(count) / 50.0,
        positions=positions,
        names=("grip", "pull"),
        flags=np.full((count, 2), PointFlag.CONSTRUCTED, dtype=np.uint8),
        arc_length=np.array([0.0, 0.085]),
        coefficients=np.zeros((count, 3, 0)),
        length=0.085,
        rotation_lab_to_specimen=np.eye(3),
    )


def swung() -> Shape:
    """Straight down by 30 mm and half of the way back, with 10 um of noise."""
    positions = np.zeros((FRAMES, 2, 3))
    positions[:, 1, 1] = np.interp(np.arange(FRAMES), [0, 10, 60, 99], [0.0, 0.0, 0.03, 0.015])
    return shape(positions + np.random.default_rng(4).normal(0.0, 1e-5, positions.shape))


def travel(seen: Shape | None) -> Result:
    (result,) = TipTravel().compute_results(ReducedTest(Signals(), shape=seen))
    return result


def test_travel_of_the_tip() -> None:
    shape = swung()
    result = travel(shape)
    assert result.interval is not None
    tip = shape.positions[:, -1]
    away = np.linalg.norm(tip - np.nanmean(tip[:5], axis=0), axis=1)
    assert result.value == pytest.approx(np.nanmax(away), abs=1e-12)
    assert result.value == pytest.approx(0.03, abs=5e-5)
    assert 1e-6 < result.interval.standard_error < 5e-5


def test_a_tip_that_was_hardly_seen() -> None:
    shape = swung()
    few = np.full_like(shape.positions, np.nan)
    few[:4] = shape.positions[:4]
    result = travel(replace(shape, positions=few))
    assert "too_few_samples: the tip is visible in 4 frames" in result.reason_text
    assert travel(None).reason_text == "no_shape: the protocol fits no shape"


TURN_TIME: Floats = np.arange(1800.0) / 25.0
WAY = np.interp(TURN_TIME, [0.0, 4.0, 36.0, 68.0, 72.0], [0.0, 0.0, 10.0, 0.0, 0.0])
FORTH = Branch(100, 900, 1, Direction.LOADING, 4.0, 36.0)
BACK = Branch(900, 1700, 1, Direction.UNLOADING, 36.0, 68.0)
TURNED = _SpanFrames(
    SpanBend(None, TURN_TIME, TURN_TIME < 4.0),  # type: ignore[arg-type]  # its shape is not read
    *(Curve(TURN_TIME, WAY, WAY, (FORTH, BACK)), FORTH, TURN_TIME, b"seed"),
)


@pytest.mark.parametrize(("before", "behind"), [(5, 5), (4, 5), (5, 4)])
def test_a_value_at_a_turn_needs_five_frames_on_each_side(before: int, behind: int) -> None:
    is_seen = (np.abs(np.arange(1800) - 900) > 50) | (np.arange(1800) > 900 - before)
    is_seen &= (np.abs(np.arange(1800) - 900) > 50) | (np.arange(1800) <= 900 + behind)
    measure = return_failure(_measure_at_turn)
    turn = measure(np.where(is_seen, WAY, np.nan), TURNED, "twist")
    if isinstance(turn, Failure):
        assert turn == Failure("too_few_samples", "9 frames within 2 s of the turn")
    else:
        assert turn.value == pytest.approx(10.0)
    assert isinstance(turn, Failure) is (min(before, behind) < 5)


@pytest.mark.slow
def test_noise_at_the_turn_is_judged_by_all_that_is_seen_alike() -> None:
    """The standard error of six that wander is never below the scatter of 60 values by a tenth.

    It is up to 1.7 times as large: pieces make the noise look steeper than it is. Those that are
    seen alike may have noise of another size. Alone, some have half of their scatter.
    """
    rows = [WAY + flicker((1, 1800), seed)[0] for seed in range(60)]

    def estimate(seed: int, *others: Floats) -> Estimate:
        made = _measure_at_turn(rows[seed], TURNED, "twist", others)
        assert isinstance(made, Estimate)
        return made

    alone = [estimate(seed) for seed in range(60)]
    six = [
        estimate(seed, *(5.0 * row for row in rows[seed + 1 : seed + 6]))
        for seed in range(0, 60, 6)
    ]
    scatter = float(np.std([made.value for made in alone]))
    assert 0.9 * scatter < min(made.error for made in six)
    assert max(made.error for made in six) < 1.7 * scatter
    assert min(made.error for made in alone) < 0.5 * scatter


slack = partial(choose_slack_samples, start_fraction=0.1, stop_fraction=0.3)


PATH = np.linspace(0.0, 0.02, 401)


PULL: Floats = 5000.0 * np.maximum(PATH - 0.002, 0.0)


TRACE = Trace(
    time=np.arange(401.0),
    displacement=PATH,
    force=PULL,
    branches=(Branch(0, 401, 1, Direction.LOADING, 0.0, 400.0),),
)


def taut(**errors: float) -> ReducedTest:
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


def shares(found: MeasuredNumber | Failure | None) -> dict[str, float]:
    assert isinstance(found, MeasuredNumber)
    return {contribution.cause: abs(contribution.change) for contribution in found.budget}


def peak(test: ReducedTest) -> dict[str, float]:
    (result,) = PeakDisplacement().compute_results(test)
    return {row.cause: abs(row.change) for row in result.budget}


def test_slack_is_the_zero_of_the_line() -> None:
    extractor = slack(TRACE)
    assert isinstance(extractor, Extractor)
    shifted = replace(TRACE, force=np.array([PULL, PULL - 5.0, 2.0 * PULL]))
    assert extractor.compute_numbers(shifted)[0] == pytest.approx([0.002, 0.003, 0.002], abs=1e-12)
    assert extractor.n == 72


def test_slack_is_looked_for_up_to_the_failure() -> None:
    """It breaks at 30 N of 90 N: 10 to 30 % are 3 to 9 N of that."""
    extractor = slack(replace(TRACE, failed_at=160))
    assert isinstance(extractor, Extractor)
    assert extractor.n == 24


def test_noise_of_the_slack_is_that_of_the_line() -> None:
    """20 mN over 5 N/mm, at the distance of zero force from the middle of the region."""
    test = taut()
    sizes = shares(test.slack)
    d = np.arange(0.0, 0.02, 2e-5)
    force = 5000.0 * (d - 0.003)
    region = d[(force >= 0.1 * force.max()) & (force <= 0.3 * force.max())]
    lever = np.sum((region - region.mean()) ** 2)
    expected = NOISE / 5000.0 * np.sqrt(1 / len(region) + (region.mean() - 0.003) ** 2 / lever)
    assert list(sizes) == ["noise", "sampling step"]
    assert sizes["noise"] == pytest.approx(expected, rel=0.2)
    assert abs(sizes["sampling step"]) < 0.5 * sizes["noise"]  # by what the region ends at samples
    total = np.hypot(sizes["noise"], sizes["sampling step"])
    assert peak(test)[SLACK] == pytest.approx(total, rel=0.03)


def test_zeros_in_the_slack_and_in_what_counts_from_it() -> None:
    """That of the displacement is in nothing behind; 0.05 N over 5000 N/m are 10 um everywhere.

    The region is chosen anew with the force, and the smooth curve is not quite straight behind a
    kink.
    """
    test = taut(force=0.05, displacement=1e-4)
    assert shares(test.slack)[ZERO_OF_DISPLACEMENT] == pytest.approx(1e-4, rel=1e-6)
    assert ZERO_OF_DISPLACEMENT not in peak(test)
    change = shares(test.slack)[ZERO_OF_FORCE]
    assert change == pytest.approx(1e-5, rel=0.1)
    assert peak(test)[ZERO_OF_FORCE] == pytest.approx(change, rel=1e-6)
    # The slack of what is counted from there is none, whatever noise and zeros do.
    assert test.replicates is not None
    assert isinstance(test.slack, MeasuredNumber)
    numbers = measure_numbers(test.replicates, slack)
    assert numbers[0].value == pytest.approx(0.0, abs=1e-9)
    assert numbers[0].error < 0.02 * shares(test.slack)["noise"]


@pytest.mark.parametrize(("name", "codes"), [("displacement", ["slow_noise"]), ("force", [])])
def test_what_counts_from_a_doubtful_slack_is_doubtful(name: str, codes: list[str]) -> None:
    """What moves with the displacement, and not the force."""
    test = taut(displacement=1e-4)
    assert test.replicates is not None
    assert isinstance(test.slack, MeasuredNumber)
    doubts = (("force", Reason("slow_noise", "it remembers")),)
    moved = subtract_slack(test.replicates, slack, replace(test.slack, doubts=doubts))
    extractor = Extractor(lambda trace: (getattr(trace, name)[..., 300],), 1)
    numbers = measure_numbers(moved, lambda _: extractor)
    assert [reason.code for _, reason in numbers[0].doubts] == codes
    for _, reason in numbers[0].doubts:
        assert reason.message.endswith("slack: it remembers")
