"""Facts about a test in exports, folder names and file names: day, operator and specimen."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import date
from types import MappingProxyType

from labpipe.protocol.yaml_text import parse_yaml
from labpipe.records.recording import Recording
from labpipe.units import parse_quantity

DAY_KEYS = ("date", "start_time", "Capture Start Time")
"""Metadata keys of the recording date or time, always in ISO 8601."""
_ENTRY_KEYS = MappingProxyType(
    {
        "date": (*DAY_KEYS, "Date", "Datum", "Date/heure", "Date/Clock time", "Data Header"),
        "operator": (
            *("User", "author", "Operator", "Tester"),
            *("Prüfer", "Bediener", "Opérateur"),
        ),
        "specimen": (
            *("Specimen label", "Specimen number (included)"),
            *("Probebezeichnung", "Probenbezeichnung", "aktuelle Probe"),
        ),
        "take": ("Take Name", "Test Run"),
        "length": ("Length", "Einspannlänge"),
        "width": ("Width", "Probenbreite b0"),
        "thickness": ("Thickness", "Probendicke a0"),
    }
)
"""Metadata keys of each fact; the first that is filled in is used."""
_EMPTY_ENTRIES = frozenset(
    {"", "-", "none", "<none>", "default", "unknown", "user", "administrator"}
)
"""Entries of programs for a field that nobody filled in."""
_ISO_DATE = re.compile(r"(?<!\d)(\d{4})[-./](\d{1,2})[-./](\d{1,2})(?!\d)")
_DOTTED_DATE = re.compile(r"(?<!\d)(\d{1,2})\.(\d{1,2})\.(\d{4})(?!\d)")
_SLASHED_DATE = re.compile(r"(?<!\d)(\d{1,2})[/-](\d{1,2})[/-](\d{4})(?!\d)(.*)", re.DOTALL)
_US_CLOCK = re.compile(r"\s+\d{1,2}:\d\d(?::\d\d)?\s*(?:AM|PM)\b")
"""12-hour clock in capitals, the US format of Windows, which puts the month first."""
_COMPACT_DATE = re.compile(r"(?<!\d)(20\d\d)(\d\d)(\d\d)(?!\d)")
_NAME_WITH_LENGTH = re.compile(r"(?P<type>.+)-(?P<length>\d{3})-(?P<sample>\d{1,3}[a-z]?)")
_NAME_WITHOUT_LENGTH = re.compile(r"(?P<type>.+?)[-_](?P<sample>\d{1,3}[a-z]?)")
FOLDER = "the name of the folder"


def day_and_operator(sheet: str, recordings: Mapping[str, Recording]) -> tuple[date | None, str]:
    """Find the day and the operator of a test.

    Parameters
    ----------
    sheet : text of its test sheet, whose date has priority
    recordings : by role; the first one with a date is used

    Returns
    -------
    The day, None if it is not stated anywhere; the operator, empty if the sheet does not name one.
    """
    sheet_data = parse_yaml(sheet, "test.yaml").data
    entries = sheet_data if isinstance(sheet_data, Mapping) else {}
    dates = [entries.get("date")]
    dates += [recording.metadata.get(key) for recording in recordings.values() for key in DAY_KEYS]
    operator = entries.get("operator")
    day = next(filter(None, map(_day, dates)), None)
    return day, operator if isinstance(operator, str) else ""


def _day(written: object) -> date | None:
    try:
        return date.fromisoformat(str(written)[:10])
    except ValueError:
        return None


@dataclass(frozen=True, slots=True)
class Fact:
    """One fact about a test and its source.

    Parameters
    ----------
    key : column of a campaign's table: ``date``, ``operator``, ``type``, ``sample``, ``length``
        ...; ``take`` for the name of the test in a program
    value : as a test sheet writes it; empty if ambiguous
    where : its source, such as ``force.mat``
    written : as it is written there
    """

    key: str
    value: str
    where: str
    written: str = ""


def facts_of_export(name: str, recording: Recording) -> tuple[Fact, ...]:
    """Collect the facts that an export holds about its test.

    Parameters
    ----------
    name : of the file; its date is used if the export has none
    recording : from its reader

    Returns
    -------
    Its facts. The modification time of the file is not one of them: copying changes it.
    """
    entries = dict(_entries(recording.metadata))
    facts = []
    for key, names in _ENTRY_KEYS.items():
        texts = [entries[entry] for entry in names if _is_filled(key, entries.get(entry, ""))]
        facts += [Fact(key, _value(key, text), name, text) for text in texts[:1]]
    if not any(fact.key == "date" for fact in facts):
        facts += [Fact("date", day, f"the name of {name}", name) for day in days_in_name(name)]
    return tuple(facts)


def _is_filled(key: str, text: str) -> bool:
    """Check whether an entry was filled in, and can be what its key says."""
    if key in ("length", "width", "thickness"):
        with suppress(ValueError):
            return parse_quantity(text, "m") > 0.0
        return False
    if key == "date":
        return any(form.search(text) for form in (_ISO_DATE, _DOTTED_DATE, _SLASHED_DATE))
    return text.casefold() not in _EMPTY_ENTRIES


def _value(key: str, text: str) -> str:
    return day_in(text) if key == "date" else text


def facts_of_folder(name: str) -> tuple[Fact, ...]:
    """Parse a folder name such as ``A2-085-1``: type, length in mm, sample.

    Parameters
    ----------
    name : of the folder of a test

    Examples
    --------
    >>> [(fact.key, fact.value) for fact in facts_of_folder("A2-085-1")]
    [('type', 'A2'), ('length', '85 mm'), ('sample', '1')]
    >>> [(fact.key, fact.value) for fact in facts_of_folder("CWB-2a-3")]
    [('type', 'CWB-2a'), ('sample', '3')]
    >>> facts_of_folder("Test Run 4 10-23-2023 6 43 09 PM")
    ()
    """
    if days_in_name(name) or _SLASHED_DATE.search(name):
        return ()
    match = _NAME_WITH_LENGTH.fullmatch(name) or _NAME_WITHOUT_LENGTH.fullmatch(name)
    parts = match.groupdict() if match else {}
    if "length" in parts:
        parts["length"] = f"{int(parts['length'])} mm"
    return tuple(Fact(key, value, FOLDER, name) for key, value in parts.items())


def days_in_name(name: str) -> list[str]:
    """Find dates in the name of a file or folder that begin with the year.

    Parameters
    ----------
    name : of the file

    Examples
    --------
    >>> days_in_name("Take 2020-08-03 11.05.00 AM.csv"), days_in_name("20260304_A2.mat")
    (['2020-08-03'], ['2026-03-04'])
    """
    written = [*_ISO_DATE.findall(name), *_COMPACT_DATE.findall(name)]
    return list(dict.fromkeys(day for parts in written if (day := _iso_date(*parts))))


def day_in(text: str) -> str:
    """Parse a date in the format of some program.

    Parameters
    ----------
    text : such as ``27.02.2015`` or ``10/26/2022 1:02:25 PM``

    Returns
    -------
    ISO date; empty if there is none, or if the order of day and month is ambiguous.

    Examples
    --------
    >>> day_in("27.02.2015"), day_in("10/26/2022 13:02"), day_in("3/11/2026 10:05:00 AM")
    ('2015-02-27', '2022-10-26', '2026-03-11')
    >>> day_in("03/09/2026 10:05:00")
    ''
    """
    if match := _ISO_DATE.search(text):
        return _iso_date(*match.groups())
    if match := _DOTTED_DATE.search(text):
        return _iso_date(match[3], match[2], match[1])
    if match := _SLASHED_DATE.search(text):
        month_first, day_first = (
            _iso_date(match[3], match[1], match[2]),
            _iso_date(match[3], match[2], match[1]),
        )
        if _US_CLOCK.match(match[4]) or not day_first or month_first == day_first:
            return month_first
        return "" if month_first else day_first
    return ""


def combine_facts(facts: Iterable[Fact]) -> tuple[dict[str, Fact], dict[str, str]]:
    """Combine the facts of several sources about one test.

    Parameters
    ----------
    facts : of its exports and of its folder

    Returns
    -------
    agreed : by key, those on which all sources agree; `where` names all of them
    left_open : by key, a sentence on contradictory or ambiguous facts
    """
    by_key: dict[str, list[Fact]] = {}
    for fact in facts:
        by_key.setdefault(fact.key, []).append(fact)
    agreed, left_open = dict[str, Fact](), dict[str, str]()
    for key, facts_of_key in by_key.items():
        clear = [fact for fact in facts_of_key if fact.value]
        if len({fact.value for fact in clear}) == 1:
            sources = " and ".join(dict.fromkeys(fact.where for fact in clear))
            agreed[key] = replace(clear[0], where=sources)
        elif clear:
            statements = ", ".join(f"{fact.value} in {fact.where}" for fact in clear)
            left_open[key] = f"{key}: {statements}; left out, write the correct one"
        else:
            statements = ", ".join(f"{fact.written!r} in {fact.where}" for fact in facts_of_key)
            left_open[key] = f"{key}: {statements} can be read day first or month first; left out"
    return agreed, left_open


def _entries(metadata: Mapping[str, object]) -> Iterator[tuple[str, str]]:
    """Yield metadata entries by the last part of their key; the first entry of a name is used."""
    seen: set[str] = set()
    for key, value in metadata.items():
        if key in ("channels", "clocks", "objects", "rigid_bodies"):
            continue  # lists that hold no facts about the test
        last_part = key.rpartition(" : ")[2].strip()
        inner = _entries(value) if isinstance(value, Mapping) else [(last_part, str(value))]
        for word, text in inner:
            if word not in seen:
                seen.add(word)
                yield word, text.strip()


def _iso_date(year: str, month: str, day: str) -> str:
    with suppress(ValueError):
        return date(int(year), int(month), int(day)).isoformat()
    return ""
