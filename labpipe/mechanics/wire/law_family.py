"""Slider laws of a wire as functions of its uncertain parameters.

A law fitted separately for each set of parameters would move its sliders, and the response of a rod
would jump. Here sliders keep their slip curvatures, and their stiffnesses are the drops of slope of
the changed law: smooth in every parameter. The error is where strands begin to slip: with twice the
friction up to 30 % of the moment at a few hundredths of 1/m, and at most 1.5 % from 1 1/m on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from labpipe.mechanics.law.loss_card import SLIDERS, fit_wire_sliders
from labpipe.mechanics.law.sliders import GrowingSlider, SliderLaw, grow_from, share_hardening
from labpipe.mechanics.law.thinning import thin
from labpipe.mechanics.wire.bending_law import compute_moment_curve
from labpipe.mechanics.wire.cross_section import (
    CrossSection,
    StretchTorsion,
    compute_stretch_torsion,
)
from labpipe.mechanics.wire.cyclic_law import continue_strands
from labpipe.mechanics.wire.wire_table import build_wire, mass_per_length, wire_table
from labpipe.records.arrays import Floats, Vector
from labpipe.records.wire import WireSpec, WireTable
from labpipe.records.wire_calibration import (
    COPPER_SCALE,
    INSULATION_MODULUS,
    PARAMETERS,
    RADIAL_FRICTION,
)

ISOTROPIC_SHARE = "isotropic_share"
"""Share of the strands' hardening that is isotropic (PHYSICS 13)."""
UNKNOWN_SHARE = (0.35, 1.0)
"""Range of the share of annealed copper of which it is not known: with less than 0.35 it would
spring back farther than standards of winding wire allow."""
LAW_FACTOR = "law_factor"
"""Logarithm of the factor on all moments: scatter of specimens and spools."""
TORSION_FACTOR = "torsion_factor"
"""Logarithm of the factor on the torsional stiffness."""
MASS_FACTOR = "mass_factor"
"""Logarithm of the factor on the mass per length."""


def apply_values(spec: WireSpec, values: Mapping[str, float]) -> WireSpec:
    """Return a wire with calibrated values in place of those of its sheet.

    Parameters
    ----------
    spec : of the calibrated wire, or another of the same type
    values : by name of `PARAMETERS`, SI units; one that is missing or NaN is unchanged. The
        copper scale is a factor on the strength of the sheet

    Returns
    -------
    The wire; its radial force matches its friction coefficients.
    """
    finite_values = {name: value for name, value in values.items() if np.isfinite(value)}
    friction = spec.friction_strand + spec.friction_insulation
    modulus, table = finite_values.get(INSULATION_MODULUS), spec.insulation_table
    if modulus is not None and table is not None:  # its curve scales with its modulus
        strains, stresses = table
        stiffer = modulus / (stresses[0] / strains[0])
        spec = replace(
            spec, insulation_table=(strains, tuple(stiffer * stress for stress in stresses))
        )
    return replace(
        spec,
        radial_force=finite_values[RADIAL_FRICTION] / friction
        if RADIAL_FRICTION in finite_values
        else spec.radial_force,
        insulation_modulus=finite_values.get(INSULATION_MODULUS, spec.insulation_modulus),
        copper_k=spec.copper_k * finite_values.get(COPPER_SCALE, 1.0),
    )


