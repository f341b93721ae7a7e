"""Moment-curvature law of copper that hardens isotropically in part, for moments as the input.

`law.sliders` give the moment of a curvature; a cantilever needs the curvature of a moment. This law
inverts its sliders station by station. Its first loading is that of the plays that it is made of,
for every isotropic share.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.mechanics.law.growing_slider import grow_from
from labpipe.mechanics.law.plays import PlayLaw, Response
from labpipe.mechanics.law.sliders import SliderLaw, bend_to_moment, make_unbent_rests
from labpipe.records.arrays import Floats


@dataclass(frozen=True, slots=True, eq=False)
class MixedLaw:
    """A law of plays on first loading, and of sliders with isotropic hardening after a reversal.

    Parameters
    ----------
    plays : of first loading
    sliders : with the same first loading
    """

    plays: PlayLaw
    sliders: SliderLaw

    @property
    def stiffness(self) -> float:
        """Return the bending stiffness of the first, elastic response, N m^2."""
        return self.plays.stiffness

    @property
    def half_widths(self) -> Floats:
        """Return the half-widths of the plays of first loading, N m."""
        return self.plays.half_widths

    @property
    def compliances(self) -> Floats:
        """Return the compliances of the plays of first loading, 1/(N m^2)."""
        return self.plays.compliances

    @property
    def largest_moment(self) -> float:
        """Return the end of the law, N m."""
        return self.plays.largest_moment

    def unbent(self, n_stations: int) -> Floats:
        """Return the history of a wire that was never bent: curvature, then rests, 1/m."""
        rests = make_unbent_rests(self.sliders, n_stations)
        return np.concatenate([np.zeros((n_stations, 1)), rests], axis=1)

    def respond(self, moment: Floats, history: Floats) -> Response:
        """Compute curvatures under new moments, from the history.

        Parameters
        ----------
        moment : shape (stations,), N m; each is reached monotonically
        history : of the last step, or of `unbent`
        """
        curvature, after = bend_to_moment(self.sliders, moment, history[:, 0], history[:, 1:])
        present = np.concatenate([curvature[:, None], after.rests], axis=1)
        return Response(curvature, 1.0 / after.stiffness, present)


def mix_hardening(plays: PlayLaw, curvature: Floats, strands: Floats, share: float) -> MixedLaw:
    """Make the law of a wire whose strands harden isotropically in part.

    Parameters
    ----------
    plays : of first loading of the wire
    curvature, strands : shape (n,), 1/m, positive, and N m: moments of the strands about their own
        axes. The first curvatures are those of the corners of `plays` and of its end; those beyond
        serve loops
    share : isotropic share, above 0 and at most 1

    Raises
    ------
    ValueError
        If the share is out of its range.
    """
    moment = np.append(plays.half_widths, plays.largest_moment)
    bent = curvature[: len(moment)]
    growing = grow_from(curvature, strands, share)
    masing = moment - growing.first_loading(bent)
    slopes = np.diff(masing, prepend=0.0) / np.diff(bent, prepend=0.0)
    falls = -np.diff(np.minimum.accumulate(slopes))
    slides = falls > 0.0
    sliders = SliderLaw(
        float(slopes.min()),
        falls[slides],
        bent[:-1][slides],
        0.0,
        float(bent[-1]),
        growing=(growing,),
    )
    return MixedLaw(plays, sliders)
