"""Profile of a calibrated parameter: how much worse the fit becomes where it is held."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.calibration import CalibratedParameter, Profile
from labpipe.report.calibration_look import MODEL, SHOWN, SOURCE, typeset
from labpipe.report.page import GREY, number_log

if TYPE_CHECKING:
    from matplotlib.axes import Axes

THRESHOLD: dict[str, Any] = {"color": "black", "linewidth": 0.8, "linestyle": (0, (4, 1.6))}
INTERVAL: dict[str, Any] = {"color": "#dddddd", "linewidth": 0, "zorder": 0}
PRIOR: dict[str, Any] = {"color": "#009E73", "linewidth": 1.0, "linestyle": (0, (1.4, 1.2))}
_CURVE: dict[str, Any] = {"color": MODEL, "linewidth": 1.2}
_DOTS: dict[str, Any] = {"color": MODEL, "linestyle": "", "marker": "o", "markersize": 2.2}
_VALUE: dict[str, Any] = {"color": "black", "marker": "^", "markersize": 4.5, "clip_on": False}
_HEIGHT = 2.6
"""Of a panel, over the threshold."""
_MARGIN = 0.12
"""Beside what a panel has to show, as a share of it in logarithms."""
_NORMAL = 1.959963984540054
_FINE = 200
_NARROW_LINE = 30
_NARROW, _WIDE = 6.0, 500.0
"""Ratio of the ends of an axis below which 1, 2, 5 are too few ticks, above which decades are too
many."""


def plot_profile(
    parameter: CalibratedParameter, axes: Axes, *, elsewhere: float | None = None
) -> None:
    """Draw the deviance of a parameter on a logarithmic axis.

    Parameters
    ----------
    parameter : one that was not fitted gets a panel that says so
    axes : to draw on; with the threshold on either side of the value, the 95 % interval in grey up
        to the end of the panel where it is open, the value as a triangle, and the deviance of the
        prior from its own centre where there is one
    elsewhere : SI, a value that another method found
    """
    profile = parameter.profile
    if profile is None or parameter.interval is None:
        _say(axes, typeset(parameter.words))
        return
    shown = SHOWN[parameter.name]
    low, high = seen(parameter, elsewhere)
    at = shown.scale.factor * np.array([low, parameter.value, high])
    axes.set_xscale("log")
    axes.axvspan(
        at[0] if parameter.is_open_below else shown.scale.factor * parameter.interval.lower,
        at[2] if parameter.is_open_above else shown.scale.factor * parameter.interval.upper,
        **INTERVAL,
    )
    values, deviance = smooth(profile)
    axes.plot(shown.scale.factor * values, deviance, **_CURVE)
    axes.plot(shown.scale.factor * profile.value, profile.deviance, **_DOTS)
    axes.plot(at[:2], [profile.threshold_below] * 2, **THRESHOLD)
    axes.plot(at[1:], [profile.threshold_above] * 2, **THRESHOLD)
    axes.plot(at[1], 0.0, **_VALUE)
    if elsewhere is not None:
        axes.axvline(shown.scale.factor * elsewhere, **SOURCE)
    _draw_prior(parameter, axes, (low, high))
    axes.set_xlim(at[0], at[2])
    axes.set_ylim(0.0, _HEIGHT * max(profile.threshold_below, profile.threshold_above))
    axes.set_xlabel(shown.label)
    _number(axes)


def seen(parameter: CalibratedParameter, elsewhere: float | None = None) -> tuple[float, float]:
    """Find the values that the panel of a parameter shows, SI.

    Parameters
    ----------
    parameter : with a profile; its interval, or up to where its profile was followed, is seen
    elsewhere : is seen as well
    """
    profile, interval = parameter.profile, parameter.interval
    if profile is None or interval is None:
        return parameter.value, parameter.value
    inside = profile.deviance <= _HEIGHT * max(profile.threshold_below, profile.threshold_above)
    wanted = [*profile.value[inside], parameter.value]
    wanted += [end for end in (interval.lower, interval.upper) if _within(end, profile)]
    if elsewhere is not None and elsewhere > 0.0:
        wanted.append(elsewhere)
    if parameter.conflict is not None:
        wanted.append(parameter.conflict.centre)
    low, high = float(np.log(min(wanted))), float(np.log(max(wanted)))
    margin = _MARGIN * max(high - low, 0.02)
    return float(np.exp(low - margin)), float(np.exp(high + margin))


def smooth(profile: Profile) -> tuple[Floats, Floats]:
    """Lay a curve through the points at which a profile was worked out.

    Parameters
    ----------
    profile : of at least one point

    Returns
    -------
    Values, and deviances at them: of its square root, with the sign of the side, by straight lines
    over the logarithm of the value, since where a parameter is normal in it that root is straight.
    """
    logs = np.log(profile.value)
    side = np.sign(logs - logs[int(np.argmin(profile.deviance))])
    fine: Floats = np.union1d(np.linspace(logs[0], logs[-1], _FINE), logs)
    root = np.interp(fine, logs, side * np.sqrt(np.maximum(profile.deviance, 0.0)))
    return np.exp(fine), root**2


def _say(axes: Axes, sentence: str) -> None:
    axes.set_axis_off()
    axes.text(
        0.5, 0.5, textwrap.fill(sentence, _NARROW_LINE), transform=axes.transAxes, ha="center",
        va="center", color=GREY,
    )  # fmt: skip


def _within(end: float, profile: Profile) -> bool:
    return bool(profile.value[0] <= end <= profile.value[-1])


def _draw_prior(parameter: CalibratedParameter, axes: Axes, ends: tuple[float, float]) -> None:
    """Draw the square of the distance from the prior's centre in its standard deviations."""
    if parameter.conflict is None:
        return
    values: Floats = np.geomspace(*ends, 200)
    error = np.log(parameter.conflict.factor) / _NORMAL
    away = np.log(values / parameter.conflict.centre) / error
    axes.plot(SHOWN[parameter.name].scale.factor * values, away**2, **PRIOR)


def _number(axes: Axes) -> None:
    from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

    axes.yaxis.set_major_locator(MaxNLocator(4, integer=True))
    low, high = axes.get_xlim()
    number_log(axes.xaxis)
    if high < _NARROW * low:
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.xaxis.set_minor_locator(NullLocator())
    elif high > _WIDE * low:
        axes.xaxis.set_major_locator(LogLocator(numticks=4))
        axes.xaxis.set_minor_locator(NullLocator())
