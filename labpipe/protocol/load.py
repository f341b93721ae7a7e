"""From YAML to a protocol or a test sheet and back; all faults are in one error."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import yaml
from pydantic import ValidationError

from labpipe.errors import Fault, ProtocolError, nearest
from labpipe.protocol.cross_checks import Outline
from labpipe.protocol.faults import faults_of, not_among
from labpipe.protocol.grammar import Block
from labpipe.protocol.overrides import (
    absent_faults,
    are_followed,
    link_faults,
    with_overrides,
    without_absent,
)
from labpipe.protocol.plausible import implausible, ranges_in
from labpipe.protocol.schema import Protocol
from labpipe.protocol.sheet_grammar import SHEET_NAME, TestSheet, wires_in_words
from labpipe.protocol.source import ROLES
from labpipe.protocol.yaml_text import Document, PlacedFault, parse_yaml, read_text

if TYPE_CHECKING:
    from labpipe.protocol.campaign_plan import CampaignPlan
    from labpipe.protocol.harness_file import HarnessFile
    from labpipe.protocol.plans import CalibrationPlan


_SUFFIXES = (".yaml", ".yml")
_Dumper = yaml.CSafeDumper if yaml.__with_libyaml__ else yaml.SafeDumper


def protocol_folders(protocols: Path | None = None) -> tuple[Path, ...]:
    """List the folders that hold protocols, in the order in which they are searched.

    Parameters
    ----------
    protocols : the lab's folder; ``protocols`` in the working folder if None

    Returns
    -------
    The lab's folder, and that of labpipe, as far as they exist.
    """
    lab_folder = Path("protocols") if protocols is None else protocols
    folders = (shipped_folder("protocols"), lab_folder)
    unique = {folder.resolve(): folder for folder in folders if folder.is_dir()}
    return tuple(reversed(unique.values()))


def shipped_folder(name: str) -> Path:
    """Find a folder of files that come with labpipe.

    Parameters
    ----------
    name : ``protocols`` or ``examples``

    Returns
    -------
    The folder: inside the package where that was installed, else beside it in the checkout.
    """
    package = Path(__file__).resolve().parents[1]
    installed = package / "shipped" / name
    return installed if installed.is_dir() else package.parent / name


def known_protocols(protocols: Path | None = None) -> dict[str, Path]:
    """List the protocols that can be named, with their files.

    Parameters
    ----------
    protocols : as for `protocol_folders`
    """
    known_protocols: dict[str, Path] = {}
    for folder in protocol_folders(protocols):
        for path in sorted(folder.iterdir()):
            if path.suffix in _SUFFIXES:
                known_protocols.setdefault(path.stem, path)
    return known_protocols


def find_protocol(wanted: str, *, beside: Path, protocols: Path | None = None) -> Path | Fault:
    """Find the file of a protocol.

    Parameters
    ----------
    wanted : its name, or a path: beside the test sheet, or else from the working folder
    beside : folder of the test sheet
    protocols : as for `protocol_folders`

    Returns
    -------
    The file, or what is wrong with the key ``protocol`` of the sheet.
    """
    if wanted.endswith(_SUFFIXES) or "/" in wanted or "\\" in wanted:
        places = [beside / wanted, Path(wanted)]
        files = [place for place in places if is_there(place)]
        remedy = f"There is none at {' or '.join(map(str, places))}."
        return files[0] if files else Fault(("protocol",), "a protocol", repr(wanted), remedy)
    protocol_files = known_protocols(protocols)
    if wanted in protocol_files:
        return protocol_files[wanted]
    if protocol_files:
        return not_among(("protocol",), wanted, protocol_files, "one of the protocols")
    remedy = "There is no folder 'protocols' here."
    return Fault(("protocol",), "a protocol", repr(wanted), remedy)


def is_there(path: Path) -> bool:
    """Check whether there is a file or a folder of a name, which the system may refuse."""
    try:
        return path.exists()
    except OSError:  # a name that is too long
        return False


_B = TypeVar("_B", bound=Block)


def load_protocol(path: Path) -> Protocol:
    """Read a protocol.

    Parameters
    ----------
    path : the YAML file

    Returns
    -------
    The protocol, defaults filled in.

    Raises
    ------
    ProtocolError
        If anything is wrong with it; the message has one line per fault.
    """
    return parse_protocol(read_text(path), str(path))


def parse_protocol(text: str, name: str) -> Protocol:
    """Read a protocol from text, such as the one that a result file holds.

    Parameters
    ----------
    text : YAML
    name : where it comes from, as in messages

    Returns
    -------
    The protocol, defaults filled in.

    Raises
    ------
    ProtocolError
        If anything is wrong with it; the message has one line per fault.
    """
    return _sound_protocol(text) or checked(Protocol, parse_yaml(text, name))


@lru_cache(maxsize=64)
def _sound_protocol(text: str) -> Protocol | None:
    """Read a protocol once for all results that hold it; None if anything is wrong with it."""
    try:
        return checked(Protocol, parse_yaml(text, ""))
    except ProtocolError:
        return None


def load_test_sheet(path: Path) -> TestSheet:
    """Read a test sheet; whether its exports are links out of its folder, `resolve` looks.

    Parameters
    ----------
    path : the ``test.yaml``

    Returns
    -------
    The test sheet.

    Raises
    ------
    ProtocolError
        If anything is wrong with it; the message has one line per fault.
    """
    return checked(TestSheet, parse_yaml(read_text(path), str(path)))


def load_calibration_plan(path: Path) -> CalibrationPlan:
    """Read what is asked of a calibration.

    Parameters
    ----------
    path : the YAML file

    Returns
    -------
    The plan, defaults filled in.

    Raises
    ------
    ProtocolError
        If anything is wrong with it; the message has one line per fault.
    """
    from labpipe.protocol.plans import CalibrationPlan  # tests do without it

    return checked(CalibrationPlan, parse_yaml(read_text(path), str(path)))


def load_campaign_plan(path: Path) -> CampaignPlan:
    """Read how exports become the tests of a campaign.

    Parameters
    ----------
    path : the YAML file

    Returns
    -------
    The plan, defaults filled in.

    Raises
    ------
    ProtocolError
        If anything is wrong with it; the message has one line per fault.
    """
    from labpipe.protocol.campaign_plan import CampaignPlan  # tests do without it

    return checked(CampaignPlan, parse_yaml(read_text(path), str(path)))


def load_harness(path: Path) -> HarnessFile:
    """Read a harness: one line between its boundaries.

    Parameters
    ----------
    path : the YAML file

    Returns
    -------
    The harness, defaults filled in; its line is long enough for its boundaries.

    Raises
    ------
    ProtocolError
        If anything is wrong with it, or a file that it names is not there; the message has one line
        per fault.
    """
    from labpipe.protocol.harness_file import HarnessFile, file_faults, reach_faults

    document = parse_yaml(read_text(path), str(path))
    harness = checked(HarnessFile, document)
    faults = [*file_faults(harness, path), *reach_faults(harness)]
    if faults:
        raise error_of_faults(list(map(document.place, faults)))
    return harness


def resolve(
    sheet: TestSheet,
    sheet_path: Path,
    protocols: Path | None = None,
    *,
    follow_links: bool = False,
) -> Protocol:
    """Find the protocol of a test and put the test's own values into it.

    Parameters
    ----------
    sheet : the test sheet
    sheet_path : the file that it was loaded from
    protocols : folder of the lab's protocols; ``protocols`` in the working folder if None
    follow_links : whether exports may be links out of the folder of the test, whatever the
        protocol says

    Returns
    -------
    The protocol, with defaults, overrides and the specimen's dimensions filled in, and without what
    an optional export would have made that the test lacks.

    Raises
    ------
    ProtocolError
        If there is no such protocol, it is wrong, an override does not fit it, the roles of the
        files are not those of its sources, or an export is a link that may not be followed; the
        message has one line per fault.
    """
    sheet_document = parse_yaml(read_text(sheet_path), str(sheet_path))
    protocol_file = find_protocol(sheet.protocol, beside=sheet_path.parent, protocols=protocols)
    if isinstance(protocol_file, Fault):
        raise error_of_faults([sheet_document.place(protocol_file)])
    plain = parse_yaml(read_text(protocol_file), str(protocol_file))
    merged = parse_yaml(read_text(protocol_file), str(protocol_file))
    with_overrides(merged, sheet_document)
    followed = follow_links or are_followed(plain)
    links = link_faults(sheet, sheet_path.parent, followed=followed)
    sheet_faults = (
        *_role_faults(sheet, merged),
        *links,
        *_implausible_sizes(sheet, sheet_document, merged),
    )
    placed = [*merged.faults, *map(sheet_document.place, sheet_faults)]
    try:
        protocol = Protocol.model_validate(merged.data)
    except ValidationError as error:
        remark = f"(With what {sheet_path} changes.)" if _is_sound(plain) else ""
        for fault in faults_of(error, data=merged.data, keys=()):
            is_of_sheet = merged.spot_at(fault.path)[0].file == str(sheet_path)
            placed.append(merged.place(fault, "" if is_of_sheet else remark))
        raise error_of_faults(placed) from None
    steps = tuple(
        step.numbered(int(merged.spot_at(("steps", number))[0].name))
        for number, step in enumerate(protocol.steps)
    )
    protocol = protocol.model_copy(update={"steps": steps})
    reduced = without_absent(protocol, sheet.files)
    placed += [sheet_document.place(fault) for fault in absent_faults(reduced, protocol)]
    if placed:
        raise error_of_faults(placed)
    return reduced


def missing_exports(sheet: TestSheet, sheet_path: Path) -> ProtocolError | None:
    """Find exports that a test sheet names and that are not there.

    Parameters
    ----------
    sheet : the test sheet
    sheet_path : the file that it was loaded from

    Returns
    -------
    The error, with a line per export; None if all are there.
    """
    folder = sheet_path.parent
    faults = [
        Fault(("files", role), "a file", f"none of that name ({name!r})", _nearest_in(folder, name))
        for role, names in sheet.files.items()
        for name in names
        if not is_there(folder / name)
    ]
    document = parse_yaml(read_text(sheet_path), str(sheet_path)) if faults else None
    placed = [] if document is None else [document.place(fault) for fault in faults]
    return error_of_faults(placed, code="missing_export") if placed else None


def _nearest_in(folder: Path, name: str) -> str:
    names = [path.name for path in folder.iterdir() if path.name != SHEET_NAME]
    listed = ", ".join(map(repr, nearest(name, names, limit=3)))
    return f"Correct the name, or copy the export there; nearest are {listed or 'no files'}."


def dump_protocol(protocol: Protocol) -> str:
    """Write a protocol as YAML with units, defaults filled in.

    Parameters
    ----------
    protocol : the protocol

    Returns
    -------
    Text that `parse_protocol` reads into an equal protocol.
    """
    data = protocol.model_dump(mode="json", by_alias=True)
    return str(yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=1000))


def checked(model: type[_B], document: Document) -> _B:
    """Validate a document.

    Parameters
    ----------
    model : the block that it should be
    document : as parsed

    Raises
    ------
    ProtocolError
        If anything is wrong with it; the message has one line per fault.
    """
    placed = list(document.faults)
    try:
        block = model.model_validate(document.data)
    except ValidationError as error:
        faults = faults_of(error, data=document.data, keys=())
        raise error_of_faults([*placed, *map(document.place, faults)]) from None
    if placed:
        raise error_of_faults(placed)
    return block


def error_of_faults(placed: list[PlacedFault], *, code: str = "") -> ProtocolError:
    """Make one error of all faults of a file, a line each, in the order of the file."""
    return ProtocolError("\n".join(text for _, _, text in sorted(set(placed))), code=code)


def _is_sound(document: Document) -> bool:
    try:
        Protocol.model_validate(document.data)
    except ValidationError:
        return False
    return True


def _implausible_sizes(sheet: TestSheet, document: Document, merged: Document) -> Iterator[Fault]:
    """Find sizes of the specimen that are outside the ranges of protocol and overrides."""
    specimen: Any = document.at(("specimen",))
    if isinstance(bundle := specimen.get("bundle"), dict):
        wires = wires_in_words(bundle.get("wires"))
        specimen = {**specimen, "bundle": {**bundle, "wires": wires}}
    ranges = ranges_in(merged.data if isinstance(merged.data, Mapping) else {})
    yield from implausible(specimen, ("specimen",), ranges, others=sheet.specimen.dimensions)


def _role_faults(sheet: TestSheet, protocol: Document) -> Iterable[Fault]:
    """Find roles that only one of test sheet and protocol has."""
    outline = Outline(protocol.data if isinstance(protocol.data, Mapping) else {})
    roles = [str(role) for role in outline.sources]
    optional = {role for role in roles if outline.is_optional(role)}
    for role in sheet.files:
        if roles and role not in roles:
            yield not_among(("files", role), role, roles, "a role of the protocol:", at="key")
    for missing in sorted(set(roles) & set(ROLES) - set(sheet.files) - optional):
        expected = f"a file in the role {missing!r}"
        yield Fault(("files",), expected, "none", "Add it to 'files'.")
