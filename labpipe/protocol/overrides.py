"""Changes of a protocol for one test: overrides in the test sheet, and absent optional exports."""

from __future__ import annotations

import copy
from collections.abc import Collection, Iterator, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Final

from labpipe.errors import Fault, KeyPath
from labpipe.protocol.cross_checks import list_result_names
from labpipe.protocol.schema import AlignNone, Protocol, ResultEntry
from labpipe.protocol.sheet_grammar import COPY_REMEDY, TestSheet
from labpipe.protocol.yaml_text import Document, Location, get_block, get_list, suggest_word
from labpipe.records.declarations import Step, TravelFromSpeed
from labpipe.units import parse_count

SHEET_DIMENSIONS = ("length", "gauge_length", "span", "mass_per_length", "section")
"""Keys of the sheet's specimen that override those of the protocol."""
_LIST_BLOCKS = (("steps",), ("results",))
"""Optional blocks of a protocol that are lists."""


def apply_overrides(protocol: Document, sheet: Document) -> None:
    """Apply the overrides of a test sheet to a protocol.

    Changed values get the locations in the sheet. Overrides of unknown keys are added to the faults
    of the protocol. An override with null removes an item of a list; a result is then also removed
    from ``groups.main``.

    Parameters
    ----------
    protocol : as written; it is modified
    sheet : a valid test sheet as written
    """
    removed: dict[KeyPath, object] = {}
    specimen, overrides = get_block(sheet.data, "specimen"), get_block(sheet.data, "overrides")
    own: dict[str, KeyPath] = {
        f"specimen.{key}": ("specimen", key) for key in SHEET_DIMENSIONS if specimen.get(key)
    }
    for key in get_block(specimen, "uncertainty"):
        own[f"specimen.uncertainty.{key}"] = ("specimen", "uncertainty", key)
    changes = {**own}
    for key in overrides:
        path: KeyPath = ("overrides", key, "value")
        if key in own:
            here, there = sheet.at(path), sheet.at(own[key])
            twice = Fault.of("protocol.override_twice", path, key=key, here=here, there=there)
            protocol.faults.append(sheet.place(twice))
        elif key == FOLLOW_LINKS:
            fixed = Fault.of("protocol.not_overridable", path[:2], at="key", key=key)
            protocol.faults.append(sheet.place(fixed))
        else:
            changes[key] = path
    for key, path in changes.items():
        if fault := _set_value(protocol, key, sheet, path, removed):
            protocol.faults.append(sheet.place(fault))
    align = protocol.block.get("align")
    if "align" in overrides and isinstance(align, dict) and align.get("method") == "stated":
        align.setdefault("because", sheet.at(("overrides", "align", "because")))
    _remove_items(protocol, removed)


def _remove_items(merged: Document, removed: Mapping[KeyPath, object]) -> None:
    """Remove items from their lists; locations of the other items keep their written numbers."""
    names = {name for item in removed.values() for name in _list_names(item)}
    main_paths: list[KeyPath] = [
        ("groups", "main", number)
        for number, name in enumerate(get_list(merged.data, "groups", "main"))
        if str(name).partition(".")[0] in names
    ]
    for path in sorted({*removed, *main_paths}, key=lambda path: path[-1], reverse=True):
        location, _ = merged.find_location(path[:-1])
        del merged.at(path[:-1])[path[-1]]
        left = [inner for number, inner in location.inner.items() if number != path[-1]]
        location.inner = dict(enumerate(left))


