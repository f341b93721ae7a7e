"""First loadings of processed cantilever tests, as a calibration takes them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from labpipe.errors import LabpipeError
from labpipe.protocol.load import parse_protocol
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Curve, Direction
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.result import Status, TestResult
from labpipe.statistics.bands import block_means
from labpipe.store.read import read_outcome
from labpipe.wire.calibrating.data import DEEPEST, MeasuredCurve
from labpipe.wire.cantilever import StringRig

GRAVITY = 9.80665
"""m/s^2, standard acceleration of free fall."""
_FEWEST = 20
"""Points of a curve with which something can be said."""
_SECOND_DIFFERENCE = np.sqrt(6.0)
"""Standard deviation of a second difference of white noise, over that of the noise."""


@dataclass(frozen=True, slots=True, eq=False)
class FirstLoading:
    """The first loading of a processed test.

    Parameters
    ----------
    curve : as calibrations take it
    gain : standard uncertainty of the load cell's gain, as a ratio
    notes : what is doubtful about it, or was cut off
    file : that it was read from
    """

    curve: MeasuredCurve
    gain: float
    notes: tuple[QualityNote, ...]
    file: Path = Path()


class NotUsableError(LabpipeError):
    """A test has no first loading that a calibration could take; the message says why."""


def read_first_loadings(
    files: Sequence[Path],
    *,
    points: int,
    up_to: float | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> tuple[list[FirstLoading], dict[str, str]]:
    """Read first loadings, test after test.

    Parameters
    ----------
    files : result.h5 files
    points : of each curve, about; each is the mean of consecutive samples
    up_to : m, largest deflection that is taken; None for as far as a first loading is followed
    say : told the name of each test as it is read

    Returns
    -------
    The curves, and by file why a test was left out.
    """
    found: list[FirstLoading] = []
    left_out: dict[str, str] = {}
    for file in files:
        say(file.parent.name)
        try:
            result = read_outcome(file)
            protocol = parse_protocol(result.protocol_yaml, str(file))
            loading = first_loading(result, protocol, points=points, up_to=up_to)
            found.append(replace(loading, file=file))
        except LabpipeError as error:
            said = str(error)
            left_out[str(file)] = said if str(file) in said else f"{file}: {said}"
    return found, left_out


def first_loading(
    result: TestResult, protocol: Protocol, *, points: int, up_to: float | None = None
) -> FirstLoading:
    """Take the first loading out of a processed test.

    Parameters
    ----------
    result : of a cantilever test
    protocol : that it was processed by
    points, up_to : as for `read_first_loadings`

    Returns
    -------
    The curve up to its largest deflection. The string is taken to have held the wire straight at
    rest, so that the load cell, zeroed then, reads what comes on top of the counterweight.

    Raises
    ------
    NotUsableError
        If there is no curve, no first loading, no free length, or too few points.

    Notes
    -----
    The noise of a point is that of the second differences of the block means.
    """
    curve, branch = _first_branch(result)
    length = result.specimen.dimensions.get("length", protocol.specimen.length)
    if length is None:
        message = "the free length is not known: give it in the test sheet (specimen.length)"
        raise NotUsableError(message)
    limit = min(up_to or np.inf, DEEPEST * length)
    part = slice(branch.start, branch.stop)
    deflection = block_means(curve.displacement[part], points)
    force = block_means(curve.force[part], points)
    usable = np.isfinite(deflection) & np.isfinite(force)
    taken = usable & (deflection > 0.0) & (deflection <= limit)
    if taken.sum() < _FEWEST:
        message = (
            f"{int(taken.sum())} points of the first loading lie between 0 and "
            f"{1e3 * limit:.3g} mm: {_FEWEST} at least are needed"
        )
        raise NotUsableError(message)
    sample = f"{result.specimen.spool}, sample {result.specimen.sample}"
    measured = MeasuredCurve(
        wire=result.specimen.type,
        test=result.test,
        sample=sample,
        length=length,
        deflection=deflection[taken],
        force=force[taken],
        noise=noise_of(force[usable]),
        rig=_rig(protocol, length),
    )
    notes = (*_doubts(result), *_cut(result.test, deflection[usable], limit))
    return FirstLoading(measured, _gain(protocol), notes)


def noise_of(force: Floats) -> float:
    """Standard deviation of the noise of consecutive values on a smooth curve, N.

    Parameters
    ----------
    force : shape (n,), N, without NaN
    """
    return float(np.std(np.diff(force, 2)) / _SECOND_DIFFERENCE)


def _first_branch(result: TestResult) -> tuple[Curve, Branch]:
    curve = result.curve
    if curve is None:
        message = "it has no curve: look at its summary"
        raise NotUsableError(message)
    first = [
        branch
        for branch in curve.branches
        if branch.cycle == 1 and branch.direction is Direction.LOADING
    ]
    if not first:
        message = "it has no first loading: no branch was found"
        raise NotUsableError(message)
    peak = next((each for each in result.results if each.name == "peak_force.1"), None)
    if peak is not None and peak.status is Status.FAILED:
        message = f"its first loading failed: {peak.reason}"
        raise NotUsableError(message)
    return curve, first[0]


def _rig(protocol: Protocol, length: float) -> StringRig | None:
    """String and counterweight as the protocol says; none where it names no string."""
    string = protocol.rig.string
    if string is None:
        return None
    return StringRig(string.length, GRAVITY * string.counterweight, length, string.length)


def _gain(protocol: Protocol) -> float:
    curve = protocol.curve
    channel = None if curve is None else protocol.channels.get(curve.force)
    return 0.0 if channel is None else channel.gain_uncertainty


def _doubts(result: TestResult) -> list[QualityNote]:
    """Say what of the curve is doubtful: results of the first cycle that rest on all of it."""
    reasons = {
        each.reason
        for each in result.results
        if each.status is Status.DOUBTFUL
        and each.name in ("peak_force.1", "peak_displacement.1", "energy.1")
    }
    return [
        QualityNote("test_doubtful", Severity.WARNING, result.test, f"taken as it is: {reason}")
        for reason in sorted(reasons)
    ]


def _cut(test: str, deflection: Floats, limit: float) -> list[QualityNote]:
    beyond = deflection > limit
    if not beyond.any():
        return []
    message = (
        f"the first loading goes to {1e3 * deflection.max():.4g} mm; what lies beyond "
        f"{1e3 * limit:.4g} mm was left out"
    )
    return [QualityNote("loading_cut", Severity.INFO, test, message)]
