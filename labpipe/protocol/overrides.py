"""What a test sheet changes in its protocol, with the places of the new values kept."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from labpipe.errors import Fault, KeyPath
from labpipe.protocol.faults import did_you_mean
from labpipe.protocol.results import result_names
from labpipe.protocol.yaml_text import Document, Spot
from labpipe.units import whole_number

SHEET_DIMENSIONS = ("length", "span")
"""Dimensions of the sheet's specimen that go before those of the protocol."""
_LEFT = {"follow_links": "Write it into the protocol, or give --follow-links."}
"""Keys that a test sheet must not change, and what to do instead."""
_LISTS = (("steps",), ("results",))
"""Blocks that a protocol may leave out and that are lists."""


def with_overrides(protocol: Document, sheet: Document) -> Document:
    """Put what a test sheet says into the protocol.

    Parameters
    ----------
    protocol : the protocol as written
    sheet : a valid test sheet as written

    Returns
    -------
    A new document in which changed values stand where the sheet has them, and overrides that lead
    nowhere are told as faults. An item of a list that is overridden with nothing is taken out, a
    result also out of those that the report shows first.
    """
    merged = Document(
        protocol.file, copy.deepcopy(protocol.data), dict(protocol.spots), list(protocol.told)
    )
    gone: dict[KeyPath, object] = {}
    said = sheet.data if isinstance(sheet.data, Mapping) else {}
    specimen, overrides = said.get("specimen") or {}, said.get("overrides") or {}
    for key in SHEET_DIMENSIONS:
        if specimen.get(key) is not None:
            _put(merged, f"specimen.{key}", sheet, ("specimen", key), gone)
    for key, override in overrides.items():
        place = ("overrides", key, "value")
        if key.removeprefix("specimen.") in SHEET_DIMENSIONS and specimen.get(key[9:]) is not None:
            found = f"{override['value']!r} beside {specimen[key[9:]]!r} in 'specimen'"
            fault = Fault(place, f"{key!r} once", found, "Keep the one in 'specimen'.")
            merged.told.append(sheet.place(fault))
        elif key in _LEFT:
            expected, found = "a key that a test may change", repr(key)
            merged.told.append(sheet.place(Fault(place[:2], expected, found, _LEFT[key], "key")))
        else:
            _put(merged, key, sheet, place, gone)
    _say_why(merged, overrides.get("align"))
    _take_out(merged, gone)
    return merged


def _say_why(merged: Document, override: Mapping[str, Any] | None) -> None:
    """Give clocks that a sheet states the reason of the override, unless they have their own."""
    align = merged.data.get("align") if isinstance(merged.data, Mapping) else None
    if override and isinstance(align, dict) and align.get("method") == "stated":
        align.setdefault("because", override["because"])


def _take_out(merged: Document, gone: Mapping[KeyPath, object]) -> None:
    """Take items out of their lists, and keep in mind which numbers the others had."""
    paths = {*gone, *_shown_first(merged, [item for item in gone.values() if _names(item)])}
    for path in {each[:-1] for each in paths}:
        items: Any = merged.at(path)
        left = [number for number in range(len(items)) if (*path, number) not in paths]
        merged.numbers[path] = tuple(left)
        merged.spots = dict(_moved(merged.spots, path, left))
        items[:] = [items[number] for number in left]


def _shown_first(merged: Document, gone: list[object]) -> Iterator[KeyPath]:
    """Find the numbers of results that the report shows first, among those of some entries."""
    names = {name for item in gone for name in _names(item)}
    groups = merged.data.get("groups") if isinstance(merged.data, Mapping) else None
    main = groups.get("main") if isinstance(groups, Mapping) else None
    for number, name in enumerate(main if isinstance(main, list) else []):
        if str(name).partition(".")[0] in names:
            yield ("groups", "main", number)


def _moved(
    spots: Mapping[KeyPath, Spot], path: KeyPath, left: Sequence[int]
) -> Iterator[tuple[KeyPath, Spot]]:
    """Spots after items of the list at a path were taken out."""
    depth = len(path)
    for known, spot in spots.items():
        if known[:depth] != path or len(known) == depth:
            yield known, spot
        elif known[depth] in left:
            yield (*path, left.index(int(known[depth])), *known[depth + 1 :]), spot


def _put(
    merged: Document, dotted: str, sheet: Document, source: KeyPath, gone: dict[KeyPath, object]
) -> None:
    """Set the value at a dotted key to the value at a path of the sheet.

    An item of a list that is set to nothing goes into `gone`, as it was.
    """
    spot = Spot(sheet.file, sheet.spots[source[:2]].key, sheet.spots[source].value)
    node: Any = merged.data
    path: KeyPath = ()
    parts = dotted.split(".")
    for part in parts:
        key = _key_in(node, part)
        if key is None:
            merged.told.append(sheet.place(_astray(node, part, source[:2])))
            return
        path = (*path, key)
        if len(path) < len(parts):
            if isinstance(node, dict) and node.get(str(key)) is None:
                if path in _LISTS:
                    merged.told.append(sheet.place(_of_none(dotted, str(key), source[:2])))
                    return
                node[str(key)] = {}  # a block that the protocol leaves out
                merged.spots[path] = spot
            node = node[key]
    if isinstance(path[-1], int) and sheet.at(source) is None:
        gone[path] = merged.at(path)
    node[path[-1]] = copy.deepcopy(sheet.at(source))
    merged.spots = {known: at for known, at in merged.spots.items() if known[: len(path)] != path}
    merged.spots |= {
        (*path, *inner[len(source) :]): at
        for inner, at in sheet.spots.items()
        if inner[: len(source)] == source
    }
    merged.spots[path] = spot


def _key_in(node: object, part: str) -> str | int | None:
    """Find what a part of a dotted key stands for: a key, or an item by number, name or kind."""
    if isinstance(node, dict):
        return part
    if not isinstance(node, list):
        return None
    if part.isdecimal():
        number = whole_number(part)
        return number if number is not None and number < len(node) else None
    # The name of a result first, then its kind: one stiffness of several may be `stiffness`.
    for called in (_names, _words):
        found = [i for i, item in enumerate(node) if part in called(item)]
        if len(found) == 1:
            return found[0]
    return None


def _words(item: object) -> list[str]:
    """What kind of step or result an item is."""
    said = [item.get(tag) for tag in ("step", "result")] if isinstance(item, Mapping) else []
    return [word for word in said if isinstance(word, str)]


def _names(item: object) -> list[str]:
    """What the results of an item are called, without the number of their cycle."""
    if not isinstance(item, Mapping) or not isinstance(item.get("result"), str):
        return []
    return [name.partition(".")[0] for name in result_names(item["result"], item)]


def _of_none(dotted: str, key: str, path: KeyPath) -> Fault:
    """Word the key of an item of a list that the protocol leaves out."""
    expected = f"a key of the protocol, which has no {key!r}"
    return Fault(path, expected, repr(dotted), f"Override {key!r} as a whole.", "key")


def _astray(node: object, part: str, path: KeyPath) -> Fault:
    """Word a dotted key that leads nowhere."""
    if not isinstance(node, list):
        return Fault(path, "a key of the protocol", f"{part!r} below a plain value", at="key")
    known = [word for item in node for word in dict.fromkeys([*_words(item), *_names(item)])]
    expected = f"a number from 0 to {len(node) - 1}, or a name that one item of the list has"
    remedy = "Use its number." if known.count(part) > 1 else did_you_mean(part, known)
    return Fault(path, expected, repr(part), remedy, "key")