def _set_value(
    merged: Document, dotted: str, sheet: Document, source: KeyPath, removed: dict[KeyPath, object]
) -> Fault | None:
    """Set the value at a dotted key to the value at a path of the sheet.

    If the new value of an item of a list is null, the old item is added to `removed`. The fault is
    that of an unknown key.
    """
    value, (value_location, _) = sheet.at(source), sheet.find_location(source)
    key_location, _ = sheet.find_location(source[:2])
    node, location = merged.data, merged.location
    path: KeyPath = ()
    parts = dotted.split(".")
    for part in parts:
        found_key = _find_key(node, part)
        if found_key is None:
            return _build_key_fault(node, part, source[:2])
        key, path = found_key, (*path, found_key)
        if len(path) == len(parts):
            break
        if isinstance(node, dict) and node.get(key) is None:
            if path in _LIST_BLOCKS:
                return Fault.of(
                    "protocol.override_of_no_list", source[:2], at="key", key=dotted, block=key
                )
            node[key] = {}  # the protocol has no such block
            location.inner[key] = Location(
                key_location.file, key, key_location.key, value_location.value
            )
        node, location = node[key], location.inner[key]
    if isinstance(key, int) and value is None:
        removed[path] = node[key]
    node[key] = copy.deepcopy(value)
    name = location.inner[key].name if key in location.inner else key
    location.inner[key] = replace(value_location, name=name, key=key_location.key)
    return None


def _find_key(node: object, part: str) -> str | int | None:
    """Resolve a part of a dotted key: a key, or an item by number, name or kind."""
    if isinstance(node, dict):
        return part
    if not isinstance(node, list):
        return None
    number = parse_count(part)
    if number is not None:
        return number if number < len(node) else None
    # Names precede kinds: of several stiffnesses, one may have the name `stiffness`.
    for list_words in (_list_names, _list_kinds):
        matches = [i for i, item in enumerate(node) if part in list_words(item)]
        if len(matches) == 1:
            return matches[0]
    return None


def _list_kinds(item: object) -> list[str]:
    """List the kinds of an item, as a step or a result."""
    kinds = (get_block(item).get(key) for key in ("step", "result"))
    return [kind for kind in kinds if isinstance(kind, str)]


def _list_names(item: object) -> list[str]:
    """List the names of the numbers that a result gives, without numbers of cycles."""
    block = get_block(item)
    return [name.partition(".")[0] for name in list_result_names(str(block.get("result")), block)]


def _build_key_fault(node: object, part: str, path: KeyPath) -> Fault:
    """Build the fault of an unknown part of a dotted key."""
    if not isinstance(node, list):
        return Fault.of("protocol.below_a_value", path, at="key", key=part)
    valid = [word for item in node for word in {*_list_kinds(item), *_list_names(item)}]
    remedy = "Use its number." if valid.count(part) > 1 else suggest_word(part, valid)
    last = len(node) - 1
    return Fault.of("protocol.no_item", path, at="key", key=part, last=last, remedy=remedy)


FOLLOW_LINKS: Final = "follow_links"
"""Key of a protocol that allows exports to be links out of the folder of the test."""


def allows_links(protocol: Document) -> bool:
    """Return whether a protocol allows exports that are links out of the folder of the test.

    Parameters
    ----------
    protocol : without overrides; a test folder from elsewhere must not allow this itself
    """
    return str(protocol.block.get(FOLLOW_LINKS)).lower() == "true"


def find_link_faults(sheet: TestSheet, folder: Path, *, followed: bool) -> Iterator[Fault]:
    """Find exports that are links out of the folder of the test, or links to themselves.

    Parameters
    ----------
    sheet : the test sheet
    folder : of the test
    followed : whether links out of it are allowed

    Returns
    -------
    Faults at the key ``files`` of the test sheet.
    """
    home = folder.resolve()
    for role, name in ((role, name) for role, names in sheet.files.items() for name in names):
        path: KeyPath = ("files", role)
        try:
            is_inside = (folder / name).resolve().is_relative_to(home)
        except (OSError, RuntimeError):  # a loop is a RuntimeError up to Python 3.12
            yield Fault.of("protocol.link_to_itself", path, name=name)
            continue
        if not (is_inside or followed):
            yield Fault.of("protocol.link_out", path, name=name, copy=COPY_REMEDY)


_MARKER_FIGURES: Final = frozenset({"wire-shapes", "moment-curvature", "marker-quality"})
"""Figures that need a source of marker tracks."""


