"""Reduce processed tests to samples of a report: thinned curves, sizes, kinds of results."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from math import floor, log10

import numpy as np

from labpipe.protocol.schema import Protocol, SpecimenBlock
from labpipe.records.arrays import Floats, Ints, average_blocks
from labpipe.records.curve import Branch, Curve, Direction
from labpipe.records.declarations import Output
from labpipe.records.group import Sample, SampleCurve
from labpipe.records.result import Specimen, TestResult
from labpipe.store.read import ReportedTest

_SHARED_FACTS = (
    *("test", "specimen", "protocol", "results", "slips", "lines", "quality", "run", "date"),
    *("operator", "instruments", "inputs"),
)
"""Fields of a result that its sample has as well."""


def make_sample(test: ReportedTest, *, source: str, label: str = "") -> Sample:
    """Make the sample of a report from a processed test.

    Parameters
    ----------
    test : as read for a report
    source : its file
    label : of the test in its campaign
    """
    result, curve = test.result, test.result.curve
    curves: dict[Direction, list[SampleCurve]] = {direction: [] for direction in Direction}
    if curve is not None:
        for branch in curve.branches:
            curves[branch.direction].append(_thin(result, curve, branch))
    shared = {name: getattr(result, name) for name in _SHARED_FACTS}
    return Sample(
        **shared,
        loading=tuple(curves[Direction.LOADING]),
        unloading=tuple(curves[Direction.UNLOADING]),
        display=dict(result.display),
        source=source,
        label=label,
        shapes=test.shapes,
        law=test.law,
    )


def choose_frames(result: TestResult, time: Floats) -> tuple[Ints, Floats]:
    """Choose the frames at equal, round steps of deflection in the first loading.

    Parameters
    ----------
    result : with or without a curve
    time : shape (frames,), s, of the frames on the clock of the curve

    Returns
    -------
    frames : index of the first frame at or beyond each step; none without a loading branch
    deflection : shape of `frames`, m, of the curve at these frames
    """
    none = np.empty(0, dtype=np.int64), np.empty(0)
    branches = result.curve.branches if result.curve is not None else ()
    first = next((branch for branch in branches if branch.direction is Direction.LOADING), None)
    if first is None or result.curve is None:
        return none
    deflection: Floats = np.interp(time, result.curve.time, result.curve.displacement)
    deflection[(time < first.start_time) | (time > first.stop_time)] = np.nan
    if not np.isfinite(deflection).any():
        return none
    levels = _round_levels(float(np.nanmax(deflection)))
    beyond = [np.flatnonzero(deflection >= level) for level in levels]
    frames = np.unique([indices[0] for indices in beyond if len(indices)]).astype(np.int64)
    return frames, deflection[frames]


def _round_levels(largest: float) -> Floats:
    """Return deflections at round steps from zero to the largest one, m."""
    max_steps = 6
    if not largest > 0.0:
        return np.zeros(1)
    power = 10.0 ** floor(log10(largest / max_steps))
    step = next(
        factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power * max_steps >= largest
    )
    return np.arange(0.0, largest, step)


def _thin(result: TestResult, curve: Curve, branch: Branch) -> SampleCurve:
    """Average a branch over blocks of samples, up to the failure."""
    max_points = 2000  # blocks smear a slip or a corner by less than a line width
    is_loading, stop = branch.direction is Direction.LOADING, branch.stop
    values = {one.name: one.value for one in result.results}
    failure = values.get("failure_displacement")
    if is_loading and failure is not None:
        beyond = np.flatnonzero(curve.displacement[branch.start : stop] > failure)
        stop = branch.start + int(beyond[0]) if len(beyond) else stop
    measured = curve.force if result.aligned is None else result.aligned.series["force"].values
    displacement, force, as_measured = (
        average_blocks(series[branch.start : stop][:: 1 if is_loading else -1], max_points)
        for series in (curve.displacement, curve.force, measured)
    )
    return SampleCurve(displacement, force, as_measured=as_measured, cycle=branch.cycle)


@dataclass(frozen=True, slots=True)
class ResultKinds:
    """Names of results that groups treat specially, without cycle and part.

    Parameters
    ----------
    signed : results that may be negative
    set_by_rig : results that describe the motion of the rig, not the specimen
    """

    signed: frozenset[str] = frozenset()
    set_by_rig: frozenset[str] = frozenset()


def classify_results(protocol: Protocol) -> ResultKinds:
    """Classify the results of a protocol.

    Parameters
    ----------
    protocol : resolved; if it states the stroke, the rig sets results that depend on the stroke
    """
    outputs = dict(_list_outputs(protocol))
    states_stroke = protocol.rig.stroke is not None
    return ResultKinds(
        frozenset(name for name, output in outputs.items() if output.can_be_negative),
        frozenset(
            stem for stem, output in outputs.items() if states_stroke and output.is_set_by_stroke
        ),
    )


def _list_outputs(protocol: Protocol) -> Iterator[tuple[str, Output]]:
    for entry in protocol.results:
        values = {field.name: getattr(entry, field.name) for field in fields(entry)}
        yield from ((output.name.format_map(values), output) for output in entry.outputs)


def add_sizes(specimen: Specimen, block: SpecimenBlock) -> Specimen:
    """Add the sizes of the protocol to those of a specimen; its test sheet has priority.

    Parameters
    ----------
    specimen : from its sheet
    block : of the resolved protocol, with the overrides of the test
    """
    section = {} if block.section is None else {**vars(block.section)}
    section.pop("area", None)  # not a length
    sizes = {"length": block.length, "span": block.span, **section}
    stated = {name: size for name, size in sizes.items() if size is not None}
    return replace(specimen, dimensions={**stated, **specimen.dimensions})