@dataclass(frozen=True, slots=True, eq=False)
class WireLaw:
    """Properties of a wire for the rod model.

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
    values : of `PARAMETERS`, for which the slip curvatures were chosen; the sheet's by default
    base : the law with these values
    scale : of the chords, so that the base law is centred about the wire's
    """

    spec: WireSpec
    values: Mapping[str, float]
    base: SliderLaw
    scale: float

    def at(self, inputs: Mapping[str, float]) -> WireLaw:
        """Return the law for other parameters.

        Parameters
        ----------
        inputs : logarithms of `PARAMETERS`, by default those of `values` or the sheet, and
            `LAW_FACTOR`, `TORSION_FACTOR`, `MASS_FACTOR`, by default 0; and `ISOTROPIC_SHARE`, by
            default that of the sheet, or 0. Other names are ignored

        Raises
        ------
        WireError
            If there is no such wire.
        """
        # of the first stiffness, for a slider that a changed law does not use
        min_slider_share = 1e-9
        changed = {name: float(np.exp(inputs[name])) for name in PARAMETERS if name in inputs}
        spec = apply_values(self.spec, {**self.values, **changed})
        built = build_wire(spec)
        corners = self.corners
        curve = compute_moment_curve(
            *(built.section, built.contacts, corners),
            tension=spec.tension,
            orientation=spec.orientation,
        )
        factor = float(np.exp(inputs.get(LAW_FACTOR, 0.0)))
        slopes = factor * self.scale * _falling_slopes(corners, curve.moment)
        least = min_slider_share * slopes[0]
        share = min(max(inputs.get(ISOTROPIC_SHARE, spec.isotropic_share or 0.0), 0.0), 1.0)
        law = replace(
            self.base,
            stiffness=float(slopes[-1]),
            stiffnesses=np.maximum(-np.diff(slopes), least),
        )
        if share > 0.0:
            strands = make_strand_slider(built.section, law, factor * self.scale)
            law = share_hardening(law, strands, share)
        pair: StretchTorsion = compute_stretch_torsion(built.section)
        return WireLaw(
            law,
            pair.torsional * float(np.exp(inputs.get(TORSION_FACTOR, 0.0))),
            pair.axial,
            pair.coupling,
            mass_per_length(spec, built.section) * float(np.exp(inputs.get(MASS_FACTOR, 0.0))),
        )

    @property
    def corners(self) -> Vector:
        """Return zero, the slip curvatures, and the end of the range, 1/m."""
        return np.concatenate([[0.0], self.base.slip_curvatures, [self.base.last]])


def make_strand_slider(section: CrossSection, law: SliderLaw, factor: float = 1.0) -> GrowingSlider:
    """Make the growing slider of all the bending of strands about their own axes.

    Parameters
    ----------
    section : with the materials of its strands
    law : of the wire, whose corners the slider gets
    factor : on the moments of the strands, as of the law
    """
    corners = np.append(law.slip_curvatures, law.last)
    bent, strands = continue_strands(section, corners)
    return grow_from(bent, factor * strands, 1.0)


def find_chord_factor(law: SliderLaw, table: WireTable) -> float:
    """Return the factor on the chords of a table of which a law was fitted to it."""
    corners = np.concatenate([[0.0], law.slip_curvatures, [law.last]])
    moment = np.interp(corners, table.curvature, table.moment)
    return law.first_stiffness / float(_falling_slopes(corners, moment)[0])


def make_law_family(
    spec: WireSpec, values: Mapping[str, float] | None = None, *, sliders: int = SLIDERS
) -> LawFamily:
    """Choose slip curvatures for a wire, and return its family of laws.

    Parameters
    ----------
    spec : of the wire, as its sheet has it
    values : of `PARAMETERS`, for which they are chosen, such as those of a calibration; the sheet's
        where left out or NaN
    sliders : at most

    Raises
    ------
    ValueError
        As `fit_sliders`.
    WireError
        As `wire_table`.
    """
    chosen_values = dict(values or {})
    table = wire_table(apply_values(spec, chosen_values))
    base = fit_wire_sliders(table, sliders)
    return LawFamily(spec, chosen_values, base, find_chord_factor(base, table))


def _falling_slopes(curvature: Floats, moment: Floats) -> Floats:
    """Return the slopes of the chords between corners, made non-increasing.

    A law that stiffens somewhere is bridged, as `fit_sliders` does.
    """
    rounding_share = 1e-12  # of the first slope
    slopes = np.diff(moment) / np.diff(curvature)
    if np.all(np.diff(slopes) <= rounding_share * slopes[0]):
        return slopes
    hull = thin(curvature, moment, max_points=len(curvature))
    bridged = np.interp(curvature, hull.curvature, hull.moment)
    return np.asarray(np.diff(bridged) / np.diff(curvature))
