"""A bending test as its shape and its curve tell it, and the curves through means of its frames."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from labpipe.processing.bending_moments import (
    Layout,
    MeanFrames,
    TipPull,
    bent,
    layout_of,
    mean_frames,
    moments,
)
from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.curve import Shape


@dataclass(frozen=True, slots=True)
class BendingErrors:
    """What is uncertain of force and places, as standard errors.

    Parameters
    ----------
    force_noise : N, of the curve's force in one frame
    force_zero : N
    force_scale : a share
    offset : m, of the clamped end and of the pull point along the specimen
    other_tension_at_rest : N, a tension at rest as likely as the one assumed; None where there is
        none
    """

    force_noise: float
    force_zero: float
    force_scale: float
    offset: float
    other_tension_at_rest: float | None = None


@dataclass(frozen=True, eq=False)
class BendingTest:
    """A test as the shape and the curve tell it; arrays of shape (frames,).

    Parameters
    ----------
    shape : with clamped end and pull point, fitted in every frame
    force : N, of the curve at the frames; NaN where there is none
    branch, cycle : of the curve at the frames
    first : branch that is the first loading
    rest : frames before the loading
    centre_offset : m, axis to marker centre
    free_tip : whether the shapes were fitted without a moment at the tip
    pull : at the tip
    errors : of all this
    """

    shape: Shape
    force: Floats
    branch: Ints
    cycle: Ints
    first: int
    rest: Flags
    centre_offset: float
    free_tip: bool
    pull: TipPull
    errors: BendingErrors

    @cached_property
    def layout(self) -> Layout:
        """Where the markers are."""
        return layout_of(self.shape, centre_offset=self.centre_offset, free_tip=self.free_tip)

    @cached_property
    def standing(self) -> Standing:
        """The specimen at rest.

        Raises
        ------
        ValueError
            If fewer than two frames at rest show all markers.
        """
        branch = np.where(self.rest, 0, -1)
        each = mean_frames(self.shape, np.zeros(len(branch)), branch, per_mean=1)
        whole = np.isfinite(each.markers).all(axis=(1, 2))
        if whole.sum() < 2:
            found = int(whole.sum())
            message = f"rest: expected frames at rest that show all markers, found {found}"
            raise ValueError(message)
        fit = self.layout.fit(each.markers[whole])
        markers = each.markers[whole].mean(axis=0)
        return Standing(
            markers=markers,
            coefficients=fit.coefficients.mean(axis=0)[None],
            finer=self.layout.fit(markers[None], more=min(fit.spare, 1)).coefficients,
            frames=int(whole.sum()),
            noise=fit.noise(slice(None)),
        )

    def frames(self, branch: Ints, *, per_mean: int) -> FittedFrames:
        """Curves through means over consecutive frames.

        Parameters
        ----------
        branch : shape (frames,); frames of a negative branch are left out
        per_mean : frames

        Raises
        ------
        ValueError
            If no mean has both a shape and a force.
        """
        means = mean_frames(self.shape, self.force, branch, per_mean=per_mean)
        fit = self.layout.fit(means.markers)
        usable = np.isfinite(fit.coefficients).all(axis=(1, 2)) & np.isfinite(means.force)
        if not usable.any():
            message = "force: expected means with a shape and a force, found none"
            raise ValueError(message)
        finer = self.layout.fit(means.markers, more=1) if fit.spare > 0 else None
        return FittedFrames(
            means=means.part(usable),
            coefficients=fit.coefficients[usable],
            finer=None if finer is None else finer.coefficients[usable],
            tip_gain=fit.gain[usable, :2].max(axis=1),
        )

    def moments(
        self,
        coefficients: Floats,
        reading: Floats,
        places: Floats,
        *,
        pull: TipPull | None = None,
    ) -> Floats:
        """Bending moments along fitted curves.

        Parameters
        ----------
        coefficients : shape (n, 3, terms), m
        reading : shape (n,), N, tension less that at rest
        places : shape (stations,), m
        pull : another than that of the test

        Returns
        -------
        shape (n, stations), N m.
        """
        length = self.layout.length
        tip = bent(coefficients, length, np.array([length]))
        force = (self.pull if pull is None else pull).force(reading, tip.x[:, 0])
        return moments(bent(coefficients, length, places), tip, force)


@dataclass(frozen=True, slots=True, eq=False)
class Standing:
    """The specimen at rest.

    Parameters
    ----------
    markers : shape (markers, 3), m, mean places
    coefficients : shape (1, 3, terms), m, of the mean curve
    finer : the same with one coefficient more where the markers carry it
    frames : that show all markers
    noise : m, standard deviation of one coordinate of one marker; NaN where the markers leave no
        residual
    """

    markers: Floats
    coefficients: Floats
    finer: Floats
    frames: int
    noise: float


@dataclass(frozen=True, slots=True, eq=False)
class FittedFrames:
    """Means of frames that have a shape and a force, and the curves through them.

    Parameters
    ----------
    means : the means
    coefficients : shape (n, 3, terms), m
    finer : shape (n, 3, terms + 1), m; None where the markers do not carry one coefficient more
    tip_gain : shape (n,), standard error of the tip per standard deviation of a marker coordinate
    """

    means: MeanFrames
    coefficients: Floats
    finer: Floats | None
    tip_gain: Floats
