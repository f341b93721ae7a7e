"""The sliders of a wire as its numbers change: what a calibration does not know, as laws.

A law fitted anew for every set of numbers would place its sliders anew, and what a rod answers
would jump with them. Here sliders keep the slip curvatures that they were given once, and their
stiffnesses are the falls of slope of the changed law between them: smooth in every number. What is
lost is where strands begin to slip: with twice the friction up to 30 % of the moment at a few
hundredths of 1/m, and at most 1.5 % from 1 1/m on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from labpipe.law.sliders import SliderLaw
from labpipe.law.table_sliders import SLIDERS, sliders_of
from labpipe.law.thinning import thin
from labpipe.records.arrays import Floats, Vector
from labpipe.records.wire import WireSpec
from labpipe.records.wire_calibration import (
    COPPER_SCALE,
    INSULATION_MODULUS,
    PARAMETERS,
    RADIAL_FRICTION,
)
from labpipe.wire.bending_law import moment_curvature
from labpipe.wire.stretch_torsion import StretchTorsion, stretch_torsion
from labpipe.wire.wire_table import build, mass_per_length, wire_table

LAW_FACTOR = "law_factor"
"""Logarithm of what all moments are multiplied by: how specimens and spools differ."""
TORSION_FACTOR = "torsion_factor"
"""Logarithm of what the torsional stiffness is multiplied by."""
MASS_FACTOR = "mass_factor"
"""Logarithm of what the mass per length is multiplied by."""

_LEAST = 1e-9  # of the first stiffness: a slider that a changed law has no use for
_CONCAVE = 1e-12


def with_values(spec: WireSpec, values: Mapping[str, float]) -> WireSpec:
    """A wire with calibrated numbers in place of those of its sheet.

    Parameters
    ----------
    spec : of the calibrated wire, or of another of the same make
    values : by name of `PARAMETERS`, SI units; one that is missing or NaN is left as it is. The
        copper scale is a factor on the strength of the sheet

    Returns
    -------
    The wire; the radial force is what goes with its friction coefficients.
    """
    known = {name: value for name, value in values.items() if np.isfinite(value)}
    friction = spec.friction_strand + spec.friction_insulation
    modulus, table = known.get(INSULATION_MODULUS), spec.insulation_table
    if modulus is not None and table is not None:  # its curve is as much stiffer as its first slope
        strains, stresses = table
        stiffer = modulus / (stresses[0] / strains[0])
        spec = replace(
            spec, insulation_table=(strains, tuple(stiffer * stress for stress in stresses))
        )
    return replace(
        spec,
        radial_force=known[RADIAL_FRICTION] / friction
        if RADIAL_FRICTION in known
        else spec.radial_force,
        insulation_modulus=known.get(INSULATION_MODULUS, spec.insulation_modulus),
        copper_k=spec.copper_k * known.get(COPPER_SCALE, 1.0),
    )


@dataclass(frozen=True, slots=True, eq=False)
class WireLaw:
    """What a rod wants to know of a wire.

    Parameters
    ----------
    law : of bending
    torsional_stiffness : GJ at fixed length, N m^2
    axial_stiffness : EA without twist, N
    coupling : C, N m
    mass_per_length : kg/m
    """

    law: SliderLaw
    torsional_stiffness: float
    axial_stiffness: float
    coupling: float
    mass_per_length: float


@dataclass(frozen=True, slots=True, eq=False)
class LawFamily:
    """Laws of one wire with the same slip curvatures.

    Parameters
    ----------
    spec : of the wire, as its sheet has it
    values : of `PARAMETERS`, for which the slip curvatures were chosen; the sheet's own where left
        out
    base : the law with these values
    scale : of the chords, so that the base law is as much above its wire's as below
    """

    spec: WireSpec
    values: Mapping[str, float]
    base: SliderLaw
    scale: float

    def at(self, inputs: Mapping[str, float]) -> WireLaw:
        """The law of other numbers.

        Parameters
        ----------
        inputs : logarithms of `PARAMETERS`, of the values themselves; those left out are `values`,
            or the sheet's own. `LAW_FACTOR`, `TORSION_FACTOR`, `MASS_FACTOR`, 0 where left out.
            Other names are not looked at

        Raises
        ------
        WireError
            If there is no such wire.
        """
        said = {name: float(np.exp(inputs[name])) for name in PARAMETERS if name in inputs}
        spec = with_values(self.spec, {**self.values, **said})
        built = build(spec)
        corners = self.corners
        bent = moment_curvature(
            *(built.section, built.contacts, corners),
            tension=spec.tension,
            orientation=spec.orientation,
        )
        factor = float(np.exp(inputs.get(LAW_FACTOR, 0.0)))
        slopes = factor * self.scale * _falling_slopes(corners, bent.moment)
        law = replace(
            self.base,
            stiffness=float(slopes[-1]),
            stiffnesses=np.maximum(-np.diff(slopes), _LEAST * slopes[0]),
        )
        pair: StretchTorsion = stretch_torsion(built.section)
        return WireLaw(
            law,
            pair.torsional * float(np.exp(inputs.get(TORSION_FACTOR, 0.0))),
            pair.axial,
            pair.coupling,
            mass_per_length(spec, built.section) * float(np.exp(inputs.get(MASS_FACTOR, 0.0))),
        )

    @property
    def corners(self) -> Vector:
        """Zero, the slip curvatures, and the end of the range, 1/m."""
        return np.concatenate([[0.0], self.base.slip_curvatures, [self.base.last]])


def family_of(
    spec: WireSpec, values: Mapping[str, float] | None = None, *, sliders: int = SLIDERS
) -> LawFamily:
    """Choose slip curvatures for a wire, and give the laws that it has with other numbers.

    Parameters
    ----------
    spec : of the wire, as its sheet has it
    values : of `PARAMETERS`, around which it is looked at, such as those of a solution of a
        calibration; the sheet's own where left out or NaN
    sliders : at most

    Raises
    ------
    ValueError
        As `fit_sliders`.
    WireError
        As `wire_table`.
    """
    around = dict(values or {})
    table = wire_table(with_values(spec, around))
    base = sliders_of(table, sliders)
    family = LawFamily(spec, around, base, 1.0)
    moment = np.interp(family.corners, table.curvature, table.moment)
    plain = _falling_slopes(family.corners, moment)
    return replace(family, scale=base.first_stiffness / float(plain[0]))


def _falling_slopes(curvature: Floats, moment: Floats) -> Floats:
    """Slopes of the chords between corners, none above the one before it.

    A law that stiffens somewhere is bridged, as `fit_sliders` does.
    """
    slopes = np.diff(moment) / np.diff(curvature)
    if np.all(np.diff(slopes) <= _CONCAVE * slopes[0]):
        return slopes
    hull = thin(curvature, moment, most=len(curvature))
    bridged = np.interp(curvature, hull.curvature, hull.moment)
    return np.asarray(np.diff(bridged) / np.diff(curvature))
