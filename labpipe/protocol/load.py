"""Load protocols, test sheets, plans and harnesses, and resolve the protocol of one test.

Resolving a protocol applies the overrides of the test sheet, and removes the steps, results and
figures that need an absent optional export. One error lists all faults of a file.
"""

from __future__ import annotations

import copy
from collections.abc import Collection, Iterator
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import yaml

from labpipe.errors import Fault, KeyPath, ProtocolError, sort_by_likeness
from labpipe.protocol.grammar import Block
from labpipe.protocol.schema import (
    AlignNone,
    Protocol,
    find_unknown_main_results,
    list_result_names,
    list_unmet_needs,
)
from labpipe.protocol.sheet_grammar import (
    SHEET_NAME,
    CampaignPlan,
    TestSheet,
)
from labpipe.protocol.source import ROLES, find_implausible_sizes
from labpipe.protocol.yaml_text import (
    Document,
    LocatedBlock,
    LocatedList,
    build_choice_fault,
    build_error,
    get_block,
    parse_yaml,
    read_text,
    suggest_word,
)
from labpipe.records.declarations import Step, TravelFromSpeed
from labpipe.units import parse_count

if TYPE_CHECKING:
    from labpipe.protocol.model_files import CalibrationPlan, HarnessFile

_SUFFIXES = (".yaml", ".yml")
"""Suffixes of the files of protocols."""
_Dumper = yaml.CSafeDumper if yaml.__with_libyaml__ else yaml.SafeDumper
"""Fastest installed class that writes YAML."""


def list_protocol_folders(protocols: Path | None = None) -> tuple[Path, ...]:
    """List the existing folders of protocols in the order of the search.

    Parameters
    ----------
    protocols : folder of the lab's protocols; ``protocols`` in the working folder if None

    Returns
    -------
    The lab's folder, then the shipped one.
    """
    lab_folder = Path("protocols") if protocols is None else protocols
    folders = (find_shipped_folder("protocols"), lab_folder)
    unique_folders = {folder.resolve(): folder for folder in folders if folder.is_dir()}
    return tuple(reversed(unique_folders.values()))


def find_shipped_folder(name: str) -> Path:
    """Find a folder of files that are shipped with labpipe.

    Parameters
    ----------
    name : ``protocols`` or ``examples``

    Returns
    -------
    The folder: in the installed package, or beside the package in a checkout.
    """
    package = Path(__file__).resolve().parents[1]
    installed_folder = package / "shipped" / name
    return installed_folder if installed_folder.is_dir() else package.parent / name


def list_protocols(protocols: Path | None = None) -> dict[str, Path]:
    """List the files of all protocols.

    Parameters
    ----------
    protocols : folder of the lab's protocols, see `list_protocol_folders`

    Returns
    -------
    File of each protocol, keyed by its name; a lab's protocol replaces a shipped one.
    """
    files: dict[str, Path] = {}
    for folder in list_protocol_folders(protocols):
        for path in sorted(folder.iterdir()):
            if path.suffix in _SUFFIXES:
                files.setdefault(path.stem, path)
    return files


def find_protocol(name: str, *, sheet_folder: Path, protocols: Path | None = None) -> Path | Fault:
    """Find the file of a protocol.

    Parameters
    ----------
    name : name of the protocol, or its path, relative to `sheet_folder` or to the working folder
    sheet_folder : folder of the test sheet
    protocols : folder of the lab's protocols, see `list_protocol_folders`

    Returns
    -------
    The file, or the fault at the key ``protocol`` of the sheet.
    """
    if name.endswith(_SUFFIXES) or "/" in name or "\\" in name:
        paths = [sheet_folder / name, Path(name)]
        fault = Fault.of("protocol.no_protocol_at", ("protocol",), name=name, paths=paths)
        return next(filter(path_exists, paths), fault)
    protocol_files = list_protocols(protocols)
    if name in protocol_files:
        return protocol_files[name]
    if protocol_files:
        return build_choice_fault(("protocol",), name, protocol_files, "one of the protocols")
    return Fault.of("protocol.no_protocols", ("protocol",), name=name)


