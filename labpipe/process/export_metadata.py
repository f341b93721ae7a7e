"""What exports, folders and names of files say about a test: its day, operator and specimen."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import date
from types import MappingProxyType

from labpipe.process.certificates import DAY_KEYS
from labpipe.records.recording import Recording
from labpipe.units import parse_quantity

_DAYS = (*DAY_KEYS, "Date", "Datum", "Date/heure", "Date/Clock time", "Data Header")
"""What exports call the day of the test."""
_OPERATOR = ("User", "author", "Operator", "Prüfer", "Tester", "Bediener", "Opérateur")
_SPECIMEN = (
    "Specimen label",
    "Specimen number (included)",
    "Probebezeichnung",
    "Probenbezeichnung",
    "aktuelle Probe",
)
_TEST = ("Take Name", "Test Run")
_SIZES = MappingProxyType(
    {
        "length": ("Length", "Einspannlänge"),
        "width": ("Width", "Probenbreite b0"),
        "thickness": ("Thickness", "Probendicke a0"),
    }
)
_NOBODY = frozenset({"", "-", "none", "<none>", "default", "unknown", "user", "administrator"})
"""Entries that programs make where nobody filled a field in."""
_ISO = re.compile(r"(?<!\d)(\d{4})[-./](\d{1,2})[-./](\d{1,2})(?!\d)")
_DOTTED = re.compile(r"(?<!\d)(\d{1,2})\.(\d{1,2})\.(\d{4})(?!\d)")
_EITHER = re.compile(r"(?<!\d)(\d{1,2})[/-](\d{1,2})[/-](\d{4})(?!\d)(.*)", re.DOTALL)
_AMERICAN = re.compile(r"\s+\d{1,2}:\d\d(?::\d\d)?\s*(?:AM|PM)\b")
"""Clock of twelve hours in capitals, as Windows writes it in the United States, month first."""
_IN_A_ROW = re.compile(r"(?<!\d)(20\d\d)(\d\d)(\d\d)(?!\d)")
_WITH_LENGTH = re.compile(r"(?P<type>.+)-(?P<length>\d{3})-(?P<sample>\d{1,3}[a-z]?)")
_WITHOUT = re.compile(r"(?P<type>.+?)[-_](?P<sample>\d{1,3}[a-z]?)")
FOLDER = "the name of the folder"


@dataclass(frozen=True, slots=True)
class Fact:
    """One thing that is said about a test.

    Parameters
    ----------
    key : column of a campaign's table: ``date``, ``operator``, ``type``, ``sample``, ``length``
        ...; ``take`` for the name that a program gave to the test
    value : as a test sheet writes it; empty where it can be read in two ways
    where : who says it, such as ``force.mat``
    written : as it is written there
    """

    key: str
    value: str
    where: str
    written: str = ""


@dataclass(frozen=True, slots=True)
class Agreed:
    """What all that is said about a test comes to.

    Parameters
    ----------
    facts : one of each key on which all agree; `where` names all that say it
    open : sentences on what is said in two ways, or can be read in two ways: it is left out
    """

    facts: Mapping[str, Fact]
    open: tuple[str, ...]


def facts_of_export(name: str, recording: Recording) -> tuple[Fact, ...]:
    """Collect what an export says about its test.

    Parameters
    ----------
    name : of the file, whose date counts where the export itself has none
    recording : as its reader gives it

    Returns
    -------
    Its facts. The time at which the file was written is none of them: a copy has another.
    """
    said = dict(_entries(recording.metadata))
    dated = {word: text for word, text in said.items() if _has_day(text)}
    facts = [Fact("date", day_in(text), name, text) for text in _first(dated, _DAYS)]
    if not facts:
        facts = [Fact("date", day, f"the name of {name}", name) for day in days_in_name(name)]
    for key, words in (("operator", _OPERATOR), ("specimen", _SPECIMEN), ("take", _TEST)):
        facts += [Fact(key, text, name, text) for text in _first(said, words)]
    for key, words in _SIZES.items():
        sizes = [text for text in _first(said, words) if _is_length(text)]
        facts += [Fact(key, text, name, text) for text in sizes]
    return tuple(facts)


def facts_of_folder(name: str) -> tuple[Fact, ...]:
    """Read the name of a folder as labs form it: ``A2-085-1`` is type, length in mm, sample.

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
    if days_in_name(name) or _EITHER.search(name):
        return ()
    found = _WITH_LENGTH.fullmatch(name) or _WITHOUT.fullmatch(name)
    said = found.groupdict() if found else {}
    if "length" in said:
        said["length"] = f"{int(said['length'])} mm"
    return tuple(Fact(key, value, FOLDER, name) for key, value in said.items())


