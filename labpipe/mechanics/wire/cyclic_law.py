"""Moment-curvature law of a wire for paths that unload, with the hardening of its copper.

Friction and insulation follow Masing's rule. Of the moment of the strands about their own axes, the
isotropic share has a limit that grows as they yield (PHYSICS 13), so that the wire springs back
less. First loading is that of `wire.bending_law` for every share.
"""

from __future__ import annotations

import numpy as np

from labpipe.mechanics.law.plays import PlayLaw, compute_first_curvature
from labpipe.mechanics.law.sliders import MixedLaw, make_mixed_law
from labpipe.mechanics.wire.bending_law import fit_play_law, sum_strand_moments
from labpipe.mechanics.wire.cross_section import CrossSection
from labpipe.mechanics.wire.friction import Contacts
from labpipe.records.arrays import Floats

LOOP_RANGE = 8.0
"""Curvature that strands slide in loops, as a multiple of the range of the law."""


def cyclic_law(
    section: CrossSection,
    contacts: Contacts,
    *,
    isotropic_share: float,
    largest_curvature: float,
    tension: float = 0.0,
    orientation: float = 0.0,
) -> PlayLaw:
    """Compute the law of a wire for paths that unload.

    Parameters
    ----------
    section, contacts, tension, orientation : as for `wire.bending_law.compute_moment_curve`
    isotropic_share : m, from 0 (Masing's rule, the plays of `fit_play_law`) to 1
    largest_curvature : 1/m, end of the range of the law

    Raises
    ------
    ValueError
        If the share is not between 0 and 1; also as `fit_play_law`.

    Notes
    -----
    Loops slide farther than the range: the strands' curve is continued to eight times the range, or
    as far as their material is known, and straight from there.
    """
    plays = fit_play_law(
        section,
        contacts,
        largest_curvature=largest_curvature,
        tension=tension,
        orientation=orientation,
    )
    return plays if isotropic_share == 0.0 else harden(plays, section, isotropic_share)


def harden(
    plays: PlayLaw, section: CrossSection, isotropic_share: float, *, factor: float = 1.0
) -> MixedLaw:
    """Give a law of first loading the hardening of its strands.

    Parameters
    ----------
    plays : of the section
    section : with the materials of its strands
    isotropic_share : above 0 and at most 1
    factor : on the moments of the strands, as of `plays`
    """
    curvature = compute_first_curvature(plays, np.append(plays.half_widths, plays.largest_moment))
    continued_curvature, strands = continue_strands(section, curvature)
    return make_mixed_law(plays, continued_curvature, factor * strands, isotropic_share)


def continue_strands(section: CrossSection, curvature: Floats) -> tuple[Floats, Floats]:
    """Compute the moments of the strands about their own axes, for loops beyond a range, too.

    Parameters
    ----------
    section : with the materials of its strands
    curvature : shape (n,), 1/m, positive, increasing: of the range

    Returns
    -------
    Curvatures, of which the first are those given and the others reach eight times the range, or as
    far as the materials are known; and moments, N m.
    """
    known_curvature = min(
        2.0 * layer.material.largest_strain / layer.diameter for layer in section.layers
    )
    last_curvature = min(LOOP_RANGE * curvature[-1], (1.0 - 1e-9) * known_curvature)
    if last_curvature > curvature[-1]:
        curvature = np.append(curvature, np.geomspace(curvature[-1], last_curvature, 41)[1:])
    return curvature, sum_strand_moments(section, curvature)[1]
