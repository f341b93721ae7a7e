"""Infer a test sheet from exports: protocol, roles, day, operator and specimen."""

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
    CombinedFacts,
    Fact,
    combine_facts,
    facts_of_export,
    facts_of_folder,
)
from labpipe.process.protocol_match import (
    Fit,
    KnownFacts,
    all_protocols,
    marked_length,
    match_protocols,
)
from labpipe.process.raw_folder import (
    FolderContents,
    InspectedExport,
    folders_of_tests,
    read_folder,
)
from labpipe.protocol.load import find_protocol, load_protocol, load_test_sheet
from labpipe.protocol.schema import Protocol
from labpipe.protocol.sheet_grammar import SHEET_NAME
from labpipe.protocol.source import ROLES
from labpipe.protocol.values import is_name_of_a_test
from labpipe.records.recording import EXPORT_FORMATS
from labpipe.units import parse_quantity

_NEEDED = ("type", "spool", "sample")
_FACT_KEYS = ("date", "operator", "type", "sample", "length", "width", "thickness")
_HOW_TO_DECIDE = (
    "what would decide: a folder, export or type called like one of them, or a protocol that most"
    " tests beside it have"
)


@dataclass(frozen=True, slots=True)
class InferredTest:
    """The inferred content of a test sheet.

    Parameters
    ----------
    folder : of the test
    values : text by column of a campaign's table
    files : names of exports by role
    open : required columns without a value, which the user fills in
    remarks : sentences on the sources of the values, and on contradictions
    unread : exports of a known format that cannot be read, with the reason
    blocks : content without a column, by key of the test sheet
    """

    folder: Path
    values: Mapping[str, str]
    files: Mapping[str, tuple[str, ...]]
    open: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    unread: Mapping[str, str] = field(default_factory=dict)
    blocks: Mapping[str, Mapping[str, object]] = field(default_factory=dict)


@dataclass(slots=True)
class Neighbours:
    """Protocols of the tests of a campaign by folder; empty for a test without one.

    Parameters
    ----------
    tests : type of the specimen and protocol of each test
    """

    tests: dict[Path, tuple[str, str]] = field(default_factory=dict)

    def protocols_beside(self, folder: Path, specimen_type: str | None = None) -> Counter[str]:
        """Count the protocols of the other tests, of all types or of one.

        Parameters
        ----------
        folder : of the test itself
        specimen_type : type of the specimen; None for all
        """
        other_tests = (test for where, test in self.tests.items() if where != folder.resolve())
        return Counter(
            name
            for other_kind, name in other_tests
            if specimen_type is None or other_kind == specimen_type
        )