def path_exists(path: Path) -> bool:
    """Return whether a file or folder exists; False for names that the system refuses."""
    try:
        return path.exists()
    except OSError:  # a name that is too long
        return False


_B = TypeVar("_B", bound=Block)


def load_protocol(path: Path) -> Protocol:
    """Load a protocol.

    Parameters
    ----------
    path : the YAML file

    Returns
    -------
    The protocol with defaults.

    Raises
    ------
    ProtocolError
        If the file cannot be read or is invalid; the message has one line per fault.
    """
    return parse_protocol(read_text(path), str(path))


def parse_protocol(text: str, name: str) -> Protocol:
    """Parse a protocol from text, such as that in a result file.

    Parameters
    ----------
    text : YAML
    name : name of the file in messages

    Returns
    -------
    The protocol with defaults.

    Raises
    ------
    ProtocolError
        If the text is invalid; the message has one line per fault.
    """
    return _parse_valid_protocol(text) or validate_document(Protocol, parse_yaml(text, name))


@lru_cache(maxsize=64)
def _parse_valid_protocol(text: str) -> Protocol | None:
    """Parse a protocol, cached for all its tests and results; None if it is invalid."""
    try:
        return validate_document(Protocol, parse_yaml(text, ""))
    except ProtocolError:
        return None


def load_test_sheet(path: Path) -> TestSheet:
    """Load a test sheet.

    Links out of the folder of the test are not checked here, but in `resolve_protocol`.

    Parameters
    ----------
    path : the YAML file

    Returns
    -------
    The test sheet.

    Raises
    ------
    ProtocolError
        If the file cannot be read or is invalid; the message has one line per fault.
    """
    return validate_document(TestSheet, parse_yaml(read_text(path), str(path)))


def load_calibration_plan(path: Path) -> CalibrationPlan:
    """Load the plan of a calibration.

    Parameters
    ----------
    path : the YAML file

    Returns
    -------
    The plan with defaults.

    Raises
    ------
    ProtocolError
        If the file cannot be read or is invalid; the message has one line per fault.
    """
    from labpipe.protocol.model_files import CalibrationPlan

    return validate_document(CalibrationPlan, parse_yaml(read_text(path), str(path)))


def load_campaign_plan(path: Path) -> CampaignPlan:
    """Load the plan of a campaign.

    Parameters
    ----------
    path : the YAML file

    Returns
    -------
    The plan with defaults.

    Raises
    ------
    ProtocolError
        If the file cannot be read or is invalid; the message has one line per fault.
    """
    return validate_document(CampaignPlan, parse_yaml(read_text(path), str(path)))


def load_harness(path: Path) -> HarnessFile:
    """Load a harness.

    Parameters
    ----------
    path : the YAML file

    Returns
    -------
    The harness with defaults; its line is long enough for its boundaries.

    Raises
    ------
    ProtocolError
        If the file cannot be read or is invalid, or if a file that it names does not exist; the
        message has one line per fault.
    """
    from labpipe.protocol.model_files import HarnessFile, find_missing_files

    document = parse_yaml(read_text(path), str(path))
    harness = validate_document(HarnessFile, document)
    if faults := [*find_missing_files(harness, path)]:
        raise build_error(map(document.place, faults))
    return harness


