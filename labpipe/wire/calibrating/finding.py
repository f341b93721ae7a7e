"""The fit of a calibration and all that is told from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from labpipe.records.arrays import Flags
from labpipe.records.calibration import CalibrationFailure, ParameterChoice, ScatterMixture
from labpipe.wire.calibrating.choices import pose
from labpipe.wire.calibrating.data import MeasuredCurve, usable
from labpipe.wire.calibrating.mixture import mix
from labpipe.wire.calibrating.parts import take_apart
from labpipe.wire.calibrating.search import Fit, Levels, Problem
from labpipe.wire.calibrating.settling import settle
from labpipe.wire.calibrating.variances import Uncertainty, uncertainty
from labpipe.wire.cross_section import CrossSection
from labpipe.wire.friction import Contacts


@dataclass(frozen=True, slots=True, eq=False)
class Wire:
    """A wire as its sheet has it.

    Parameters
    ----------
    section : strands in place, with copper and insulation: nominal values
    contacts : friction coefficients, whose ratios are kept, and nominal radial force
    orientation : rad, of the section against the neutral axis
    """

    section: CrossSection
    contacts: Contacts
    orientation: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Settings:
    """What is asked of a calibration.

    Parameters
    ----------
    choices : by name of the parameter; one that is not named is free if it acts on the wire
    gain : standard uncertainty of the load cell's gain, as a ratio, common to all curves
    scatter : standard deviation of the samples' factors on the force, as a ratio, where it is
        known; else None: it is estimated from the samples
    """

    choices: Mapping[str, ParameterChoice] = field(default_factory=dict)
    gain: float = 0.0
    scatter: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The fit of a calibration.

    Parameters
    ----------
    wire, settings : what was asked for
    problem, free : what was fitted
    fit, levels : the least of the objective
    spread : covariance, and what degrees of freedom need
    mixture : covariance for each scatter that the tests allow
    """

    wire: Wire
    settings: Settings
    problem: Problem
    free: Flags
    fit: Fit
    levels: Levels
    spread: Uncertainty
    mixture: ScatterMixture

    @property
    def is_scatter_known(self) -> bool:
        """Whether the scatter of the samples was given."""
        return self.settings.scatter is not None


def find(
    wire: Wire, curves: Sequence[MeasuredCurve], settings: Settings
) -> Found | CalibrationFailure:
    """Fit a wire to its tests.

    Parameters
    ----------
    wire, settings : what is fitted
    curves : first loadings

    Raises
    ------
    ValueError
        If a choice has an unknown name, or a number is out of its range.
    """
    known = usable(tuple(curves))
    if isinstance(known, CalibrationFailure):
        return known
    parts = take_apart(wire.section, wire.contacts, orientation=wire.orientation)
    posed = pose(parts, known, settings.choices, settings.gain)
    if isinstance(posed, CalibrationFailure):
        return posed
    problem, logs, free = posed
    try:
        fit, levels = settle(problem, logs, free, scatter=settings.scatter)
    except ValueError as error:
        return CalibrationFailure("model_cannot_follow", str(error))
    is_known = settings.scatter is not None
    spread = uncertainty(problem, fit, free, levels, is_scatter_known=is_known)
    is_given = is_known or problem.n_samples == 1
    mixture = mix(problem, fit, free, levels, is_scatter_known=is_given)
    return Found(wire, settings, problem, free, fit, levels, spread, mixture)
