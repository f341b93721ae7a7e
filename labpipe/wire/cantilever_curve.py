"""The cantilever of a wire's table: end load against deflection, from rest."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from labpipe.law.play_fits import concave_law
from labpipe.law.plays import PlayLaw
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.wire import WireAtRest, WireSpec, WireTable
from labpipe.wire.bending_law import MomentCurve
from labpipe.wire.cantilever import CantileverShape
from labpipe.wire.end_load import deflection_at
from labpipe.wire.end_load_path import end_load_path

N_DEFLECTIONS = 49
"""Points of the curve, including zero."""
FARTHEST = 0.8
"""Tip deflection at its end, as a share of the length."""


@dataclass(frozen=True, slots=True, eq=False)
class CantileverCurve:
    """The cantilever of a wire.

    Parameters
    ----------
    deflection, force : shape (n,), m and N, of the tip, from rest
    clamp_moment : shape (n,), N m
    rest : None where the wire's weight is left out
    notes : reasons of an early end, neglected effects
    """

    deflection: Floats
    force: Floats
    clamp_moment: Floats
    rest: WireAtRest | None
    notes: tuple[QualityNote, ...]

    def deflection_at(self, law: MomentCurve, curvature: float) -> float:
        """Return the deflection at a curvature of the clamp, m; infinite if it is not reached."""
        if curvature >= law.curvature[-1]:
            return float("inf")
        moment = float(np.interp(curvature, law.curvature, law.moment))
        if moment >= self.clamp_moment[-1]:
            return float("inf")
        return float(PchipInterpolator(self.clamp_moment, self.deflection)(moment))


def cantilever_of(spec: WireSpec, curve: MomentCurve, self_weight: float) -> CantileverCurve:
    """Bend the cantilever of a wire up to the end of its law.

    Parameters
    ----------
    spec : of the wire: its free length
    curve : its law
    self_weight : N/m
    """
    try:
        law = concave_law(curve.curvature[1:], curve.moment[1:])
    except ValueError as error:
        message = f"no curve of the cantilever: {error}"
        note = QualityNote("cantilever_cut", Severity.WARNING, spec.place, message)
        return CantileverCurve(np.zeros(1), np.zeros(1), np.zeros(1), None, (note,))
    wanted = FARTHEST * spec.length
    end = min(wanted, deflection_at(law, spec.length, float(curve.moment[-1])))
    notes = []
    try:
        bent = _bend_to(law, spec.length, end, self_weight)
    except ValueError as error:
        message = (
            f"the curve of the cantilever of {spec.length * 1e3:.4g} mm is without the wire's own "
            f"weight, {1e3 * self_weight * spec.length:.4g} mN: {error}"
        )
        notes.append(QualityNote("weight_left_out", Severity.WARNING, spec.place, message))
        bent = _bend_to(law, spec.length, end, 0.0)
    if bent.deflection[-1] < wanted:
        message = (
            f"the cantilever of {spec.length * 1e3:.4g} mm is reported up to a tip deflection of "
            f"{bent.deflection[-1] * 1e3:.4g} mm, not {wanted * 1e3:.4g} mm: beyond, the curvature "
            f"at the clamp leaves the range of the law, {curve.curvature[-1]:.4g} 1/m"
        )
        notes.append(QualityNote("cantilever_cut", Severity.WARNING, spec.place, message))
    return replace(bent, notes=tuple(notes))


def _bend_to(law: PlayLaw, length: float, end: float, self_weight: float) -> CantileverCurve:
    """Compute the curve up to a deflection, or to the end of the law.

    With weight the clamp reaches the end of the law at a slightly different deflection than
    without, for which `end` holds; a curve that is cut ends there.
    """
    end_share = 0.97  # of the way to the end of the law, which is extrapolated linearly
    deflection = _deflections(end)
    path = end_load_path(law, length, deflection[1:], self_weight=self_weight)
    last = len(path.load)
    if last > 1 and end < FARTHEST * length and path.rest is not None:
        clamp = np.append(path.rest.moment[0], path.clamp_moment)
        slope = (clamp[-1] - clamp[-2]) / (deflection[last] - deflection[last - 1])
        ahead = (law.largest_moment - clamp[-1]) / slope
        deflection = _deflections(deflection[last] + end_share * ahead)
        path = end_load_path(law, length, deflection[1:], self_weight=self_weight)
        last = len(path.load)
    force = np.append(0.0, path.load)
    rest = _rest_record(path.rest)
    clamp = np.append(0.0 if rest is None else rest.moment, path.clamp_moment)
    return CantileverCurve(deflection[: last + 1], force, clamp, rest, ())


def _deflections(end: float) -> Floats:
    """Return the deflections of the curve, m, dense near zero."""
    spacing_power = 3  # the first point lies at 1e-5 of the last, before strands slip
    return np.asarray(end * np.linspace(0.0, 1.0, N_DEFLECTIONS) ** spacing_power)


def force_at(table: WireTable, deflection: float) -> float:
    """Interpolate the end load at a tip deflection, N, in a table.

    Parameters
    ----------
    table : of the wire
    deflection : m

    Returns
    -------
    NaN beyond the end of the curve, and without a curve.

    Notes
    -----
    Monotone cubics (Fritsch and Carlson, SIAM J. Numer. Anal. 17 (1980) 238).
    """
    if len(table.tip_deflection) < 2 or deflection > table.tip_deflection[-1]:
        return float("nan")
    return float(PchipInterpolator(table.tip_deflection, table.tip_force)(deflection))


def _rest_record(shape: CantileverShape | None) -> WireAtRest | None:
    if shape is None:
        return None
    sag = -float(np.min(shape.y))
    rest = float(shape.force[1]), float(shape.moment[0]), float(shape.curvature[0])
    return WireAtRest(*rest, sag)
