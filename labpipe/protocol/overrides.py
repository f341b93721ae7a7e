"""What a test sheet changes in its protocol, by its values and by the exports that it names."""

from __future__ import annotations

import copy
from collections.abc import Collection, Iterator, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final

from labpipe.errors import At, Fault, KeyPath
from labpipe.protocol.cross_checks import result_names
from labpipe.protocol.faults import did_you_mean
from labpipe.protocol.schema import AlignNone, Protocol, ResultEntry
from labpipe.protocol.sheet_grammar import COPY_IT, TestSheet
from labpipe.protocol.yaml_text import Document, Spot
from labpipe.records.declarations import Step, TravelFromSpeed
from labpipe.units import whole_number

SHEET_DIMENSIONS = ("length", "span", "mass_per_length")
"""Keys of the sheet's specimen that override those of the protocol."""
_NOT_OVERRIDABLE = {"follow_links": "Write it into the protocol, or give --follow-links."}
"""Keys that a test sheet must not change, and what to do instead."""
_LISTS = (("steps",), ("results",))
"""Blocks that a protocol may leave out and that are lists."""


def with_overrides(protocol: Document, sheet: Document) -> None:
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
    specimen, overrides = sheet.data.get("specimen") or {}, sheet.data.get("overrides") or {}
    sizes = _own_sizes(specimen)

    def refuse(key: str, expected: str, found: str, remedy: str, at: At) -> None:
        path = ("overrides", key, "value")[: 2 if at == "key" else 3]
        protocol.faults.append(sheet.place(Fault(path, expected, found, remedy, at)))

    for key, path in sizes.items():
        _set_value(protocol, key, sheet, path, removed)
    for key, override in overrides.items():
        if key in sizes:
            found = f"{override['value']!r} beside {sheet.at(sizes[key])!r} in 'specimen'"
            refuse(key, f"{key!r} once", found, "Keep the one in 'specimen'.", "value")
        elif key in _NOT_OVERRIDABLE:
            remedy = _NOT_OVERRIDABLE[key]
            refuse(key, "a key that a test may change", repr(key), remedy, "key")
        else:
            _set_value(protocol, key, sheet, ("overrides", key, "value"), removed)
    align = protocol.data.get("align") if isinstance(protocol.data, Mapping) else None
    if "align" in overrides and isinstance(align, dict) and align.get("method") == "stated":
        align.setdefault("because", overrides["align"]["because"])
    _remove_items(protocol, removed)


def _own_sizes(specimen: Mapping[str, Any]) -> dict[str, KeyPath]:
    """Return the keys that a sheet's own specimen replaces, by dotted key of the protocol."""
    sizes: dict[str, KeyPath] = {
        f"specimen.{key}": ("specimen", key)
        for key in SHEET_DIMENSIONS
        if specimen.get(key) is not None
    }
    return sizes | {
        f"specimen.uncertainty.{key}": ("specimen", "uncertainty", key)
        for key in specimen.get("uncertainty") or ()
    }


def _remove_items(merged: Document, removed: Mapping[KeyPath, object]) -> None:
    """Remove items from their lists; the spots of the others keep their numbers as written."""
    shown_first = _shown_first(merged, [item for item in removed.values() if _names(item)])
    for path in sorted({*removed, *shown_first}, key=lambda path: path[-1], reverse=True):
        spot, _ = merged.spot_at(path[:-1])
        del merged.at(path[:-1])[path[-1]]
        left = [inner for number, inner in spot.inner.items() if number != path[-1]]
        spot.inner = dict(enumerate(left))


def _shown_first(merged: Document, removed: list[object]) -> Iterator[KeyPath]:
    """Find the numbers of results that the report shows first, among those of some entries."""
    names = {name for item in removed for name in _names(item)}
    groups = merged.data.get("groups") if isinstance(merged.data, Mapping) else None
    main = groups.get("main") if isinstance(groups, Mapping) else None
    for number, name in enumerate(main if isinstance(main, list) else []):
        if str(name).partition(".")[0] in names:
            yield ("groups", "main", number)


def _set_value(
    merged: Document, dotted: str, sheet: Document, source: KeyPath, removed: dict[KeyPath, object]
) -> None:
    """Set the value at a dotted key to the value at a path of the sheet.

    An item of a list that is set to nothing goes into `removed`, as it was.
    """
    value, (value_spot, _) = sheet.at(source), sheet.spot_at(source)
    key_spot, _ = sheet.spot_at(source[:2])
    node, spot = merged.data, merged.spot
    path: KeyPath = ()
    parts = dotted.split(".")
    for number, part in enumerate(parts, start=1):
        key = _key_in(node, part)
        if key is None:
            merged.faults.append(sheet.place(_unknown_key(node, part, source[:2])))
            return
        path = (*path, key)
        if number == len(parts):
            break
        if isinstance(node, dict) and node.get(key) is None:
            if path in _LISTS:
                expected = f"a key of the protocol, which has no {key!r}"
                remedy = f"Override {key!r} as a whole."
                fault = Fault(source[:2], expected, repr(dotted), remedy, "key")
                merged.faults.append(sheet.place(fault))
                return
            node[key] = {}  # a block that the protocol leaves out
            spot.inner[key] = Spot(key_spot.file, key, key_spot.key, value_spot.value)
        node, spot = node[key], spot.inner[key]
    if isinstance(path[-1], int) and value is None:
        removed[path] = node[path[-1]]
    node[path[-1]] = copy.deepcopy(value)
    name = spot.inner[path[-1]].name if path[-1] in spot.inner else path[-1]
    spot.inner[path[-1]] = replace(value_spot, name=name, key=key_spot.key)