def resolve_protocol(
    sheet: TestSheet, sheet_path: Path, protocols: Path | None = None, *, follow_links: bool = False
) -> Protocol:
    """Load the protocol of a test and apply the test sheet to it.

    Parameters
    ----------
    sheet : the test sheet
    sheet_path : file of the test sheet
    protocols : folder of the lab's protocols, see `list_protocol_folders`
    follow_links : whether exports may be links out of the folder of the test, even if the protocol
        does not allow them

    Returns
    -------
    The protocol with defaults, the overrides and the dimensions of the specimen, and without steps
    and results that need an absent optional export.

    Raises
    ------
    ProtocolError
        If the protocol does not exist or is invalid; if an override, a role, a dimension or an
        answer of the sheet does not fit it; if the curve needs an absent export; or if an export is
        a link that is not allowed. The message has one line per fault.
    """
    sheet_document = parse_yaml(read_text(sheet_path), str(sheet_path))
    protocol_file = find_protocol(
        sheet.protocol, sheet_folder=sheet_path.parent, protocols=protocols
    )
    if isinstance(protocol_file, Fault):
        raise build_error([sheet_document.place(protocol_file)])
    text, name = read_text(protocol_file), str(protocol_file)
    document = parse_yaml(text, name)
    document.faults += map(sheet_document.place, apply_overrides(document, sheet_document))
    protocol, protocol_faults = Protocol.read(document.data)
    is_due_to_sheet = bool(protocol_faults) and not Protocol.read(parse_yaml(text, name).data)[1]
    remark = f"(With the overrides of {sheet_path}.)" if is_due_to_sheet else ""
    placed_faults = [
        document.place(fault, remark if document.find_location(fault.path)[0].file == name else "")
        for fault in protocol_faults
    ]
    faults: list[Fault] = []
    if protocol is not None:
        # A test sheet cannot override whether links are followed.
        follow_links |= protocol.follow_links is True  # None in a draft if its value is invalid
        faults += _find_role_faults(sheet, protocol)
        faults += _find_link_faults(sheet, sheet_path.parent, follow_links=follow_links)
        faults += _find_wrong_answers(sheet, protocol)
    if protocol is None or placed_faults:
        raise build_error([*document.faults, *placed_faults, *map(sheet_document.place, faults)])
    # Overrides may have removed steps; the other steps keep their numbers from the file.
    steps = tuple(
        step.with_index(int(document.find_location(("steps", index))[0].name))
        for index, step in enumerate(protocol.steps)
    )
    protocol = protocol.model_copy(update={"steps": steps})
    reduced_protocol = remove_absent_sources(protocol, sheet.files)
    ranges, dimensions = protocol.plausible, sheet.specimen.dimensions
    faults += find_implausible_sizes(
        sheet.specimen, ("specimen",), ranges, other_lengths=dimensions
    )
    faults += find_missing_curve_sources(reduced_protocol, protocol)
    if placed_faults := [*document.faults, *map(sheet_document.place, faults)]:
        raise build_error(placed_faults)
    return reduced_protocol


def find_export_error(sheet: TestSheet, sheet_path: Path) -> ProtocolError | None:
    """Find exports that a test sheet names but that do not exist, and build their error.

    Parameters
    ----------
    sheet : the test sheet
    sheet_path : file of the test sheet

    Returns
    -------
    The error, with one line per missing export; None if all exports exist.
    """
    folder = sheet_path.parent
    exports = [(role, name) for role, names in sheet.files.items() for name in names]
    missing_exports = [(role, name) for role, name in exports if not path_exists(folder / name)]
    if not missing_exports:
        return None
    document = parse_yaml(read_text(sheet_path), str(sheet_path))
    other_files = [path.name for path in folder.iterdir() if path.name != SHEET_NAME]
    placed_faults = []
    for role, name in missing_exports:
        similar = ", ".join(map(repr, sort_by_likeness(name, other_files, limit=3))) or "no files"
        fault = Fault.of("protocol.no_such_export", ("files", role), name=name, similar=similar)
        placed_faults.append(document.place(fault))
    return build_error(placed_faults, code="missing_export")


def format_protocol(protocol: Protocol) -> str:
    """Format a protocol as YAML with units and defaults.

    Parameters
    ----------
    protocol : the protocol, which may be resolved

    Returns
    -------
    Text from which `parse_protocol` reads an equal protocol.
    """
    data = protocol.model_dump(mode="json", by_alias=True)
    return str(yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=1000))


