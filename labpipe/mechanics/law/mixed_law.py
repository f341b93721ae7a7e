"""Curvature as a function of moment, for a wire whose copper hardens partly isotropically.

`law.sliders` computes the moment at a curvature, but a cantilever needs the curvature at a moment.
The law of this module solves for the curvature at every station. On first loading it equals the
law of plays from which it was made, for every isotropic share.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from labpipe.mechanics.law.growing_slider import grow_from
from labpipe.mechanics.law.plays import PlayLaw, Response
from labpipe.mechanics.law.sliders import SliderLaw, bend_to_moment, make_unbent_rests
from labpipe.records.arrays import Floats


@dataclass(frozen=True, slots=True, eq=False)
class MixedLaw(PlayLaw):
    """A law of a wire with partly isotropic hardening, which computes curvature from moment.

    Its plays are those of first loading, which state the stiffness and the range.

    Parameters
    ----------
    sliders : law with the same first loading, which computes all responses
    """

    sliders: SliderLaw = field(kw_only=True, repr=False)

    def make_unbent_history(self, n_stations: int) -> Floats:
        """Return the history of a wire that was never bent, 1/m.

        Parameters
        ----------
        n_stations : number of stations along the wire

        Returns
        -------
        Shape (stations, 1 + n): the curvature, then the history of the sliders, see
        `SliderResponse`.
        """
        slider_history = make_unbent_rests(self.sliders, n_stations)
        return np.concatenate([np.zeros((n_stations, 1)), slider_history], axis=1)

    def respond(self, moment: Floats, history: Floats) -> Response:
        """Compute the curvatures under new moments.

        Parameters
        ----------
        moment : shape (stations,), N m; each is reached monotonically
        history : shape (stations, 1 + n), 1/m, from the last step or `make_unbent_history`

        Returns
        -------
        The response; its `plays` are the new history, shape (stations, 1 + n), 1/m. A moment of NaN
        gives NaN at its station.
        """
        curvature, response = bend_to_moment(self.sliders, moment, history[:, 0], history[:, 1:])
        new_history = np.concatenate([curvature[:, None], response.rests], axis=1)
        return Response(curvature, 1.0 / response.stiffness, new_history)


def make_mixed_law(
    plays: PlayLaw, curvature: Floats, strand_moment: Floats, isotropic_share: float
) -> MixedLaw:
    """Make the law of a wire whose strands harden partly isotropically.

    Parameters
    ----------
    plays : law of the wire on first loading
    curvature : shape (n,), 1/m, positive and increasing: first the curvatures at the half-widths
        of `plays` and at its largest moment, then larger ones that the strands reach in loops
    strand_moment : shape (n,), N m, moment of the strands about their own axes
    isotropic_share : share of that moment that hardens isotropically, above 0 and at most 1

    Raises
    ------
    ValueError
        If the share is outside its range.
    """
    moment = np.append(plays.half_widths, plays.largest_moment)
    corners = curvature[: len(moment)]
    growing_slider = grow_from(curvature, strand_moment, isotropic_share)
    masing_moment = moment - growing_slider.first_loading(corners)
    slopes = np.diff(masing_moment, prepend=0.0) / np.diff(corners, prepend=0.0)
    slope_drops = -np.diff(np.minimum.accumulate(slopes))
    has_slider = slope_drops > 0.0
    sliders = SliderLaw(
        max(float(slopes.min()), 0.0),  # nothing but rounding remains of a bare solid wire
        slope_drops[has_slider],
        corners[:-1][has_slider],
        0.0,
        float(corners[-1]),
        growing=(growing_slider,),
    )
    return MixedLaw(
        *(plays.stiffness, plays.half_widths, plays.compliances, plays.largest_moment),
        sliders=sliders,
    )
