"""Where measured bending stiffnesses of harness bundles lie between the bounds of their model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain

from labpipe.records.bundle import Bundle, BundleModel
from labpipe.records.curve import Interval
from labpipe.records.group import BundlePlace, Group, Sample
from labpipe.records.quality import Reason
from labpipe.records.result import Result
from labpipe.records.wire import WireSpec, WireTable
from labpipe.wire.bundle.model import bundle_model
from labpipe.wire.bundle.stiffness import share_of_bounds
from labpipe.wire.wire_table import wire_table

STIFFNESS = "bending_stiffness"


@dataclass(frozen=True, slots=True)
class _Bounds:
    """Model of a bundle, or why there is none."""

    model: BundleModel | None
    reasons: tuple[Reason, ...] = ()


def find_places(groups: Sequence[Group], wires: Sequence[WireSpec]) -> Iterator[BundlePlace]:
    """Place the samples of each group with a bundle, and its mean, between slipping and sticking.

    Parameters
    ----------
    groups : of the report; those without a bundle have no place
    wires : of the wire sheet

    Yields
    ------
    Group by group: its samples, then its mean. The mean has bounds where all its samples have the
    same ones. What has no bounds, or no stiffness, says why.

    Notes
    -----
    The share is 0 where every wire slips on its neighbours and its strands slip too, 1 where
    nothing slips: see `share_of_bounds`.
    """
    with_bundles = [group for group in groups if _bundles(group)]
    every = dict.fromkeys(chain.from_iterable(map(_bundles, with_bundles)))
    bounds = _bounds(list(every), {wire.name: wire for wire in wires})
    for group in with_bundles:
        for sample in group.samples:
            yield _of_sample(group, sample, bounds)
        yield _of_mean(group, bounds)


def _bundles(group: Group) -> list[Bundle]:
    return [bundle for each in group.samples if (bundle := _bundle_of(each)) is not None]


def _bundle_of(sample: Sample) -> Bundle | None:
    """What bounds rest on: the wires and where they lie, whatever holds them together."""
    own = sample.specimen.bundle
    return None if own is None else Bundle(own.wires, own.arrangement, own.positions)


def _bounds(bundles: Sequence[Bundle], wires: Mapping[str, WireSpec]) -> dict[Bundle, _Bounds]:
    tables: dict[str, WireTable] = {}
    refused: dict[str, Reason] = {}
    for name in dict.fromkeys(wire.type for bundle in bundles for wire in bundle.wires):
        if name not in wires:
            refused[name] = Reason("not_in_sheet", f"no bounds: the sheet has no {name}")
            continue
        try:
            tables[name] = wire_table(wires[name])
        except ValueError as error:
            message = f"no bounds: {name} of the sheet cannot be modelled: {error}"
            refused[name] = Reason("no_law", message)
    return {bundle: _model(bundle, tables, refused) for bundle in bundles}


def _model(
    bundle: Bundle, tables: Mapping[str, WireTable], refused: Mapping[str, Reason]
) -> _Bounds:
    reasons = tuple(refused[wire.type] for wire in bundle.wires if wire.type in refused)
    if reasons:
        return _Bounds(None, reasons)
    try:
        return _Bounds(bundle_model(bundle, tables))
    except ValueError as error:
        return _Bounds(None, (Reason("no_model", f"no bounds: {error}"),))


def _of_sample(group: Group, sample: Sample, bounds: Mapping[Bundle, _Bounds]) -> BundlePlace:
    result = next((each for each in sample.results if each.name == STIFFNESS), None)
    value = None if result is None else result.value
    interval = None if result is None else result.interval
    place = BundlePlace(group.name, sample.test, value, interval, reasons=_why_no_value(result))
    bundle = _bundle_of(sample)
    if bundle is None:
        return _without(place, "no_bundle", "no bounds: its test sheet says no bundle")
    return _between(place, bounds[bundle])


def _without(place: BundlePlace, code: str, message: str) -> BundlePlace:
    return replace(place, reasons=(Reason(code, message),))


def _why_no_value(result: Result | None) -> tuple[Reason, ...]:
    if result is None:
        return (Reason("no_result", f"the test has no {STIFFNESS}"),)
    return result.reasons if result.value is None else ()


def _of_mean(group: Group, bounds: Mapping[Bundle, _Bounds]) -> BundlePlace:
    number = next((each for each in group.numbers if each.name == STIFFNESS), None)
    mean = None if number is None or number.mean is None else number.mean.chosen
    value = None if mean is None else mean.mean
    place = BundlePlace(group.name, "", value, mean.interval if mean else None)
    if mean is None:
        place = _without(place, "no_result", f"no sample has a {STIFFNESS}")
    shared = list(dict.fromkeys(map(_bundle_of, group.samples)))
    if len(shared) > 1 or shared[0] is None:
        return _without(place, "bundles_differ", "no bounds: its samples differ in them")
    return _between(place, bounds[shared[0]])


def _between(place: BundlePlace, bounds: _Bounds) -> BundlePlace:
    model = bounds.model
    if model is None:
        return replace(place, reasons=bounds.reasons)
    place = replace(
        place, low=model.low, free=model.free, high=model.high, principal=model.principal
    )
    if place.value is None:
        return place
    if not model.high > model.low:
        return _without(place, "one_bound", "no share: the two bounds are the same")
    share = partial(share_of_bounds, low=model.low, high=model.high)
    own = place.interval
    ends = None if own is None else Interval(share(own.lower), share(own.upper), own.level)
    return replace(place, share=share(place.value), share_interval=ends)
