"""The law through the first loading of a test, with the errors that all its frames share."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from labpipe.processing.bending_cloud import bending_cloud
from labpipe.processing.bending_moments import TipPull, bent
from labpipe.processing.bending_test import BendingTest, FittedFrames
from labpipe.processing.law_shapes import LawShapes, Line, Loaded
from labpipe.processing.law_table import tabulate
from labpipe.processing.measured_law import LawFit, refine_law
from labpipe.records.arrays import Floats
from labpipe.records.bending import Bending, BendingCloud, MeasuredLaw
from labpipe.records.quality import Reason

MEANS = 80
"""Means of consecutive frames that the first loading is fitted by."""
_FEWEST = 24
_RECTANGLE = 1.0 / np.sqrt(3.0)


def measure_bending(test: BendingTest) -> Bending:
    """Measure moment against curvature: the cloud, and the law through the first loading.

    Parameters
    ----------
    test : shapes and force

    Returns
    -------
    Both, or the cloud and why there is no law.

    Raises
    ------
    ValueError
        If fewer than two frames at rest show all markers, or no mean has shape and force.
    """
    cloud = bending_cloud(test)
    try:
        law = loading_law(test, cloud)
    except ValueError as error:
        return Bending(cloud, None, Reason("no_law", str(error)))
    return Bending(cloud, law)


def loading_law(test: BendingTest, cloud: BendingCloud) -> MeasuredLaw:
    """Find the law that all frames of the first loading obey together.

    Parameters
    ----------
    test : shapes and force
    cloud : of the test; its noise says from which curvature on the law is known

    Returns
    -------
    The law, from about `MEANS` means over consecutive frames.

    Raises
    ------
    ValueError
        If the first loading has too few means, or they do not fix the law.

    Notes
    -----
    Moments are those of the fitted shapes. Changes of the compliances from what all frames share
    (zero of the force, a tension at rest that the zero hides, ends of the specimen, moments of
    shapes with one coefficient more) are found to first order and added as independent errors; an
    alternative as good as the one taken counts as a rectangle, 1 / sqrt(3) of the change. So does
    a law with half as many knots.
    """
    count = int((test.branch == test.first).sum())
    branch = np.where(test.branch == test.first, test.branch, -1)
    frames = test.frames(branch, per_mean=max(1, count // MEANS))
    n_means = len(frames.means.force)
    if n_means < _FEWEST:
        message = f"frames of the first loading={n_means}: expected at least {_FEWEST}"
        raise ValueError(message)
    loaded = _loaded(test, frames)
    if not loaded.moment.max() > np.abs(loaded.moment_at_rest).max():
        message = (
            f"moment={loaded.moment.max():.3g} N m at most: expected more towards the pull than at "
            f"rest, {np.abs(loaded.moment_at_rest).max():.3g} N m"
        )
        raise ValueError(message)
    refined = refine_law(loaded)
    return tabulate(
        refined.fit,
        [refined.change, *_Shared(test, frames, loaded, refined.fit).changes()],
        scale_error=test.errors.force_scale,
        noise=test.standing.noise / np.sqrt(frames.means.per_mean),
        curvature_noise=float(np.nanmedian(cloud.noise[cloud.branch == test.first])),
        n_frames=n_means * frames.means.per_mean,
    )


def _loaded(test: BendingTest, frames: FittedFrames) -> Loaded:
    layout, rest = test.layout, test.standing
    line = Line.through(layout.arc_length, layout.length)
    still = bent(rest.coefficients, layout.length, line.arc_length)
    return Loaded(
        line=line,
        moment=test.moments(frames.coefficients, frames.means.force, line.arc_length),
        moment_at_rest=test.moments(rest.coefficients, np.zeros(1), line.arc_length)[0],
        angle_at_rest=still.angle[0],
        markers=frames.means.markers[..., :2],
        markers_at_rest=rest.markers[:, :2],
        rest_weight=rest.frames / frames.means.per_mean,
        centre_offset=layout.centre_offset,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Shared:
    """A law, and what all the frames that it was found from share."""

    test: BendingTest
    frames: FittedFrames
    loaded: Loaded
    fit: LawFit

    def changes(self) -> Iterator[Floats]:
        """One standard error each, as changes of the compliances."""
        errors, frames = self.test.errors, self.frames
        before = self.movement(self.loaded)

        def change(other: Loaded, share: float = 1.0) -> Floats:
            return share * self.fit.shift(self.movement(other) - before)

        yield change(self.with_reading(frames.means.force + errors.force_zero))
        if errors.other_tension_at_rest is not None:
            pull = replace(self.test.pull, tension_at_rest=errors.other_tension_at_rest)
            yield change(self.with_moments(pull=pull), _RECTANGLE)
        if frames.finer is not None:
            yield change(self.with_moments(finer=True), _RECTANGLE)
        if errors.offset > 0.0:
            yield change(self.longer_at_the_clamp(errors.offset))
            yield change(self.longer_at_the_tip(errors.offset))

    def movement(self, loaded: Loaded) -> Floats:
        """How far the law moves the markers."""
        return LawShapes.of(loaded, self.fit.basis).movement(self.fit.compliance)

    def with_reading(self, reading: Floats) -> Loaded:
        """With another force."""
        places = self.loaded.line.arc_length
        moment = self.test.moments(self.frames.coefficients, reading, places)
        return replace(self.loaded, moment=moment)

    def with_moments(self, *, pull: TipPull | None = None, finer: bool = False) -> Loaded:
        """With another pull at the tip, or with curves of one coefficient more."""
        test, frames, rest = self.test, self.frames, self.test.standing
        places, no_load = self.loaded.line.arc_length, np.zeros(1)
        if finer and frames.finer is not None:
            curves, still = frames.finer, rest.finer
        else:
            curves, still = frames.coefficients, rest.coefficients
        return replace(
            self.loaded,
            moment=test.moments(curves, frames.means.force, places, pull=pull),
            moment_at_rest=test.moments(still, no_load, places, pull=pull)[0],
        )

    def longer_at_the_clamp(self, more: float) -> Loaded:
        """With the clamped end farther back."""
        line, frames = self.loaded.line, self.frames
        places = line.arc_length
        first = places[line.markers[0]]
        longer = np.where(places < first, places * (first + more) / first, places + more)
        moment = self.test.moments(frames.coefficients, frames.means.force, longer - more)
        return replace(self.loaded, line=replace(line, arc_length=longer), moment=moment)

    def longer_at_the_tip(self, more: float) -> Loaded:
        """With the pull point farther along the tangent."""
        length = self.test.layout.length
        tip = bent(self.frames.coefficients, length, np.array([length]))
        force = self.test.pull.force(self.frames.means.force, tip.x[:, 0])
        extra = more * (force[:, 1:] * np.cos(tip.angle) - force[:, :1] * np.sin(tip.angle))
        return replace(self.loaded, moment=self.loaded.moment + extra)
