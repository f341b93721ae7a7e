"""Forces of all curves at given parameters, with their derivatives by their logarithms."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.calibration import PARAMETERS
from labpipe.wire.calibrating.data import MeasuredCurve, shared_errors, whiten
from labpipe.wire.calibrating.parts import WireParts, loading_law
from labpipe.wire.cantilever import StringRig
from labpipe.wire.first_loading import LoadingCurve, force_at, load_cantilever

_MARGIN, _WIDER = 1.5, 1.5
_J, _M, _R = slice(0, len(PARAMETERS)), len(PARAMETERS), len(PARAMETERS) + 1
COLUMNS = len(PARAMETERS) + 2
"""Of a Gram matrix: the derivatives by the parameters, the model's force, the residual."""


@dataclass(frozen=True, slots=True, eq=False)
class ModelForce:
    """Forces of one curve, shape (n,), N, their derivatives, shape (3, n), N, and slope, N/m."""

    force: Floats
    change: Floats
    slope: Floats


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
        rise = np.interp(np.abs(every), curve.deflection, curve.stiffness)
        parts_of = (np.split(values, ends, axis=-1) for values in (force, change, rise))
        for number, *part in zip(numbers, *parts_of, strict=True):
            found[number] = ModelForce(*part)
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

    Notes
    -----
    Errors N that the points share make the covariance R + N N', R being that of the noise. With
    whitened columns W, N the products are W'W - W'N (1 + N'N)^-1 N'W (Woodbury), as if each error
    were fitted with its own standard deviation for a prior. They are in units of the stated noise:
    where residuals show more noise, the shared errors count for as much more.
    """
    columns = np.empty((len(curve.force), COLUMNS))
    columns[:, _J] = factor * model.change.T
    columns[:, _M] = factor * model.force
    columns[:, _R] = curve.force - columns[:, _M]
    noise = np.asarray(curve.noise)[:, None]
    white = whiten(columns / noise, correlation)
    shared = whiten(shared_errors(curve, model.slope).T / noise, correlation)
    seen = shared.T @ white
    held = np.eye(shared.shape[1]) + shared.T @ shared
    return np.asarray(white.T @ white - seen.T @ np.linalg.solve(held, seen))
