"""What tests of one protocol were processed with, and where that differs from test to test."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from labpipe.protocol.schema import Protocol
from labpipe.records.group import Sample
from labpipe.records.quality import QualityNote, Severity
from labpipe.statistics.methods import PROTOCOLS_DIFFER, parted

_SECTIONS = ("align", "steps", "curve", "branches", "results")
"""What makes numbers of a recording; the rest of a protocol speaks of the sample and its files."""

_ABSENT = "none"
_MOST_KEYS = 3
"""Settings that a verdict names one by one."""

Settings = Mapping[str, str]


def settings_of(protocol: Protocol) -> Settings:
    """List what a protocol says about processing.

    Parameters
    ----------
    protocol : resolved: the overrides of the test are in it

    Returns
    -------
    Value by dotted key, such as ``results.stiffness_first.from``. Items of a list go by their name
    or kind, and the list itself is there too, for their order.
    """
    data = protocol.model_dump(mode="json", by_alias=True)
    return dict(_flat({key: data[key] for key in _SECTIONS if data.get(key) is not None}, ""))


def _flat(data: object, at: str) -> Iterator[tuple[str, str]]:
    inner: dict[str, Any] = {}
    if isinstance(data, dict):
        inner = {str(key): value for key, value in data.items()}
    elif isinstance(data, list) and any(isinstance(item, dict) for item in data):
        inner = _by_label(data)
        yield at, ", ".join(inner)
    else:
        yield at, str(data)
    for key, value in inner.items():
        yield from _flat(value, f"{at}.{key}" if at else key)


def _by_label(items: Sequence[Any]) -> dict[str, Any]:
    """Items by name, or by kind, with a number where that is taken."""
    found: dict[str, Any] = {}
    times: Counter[str] = Counter()
    for item in items:
        label = next((str(item[key]) for key in ("name", "step", "result") if key in item), "item")
        times[label] += 1
        found[label if times[label] == 1 else f"{label} {times[label]}"] = item
    return found


def setting_notes(settings: Mapping[str, Settings], told: Sequence[str] = ()) -> list[QualityNote]:
    """Warn where tests that are averaged were processed otherwise.

    Parameters
    ----------
    settings : by test
    told : results, or ``slips``, whose difference is told already

    Returns
    -------
    One note ``protocols_differ`` per setting, at its key; of a block of the protocol in which more
    than `_MOST_KEYS` settings differ, as where a test lacks an optional export, one for the block.
    """
    blocks: dict[str, dict[str, str]] = {}
    for key, said in differing(settings).items():
        if not _is_told(key, told):
            blocks.setdefault(key.partition(".")[0], {})[key] = said
    notes = []
    for block, own in blocks.items():
        shown = own if len(own) <= _MOST_KEYS else {block: _of_block(own)}
        notes += [
            QualityNote(
                PROTOCOLS_DIFFER, Severity.WARNING, key, f"set otherwise from test to test: {said}"
            )
            for key, said in shown.items()
        ]
    return notes


def _of_block(own: Mapping[str, str]) -> str:
    """How a block differs, by the first of its settings."""
    key, said = next(iter(own.items()))
    return f"{len(own)} settings, the first {key}: {said}"


def differing(settings: Mapping[str, Settings]) -> dict[str, str]:
    """Find the settings that are not the same in all tests.

    Parameters
    ----------
    settings : by test

    Returns
    -------
    By key, which value in which tests, in words. Where a list lacks an item in some test, the list
    is named and not all that the item says.
    """
    keys = dict.fromkeys(key for own in settings.values() for key in own)
    found: dict[str, str] = {}
    for key in keys:
        tests: dict[str, list[str]] = {}
        for test, own in settings.items():
            tests.setdefault(own.get(key, _ABSENT), []).append(test)
        is_told = _ABSENT in tests and any(key.startswith(f"{known}.") for known in found)
        if len(tests) > 1 and not is_told:
            found[key] = parted(tests)
    return found


def settings_by_test(
    samples: Sequence[Sample], settings: Mapping[str, Settings]
) -> dict[str, Settings]:
    """Settings of samples by test; of tests of one name, by file.

    Parameters
    ----------
    samples : of one group, or of two that are compared
    settings : by file
    """
    times = Counter(sample.test for sample in samples)
    return {
        sample.test if times[sample.test] == 1 else sample.source: settings[sample.source]
        for sample in samples
    }


def unlike_words(settings: Mapping[str, Settings]) -> tuple[str, ...]:
    """Name the settings that differ among the tests of a comparison; empty where none does.

    Parameters
    ----------
    settings : by test

    Returns
    -------
    Of more than `_MOST_KEYS` settings, the blocks of the protocol that they stand in: the notes of
    the groups have them all.
    """
    keys = list(differing(settings))
    if len(keys) > _MOST_KEYS:
        keys = list(dict.fromkeys(key.partition(".")[0] for key in keys))
    return (f"the tests were processed otherwise: {', '.join(keys)} differ",) if keys else ()


def _is_told(key: str, told: Sequence[str]) -> bool:
    return any(key.startswith((f"results.{name}.", f"curve.{name}.decision")) for name in told)
