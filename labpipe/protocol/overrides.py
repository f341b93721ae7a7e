"""What a test sheet changes in its protocol, with the places of the new values kept."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

from labpipe.protocol.faults import Fault, KeyPath, did_you_mean
from labpipe.protocol.yaml_text import Document, Spot

SHEET_DIMENSIONS = ("length", "span")
"""Dimensions of the sheet's specimen that go before those of the protocol."""
_TAGS = ("step", "result")


def with_overrides(protocol: Document, sheet: Document) -> Document:
    """Put what a test sheet says into the protocol.

    Parameters
    ----------
    protocol : the protocol as written
    sheet : a valid test sheet as written

    Returns
    -------
    A new document in which changed values stand where the sheet has them, and overrides that lead
    nowhere are told as faults.
    """
    merged = Document(
        protocol.file, copy.deepcopy(protocol.data), dict(protocol.spots), list(protocol.told)
    )
    said = sheet.data if isinstance(sheet.data, Mapping) else {}
    specimen, overrides = said.get("specimen") or {}, said.get("overrides") or {}
    for key in SHEET_DIMENSIONS:
        if specimen.get(key) is not None:
            _put(merged, f"specimen.{key}", sheet, ("specimen", key))
    for key, override in overrides.items():
        place = ("overrides", key, "value")
        if key.removeprefix("specimen.") in SHEET_DIMENSIONS and specimen.get(key[9:]) is not None:
            found = f"{override['value']!r} beside {specimen[key[9:]]!r} in 'specimen'"
            fault = Fault(place, f"{key!r} once", found, "Keep the one in 'specimen'.")
            merged.told.append(sheet.place(fault))
        else:
            _put(merged, key, sheet, place)
    return merged


def _put(merged: Document, dotted: str, sheet: Document, source: KeyPath) -> None:
    """Set the value at a dotted key to the value at a path of the sheet."""
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
                node[str(key)] = {}  # a block that the protocol leaves out
                merged.spots[path] = spot
            node = node[key]
    node[path[-1]] = copy.deepcopy(sheet.at(source))
    merged.spots = {known: at for known, at in merged.spots.items() if known[: len(path)] != path}
    merged.spots |= {
        (*path, *inner[len(source) :]): at
        for inner, at in sheet.spots.items()
        if inner[: len(source)] == source
    }
    merged.spots[path] = spot


def _key_in(node: object, part: str) -> str | int | None:
    """Find what a part of a dotted key stands for: a key, an item's number, or an item's tag."""
    if isinstance(node, dict):
        return part
    if not isinstance(node, list):
        return None
    if part.isdecimal():
        return int(part) if int(part) < len(node) else None
    tagged = [i for i, item in enumerate(node) if part in _tags(item)]
    return tagged[0] if len(tagged) == 1 else None


def _tags(item: object) -> list[object]:
    return [item.get(tag) for tag in _TAGS] if isinstance(item, Mapping) else []


def _astray(node: object, part: str, path: KeyPath) -> Fault:
    """Word a dotted key that leads nowhere."""
    if not isinstance(node, list):
        return Fault(path, "a key of the protocol", f"{part!r} below a plain value", at="key")
    tags = [str(tag) for item in node for tag in _tags(item) if tag is not None]
    expected = f"a number from 0 to {len(node) - 1}, or a name that one item of the list has"
    remedy = "Use its number." if tags.count(part) > 1 else did_you_mean(part, tags)
    return Fault(path, expected, repr(part), remedy, "key")
