"""Forces of all curves at given parameters, with their derivatives by their logarithms."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.calibration import PARAMETERS
from labpipe.wire.calibrating.data import MeasuredCurve, whiten
from labpipe.wire.calibrating.parts import WireParts, loading_law
from labpipe.wire.cantilever import StringRig
from labpipe.wire.first_loading import LoadingCurve, force_at, load_cantilever

_MARGIN, _WIDER = 1.5, 1.5
_J, _M, _R = slice(0, len(PARAMETERS)), len(PARAMETERS), len(PARAMETERS) + 1
COLUMNS = len(PARAMETERS) + 2
"""Of a Gram matrix: the derivatives by the parameters, the model's force, the residual."""


@dataclass(frozen=True, slots=True, eq=False)
class ModelForce:
    """Forces of one curve: shape (n,), N, and their derivatives, shape (3, n), N."""

    force: Floats
    change: Floats


def loading_curve(
    parts: WireParts, values: Floats, length: float, rig: StringRig | None, deflection: float
) -> LoadingCurve:
    """Loading curve that reaches a deflection.

    Parameters
    ----------
    parts : the wire
    values : shape (3,), of its parameters
    length, deflection : m
    rig : as for `load_cantilever`

    Raises
    ------
    ValueError
        If first loading ends before the deflection.
    """
    share = min(deflection / length, 0.9)
    largest = _MARGIN * 3.0 * share / (1.0 - share**2) / length
    curve = load_cantilever(loading_law(parts, values, largest), length, rig)
    while curve.deflection[-1] < deflection and curve.clamp_curvature[-1] >= largest:
        largest *= _WIDER
        curve = load_cantilever(loading_law(parts, values, largest), length, rig)
    return curve


def model_forces(
    parts: WireParts, values: Floats, curves: tuple[MeasuredCurve, ...]
) -> list[ModelForce]:
    """Force of the model at every point of the curves, without the samples' own factors.

    Raises
    ------
    ValueError
        If a curve goes beyond first loading.
    """
    found: list[ModelForce | None] = [None] * len(curves)
    order = sorted(range(len(curves)), key=lambda i: _place(curves[i]))
    for _, members in groupby(order, key=lambda i: _place(curves[i])):
        numbers = list(members)
        every = np.concatenate([curves[i].deflection for i in numbers])
        first = curves[numbers[0]]
        deepest = float(np.max(np.abs(every)))
        curve = loading_curve(parts, values, first.length, first.rig, deepest)
        force, change = force_at(curve, every)
        ends = np.cumsum([len(curves[i].deflection) for i in numbers])[:-1]
        pieces = zip(numbers, np.split(force, ends), np.split(change, ends, axis=1), strict=True)
        for number, part, slopes in pieces:
            found[number] = ModelForce(part, slopes)
    return [force for force in found if force is not None]


def _place(curve: MeasuredCurve) -> tuple[float, ...]:
    rig = curve.rig
    if rig is None:
        return (curve.length,)
    return (curve.length, rig.string_length, rig.weight, rig.anchor_x, rig.anchor_height)


def gram(curve: MeasuredCurve, model: ModelForce, factor: float, correlation: float) -> Floats:
    """Whitened products of derivatives, model and residual with each other, shape (5, 5).

    Parameters
    ----------
    curve, model : measured and modelled
    factor : of the sample and the load cell on the model's force
    correlation : of neighbouring points
    """
    columns = np.empty((len(curve.force), COLUMNS))
    columns[:, _J] = factor * model.change.T
    columns[:, _M] = factor * model.force
    columns[:, _R] = curve.force - columns[:, _M]
    white = whiten(columns / np.asarray(curve.noise)[:, None], correlation)
    return np.asarray(white.T @ white)
