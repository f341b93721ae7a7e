"""What a test sheet can say by itself: protocol, roles, day, operator and specimen, as seen."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

from labpipe.errors import Fault, LabpipeError
from labpipe.process.checking import needs_span
from labpipe.process.export_metadata import (
    FOLDER,
    Agreed,
    Fact,
    agreed,
    facts_of_export,
    facts_of_folder,
)
from labpipe.process.protocol_match import Fit, KnownFacts, all_protocols, fitting, seen_length
from labpipe.process.raw_folder import (
    FolderContents,
    InspectedExport,
    folders_of_tests,
    look_into,
)
from labpipe.protocol.load import find_protocol, load_protocol, load_test_sheet
from labpipe.protocol.schema import Protocol
from labpipe.protocol.sheet_grammar import SHEET_NAME
from labpipe.protocol.source import ROLES
from labpipe.protocol.values import is_name_of_a_test
from labpipe.records.recording import EXPORT_FORMATS
from labpipe.units import parse_quantity

_NEEDED = ("type", "spool", "sample")
_AGREE = 0.05
"""Lengths that differ by more than this ratio are not the same."""
_SAID = ("date", "operator", "type", "sample", "length", "width", "thickness")
_DECIDES = (
    "what would decide: a folder, export or type called like one of them, or a protocol that most"
    " tests beside it have"
)
_MOST = 3
"""Faults of one export that are listed."""


@dataclass(frozen=True, slots=True)
class InferredTest:
    """What a test sheet can say about a test.

    Parameters
    ----------
    folder : of the test
    values : text by column of a campaign's table
    files : names of exports by role
    open : columns that are needed and not seen; the person fills them in
    said : sentences on where the values come from, and on what does not agree
    unread : exports of a known format that cannot be read, with the reason
    blocks : what no column holds, by key of the test sheet: it is put beside what was seen
    """

    folder: Path
    values: Mapping[str, str]
    files: Mapping[str, tuple[str, ...]]
    open: tuple[str, ...] = ()
    said: tuple[str, ...] = ()
    unread: Mapping[str, str] = field(default_factory=dict)
    blocks: Mapping[str, Mapping[str, object]] = field(default_factory=dict)


@dataclass(slots=True)
class Neighbours:
    """Protocols of the tests of a campaign, by their folders; empty where a test has none yet.

    Parameters
    ----------
    tests : type of the specimen and protocol of each test
    """

    tests: dict[Path, tuple[str, str]] = field(default_factory=dict)

    def beside(self, folder: Path, kind: str | None = None) -> Counter[str]:
        """Count the protocols of the other tests, of all or of one type of specimen.

        Parameters
        ----------
        folder : of the test itself
        kind : type of the specimen; None for all
        """
        others = (test for where, test in self.tests.items() if where != folder.resolve())
        return Counter(name for known, name in others if kind is None or known == kind)


def neighbours_in(campaign: Path) -> Neighbours:
    """Read which protocols the tests of a campaign have.

    Parameters
    ----------
    campaign : folder with the folders of the tests
    """
    neighbours = Neighbours()
    for folder in folders_of_tests(campaign):
        neighbours.tests[folder] = (_type_of(folder), "")
        if (folder / SHEET_NAME).exists():
            with suppress(LabpipeError, OSError):
                sheet = load_test_sheet(folder / SHEET_NAME)
                neighbours.tests[folder] = (sheet.specimen.type, sheet.protocol)
    return neighbours


def _type_of(folder: Path) -> str:
    """Type of the specimen as the name of a folder says it."""
    return next((fact.value for fact in facts_of_folder(folder.name) if fact.key == "type"), "")


def infer_test(
    folder: Path,
    given: Mapping[str, str],
    *,
    protocols: Path | None = None,
    neighbours: Neighbours | None = None,
) -> InferredTest:
    """See what the exports in a folder say about their test.

    Parameters
    ----------
    folder : of the test
    given : values by column, which count before what is seen
    protocols : folder of the lab's protocols; ``protocols`` in the working folder if None
    neighbours : the tests of the campaign; those beside the folder if None

    Returns
    -------
    What can be said. Nothing is raised for what cannot be read: it is said.
    """
    contents = look_into(folder)
    known = _protocols(given, folder, protocols)
    around = neighbours_in(folder.resolve().parent) if neighbours is None else neighbours
    return _TestInference(contents, dict(given), known, around).seen()


def infer_tests(
    folders: Sequence[Path], given: Mapping[str, str], *, protocols: Path | None = None
) -> Iterator[InferredTest]:
    """See several tests of one campaign; what one leaves open, the others may settle.

    Parameters
    ----------
    folders : of the tests
    given, protocols : see `infer_test`

    Yields
    ------
    Each test: first those that are settled by themselves, then the others. The recordings of one
    test are in the memory at a time.
    """
    if not folders:
        return
    known = _protocols(given, folders[0], protocols)
    around = neighbours_in(folders[0].resolve().parent)
    waiting = []
    for folder in folders:
        sight = _TestInference(look_into(folder), dict(given), known, around)
        if len(sight.fits) > 1:
            waiting.append(folder)
            continue
        if sight.fit is not None:
            around.tests[folder.resolve()] = (sight.kind, sight.fit.protocol.name)
        yield sight.seen()
    for folder in waiting:
        yield _TestInference(look_into(folder), dict(given), known, around).seen()


def _protocols(given: Mapping[str, str], folder: Path, protocols: Path | None) -> list[Protocol]:
    """The protocols that come into question: all, or the one that a person named."""
    if "protocol" not in given:
        return all_protocols(protocols)
    found = find_protocol(given["protocol"], beside=folder, protocols=protocols)
    with suppress(LabpipeError):  # one that is wrong, or not there, is said when it is written
        return [] if isinstance(found, Fault) else [load_protocol(found)]
    return []


class _TestInference:
    """One test as it is looked at."""

    def __init__(
        self,
        contents: FolderContents,
        given: dict[str, str],
        protocols: Sequence[Protocol],
        around: Neighbours,
    ) -> None:
        self.contents, self.given, self.around = contents, given, around
        self._protocols = protocols

    @cached_property
    def facts(self) -> Agreed:
        each = [facts_of_export(export.name, export.recording) for export in self._belonging]
        said = [fact for facts in each for fact in facts if fact.key != "take"]
        own = facts_of_folder(self.contents.folder.name)
        named = {fact.key for fact in own}
        # The name of the folder is the lab's word; what a program counts is only a help.
        said = [fact for fact in said if fact.key not in named]
        if "sample" not in named:
            said = [
                replace(sentence, key="sample") if sentence.key == "specimen" else sentence
                for sentence in said
            ]
        return agreed([*own, *(fact for fact in said if fact.key != "specimen")])

    @property
    def _belonging(self) -> list[InspectedExport]:
        """Exports that are surely of this test; all, where no protocol takes any of them."""
        unclear = {
            name
            for fit in self.fits
            for role in fit.unclear
            for name in fit.files[role]
            if role not in self.given
        }
        return [export for export in self.contents.exports if export.name not in unclear]

    @property
    def kind(self) -> str:
        """Type of the specimen, as far as it is known."""
        return self.given.get("type") or _type_of(self.contents.folder)

    def _fact(self, key: str) -> str:
        return self.facts.facts[key].value if key in self.facts.facts else ""

    @cached_property
    def fits(self) -> list[Fit]:
        roles = {role: _parts(self.given[role]) for role in ROLES if role in self.given}
        named = {fact.key: fact.value for fact in facts_of_folder(self.contents.folder.name)}
        length = self.given.get("length") or named.get("length", "")
        folder, exports = self.contents.folder, self.contents.exports
        known = KnownFacts(
            names=(folder.name, self.kind, *(export.path.stem for export in exports)),
            length=_metres(length),
            of_type=self.around.beside(folder, self.kind) if self.kind else {},
            of_campaign=self.around.beside(folder),
            roles=roles,
        )
        return fitting(exports, self._protocols, known) if exports else []

    @property
    def fit(self) -> Fit | None:
        """The protocol that fits better than all others; None where that is open."""
        return self.fits[0] if len(self.fits) == 1 else None

    def seen(self) -> InferredTest:
        """Put together what can be said."""
        seen = {key: self._fact(key) for key in _SAID if self._fact(key)}
        values = {"test": self._name, **self._protocol, **seen, **self.given}
        files = {role: _parts(self.given[role]) for role in ROLES if role in self.given}
        files = {**self._files, **files}
        needed = [*_NEEDED, *(["span"] if self.fit and needs_span(self.fit.protocol) else [])]
        still = [key for key in ("protocol", *needed) if not values.get(key)]
        unclear = sorted(self._unclear(files))
        still += unclear or ([] if files else ["files"])
        return InferredTest(
            self.contents.folder,
            values,
            files,
            tuple(still),
            tuple(self._sentences(values, files)),
            self.contents.unread,
        )

    @property
    def _name(self) -> str:
        name = self.contents.folder.resolve().name
        return name if is_name_of_a_test(name) else safe_name(name)

    @property
    def _protocol(self) -> dict[str, str]:
        if self.fit is not None:
            return {"protocol": self.fit.protocol.name}
        return {}

    @property
    def _files(self) -> dict[str, tuple[str, ...]]:
        """Exports by role; where no protocol is settled, what all agree on, or their kinds."""
        if not self.fits:
            return {
                role: tuple(
                    export.name for export in self.contents.exports if _role(export.reader) == role
                )
                for role in dict.fromkeys(_role(export.reader) for export in self.contents.exports)
            }
        first = dict(self.fits[0].files)
        return {role: names for role, names in first.items() if self._agree(role, names)}

    def _agree(self, role: str, names: tuple[str, ...]) -> bool:
        return all(fit.files.get(role) == names and role not in fit.unclear for fit in self.fits)

    def _unclear(self, files: Mapping[str, object]) -> set[str]:
        return {role for fit in self.fits[:1] for role in fit.unclear if role not in files}

    def _sentences(
        self, values: Mapping[str, str], files: Mapping[str, tuple[str, ...]]
    ) -> Iterator[str]:
        yield from self._about_protocol()
        readers = {export.name: export.reader for export in self.contents.exports}
        seen = {role: names for role, names in files.items() if role not in self.given}
        if seen:
            yield "; ".join(
                f"{role}: {', '.join(f'{_shown(name)} ({readers[name]})' for name in names)}"
                for role, names in seen.items()
            )
        for role in sorted(self._unclear(files)):
            several = ", ".join(map(_shown, self.fits[0].files[role]))
            yield (
                f"{role}: {several} could each be it, and are not parts of one recording; name one"
                f" with --{role}, and give each test a folder of its own"
            )
        yield from self._about_facts()
        if values["test"] != self.contents.folder.resolve().name and "test" not in self.given:
            yield f"test: {values['test']}, as a name of a test has no blanks or other signs"
        left = self.facts.open
        yield from (each for each in left if each.partition(":")[0] not in self.given)
        yield from self._contradictions(values)
        unclear = {role: self.fits[0].files[role] for role in self._unclear(files)}
        yield from self._unused({**files, **unclear})

    def _about_facts(self) -> Iterator[str]:
        """Say which values come from where, one line for each place."""
        facts = [self.facts.facts[key] for key in _SAID if key in self.facts.facts]
        taken = [fact for fact in facts if fact.key not in self.given]
        for where in dict.fromkeys(fact.where for fact in taken):
            each = [f"{x.key} {x.value}{_as_written(x)}" for x in taken if x.where == where]
            yield f"{', '.join(each)}: from {where}"

    def _about_protocol(self) -> Iterator[str]:
        if "protocol" in self.given:
            yield from _faults(self.fits[:1])
            return
        if self.fit is not None:
            why = "; ".join(sign.text for sign in self.fit.signs if sign.weight > 0)
            yield f"protocol: {self.fit.protocol.name}" + (f", as {why}" if why else "")
            yield from _faults([self.fit])
        elif self.fits:
            first = (
                f"protocol: {len(self.fits)} fit alike; name one with --protocol, or in the sheet"
            )
            which = (_described(fit.protocol) for fit in self.fits)
            yield "\n    ".join((first, *which, _DECIDES))
        elif self.contents.exports:
            yield "protocol: none of those here takes these exports; name one, or write one"
        else:
            missing = (
                "no export that labpipe can read is"
                if self.contents.others or self.contents.unread
                else "no exports are"
            )
            yield f"protocol: {missing} in this folder; copy the exports there, or use --protocol"

    def _contradictions(self, values: Mapping[str, str]) -> Iterator[str]:
        """What is said in two ways, but does not keep a value from being taken."""
        name = self.contents.folder.resolve().name
        for export in self._belonging:
            for fact in facts_of_export(export.name, export.recording):
                if fact.key == "take" and fact.value != name and facts_of_folder(fact.value):
                    yield f"look: {export.name} is of {fact.value!r}, the folder is called {name!r}"
        stated, fit = _metres(values.get("length", "")), self.fit
        for export in self._belonging:
            tracks = export.recording.markers
            if fit is None or tracks is None or not stated:
                continue
            reach = seen_length(fit.protocol, tracks)
            if reach is not None and abs(reach / stated - 1.0) > _AGREE:
                shown = f"{reach * 1e3:.3g} mm, {values['length']} is stated"
                yield f"look: the markers of {export.name} show a length of about {shown}"

    def _unused(self, files: Mapping[str, tuple[str, ...]]) -> Iterator[str]:
        used = {name for names in files.values() for name in names}
        for export in self.contents.exports:
            if export.name not in used:
                yield f"not used: {_shown(export.name)} ({export.reader})"
        for name, why in {**self.contents.unread, **self.contents.others}.items():
            if name not in used:
                yield f"not used: {_shown(name)}: {why.splitlines()[0]}"
        for name in sorted(used):
            if not (self.contents.folder / name).exists():
                yield f"not there yet: {_shown(name)}"


def _described(protocol: Protocol) -> str:
    """What a protocol is for, and the sizes that it states."""
    length, rig = protocol.specimen.length, protocol.rig
    sizes = [f"length {length * 1e3:g} mm"] if length else []
    sizes += [f"stroke {rig.stroke * 1e3:g} mm"] if rig.stroke else []
    sizes += [f"speed {rig.crosshead_speed * 1e3:g} mm/s"] if rig.crosshead_speed else []
    return f"{protocol.name}: {'; '.join(filter(None, (protocol.about, ', '.join(sizes))))}"


def _faults(fits: Iterable[Fit]) -> Iterator[str]:
    for fit in fits:
        if not fit.unclear:
            yield from (f"look: {fault}" for fault in fit.faults[:_MOST])


def _role(reader: str) -> str:
    """What an export is for, by its kind alone."""
    if any(
        export_format.has_markers
        for export_format in EXPORT_FORMATS
        if export_format.name == reader
    ):
        return "markers"
    return "frame" if reader == "load-frame" else "force"


def _parts(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(";"))


def _metres(text: str) -> float | None:
    with suppress(ValueError):
        return parse_quantity(text, "m") if text else None
    return None


def safe_name(name: str) -> str:
    """Make a name that a test can have of any.

    Parameters
    ----------
    name : such as that of a folder

    Examples
    --------
    >>> safe_name("Run 4, (2)"), safe_name("A2-085-1")
    ('Run-4-2', 'A2-085-1')
    """
    if is_name_of_a_test(name):
        return name
    plain = re.sub(r"[^\w.+-]+", "-", name).strip("-.+") or "test"
    return plain if is_name_of_a_test(plain) else f"test-{plain}"[:100]


def _as_written(fact: Fact) -> str:
    is_named = fact.where.startswith((FOLDER, "the name of"))
    is_plain = fact.written.startswith(fact.value) or not fact.written or is_named
    return "" if is_plain else f" ({fact.written!r})"


def _shown(name: str) -> str:
    """A name of a file as a terminal can show it."""
    return name if name.isprintable() else repr(name)[1:-1]
