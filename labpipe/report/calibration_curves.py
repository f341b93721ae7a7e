"""Measured first loadings of a calibration against its model, and what is left between them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.agreement import CurveAgreement, Prediction
from labpipe.records.arrays import Floats
from labpipe.records.calibration import Calibration, SourceCalibration
from labpipe.report.calibration_look import (
    BAND,
    DEFLECTION,
    FORCE,
    MODEL,
    SMALL_FORCE,
    SOURCE,
    length_looks,
    length_words,
)
from labpipe.report.page import Look
from labpipe.report.thinning import extremes
from labpipe.statistics.block_means import block_means

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SAMPLE: dict[str, Any] = {"linewidth": 0.6, "zorder": 2}
MODEL_LINE: dict[str, Any] = {"color": MODEL, "linewidth": 1.5, "zorder": 4}
MODEL_BAND: dict[str, Any] = {"color": BAND, "alpha": 0.55, "linewidth": 0, "zorder": 1}
_FAINT: dict[str, Any] = {"alpha": 0.2, "linewidth": 0.4}
_MEANS: dict[str, Any] = {"linewidth": 0.9, "zorder": 3}
_ZERO: dict[str, Any] = {"color": "black", "linewidth": 0.6, "zorder": 1}
N_MEANS = 25
"""Stretches that residuals are averaged over at the least."""
_BINS = 120
"""Stretches of a curve that are drawn by their highest and lowest point."""


def looks_of(calibration: Calibration) -> dict[float, Look]:
    """Look of the samples of each length."""
    return length_looks([curve.length for curve in calibration.curves])


def plot_loadings(
    calibration: Calibration,
    axes: Axes,
    *,
    predictions: Mapping[float, Prediction] | None = None,
    source: SourceCalibration | None = None,
) -> None:
    """Draw the first loadings of all samples, and the model once for each length.

    Parameters
    ----------
    calibration : its curves are drawn
    axes : to draw on
    predictions : by length, m: what the model says with its band; no band without one
    source : drawn where it is of the same curves
    """
    looks = looks_of(calibration)
    for curve in calibration.curves:
        look = looks[curve.length]
        _plot(axes, curve.deflection, FORCE.factor * curve.force, look)
    for length in looks:
        deepest = _deepest(calibration, length)
        order = np.argsort(deepest.deflection)
        x = DEFLECTION.factor * deepest.deflection[order]
        y = FORCE.factor * deepest.model[order]
        axes.plot(x, y, **MODEL_LINE)
        axes.annotate(
            length_words(length), (x[-1], y[-1]), (3, 0), textcoords="offset points",
            va="center", size=8, annotation_clip=False,
        )  # fmt: skip
        if predictions and length in predictions:
            _draw_band(axes, predictions[length], deepest)
        if source is not None:
            _draw_source(axes, calibration, source, length)
    axes.set_xlim(left=0.0)
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    axes.set_xlabel(DEFLECTION.label("Tip deflection"))
    axes.set_ylabel(FORCE.label("Force"))


def plot_residuals(calibration: Calibration, axes: Axes, *, has_own_factor: bool = False) -> None:
    """Draw measured force less that of the model against deflection.

    Parameters
    ----------
    calibration : its curves are drawn
    axes : to draw on
    has_own_factor : the model is multiplied with each sample's own factor first, so that what
        is left is noise and misfit of shape

    Notes
    -----
    Every point is drawn faint, and means over neighbouring points as a line: `N_MEANS` or more of
    them, where there are as many points.
    """
    looks = looks_of(calibration)
    axes.axhline(0.0, **_ZERO)
    for curve in calibration.curves:
        factor = curve.sample_factor if has_own_factor else 1.0
        left = SMALL_FORCE.factor * (curve.force - factor * curve.model)
        _plot(axes, curve.deflection, left, looks[curve.length], **_FAINT)
        across, up = (block_means(values, N_MEANS) for values in (curve.deflection, left))
        look = looks[curve.length]
        axes.plot(DEFLECTION.factor * across, up, color=look.colour, linestyle=look.dash, **_MEANS)
    axes.set_xlim(left=0.0)
    axes.set_xlabel(DEFLECTION.label("Tip deflection"))
    axes.set_ylabel(SMALL_FORCE.label("Measured \u2212 model"))


def source_curves(
    calibration: Calibration, source: SourceCalibration
) -> tuple[tuple[float, Floats, Floats], ...]:
    """Cut what `method: source` makes of the tests into curves.

    Returns
    -------
    Length, deflection and force (m, m, N) of each; nothing where the points are not those of the
    calibration's curves, one after the other.
    """
    ends = np.cumsum([len(curve.deflection) for curve in calibration.curves])
    joined = np.concatenate([curve.deflection for curve in calibration.curves])
    if not np.array_equal(joined, source.deflection):
        return ()
    return tuple(
        (curve.length, curve.deflection, source.model[end - len(curve.deflection) : end])
        for curve, end in zip(calibration.curves, ends.tolist(), strict=True)
    )


def _draw_source(
    axes: Axes, calibration: Calibration, source: SourceCalibration, length: float
) -> None:
    own = [each for each in source_curves(calibration, source) if each[0] == length]
    for _, deflection, force in own[:1]:
        order = np.argsort(deflection)
        across = DEFLECTION.factor * deflection[order]
        axes.plot(across, FORCE.factor * force[order], zorder=5, **SOURCE)


def _draw_band(axes: Axes, prediction: Prediction, curve: CurveAgreement) -> None:
    """The band of the mean sample, as far as the tests go."""
    use = prediction.deflection <= np.max(curve.deflection)
    axes.fill_between(
        DEFLECTION.factor * prediction.deflection[use],
        FORCE.factor * prediction.lower_mean[use],
        FORCE.factor * prediction.upper_mean[use],
        **MODEL_BAND,
    )


def _deepest(calibration: Calibration, length: float) -> CurveAgreement:
    own = [curve for curve in calibration.curves if curve.length == length]
    return max(own, key=lambda curve: float(np.max(curve.deflection)))


def _plot(axes: Axes, deflection: Floats, values: Floats, look: Look, **more: Any) -> None:
    kept = extremes(values, bins=_BINS)
    across = DEFLECTION.factor * deflection[kept]
    style = {"color": look.colour, "linestyle": look.dash, **SAMPLE, **more}
    axes.plot(across, values[kept], **style)