def validate_document(model: type[_B], document: Document) -> _B:
    """Validate a parsed YAML file.

    Parameters
    ----------
    model : class of the expected block
    document : parsed file

    Returns
    -------
    The block.

    Raises
    ------
    ProtocolError
        If the file is invalid; the message has one line per fault.
    """
    block, faults = model.read(document.data)
    if placed_faults := [*document.faults, *map(document.place, faults)]:
        raise build_error(placed_faults)
    return cast("_B", block)


def _find_wrong_answers(sheet: TestSheet, protocol: Protocol) -> Iterator[Fault]:
    """Find answers to no question of the protocol, and answers that the protocol does not list."""
    questions = protocol.questions
    for name, answer in sheet.specimen.observed.items():
        path = ("specimen", "observed", name)
        if name not in questions:
            remedy = "The protocol asks no questions; use specimen.labels."
            choice_text = "a question of the protocol:"
            yield build_choice_fault(path, name, questions, choice_text, remedy=remedy, is_key=True)
        elif answer not in questions[name]:
            answers = ", ".join(map(repr, questions[name]))
            yield Fault.of("protocol.no_answer", path, answers=answers, found=answer)


def _find_role_faults(sheet: TestSheet, protocol: Protocol) -> Iterator[Fault]:
    """Find roles without a source in the protocol, and required sources without a file."""
    sources = protocol.sources or sheet.files.keys()
    for role in sheet.files.keys() - sources:
        choice_text = "a role of the protocol:"
        yield build_choice_fault(("files", role), role, sources, choice_text, is_key=True)
    for role, source in (protocol.sources or {}).items():
        if role in ROLES and role not in sheet.files and not source.optional:
            yield Fault.of("protocol.no_file_of_role", ("files",), role=role)


def _find_link_faults(sheet: TestSheet, folder: Path, *, follow_links: bool) -> Iterator[Fault]:
    """Find exports that are links to themselves, or links out of the folder of the test."""
    test_folder = folder.resolve()
    for role, name in ((role, name) for role, names in sheet.files.items() for name in names):
        try:
            is_inside = (folder / name).resolve().is_relative_to(test_folder)
        except (OSError, RuntimeError):  # a loop is a RuntimeError up to Python 3.12
            yield Fault.of("protocol.link_to_itself", ("files", role), name=name)
            continue
        if not (is_inside or follow_links):
            yield Fault.of("protocol.link_out", ("files", role), name=name)


_DIMENSION_KEYS = ("length", "gauge_length", "span", "mass_per_length", "section")
"""Keys of the specimen in a test sheet that override those in the protocol."""


def apply_overrides(protocol: Document, sheet: Document) -> Iterator[Fault]:
    """Apply the overrides of a test sheet to a protocol.

    Changed values get their locations in the sheet. An override with null removes an item of a
    list; a result is also removed from the main results of groups. The overrides are applied as the
    faults are yielded.

    Parameters
    ----------
    protocol : document of the protocol, which is modified
    sheet : document of a valid test sheet

    Yields
    ------
    Faults, with paths in the sheet: overrides of unknown keys, of keys that the sheet states twice,
    and of the key ``follow_links``.
    """
    specimen, overrides = get_block(sheet.data, "specimen"), get_block(sheet.data, "overrides")
    sheet_paths: dict[str, KeyPath] = {
        f"specimen.{key}": ("specimen", key) for key in _DIMENSION_KEYS if specimen.get(key)
    }
    for key in get_block(specimen, "uncertainty"):
        sheet_paths[f"specimen.uncertainty.{key}"] = ("specimen", "uncertainty", key)
    value_paths = {**sheet_paths}
    for key in overrides:
        path: KeyPath = ("overrides", key, "value")
        if key in sheet_paths:
            override, value = sheet.get_value(path), sheet.get_value(sheet_paths[key])
            yield Fault.of("protocol.override_twice", path, key=key, override=override, value=value)
        elif key == "follow_links":  # a test folder from elsewhere must not allow links
            yield Fault.of("protocol.not_overridable", path[:2], is_key=True, key=key)
        else:
            value_paths[key] = path
    for key, path in value_paths.items():
        yield from _set_value(protocol, key, sheet, path)
    align = get_block(protocol.data).get("align")
    if "align" in overrides and isinstance(align, dict) and align.get("method") == "stated":
        align.setdefault("because", sheet.get_value(("overrides", "align", "because")))


