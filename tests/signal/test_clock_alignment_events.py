"""Two clocks joined at events."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.signal.clock_alignment import fit_clocks, match_peaks, rough_peaks

PEAKS = np.array([58.0, 164.0, 270.0])


def test_exact_events_give_the_clocks_back() -> None:
    force = 1.37 + (1.0 + 40e-6) * PEAKS
    fit = fit_clocks(PEAKS, force, np.full(3, 1e-3), method="test")
    assert fit.offset == pytest.approx(1.37, abs=1e-10)
    assert fit.drift == pytest.approx(40e-6, abs=1e-12)
    assert fit.residual == pytest.approx(0.0, abs=1e-10)
    assert fit.to_marker_time(fit.to_force_time(PEAKS)) == pytest.approx(PEAKS)
    assert fit.to_force_seconds(58.0) == pytest.approx(float(force[0]))


def test_intervals_cover() -> None:
    rng, runs = np.random.default_rng(3), 2000
    errors = np.array([1e-3, 2e-3, 1e-3])
    inside = np.zeros(2)
    for _ in range(runs):
        force = 1.37 + (1.0 + 40e-6) * PEAKS + rng.normal(0, errors)
        fit = fit_clocks(PEAKS, force, errors, method="test")
        inside += [
            fit.offset_interval.lower <= 1.37 <= fit.offset_interval.upper,
            fit.drift_interval.lower <= 40e-6 <= fit.drift_interval.upper,
        ]
    # Widening by the scatter (1 % of the runs) may only add to the 95 %.
    assert (inside / runs) == pytest.approx([0.952, 0.952], abs=0.015)


def test_scatter_beyond_the_errors_widens_the_intervals() -> None:
    force = PEAKS + np.array([0.0, 0.05, 0.0])
    narrow = fit_clocks(PEAKS, PEAKS, np.full(3, 1e-3), method="test")
    wide = fit_clocks(PEAKS, force, np.full(3, 1e-3), method="test")
    assert wide.drift_interval.standard_error > 20 * narrow.drift_interval.standard_error
    assert wide.residual == pytest.approx(0.0236, abs=1e-3)


def test_one_event_gives_an_offset_and_no_drift() -> None:
    fit = fit_clocks(np.array([50.0]), np.array([51.0]), np.array([1e-3]), method="test")
    assert fit.offset == pytest.approx(1.0)
    assert fit.drift == 0.0
    assert np.isnan(fit.drift_interval.lower)


def test_no_event_is_refused() -> None:
    with pytest.raises(ValueError, match="events=0: expected at least one event"):
        fit_clocks(np.empty(0), np.empty(0), np.empty(0), method="test")


def test_peaks_are_paired_in_order() -> None:
    pairs, is_ambiguous = match_peaks(PEAKS, PEAKS + 1.4)
    assert pairs.tolist() == [[0, 0], [1, 1], [2, 2]]
    assert not is_ambiguous


def test_a_record_that_began_late_is_ambiguous_when_the_peaks_are_even() -> None:
    pairs, is_ambiguous = match_peaks(PEAKS, PEAKS[1:] + 1.4)
    assert pairs.tolist() == [[1, 0], [2, 1]]
    assert is_ambiguous


def test_uneven_peaks_settle_a_late_start() -> None:
    motion = np.array([58.0, 164.0, 290.0])
    pairs, is_ambiguous = match_peaks(motion, motion[1:] - 100.0)
    assert pairs.tolist() == [[1, 0], [2, 1]]
    assert not is_ambiguous


def test_no_peaks_no_pairs() -> None:
    pairs, is_ambiguous = match_peaks(PEAKS, np.empty(0))
    assert pairs.shape == (0, 2)
    assert not is_ambiguous


def test_rough_peaks_of_a_noisy_force() -> None:
    time = np.arange(0.0, 330.0, 1e-3)
    force = np.interp(time, [5, 58, 90, 111, 164, 217, 270, 323], [0, 1.2, 0, 0, 1.3, 0, 1.3, 0])
    force += np.random.default_rng(4).normal(0, 0.02, len(time))
    assert rough_peaks(time, force, smoothing=0.5, share=0.3) == pytest.approx(PEAKS, abs=0.3)


def test_a_constant_force_has_no_peak() -> None:
    assert len(rough_peaks(np.arange(10.0), np.ones(10), smoothing=0.5, share=0.3)) == 0


def test_the_turn_of_a_plateau_is_its_end() -> None:
    """The force rests from 35 s on and is largest somewhere there; it turns at 58 s."""
    time = np.arange(0.0, 120.0, 1e-2)
    force = np.interp(time, [5.0, 35.0, 58.0, 70.0, 111.0], [0.0, 1.2, 1.21, 0.0, 0.0])
    force += np.random.default_rng(7).normal(0, 0.02, len(time))
    force += 0.04 * np.exp(-(((time - 38.0) / 3.0) ** 2))
    assert rough_peaks(time, force, smoothing=0.5, share=0.3) == pytest.approx([58.0], abs=0.3)


@pytest.mark.parametrize(("square", "widened"), [(6.4, 1.0), (6.8, 6.8), (9.0, 9.0)])
def test_the_quantile_above_which_scatter_widens(square: float, widened: float) -> None:
    """One degree of freedom: 99 % of chi-square lie below 6.63. (1, -2, 1) lies across all lines.

    Three events 100 s apart with errors of 1 ms know the drift to 1 ms / (100 s sqrt 2).
    """
    off = 1e-3 * np.sqrt(square / 6.0) * np.array([1.0, -2.0, 1.0])
    motion = np.array([100.0, 200.0, 300.0])
    fit = fit_clocks(motion, motion + off, np.full(3, 1e-3), method="test")
    assert fit.drift == pytest.approx(0.0, abs=1e-15)
    known = 1e-5 / np.sqrt(2.0)
    assert fit.drift_interval.standard_error == pytest.approx(known * np.sqrt(widened), rel=1e-9)
