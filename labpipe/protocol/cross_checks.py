"""Checks of one part of a protocol against another, none of which needs data."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import TypeAlias

from labpipe.errors import Fault, KeyPath, in_test_sheet
from labpipe.protocol.faults import did_you_mean, one_of
from labpipe.protocol.outline import (
    RESULTS,
    Entry,
    Outline,
    Values,
    outline_of,
    result_names,
    source_faults,
)
from labpipe.protocol.plausible import plausible_faults
from labpipe.protocol.uncertainties import length_faults, size_faults
from labpipe.protocol.values import SI_UNITS
from labpipe.records.declarations import STEPS, Needs, defaults_of, existing_in
from labpipe.units import si_factor

Faults: TypeAlias = Iterator[Fault]

_DRAWS_SHAPES = ("fit-shape", "three-point-shape")
"""Steps of which one makes the shapes that `wire-shapes` shows."""


def cross_faults(data: Values) -> list[Fault]:
    """Find what is wrong between the parts of a protocol.

    Parameters
    ----------
    data : the protocol as plain values, whether or not its details are valid

    Returns
    -------
    The faults, with their paths in `data`.
    """
    outline = outline_of(data)
    checks: tuple[Callable[[Outline], Faults], ...] = (
        source_faults,
        _size_faults,
        _dimension_faults,
        _step_faults,
        _align_faults,
        _curve_faults,
        _branch_faults,
        _result_faults,
        _figure_faults,
        _display_faults,
        _group_faults,
    )
    return [fault for check in checks for fault in check(outline)]


def _size_faults(outline: Outline) -> Faults:
    """Find sizes that are known no better than they are large, or in two ways."""
    specimen = outline.block("specimen")
    yield from size_faults(specimen)
    for entry in outline.results:
        if entry.tag == "bending-stiffness":
            yield from length_faults(specimen, entry.values, ("results", entry.number))


def _dimension_faults(outline: Outline) -> Faults:
    yield from plausible_faults(outline.data, ("specimen", "rig", "markers", "results"))


def _step_faults(outline: Outline) -> Faults:
    channel_names = [channel.name for channel in outline.channels]
    earlier_tags: list[str] = []
    for step in outline.steps:
        step_type = STEPS.get(step.tag)
        if step_type is not None and step_type.on_markers:
            yield from _marker_step_faults(outline, step, earlier_tags)
        for key in existing_in(step_type, "channel") if step_type is not None else ("channel",):
            yield from _channel_faults(
                step.values, ("steps", step.number, key), channel_names, outline
            )
        if step.tag == "travel-from-speed":
            yield from _from_speed_faults(outline, step)
        yield from _span_faults(outline, step)
        channel_names = [*channel_names, *step.makes]
        earlier_tags.append(step.tag)


def _marker_step_faults(outline: Outline, step: Entry, before: list[str]) -> Faults:
    tag = step.tag
    place: KeyPath = ("steps", step.number, "step")
    if not outline.has_markers:
        yield Fault(place, f"a source of marker tracks for {tag!r}", "none", _ADD_MARKERS)
    elif not outline.block("markers"):
        yield Fault(place, f"a block 'markers' for {tag!r}", "none", "Add the block 'markers'.")
    if tag in before:
        yield Fault(place, f"{tag!r} once", "a second one", "Remove one of them.")
    needed = STEPS[tag].after
    if needed and needed not in before:
        remedy = f"Put the step {needed!r} before it."
        yield Fault(place, f"{needed!r} before {tag!r}", "no such step before", remedy)


def _from_speed_faults(outline: Outline, step: Entry) -> Faults:
    """Find a travel that nothing can be made of, where no source can take its place."""
    rig = outline.block("rig")
    if rig.get("cycles") not in (None, "1", 1):
        remedy = "Remove the step, or set 'rig.cycles' to 1."
        cycles = f"{rig.get('cycles')}"
        yield Fault(("rig", "cycles"), "one cycle for 'travel-from-speed'", cycles, remedy)
    if any(channel.name == step.values.get("channel") for channel in outline.channels):
        return
    for key in ("crosshead_speed", "stroke"):
        if key not in rig:
            remedy = f"Add 'rig.{key}', or a source that measures the displacement."
            expected = f"'rig.{key}' for 'travel-from-speed'"
            yield Fault(("steps", step.number, "step"), expected, "none", remedy)


_ADD_MARKERS = "Add the source 'markers'."


def _channel_faults(
    block: Values, path: KeyPath, valid_names: list[str], outline: Outline | None = None
) -> Faults:
    """Find a channel that does not exist, or not yet."""
    name = block.get(str(path[-1]))
    if not isinstance(name, str) or name in valid_names:
        return
    if outline is not None and name in outline.made:
        remedy = "Move it behind the step that makes this channel."
        yield Fault(path, "a channel that exists at this step", repr(name), remedy)
        return
    expected = f"one of the channels {one_of(name, valid_names)}" if valid_names else "a channel"
    remedy = did_you_mean(name, valid_names) or "No source gives a channel."
    yield Fault(path, expected, repr(name), remedy)


def _span_faults(outline: Outline, step: Entry) -> Faults:
    span = step.values.get("span")
    if isinstance(span, str) and span.strip().endswith("%") and not outline.block("branches"):
        remedy = "Add the block 'branches', or give the span in s."
        expected = "a span of time or samples where there are no branches"
        yield Fault(("steps", step.number, "span"), expected, repr(span), remedy)


def _align_faults(outline: Outline) -> Faults:
    align, place = outline.block("align"), ("align", "method")
    if outline.joins_clocks and align.get("channel") is not None:
        sources = [channel.name for channel in outline.channels]
        yield from _channel_faults(align, ("align", "channel"), sources)
    if align.get("method") != "turning-points":
        return
    if not outline.has_markers:
        yield Fault(place, "a source of marker tracks for 'turning-points'", "none", _ADD_MARKERS)
    elif not outline.has_clamp:
        remedy = "Name the rigid body at the clamp in 'markers.clamp'."
        yield Fault(place, "a clamp whose motion has the turning points", "none", remedy)


def _curve_faults(outline: Outline) -> Faults:
    curve = outline.block("curve")
    for key, unit in (("force", "N"), ("displacement", "m")):
        name = curve.get(key)
        yield from _channel_faults(curve, ("curve", key), outline.names)
        channel_unit = outline.unit_of(name) if isinstance(name, str) else None
        if channel_unit not in (None, unit):
            expected = f"a channel in {unit}"
            yield Fault(
                ("curve", key), expected, f"{name!r} in {channel_unit}", "Name another channel."
            )
    yield from _reverse_faults(outline, curve)
    names = (curve.get("force"), curve.get("displacement"))
    clocks = {outline.clock_of(str(name)) for name in names} - {None}
    if len(clocks) > 1 and not outline.joins_clocks:
        remedy = "Set 'align.method' to 'turning-points'."
        path: KeyPath = ("align", "method") if outline.block("align") else ("curve",)
        yield Fault(path, "a method that joins the two clocks of the curve", "none", remedy)


def _reverse_faults(outline: Outline, curve: Values) -> Faults:
    """Find a sign to be turned of a channel that labpipe makes itself."""
    quantities = curve.get("reverse")
    measured, step_channels = [channel.name for channel in outline.channels], outline.made
    for quantity in quantities if isinstance(quantities, list) else []:
        name = curve.get(quantity) if isinstance(quantity, str) else None
        if name in step_channels and name not in measured:
            remedy = "Its sign is that of the specimen frame: take it out of 'curve.reverse'."
            channel = f"{name!r}, which a step makes"
            yield Fault(("curve", "reverse"), "a channel that a source gives", channel, remedy)


def _branch_faults(outline: Outline) -> Faults:
    branches = outline.block("branches")
    yield from _channel_faults(branches, ("branches", "channel"), outline.names)
    if branches and not outline.block("curve"):
        yield _lacking(("branches",), "curve", "'branches'")


def _result_faults(outline: Outline) -> Faults:
    seen: dict[str, str] = {}
    stiffnesses: list[str] = []
    for entry in outline.results:
        tag, path = entry.tag, ("results", entry.number, "result")
        result_type = RESULTS.get(tag)
        if result_type is None:
            continue
        yield from _need_faults(outline, tag, result_type.needs, path)
        settings = {**defaults_of(result_type), **entry.values}
        for key in existing_in(result_type, "stiffness"):
            yield from _of_faults(settings.get(key), (*path[:2], key), stiffnesses)
        names = result_names(tag, entry.values)
        yield from _twice_faults(names, tag, seen, path)
        seen |= dict.fromkeys(names, tag)
        named_outputs = zip(names, result_type.outputs, strict=True)
        stiffnesses += [
            name for name, output in named_outputs if output.unit == "N/m" and output.first is None
        ]


def _twice_faults(names: tuple[str, ...], tag: str, seen: dict[str, str], path: KeyPath) -> Faults:
    """Find a result whose name in the summary another one has."""
    repeated_name = next((name for name in names if name in seen), None)
    if repeated_name is None:
        return
    repeated = repeated_name
    if "name" in defaults_of(RESULTS[tag]):
        remedy = "Give it another 'name'."
    elif "name" in defaults_of(RESULTS[seen[repeated_name]]):
        remedy = f"Give the {seen[repeated_name]} of that name another 'name'."
    else:
        remedy = "Remove one of them."
        repeated = repeated_name if tag == "normalised-stiffness" else tag
    yield Fault(path, "each result once", f"a second {repeated!r}", remedy)


def _of_faults(stiffness: object, path: KeyPath, stiffnesses: list[str]) -> Faults:
    """Find a result of a stiffness that is not above it in the list."""
    if not isinstance(stiffness, str) or stiffness in stiffnesses:
        return
    expected = "a stiffness above it in the list"
    if stiffnesses:
        expected = f"one of the stiffnesses above, {one_of(stiffness, stiffnesses)}"
    remedy = did_you_mean(stiffness, stiffnesses) or "Add a result 'stiffness' before it."
    yield Fault(path, expected, repr(stiffness), remedy)


def _need_faults(outline: Outline, tag: str, needs: Needs, path: KeyPath) -> Faults:
    for block in ("curve", "branches") if needs.branches else ():
        if not outline.block(block):
            yield _lacking(path, block, repr(tag))
    needed = needs.correction
    if needed and outline.block("curve") and not outline.block("curve", needed):
        out = in_test_sheet(f"results.{tag}", "null")
        remedy = f"Add the block {needed!r} to 'curve', or take the result out: {out}."
        yield Fault(path, f"a block 'curve.{needed}' for {tag!r}", "none", remedy)
    if needs.clocks and not outline.joins_clocks:
        expected = f"'align.method' to be 'turning-points' for {tag!r}"
        yield Fault(path, expected, "another", "Set 'align.method' to 'turning-points'.")
    if needs.shape:
        yield from _shape_faults(outline, tag, (needs.shape,), path)
    if needs.clamp:
        yield from _clamp_faults(outline, tag, path)


def _shape_faults(outline: Outline, tag: str, steps: tuple[str, ...], path: KeyPath) -> Faults:
    """Find a result or a figure of a shape that none of some steps makes."""
    if not {step.tag for step in outline.steps} & set(steps):
        remedy = f"Add the step {steps[0]!r}."
        yield Fault(path, f"the step {steps[0]!r} for {tag!r}", "no such step", remedy)


def _clamp_faults(outline: Outline, tag: str, path: KeyPath) -> Faults:
    """Find a moment without a clamped end, or with a force on another clock than the shape."""
    if not outline.has_clamp:
        remedy = "Name the rigid body at the clamp in 'markers.clamp'."
        yield Fault(path, f"a clamped end for {tag!r}", "none", remedy)
    displacement = outline.block("curve").get("displacement")
    if isinstance(displacement, str) and outline.clock_of(displacement) not in (None, "markers"):
        remedy = "Set 'curve.displacement' to 'deflection'."
        expected = f"a curve on the clock of the markers for {tag!r}"
        yield Fault(path, expected, f"displacement {displacement!r}", remedy)


def _figure_faults(outline: Outline) -> Faults:
    figures = outline.block("report").get("figures")
    names = figures if isinstance(figures, list) else []
    for number, name in enumerate(names):
        path: KeyPath = ("report", "figures", number)
        if name in ("force-displacement", "stiffness-lines", "timeline") and not outline.block(
            "curve"
        ):
            yield _lacking(path, "curve", repr(name))
        if name == "wire-shapes":
            yield from _shape_faults(outline, name, _DRAWS_SHAPES, path)
        if name == "moment-curvature" and name not in [result.tag for result in outline.results]:
            remedy = "Add a result 'moment-curvature'."
            yield Fault(path, f"a result 'moment-curvature' for {name!r}", "none", remedy)
        if name == "marker-quality" and not outline.has_markers:
            yield Fault(path, f"a source of marker tracks for {name!r}", "none", _ADD_MARKERS)
        if name in names[:number]:
            yield Fault(path, "each figure once", f"{name!r} again", "Remove one of them.")


def _display_faults(outline: Outline) -> Faults:
    for quantity, unit in outline.block("report", "display").items():
        path: KeyPath = ("report", "display", quantity)
        if quantity not in SI_UNITS:
            remedy = did_you_mean(quantity, SI_UNITS)
            expected = f"one of the quantities {one_of(quantity, SI_UNITS)}"
            yield Fault(path, expected, repr(quantity), remedy, "key")
            continue
        try:
            si_factor(str(unit), SI_UNITS[quantity])
        except ValueError:
            expected = f"a unit of {quantity} such as {SI_UNITS[quantity]}"
            yield Fault(path, expected, repr(unit), "Write the unit alone, without a number.")


def _group_faults(outline: Outline) -> Faults:
    """Find a number that the report is to show first and that no result gives."""
    entries = outline.results
    result_names_ = [name for entry in entries for name in result_names(entry.tag, entry.values)]
    main = outline.block("groups").get("main")
    for number, name in enumerate(main if isinstance(main, list) else []):
        if isinstance(name, str) and _of_any_cycle(name) not in map(_of_any_cycle, result_names_):
            expected = (
                f"one of the results {one_of(name, result_names_)}" if result_names_ else "a result"
            )
            remedy = did_you_mean(name, result_names_) or "The protocol asks for none."
            yield Fault(("groups", "main", number), expected, repr(name), remedy)


def _of_any_cycle(name: str) -> str:
    return re.sub(r"\.\d+$", ".1", name)


def _lacking(path: KeyPath, block: str, needed_for: str) -> Fault:
    expected = f"a block {block!r} for {needed_for}"
    return Fault(path, expected, "none", f"Add the block {block!r}.")
