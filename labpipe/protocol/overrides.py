"""What a test sheet changes in its protocol, by its values and by the exports that it names."""

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
_LISTS = (("steps",), ("results",))
"""Blocks that a protocol may leave out and that are lists."""


def apply_overrides(protocol: Document, sheet: Document) -> None:
    """Apply the overrides of a test sheet to the protocol.

    Changed values get the positions of the sheet; overrides of unknown keys become faults. An item
    of a list that is overridden with nothing is removed, a result also from those that the report
    shows first.

    Parameters
    ----------
    protocol : the protocol as written, which is changed
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
        elif key == FOLLOW:
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
    """Remove items from their lists; the locations of the others keep their numbers as written."""
    names = {name for item in removed.values() for name in _names(item)}
    shown_first: list[KeyPath] = [
        ("groups", "main", number)
        for number, name in enumerate(get_list(merged.data, "groups", "main"))
        if str(name).partition(".")[0] in names
    ]
    for path in sorted({*removed, *shown_first}, key=lambda path: path[-1], reverse=True):
        location, _ = merged.find_location(path[:-1])
        del merged.at(path[:-1])[path[-1]]
        left = [inner for number, inner in location.inner.items() if number != path[-1]]
        location.inner = dict(enumerate(left))


def _set_value(
    merged: Document, dotted: str, sheet: Document, source: KeyPath, removed: dict[KeyPath, object]
) -> Fault | None:
    """Set the value at a dotted key to the value at a path of the sheet, if there is such a key.

    An item of a list that is set to nothing goes into `removed`, as it was.
    """
    value, (value_location, _) = sheet.at(source), sheet.find_location(source)
    key_location, _ = sheet.find_location(source[:2])
    node, location = merged.data, merged.location
    path: KeyPath = ()
    parts = dotted.split(".")
    for part in parts:
        found = _key_in(node, part)
        if found is None:
            return _unknown_key(node, part, source[:2])
        key, path = found, (*path, found)
        if len(path) == len(parts):
            break
        if isinstance(node, dict) and node.get(key) is None:
            if path in _LISTS:
                return Fault.of(
                    "protocol.override_of_no_list", source[:2], at="key", key=dotted, block=key
                )
            node[key] = {}  # a block that the protocol leaves out
            location.inner[key] = Location(
                key_location.file, key, key_location.key, value_location.value
            )
        node, location = node[key], location.inner[key]
    if isinstance(key, int) and value is None:
        removed[path] = node[key]
    node[key] = copy.deepcopy(value)
    written = location.inner[key].name if key in location.inner else key
    location.inner[key] = replace(value_location, name=written, key=key_location.key)
    return None


def _key_in(node: object, part: str) -> str | int | None:
    """Resolve a part of a dotted key: a key, or an item by number, name or kind."""
    if isinstance(node, dict):
        return part
    if not isinstance(node, list):
        return None
    number = parse_count(part)
    if number is not None:
        return number if number < len(node) else None
    # The name of a result first, then its kind: one stiffness of several may be `stiffness`.
    for words_of in (_names, _tags):
        matches = [i for i, item in enumerate(node) if part in words_of(item)]
        if len(matches) == 1:
            return matches[0]
    return None


def _tags(item: object) -> list[str]:
    """List the tags of a step or result."""
    tags = (get_block(item).get(tag) for tag in ("step", "result"))
    return [tag for tag in tags if isinstance(tag, str)]


def _names(item: object) -> list[str]:
    """List the names of the results of an item, without cycle numbers."""
    block = get_block(item)
    return [name.partition(".")[0] for name in list_result_names(str(block.get("result")), block)]


def _unknown_key(node: object, part: str, path: KeyPath) -> Fault:
    """Make the fault of an unknown dotted key."""
    if not isinstance(node, list):
        return Fault.of("protocol.below_a_value", path, at="key", key=part)
    valid = [word for item in node for word in dict.fromkeys([*_tags(item), *_names(item)])]
    remedy = "Use its number." if valid.count(part) > 1 else suggest_word(part, valid)
    last = len(node) - 1
    return Fault.of("protocol.no_item", path, at="key", key=part, last=last, remedy=remedy)


FOLLOW: Final = "follow_links"
"""Key of a protocol whose exports may be links into a store elsewhere."""


def allows_links(protocol: Document) -> bool:
    """Return whether a protocol allows exports that are links out of the folder of the test.

    Parameters
    ----------
    protocol : without what a test changes in it: a test folder from elsewhere must not decide this
    """
    return str(protocol.block.get(FOLLOW)).lower() == "true"


def find_link_faults(sheet: TestSheet, folder: Path, *, followed: bool) -> Iterator[Fault]:
    """Find exports that a link takes out of the folder of the test, or nowhere.

    Parameters
    ----------
    sheet : names the exports
    folder : of the test
    followed : whether links may lead out of it

    Returns
    -------
    Faults at the key ``files`` of the test sheet.
    """
    home = folder.resolve()
    for role, name in ((role, name) for role, names in sheet.files.items() for name in names):
        path: KeyPath = ("files", role)
        try:
            is_inside = (folder / name).resolve().is_relative_to(home)
        except (OSError, RuntimeError):  # Python 3.12 and before call a loop a RuntimeError
            yield Fault.of("protocol.link_to_itself", path, name=name)
            continue
        if not (is_inside or followed):
            yield Fault.of("protocol.link_out", path, name=name, copy=COPY_REMEDY)


_MARKER_FIGURES: Final = frozenset({"wire-shapes", "moment-curvature", "marker-quality"})
"""Figures that need a source of marker tracks."""


def remove_absent_sources(protocol: Protocol, roles: Collection[str]) -> Protocol:
    """Take out of a protocol what a test without an optional export cannot have.

    Parameters
    ----------
    protocol : as loaded
    roles : of the files that the test has

    Returns
    -------
    The protocol of this test: without the sources that are optional and absent, without the steps,
    results and figures that only these make possible, and without a ``travel-from-speed`` whose
    channel a source of the test measures.
    """
    sources = {
        role: source
        for role, source in protocol.sources.items()
        if role in roles or not source.optional
    }
    reduced = protocol.model_copy(update={"sources": sources})
    no_markers = "markers" in protocol.sources and "markers" not in sources
    one_clock = _is_made_from_speed(reduced)
    results = tuple(
        result
        for result in reduced.results
        if not (result.needs.shape and no_markers) and not (result.needs.clocks and one_clock)
    )
    removed_names = _result_names(protocol.results) - _result_names(results)
    main = tuple(name for name in reduced.groups.main if name not in removed_names)
    update: dict[str, object] = {
        "steps": tuple(_kept_steps(reduced, set(protocol.channels) - set(reduced.channels))),
        "results": results,
        "groups": reduced.groups.model_copy(update={"main": main}),
    }
    if one_clock:
        update["align"] = AlignNone()
    if no_markers:
        figures = tuple(x for x in reduced.report.figures if x not in _MARKER_FIGURES)
        update["report"] = reduced.report.model_copy(update={"figures": figures})
        update["markers"] = None
    return reduced.model_copy(update=update)


def find_absent_needs(protocol: Protocol, full_protocol: Protocol) -> Iterator[Fault]:
    """Find what a test cannot do without, although its source is optional.

    Parameters
    ----------
    protocol : as `remove_absent_sources` gives it
    full_protocol : the same with all its sources

    Returns
    -------
    Faults at the key ``files`` of the test sheet.
    """
    from_speed = {step.channel for step in protocol.steps if isinstance(step, TravelFromSpeed)}
    for role, source in full_protocol.sources.items():
        names = sorted(source.all_channels) if role not in protocol.sources else ()
        for name in names:
            if name in _needed(protocol) - from_speed:
                yield Fault.of("protocol.no_needed_file", ("files",), role=role, channel=name)
            for key in ("crosshead_speed", "stroke") if name in from_speed else ():
                if getattr(protocol.rig, key) is None:
                    yield Fault.of(
                        "protocol.no_file_or_speed", ("files",), role=role, key=key, channel=name
                    )


def _needed(protocol: Protocol) -> set[str]:
    """Return the channels without which there is no curve."""
    names = set()
    if protocol.curve is not None:
        names |= {protocol.curve.force, protocol.curve.displacement}
    if protocol.branches is not None:
        names.add(protocol.branches.channel)
    if not isinstance(protocol.align, AlignNone) and protocol.align.channel is not None:
        names.add(protocol.align.channel)
    return names


def _kept_steps(protocol: Protocol, lost: set[str]) -> Iterator[Step]:
    """Return the steps whose channel exists; one made from speed exists after its step."""
    for step in protocol.steps:
        if "markers" not in protocol.sources and step.on_markers:
            continue
        if isinstance(step, TravelFromSpeed):
            if step.channel not in protocol.channels:
                lost = lost - {step.channel}
                yield step
        elif getattr(step, "channel", None) not in lost:
            yield step


def _is_made_from_speed(protocol: Protocol) -> bool:
    """Return whether the displacement of the curve is made on the clock of the force."""
    if protocol.curve is None or protocol.curve.displacement in protocol.channels:
        return False
    step_channels = {step.channel for step in protocol.steps if isinstance(step, TravelFromSpeed)}
    return protocol.curve.displacement in step_channels


def _result_names(entries: tuple[ResultEntry, ...]) -> set[str]:
    return {name for entry in entries for name in list_result_names(entry.result, asdict(entry))}
