"""Whether the numbers behind a mean were made alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from labpipe.records.group import GroupNumber, Sample
from labpipe.records.quality import QualityNote, Severity

PROTOCOLS_DIFFER = "protocols_differ"
_NAMED = 4
"""Tests that are called by name where more than two share what is said of them."""


def ways_of(number: GroupNumber) -> dict[str, list[str]]:
    """Tests by the method that their number was made with.

    Parameters
    ----------
    number : of a group; what was left out does not count

    Returns
    -------
    Tests by method, in the order in which they come; one entry where all were made alike. Remarks
    do not count: they speak of one test each.
    """
    found: dict[str, list[str]] = {}
    for test, result in number.values.items():
        found.setdefault(result.method, []).append(test)
    return found


def mixed(numbers: Sequence[GroupNumber]) -> dict[str, dict[str, list[str]]]:
    """Find the numbers that were not made alike, and those that were made of them.

    Parameters
    ----------
    numbers : of a group

    Returns
    -------
    Tests by method, by result; of a number that is made of another one, the ways of that one.
    """
    ways = {number.name: ways_of(number) for number in numbers}
    found = {name: own for name, own in ways.items() if len(own) > 1}
    for number in numbers:
        made_of = {result.made_of for result in number.values.values()}
        source = next((known for known in found if known in made_of), None)
        if source is not None and number.name not in found:
            found[number.name] = found[source]
    return found


def method_notes(numbers: Sequence[GroupNumber], samples: Sequence[Sample]) -> list[QualityNote]:
    """Warn of means over numbers that were not made alike.

    Parameters
    ----------
    numbers : of a group
    samples : of the group; their slips must have been treated alike

    Returns
    -------
    One note ``protocols_differ`` per number, at the name of the result, and one for slips.
    """
    notes = [
        QualityNote(
            PROTOCOLS_DIFFER,
            Severity.WARNING,
            name,
            f"the mean mixes numbers made in {len(ways)} ways: {parted(ways)}",
        )
        for name, ways in mixed(numbers).items()
    ]
    decisions: dict[str, list[str]] = {}
    for sample in samples:
        for decision in dict.fromkeys(slip.decision for slip in sample.slips):
            decisions.setdefault(decision, []).append(sample.test)
    if len(decisions) > 1:
        message = f"the mean mixes curves whose slips were treated otherwise: {parted(decisions)}"
        notes.append(QualityNote(PROTOCOLS_DIFFER, Severity.WARNING, "slips", message))
    return notes


def parted(tests: Mapping[str, Sequence[str]]) -> str:
    """What is said of which tests, in words; of those that are most at last.

    Examples
    --------
    >>> parted({"2 mm": ["a", "b", "c", "d", "e"], "1 mm": ["f"]})
    '1 mm (f) and 2 mm (the other 5)'
    """
    rarest_first = sorted(tests.items(), key=lambda each: len(each[1]))
    words = [f"{said or 'not said'} ({', '.join(own)})" for said, own in rarest_first]
    said, most = rarest_first[-1]
    if len(most) > _NAMED:
        words[-1] = f"{said or 'not said'} (the other {len(most)})"
    return f"{'; '.join(words[:-1])} and {words[-1]}"


def apart(one: GroupNumber, two: GroupNumber) -> tuple[str, ...]:
    """Say that two groups have a number that was not made alike; empty where it was."""
    first, second = list(ways_of(one)), list(ways_of(two))
    if sorted(first) == sorted(second) and len(first) == 1:
        return ()
    return (f"not made alike: {' or '.join(first)} against {' or '.join(second)}",)