def remove_absent_sources(protocol: Protocol, roles: Collection[str]) -> Protocol:
    """Remove absent optional sources from a protocol, and everything that needs them.

    Parameters
    ----------
    protocol : as loaded
    roles : of the files of the test

    Returns
    -------
    The protocol of this test: without absent optional sources, without the steps, results and
    figures that need them, and without a ``travel-from-speed`` whose channel a source measures.
    """
    sources = {
        role: source
        for role, source in protocol.sources.items()
        if role in roles or not source.optional
    }
    reduced = protocol.model_copy(update={"sources": sources})
    no_markers = "markers" in protocol.sources and "markers" not in sources
    has_one_clock = _has_travel_from_speed(reduced)
    results = tuple(
        result
        for result in reduced.results
        if not (result.needs.shape and no_markers) and not (result.needs.clocks and has_one_clock)
    )
    removed_names = _list_all_names(protocol.results) - _list_all_names(results)
    main = tuple(name for name in reduced.groups.main if name not in removed_names)
    update: dict[str, object] = {
        "steps": tuple(
            _list_possible_steps(reduced, set(protocol.channels) - set(reduced.channels))
        ),
        "results": results,
        "groups": reduced.groups.model_copy(update={"main": main}),
    }
    if has_one_clock:
        update["align"] = AlignNone()
    if no_markers:
        figures = tuple(
            figure for figure in reduced.report.figures if figure not in _MARKER_FIGURES
        )
        update["report"] = reduced.report.model_copy(update={"figures": figures})
        update["markers"] = None
    return reduced.model_copy(update=update)


def find_absent_needs(protocol: Protocol, full_protocol: Protocol) -> Iterator[Fault]:
    """Find channels of absent optional sources without which there is no curve.

    Parameters
    ----------
    protocol : from `remove_absent_sources`
    full_protocol : the same with all sources

    Returns
    -------
    Faults at the key ``files`` of the test sheet.
    """
    from_speed = {step.channel for step in protocol.steps if isinstance(step, TravelFromSpeed)}
    for role, source in full_protocol.sources.items():
        names = sorted(source.all_channels) if role not in protocol.sources else ()
        for name in names:
            if name in _list_curve_channels(protocol) - from_speed:
                yield Fault.of("protocol.no_needed_file", ("files",), role=role, channel=name)
            for key in ("crosshead_speed", "stroke") if name in from_speed else ():
                if getattr(protocol.rig, key) is None:
                    yield Fault.of(
                        "protocol.no_file_or_speed", ("files",), role=role, key=key, channel=name
                    )


def _list_curve_channels(protocol: Protocol) -> set[str]:
    """List the channels without which there is no curve."""
    names = set()
    if protocol.curve is not None:
        names |= {protocol.curve.force, protocol.curve.displacement}
    if protocol.branches is not None:
        names.add(protocol.branches.channel)
    if not isinstance(protocol.align, AlignNone) and protocol.align.channel is not None:
        names.add(protocol.align.channel)
    return names


def _list_possible_steps(protocol: Protocol, lost: set[str]) -> Iterator[Step]:
    """List the steps whose channels exist; `lost` are those of absent sources."""
    for step in protocol.steps:
        if "markers" not in protocol.sources and step.on_markers:
            continue
        if isinstance(step, TravelFromSpeed):
            if step.channel not in protocol.channels:
                lost = lost - {step.channel}
                yield step
        elif getattr(step, "channel", None) not in lost:
            yield step


def _has_travel_from_speed(protocol: Protocol) -> bool:
    """Return whether the displacement of the curve is computed on the clock of the force."""
    if protocol.curve is None or protocol.curve.displacement in protocol.channels:
        return False
    step_channels = {step.channel for step in protocol.steps if isinstance(step, TravelFromSpeed)}
    return protocol.curve.displacement in step_channels


def _list_all_names(entries: tuple[ResultEntry, ...]) -> set[str]:
    return {name for entry in entries for name in list_result_names(entry.result, asdict(entry))}