def _key_in(node: object, part: str) -> str | int | None:
    """Resolve a part of a dotted key: a key, or an item by number, name or kind."""
    if isinstance(node, dict):
        return part
    if not isinstance(node, list):
        return None
    if part.isdecimal():
        number = whole_number(part)
        return number if number is not None and number < len(node) else None
    # The name of a result first, then its kind: one stiffness of several may be `stiffness`.
    for names_of in (_names, _tags):
        matches = [i for i, item in enumerate(node) if part in names_of(item)]
        if len(matches) == 1:
            return matches[0]
    return None


def _tags(item: object) -> list[str]:
    """List the tags of a step or result."""
    tags = [item.get(tag) for tag in ("step", "result")] if isinstance(item, Mapping) else []
    return [tag_value for tag_value in tags if isinstance(tag_value, str)]


def _names(item: object) -> list[str]:
    """List the names of the results of an item, without cycle numbers."""
    if not isinstance(item, Mapping) or not isinstance(item.get("result"), str):
        return []
    return [name.partition(".")[0] for name in result_names(item["result"], item)]


def _unknown_key(node: object, part: str, path: KeyPath) -> Fault:
    """Make the fault of an unknown dotted key."""
    if not isinstance(node, list):
        return Fault(path, "a key of the protocol", f"{part!r} below a plain value", at="key")
    valid = [word for item in node for word in dict.fromkeys([*_tags(item), *_names(item)])]
    expected = f"a number from 0 to {len(node) - 1}, or a name that one item of the list has"
    remedy = "Use its number." if valid.count(part) > 1 else did_you_mean(part, valid)
    return Fault(path, expected, repr(part), remedy, "key")


FOLLOW: Final = "follow_links"
"""Key of a protocol whose exports may be links into a store elsewhere."""
_OR_FOLLOW = (
    f" Or let links be followed: with --follow-links on the command line, or '{FOLLOW}: true' in"
    " the protocol."
)


def are_followed(protocol: Document) -> bool:
    """Return whether a protocol allows exports that are links out of the folder of the test.

    Parameters
    ----------
    protocol : without what a test changes in it: a test folder from elsewhere must not decide this
    """
    data = protocol.data if isinstance(protocol.data, Mapping) else {}
    return str(data.get(FOLLOW)).lower() == "true"


def link_faults(sheet: TestSheet, folder: Path, *, followed: bool) -> Iterator[Fault]:
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
    for role, names in sheet.files.items():
        for name in names:
            try:
                is_inside = (folder / name).resolve().is_relative_to(home)
            except (OSError, RuntimeError):  # Python 3.12 and before call a loop a RuntimeError
                actual = f"{name!r}, a link that leads back to itself"
                yield Fault(("files", role), "a file", actual, "Make the link again.")
                continue
            if not (is_inside or followed):
                expected = "a file inside the folder of the test"
                actual = f"{name!r}, a link out of it"
                yield Fault(("files", role), expected, actual, f"{COPY_IT}{_OR_FOLLOW}")


_MARKER_FIGURES: Final = frozenset({"wire-shapes", "moment-curvature", "marker-quality"})
"""Figures that need a source of marker tracks."""


def without_absent(protocol: Protocol, roles: Collection[str]) -> Protocol:
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


def absent_faults(protocol: Protocol, full_protocol: Protocol) -> Iterator[Fault]:
    """Find what a test cannot do without, although its source is optional.

    Parameters
    ----------
    protocol : as `without_absent` gives it
    full_protocol : the same with all its sources

    Returns
    -------
    Faults at the key ``files`` of the test sheet.
    """
    step_channels = {step.channel for step in protocol.steps if isinstance(step, TravelFromSpeed)}
    for role, source in full_protocol.sources.items():
        if role in protocol.sources:
            continue
        for name in sorted(set(source.all_channels) & _needed(protocol) - step_channels):
            expected = f"a file in the role {role!r}, which gives {name!r}"
            remedy = "Add it to 'files', or add the step 'travel-from-speed' to the protocol."
            yield Fault(("files",), expected, "none", remedy)
        for name in sorted(set(source.all_channels) & step_channels):
            yield from _speed_faults(protocol, role, name)


def _speed_faults(protocol: Protocol, role: str, name: str) -> Iterator[Fault]:
    """Find a displacement that neither an export nor speed and stroke give."""
    for key in ("crosshead_speed", "stroke"):
        if getattr(protocol.rig, key) is None:
            expected = f"a file in the role {role!r}, or 'rig.{key}' to make {name!r} from"
            remedy = f"Add the file to 'files', or 'rig.{key}' to the protocol."
            yield Fault(("files",), expected, "neither", remedy)


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
    return {name for entry in entries for name in result_names(entry.result, asdict(entry))}