def neighbours_in(campaign: Path) -> Neighbours:
    """Read the protocols of the tests of a campaign.

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
    """Return the type of the specimen in the name of a folder; empty if there is none."""
    return next((fact.value for fact in facts_of_folder(folder.name) if fact.key == "type"), "")


def infer_test(
    folder: Path,
    stated: Mapping[str, str],
    *,
    neighbours: Neighbours | None = None,
) -> InferredTest:
    """Infer the test sheet of a folder from its exports.

    Parameters
    ----------
    folder : of the test
    stated : values by column, which have priority over inferred ones
    neighbours : the tests of the campaign; those of the parent folder if None

    Returns
    -------
    The inferred test. Exports that cannot be read are in the remarks and raise nothing.
    """
    contents = read_folder(folder)
    candidates = _protocols(stated, folder)
    known_neighbours = neighbours_in(folder.resolve().parent) if neighbours is None else neighbours
    return _TestInference(contents, stated, candidates, known_neighbours).infer()


def infer_tests(folders: Sequence[Path], stated: Mapping[str, str]) -> Iterator[InferredTest]:
    """Infer several tests of one campaign; the others may decide what one leaves open.

    Parameters
    ----------
    folders : of the tests
    stated : see `infer_test`

    Yields
    ------
    Each test: first those with a definite protocol, then the others. Only the recordings of one
    test are in memory at a time.
    """
    if not folders:
        return
    candidates = _protocols(stated, folders[0])
    neighbours = neighbours_in(folders[0].resolve().parent)
    waiting = []
    for folder in folders:
        inference = _TestInference(read_folder(folder), stated, candidates, neighbours)
        if len(inference.fits) > 1:
            waiting.append(folder)
            continue
        if inference.fit is not None:
            neighbours.tests[folder.resolve()] = (inference.kind, inference.fit.protocol.name)
        yield inference.infer()
    for folder in waiting:
        yield _TestInference(read_folder(folder), stated, candidates, neighbours).infer()


def _protocols(stated: Mapping[str, str], folder: Path) -> list[Protocol]:
    """Return the candidate protocols: all, or the one that the user named."""
    if "protocol" not in stated:
        return all_protocols()
    path = find_protocol(stated["protocol"], beside=folder)
    with suppress(LabpipeError):  # a wrong or missing one is reported when the sheet is written
        return [] if isinstance(path, Fault) else [load_protocol(path)]
    return []


@dataclass(frozen=True, eq=False)
class _TestInference:
    """The inference of one test."""

    contents: FolderContents
    stated: Mapping[str, str]
    protocols: Sequence[Protocol]
    neighbours: Neighbours

    @cached_property
    def facts(self) -> CombinedFacts:
        by_export = [facts_of_export(export.name, export.recording) for export in self._belonging]
        facts = [fact for facts in by_export for fact in facts if fact.key != "take"]
        folder_facts = facts_of_folder(self.contents.folder.name)
        named = {fact.key for fact in folder_facts}
        # The lab chose the name of the folder; numbers of a program have no priority over it.
        facts = [fact for fact in facts if fact.key not in named]
        if "sample" not in named:
            facts = [
                replace(fact, key="sample") if fact.key == "specimen" else fact for fact in facts
            ]
        return combine_facts([*folder_facts, *(fact for fact in facts if fact.key != "specimen")])

    @cached_property
    def stated_files(self) -> dict[str, tuple[str, ...]]:
        """Return the exports by role that the user named."""
        return {role: file_names(self.stated[role]) for role in ROLES if role in self.stated}

    @property
    def _belonging(self) -> list[InspectedExport]:
        """Return the exports that belong to this test; all of them without a matching protocol."""
        unclear = {
            name
            for fit in self.fits
            for role in fit.unclear - set(self.stated)
            for name in fit.files[role]
        }
        return [export for export in self.contents.exports if export.name not in unclear]

    @property
    def kind(self) -> str:
        """Return the type of the specimen; empty if it is not known."""
        return self.stated.get("type") or _type_of(self.contents.folder)

    @cached_property
    def fits(self) -> list[Fit]:
        named = {fact.key: fact.value for fact in facts_of_folder(self.contents.folder.name)}
        length = self.stated.get("length") or named.get("length", "")
        folder, exports = self.contents.folder, self.contents.exports
        known_facts = KnownFacts(
            names=(folder.name, self.kind, *(export.path.stem for export in exports)),
            length=_metres(length),
            of_type=self.neighbours.protocols_beside(folder, self.kind) if self.kind else {},
            of_campaign=self.neighbours.protocols_beside(folder),
            roles=self.stated_files,
        )
        return match_protocols(exports, self.protocols, known_facts) if exports else []

    @property
    def fit(self) -> Fit | None:
        """Return the protocol that fits better than all others; None if there are several."""
        return self.fits[0] if len(self.fits) == 1 else None

    def infer(self) -> InferredTest:
        """Combine all inferred values."""
        facts = self.facts.facts
        inferred = {key: facts[key].value for key in _FACT_KEYS if key in facts}
        if self.fit is not None:
            inferred = {"protocol": self.fit.protocol.name, **inferred}
        name = safe_name(self.contents.folder.resolve().name)
        values = {"test": name, **inferred, **self.stated}
        files = {**self._files, **self.stated_files}
        needed = [*_NEEDED, *(["span"] if self.fit and needs_span(self.fit.protocol) else [])]
        open_keys = [key for key in ("protocol", *needed) if not values.get(key)]
        unclear = sorted(self._unclear(files))
        open_keys += unclear or ([] if files else ["files"])
        return InferredTest(
            self.contents.folder,
            values,
            files,
            tuple(open_keys),
            tuple(self._sentences(values, files)),
            self.contents.unread,
        )

    @property
    def _files(self) -> dict[str, tuple[str, ...]]:
        """Return the exports by role, on which all candidate protocols agree, or by format."""
        if self.fits:
            return {
                role: names
                for role, names in self.fits[0].files.items()
                if all(
                    fit.files.get(role) == names and role not in fit.unclear for fit in self.fits
                )
            }
        by_role: dict[str, tuple[str, ...]] = {}
        for export in self.contents.exports:
            role = _role(export.reader)
            by_role[role] = (*by_role.get(role, ()), export.name)
        return by_role

    def _unclear(self, files: Mapping[str, object]) -> set[str]:
        return {role for fit in self.fits[:1] for role in fit.unclear if role not in files}

    def _sentences(
        self, values: Mapping[str, str], files: Mapping[str, tuple[str, ...]]
    ) -> Iterator[str]:
        yield from self._about_protocol()
        readers = {export.name: export.reader for export in self.contents.exports}
        inferred = {role: names for role, names in files.items() if role not in self.stated}
        if inferred:
            yield "; ".join(
                f"{role}: {', '.join(f'{_printable(name)} ({readers[name]})' for name in names)}"
                for role, names in inferred.items()
            )
        for role in sorted(self._unclear(files)):
            candidates = ", ".join(map(_printable, self.fits[0].files[role]))
            yield (
                f"{role}: {candidates} are all possible, and are not parts of one recording; name"
                f" one with --{role}, and use a folder for each test"
            )
        yield from self._about_facts()
        if values["test"] != self.contents.folder.resolve().name and "test" not in self.stated:
            yield f"test: {values['test']}, as a name of a test has no blanks or other signs"
        open_facts = self.facts.open
        yield from (
            sentence for sentence in open_facts if sentence.partition(":")[0] not in self.stated
        )
        yield from self._contradictions(values)
        unclear = {role: self.fits[0].files[role] for role in self._unclear(files)}
        yield from self._unused({**files, **unclear})

    def _about_facts(self) -> Iterator[str]:
        """Yield the values of each source, one line per source."""
        facts = [self.facts.facts[key] for key in _FACT_KEYS if key in self.facts.facts]
        used = [fact for fact in facts if fact.key not in self.stated]
        for where in dict.fromkeys(fact.where for fact in used):
            parts = [
                f"{fact.key} {fact.value}{_as_written(fact)}"
                for fact in used
                if fact.where == where
            ]
            yield f"{', '.join(parts)}: from {where}"

    def _about_protocol(self) -> Iterator[str]:
        if "protocol" in self.stated:
            yield from _faults(self.fits[:1])
            return
        if self.fit is not None:
            reasons = "; ".join(sign.text for sign in self.fit.signs if sign.weight > 0)
            yield f"protocol: {self.fit.protocol.name}" + (f", as {reasons}" if reasons else "")
            yield from _faults([self.fit])
        elif self.fits:
            heading = (
                f"protocol: {len(self.fits)} fit alike; name one with --protocol, or in the sheet"
            )
            descriptions = (_described(fit.protocol) for fit in self.fits)
            yield "\n    ".join((heading, *descriptions, _HOW_TO_DECIDE))
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
        """Yield contradictions that do not leave a value open."""
        max_length_deviation = 0.05
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
            reach = marked_length(fit.protocol, tracks)
            if reach is not None and abs(reach / stated - 1.0) > max_length_deviation:
                lengths = f"{reach * 1e3:.3g} mm, {values['length']} is stated"
                yield f"look: the markers of {export.name} show a length of about {lengths}"

    def _unused(self, files: Mapping[str, tuple[str, ...]]) -> Iterator[str]:
        used = {name for names in files.values() for name in names}
        for export in self.contents.exports:
            if export.name not in used:
                yield f"not used: {_printable(export.name)} ({export.reader})"
        for name, why in {**self.contents.unread, **self.contents.others}.items():
            if name not in used:
                yield f"not used: {_printable(name)}: {why.splitlines()[0]}"
        for name in sorted(used):
            if not (self.contents.folder / name).exists():
                yield f"not there yet: {_printable(name)}"


def _described(protocol: Protocol) -> str:
    """Describe the purpose of a protocol and the sizes that it states."""
    length, rig = protocol.specimen.length, protocol.rig
    sizes = [f"length {length * 1e3:g} mm"] if length else []
    sizes += [f"stroke {rig.stroke * 1e3:g} mm"] if rig.stroke else []
    sizes += [f"speed {rig.crosshead_speed * 1e3:g} mm/s"] if rig.crosshead_speed else []
    return f"{protocol.name}: {'; '.join(filter(None, (protocol.about, ', '.join(sizes))))}"


def _faults(fits: Iterable[Fit]) -> Iterator[str]:
    max_faults = 3
    for fit in fits:
        if not fit.unclear:
            yield from (f"look: {fault}" for fault in fit.faults[:max_faults])


def _role(reader: str) -> str:
    """Return the role of an export by its format alone."""
    if reader in {entry.name for entry in EXPORT_FORMATS if entry.has_markers}:
        return "markers"
    return "frame" if reader == "load-frame" else "force"


def file_names(text: str) -> tuple[str, ...]:
    """Split the exports of a role, as a table or an option writes them.

    Parameters
    ----------
    text : names, separated by semicolons; empty for none

    Examples
    --------
    >>> file_names("a.csv; b.csv"), file_names("")
    (('a.csv', 'b.csv'), ())
    """
    return tuple(part.strip() for part in text.split(";")) if text else ()


def _metres(text: str) -> float | None:
    with suppress(ValueError):
        return parse_quantity(text, "m") if text else None
    return None


def safe_name(name: str) -> str:
    """Convert any name to a valid name of a test.

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


def _printable(name: str) -> str:
    """Return a printable form of a file name."""
    return name if name.isprintable() else repr(name)[1:-1]