def _set_value(
    protocol: Document, dotted_key: str, sheet: Document, value_path: KeyPath
) -> Iterator[Fault]:
    """Set the value at a dotted key of the protocol to the value at a path of the sheet.

    An item of a list is removed if its new value is null. An unknown key is a fault, and so is a
    key below a missing list of steps or results.
    """
    value, (location, _) = sheet.get_value(value_path), sheet.find_location(value_path)
    location = location._replace(key_mark=sheet.find_location(value_path[:2])[0].key_mark)
    node: Any = protocol.data
    words = dotted_key.split(".")
    for depth, word in enumerate(words, start=1):
        key = _find_key(node, word)
        if key is None:
            yield _build_key_fault(node, word, value_path[:2])
            return
        if depth == len(words):
            break
        if isinstance(node, LocatedBlock) and node.get(word) is None:
            if depth == 1 and word in ("steps", "results"):
                path = value_path[:2]
                yield Fault.of(
                    "protocol.override_of_no_list", path, is_key=True, key=dotted_key, block=word
                )
                return
            node[word], node.locations[word] = LocatedBlock(), location._replace(name=word)
        node = node[key]
    if isinstance(node, LocatedList) and value is None:
        _remove_main_results(protocol, _list_names(node.pop(key)))
        del node.locations[key]
        return
    location = location._replace(name=node.locations[key].name if isinstance(key, int) else word)
    node[key], node.locations[key] = copy.deepcopy(value), location


def _remove_main_results(protocol: Document, names: list[str]) -> None:
    """Remove results from the main results of groups."""
    main = get_block(protocol.data, "groups").get("main")
    if not isinstance(main, LocatedList):
        return
    for index in reversed(range(len(main))):
        if str(main[index]).partition(".")[0] in names:
            del main[index], main.locations[index]


def _find_key(node: object, word: str) -> Any:
    """Find the key or index of a word of a dotted key, which is a key, number, name or kind."""
    if isinstance(node, dict):
        return word
    if not isinstance(node, LocatedList):
        return None
    index = parse_count(word)
    if index is not None:
        # Earlier overrides may have removed items; the other items keep their numbers.
        written_indices = [location.name for location in node.locations]
        return written_indices.index(index) if index in written_indices else None
    # Names precede kinds: of several stiffnesses, one may have the name `stiffness`.
    for list_labels in (_list_names, _list_kinds):
        matches = [i for i, item in enumerate(node) if word in list_labels(item)]
        if len(matches) == 1:
            return matches[0]
    return None


def _list_kinds(item: object) -> list[str]:
    """List the kind of an item of ``steps`` or ``results``; empty if it has none."""
    kinds = (get_block(item).get(key) for key in ("step", "result"))
    return [kind for kind in kinds if isinstance(kind, str)]


def _list_names(item: object) -> list[str]:
    """List the names of an item of ``results`` in the summary, without numbers of cycles."""
    block = get_block(item)
    return [name.partition(".")[0] for name in list_result_names(str(block.get("result")), block)]


def _build_key_fault(node: object, word: str, path: KeyPath) -> Fault:
    """Build the fault of an unknown word of a dotted key."""
    if not isinstance(node, list):
        return Fault.of("protocol.below_a_value", path, is_key=True, key=word)
    labels = [label for item in node for label in {*_list_kinds(item), *_list_names(item)}]
    remedy = "Use its number." if labels.count(word) > 1 else suggest_word(word, labels)
    last_index = len(node) - 1
    return Fault.of("protocol.no_item", path, is_key=True, key=word, last=last_index, remedy=remedy)