def days_in_name(name: str) -> list[str]:
    """Find days in the name of a file or folder, the year first: there the order is plain.

    Parameters
    ----------
    name : of the file

    Examples
    --------
    >>> days_in_name("Take 2020-08-03 11.05.00 AM.csv"), days_in_name("20260304_A2.mat")
    (['2020-08-03'], ['2026-03-04'])
    """
    written = [*_ISO.findall(name), *_IN_A_ROW.findall(name)]
    return list(dict.fromkeys(day for parts in written if (day := _iso(*parts))))


def day_in(text: str) -> str:
    """Read the day in a date as a program wrote it.

    Parameters
    ----------
    text : such as ``27.02.2015`` or ``10/26/2022 1:02:25 PM``

    Returns
    -------
    ISO date; empty if there is none, or if day and month could be either way round.

    Examples
    --------
    >>> day_in("27.02.2015"), day_in("10/26/2022 13:02"), day_in("3/11/2026 10:05:00 AM")
    ('2015-02-27', '2022-10-26', '2026-03-11')
    >>> day_in("03/09/2026 10:05:00")
    ''
    """
    if match := _ISO.search(text):
        return _iso(*match.groups())
    if match := _DOTTED.search(text):
        return _iso(match[3], match[2], match[1])
    if match := _EITHER.search(text):
        month_first, day_first = (
            _iso(match[3], match[1], match[2]),
            _iso(match[3], match[2], match[1]),
        )
        if _AMERICAN.match(match[4]) or not day_first or month_first == day_first:
            return month_first
        return "" if month_first else day_first
    return ""


def agreed(facts: Iterable[Fact]) -> Agreed:
    """Bring together what several say about one test.

    Parameters
    ----------
    facts : of its exports and of its folder
    """
    by_key: dict[str, list[Fact]] = {}
    for fact in facts:
        by_key.setdefault(fact.key, []).append(fact)
    kept, left_open = {}, []
    for key, said in by_key.items():
        plain = [fact for fact in said if fact.value]
        values = dict.fromkeys(fact.value for fact in plain)
        if len(values) == 1:
            first = plain[0]
            where = list(dict.fromkeys(fact.where for fact in plain))
            kept[key] = Fact(key, first.value, " and ".join(where), first.written)
        elif values:
            each = ", ".join(f"{fact.value} in {fact.where}" for fact in plain)
            left_open.append(f"{key}: {each}; left out, write the right one")
        else:
            each = ", ".join(f"{fact.written!r} in {fact.where}" for fact in said)
            left_open.append(f"{key}: {each} can be read day first or month first; left out")
    return Agreed(kept, tuple(left_open))


def _entries(metadata: Mapping[str, object]) -> Iterator[tuple[str, str]]:
    """What an export says, by the last word of each key; the first of a word counts."""
    seen: set[str] = set()
    for key, value in metadata.items():
        if key in ("channels", "clocks", "objects", "rigid_bodies"):
            continue  # of these there are many, and they say nothing about the test
        inner = _entries(value) if isinstance(value, Mapping) else [(_word(key), str(value))]
        for word, text in inner:
            if word not in seen:
                seen.add(word)
                yield word, text.strip()


def _word(key: str) -> str:
    return key.rpartition(" : ")[2].strip()


def _first(said: Mapping[str, str], words: Iterable[str]) -> list[str]:
    """The first entry that somebody filled in, as a list of one or none."""
    return [said[word] for word in words if said.get(word, "").casefold() not in _NOBODY][:1]


def _has_day(text: str) -> bool:
    return any(form.search(text) for form in (_ISO, _DOTTED, _EITHER))


def _is_length(text: str) -> bool:
    with suppress(ValueError):
        return parse_quantity(text, "m") > 0.0
    return False


def _iso(year: str, month: str, day: str) -> str:
    with suppress(ValueError):
        return date(int(year), int(month), int(day)).isoformat()
    return ""
