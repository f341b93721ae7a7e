"""Faults of a protocol or test sheet in plain language, from all checks."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails, InitErrorDetails, PydanticCustomError

from labpipe.errors import At, Fault, KeyPath, nearest

_TYPE = "labpipe"
_EXPECTED = {
    "model_type": "a block of keys with values",
    "model_attributes_type": "a block of keys with values",
    "dict_type": "a block of keys with values",
    "list_type": "a list",
    "tuple_type": "a list",
    "string_type": "text",
    "too_short": "at least one entry",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
}


def one_of(word: str, valid: Iterable[str]) -> str:
    """List valid words, nearest first.

    Parameters
    ----------
    word : the invalid one
    valid : the valid ones
    """
    valid_words = sorted(set(valid))
    listed = nearest(word, valid_words, limit=6)
    more = ", ..." if len(valid_words) > len(listed) else ""
    return f"{', '.join(repr(valid_word) for valid_word in listed)}{more}"


def did_you_mean(word: str, valid: Iterable[str]) -> str:
    """Suggest the most similar valid word; empty if there is none."""
    best = nearest(word, sorted(set(valid)), limit=1)
    return f"Did you mean {best[0]!r}?" if best else ""


def shown(value: object) -> str:
    """Name a value of a YAML file in a message."""
    if value is None:
        return "nothing"
    if isinstance(value, Mapping):
        return "a block of keys" if value else "an empty block"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "a list" if value else "an empty list"
    text, max_shown = str(value), 200
    return repr(text if len(text) <= max_shown else f"{text[:max_shown]}...")


def error_of(*, expected: str, found: object, remedy: str = "") -> PydanticCustomError:
    """Make the error that a validator of the schema raises.

    Parameters
    ----------
    expected : valid values
    found : the actual value
    remedy : what to do; may be empty
    """
    return _error(Fault((), expected, shown(found), remedy))


def raised(faults: Iterable[Fault], data: object) -> ValidationError:
    """Make one validation error of several faults.

    Parameters
    ----------
    faults : with paths relative to the validated block
    data : what was validated
    """
    lines = [InitErrorDetails(type=_error(fault), loc=fault.path, input=data) for fault in faults]
    return ValidationError.from_exception_data("labpipe", lines)


def faults_of(error: ValidationError, *, data: object, keys: Iterable[str]) -> list[Fault]:
    """Convert the errors of one block; those of inner blocks are faults already.

    Parameters
    ----------
    error : what pydantic found
    data : the block as it was validated
    keys : the valid keys of the block
    """
    valid_keys = list(keys)
    return [_fault_of(line, data, valid_keys) for line in error.errors(include_url=False)]


def _error(fault: Fault) -> PydanticCustomError:
    context = {
        "expected": fault.expected,
        "found": fault.found,
        "remedy": fault.remedy,
        "at": fault.at,
        "missing": fault.missing,
    }
    return PydanticCustomError(_TYPE, "expected {expected}, found {found}. {remedy}", context)


def _fault_of(line: ErrorDetails, data: object, keys: list[str]) -> Fault:
    path = _path_in(data, line["loc"])
    context = line.get("ctx", {})
    if line["type"] == "labpipe":
        parts = (context[part] for part in ("expected", "found", "remedy", "at", "missing"))
        return Fault(path, *parts)
    if line["type"] in ("missing", "union_tag_not_found"):
        key = _quoted(context["discriminator"])[0] if context else str(line["loc"][-1])
        remedy = f"Add the key {key!r}."
        return Fault(path, f"the key {key!r}", "no such key", remedy, missing=key)
    match line["type"]:
        case "extra_forbidden":
            word = str(path[-1])
            expected = f"one of the keys {one_of(word, keys)}"
            return Fault(path, expected, repr(word), did_you_mean(word, keys), "key")
        case "union_tag_invalid":
            tag = _quoted(context["discriminator"])[0]
            return _not_one_of((*path, tag), context["tag"], _quoted(context["expected_tags"]))
        case "literal_error":
            valid_words = _quoted(context["expected"])
            location: At = "key" if line["loc"][-1] == "[key]" else "value"
            return _not_one_of(path, line["input"], valid_words, location)
        case other:
            expected = _EXPECTED.get(other, line["msg"])
            remedy = "Fill it in." if line["input"] is None else ""
            return Fault(path, expected, shown(line["input"]), remedy)


def _not_one_of(path: KeyPath, value: object, valid: list[str], at: At = "value") -> Fault:
    word = str(value)
    remedy = did_you_mean(word, valid)
    return Fault(path, f"one of {one_of(word, valid)}", shown(value), remedy, at)


def _quoted(text: str) -> list[str]:
    return re.findall(r"'([^']*)'", text)


def _path_in(data: object, location: tuple[int | str, ...]) -> KeyPath:
    """Strip parts of a pydantic location that are not in the YAML: union tags, missing keys."""
    path: list[str | int] = []
    node: Any = data
    for part in location:
        if _holds(node, part):
            node = node[part]
            path.append(part)
    return tuple(path)


def _holds(node: object, part: int | str) -> bool:
    if isinstance(node, Mapping):
        return part in node
    return isinstance(node, list) and isinstance(part, int) and part < len(node)