def remove_absent_sources(protocol: Protocol, roles: Collection[str]) -> Protocol:
    """Remove absent optional sources from a protocol, and everything that needs them.

    Parameters
    ----------
    protocol : protocol as loaded
    roles : roles of the files of the test

    Returns
    -------
    The protocol without absent optional sources, without the steps, results and figures that need
    them, and without a ``travel-from-speed`` whose channel a source measures. If the displacement
    is computed from the speed, it is on the clock of the force, and no clocks are aligned.
    """
    sources = {
        role: source
        for role, source in protocol.sources.items()
        if role in roles or not source.optional
    }
    reduced = protocol.model_copy(update={"sources": sources})
    steps = tuple(_list_possible_steps(reduced, {*protocol.channels} - {*reduced.channels}))
    changes: dict[str, object] = {"steps": steps}
    if "markers" not in sources:
        changes["markers"] = None
    computed_channels = {step.channel for step in steps if isinstance(step, TravelFromSpeed)}
    if protocol.curve is not None and protocol.curve.displacement in computed_channels:
        changes["align"] = AlignNone()
    reduced = reduced.model_copy(update=changes)
    unmet_paths = {path for path, *_ in list_unmet_needs(reduced)}
    results = enumerate(reduced.results)
    kept_results = tuple(x for i, x in results if ("results", i, "result") not in unmet_paths)
    reduced = reduced.model_copy(update={"results": kept_results})
    unmet_paths = {path for path, *_ in list_unmet_needs(reduced)}
    unmet_paths |= {fault.path for fault in find_unknown_main_results(reduced)}
    figures, main_results = enumerate(reduced.report.figures), enumerate(reduced.groups.main)
    kept_figures = tuple(x for i, x in figures if ("report", "figures", i) not in unmet_paths)
    kept_main = tuple(name for i, name in main_results if ("groups", "main", i) not in unmet_paths)
    report = reduced.report.model_copy(update={"figures": kept_figures})
    groups = reduced.groups.model_copy(update={"main": kept_main})
    return reduced.model_copy(update={"report": report, "groups": groups})


def find_missing_curve_sources(protocol: Protocol, full_protocol: Protocol) -> Iterator[Fault]:
    """Find absent optional sources without which there is no curve.

    Parameters
    ----------
    protocol : protocol without absent sources, from `remove_absent_sources`
    full_protocol : the same protocol with all its sources

    Yields
    ------
    Faults at the key ``files`` of the test sheet.
    """
    speed_steps = (step for step in protocol.steps if isinstance(step, TravelFromSpeed))
    computed_channels = {step.channel for step in speed_steps}
    blocks = (protocol.curve, protocol.branches, protocol.align)
    keys = ("force", "displacement", "channel")
    used_channels = {getattr(block, key, None) for block in blocks for key in keys}
    rig_keys = ("crosshead_speed", "stroke")
    missing_keys = [key for key in rig_keys if getattr(protocol.rig, key) is None]
    absent_roles = [role for role in full_protocol.sources if role not in protocol.sources]
    for role in absent_roles:
        for name in sorted(full_protocol.sources[role].all_channels):
            if name in computed_channels:
                for key in missing_keys:
                    yield Fault.of(
                        "protocol.no_file_or_speed", ("files",), role=role, key=key, channel=name
                    )
            elif name in used_channels:
                yield Fault.of("protocol.no_needed_file", ("files",), role=role, channel=name)


def _list_possible_steps(protocol: Protocol, absent_channels: set[str]) -> Iterator[Step]:
    """Yield the steps of a protocol that need no absent source."""
    for step in protocol.steps:
        if "markers" not in protocol.sources and step.uses_markers:
            continue
        if isinstance(step, TravelFromSpeed):
            if step.channel not in protocol.channels:
                absent_channels = absent_channels - {step.channel}
                yield step
        elif getattr(step, "channel", None) not in absent_channels:
            yield step
