"""From the tables of an export to a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labpipe.readers.channels import Wanted, channel_notes, find_in_parts, unique_names
from labpipe.readers.clocks import clock_notes
from labpipe.readers.files import unreadable
from labpipe.readers.load_frame.card import Card
from labpipe.readers.load_frame.table import FEW, Export, Table, time_column
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.recording import Channel, Clock, Recording
from labpipe.units import si_factor

_SAY_UNIT = (
    "Write it in a row below the names, or in brackets as in 'Time (s)', or say it in a card of"
    " your own (time_unit); see docs/how-to/new-dialect.md."
)


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    clock: Clock
    channels: list[Channel]
    about: dict[str, object]
    notes: list[QualityNote]


def assemble(
    export: Export, card: Card, path: object, channels: Sequence[Wanted] | None = None
) -> Recording:
    """Make a recording of the tables of an export.

    Parameters
    ----------
    export : its tables, already without rows that are no samples
    card : that it was read by
    path : named in errors
    channels : names or paths asked for, None for all

    Returns
    -------
    The recording: one clock per table; values in the units of the file, time in seconds.

    Raises
    ------
    ReadError
        If a channel does not exist, or the unit of time is missing or is none of time.
    """
    several = len(export.tables) > 1
    parts = [_part(table, card, path, several=several) for table in export.tables]
    made = [channel for part in parts for channel in part.channels]
    chosen = made if channels is None else _chosen(made, channels, path)
    clocks = {channel.clock for channel in chosen} if channels is not None else None
    kept = [part for part in parts if clocks is None or part.clock.name in clocks]
    notes = [note for part in kept for note in part.notes]
    return Recording(
        reader="load-frame",
        program=" ".join((card.program, _said(card.model, export.head))).strip(),
        program_version=_said(card.version, export.head),
        clocks=tuple(part.clock for part in kept),
        channels=tuple(chosen),
        metadata=_metadata(export, card, kept),
        notes=(*export.notes, *notes, *_channel_notes(chosen, card)),
    )


def _said(pattern: object, head: str) -> str:
    import re

    match = pattern.search(head) if isinstance(pattern, re.Pattern) else None
    return match[1].strip() if match else ""


def _metadata(export: Export, card: Card, parts: Sequence[_Part]) -> dict[str, object]:
    times = {part.clock.name: part.about for part in parts}
    return {"dialect": card.name, **export.about, "clocks": times}


def _chosen(made: list[Channel], wanted: Sequence[Wanted], path: object) -> list[Channel]:
    if not made:
        return []
    return [made[i] for i in sorted(set(find_in_parts(wanted, made, path)))]


def _part(table: Table, card: Card, path: object, *, several: bool) -> _Part:
    column = time_column(table.names, table.units, card)
    clock_name = table.part if several else "time"
    clock, about, notes = _clock(table, column, clock_name, card, path)
    prefix = f"{table.part}/" if several else ""
    paths = unique_names(table.names)
    channels = [
        Channel(
            name=table.names[i] or paths[i],
            path=prefix + paths[i],
            values=values,
            clock=clock_name,
            unit_in_file=table.units[i],
        )
        for i, values in table.columns.items()
        if i != column
    ]
    if table.part or table.also:
        about |= {"part": table.part or table.also}
    return _Part(clock, channels, about, [*table.notes, *notes])


def _clock(
    table: Table, column: int | None, name: str, card: Card, path: object
) -> tuple[Clock, dict[str, object], list[QualityNote]]:
    rows = max((len(values) for values in table.columns.values()), default=0)
    if column is None:
        message = f"the export has no time: its {rows} rows are counted from 0"
        note = QualityNote("no_time", Severity.INFO, f"clock {name}", message)
        few = _few_note(rows, name)
        return Clock(name, np.arange(rows, dtype=np.float64), unit="1"), {}, [note, *few]
    unit = table.units[column] or card.time_unit
    factor = _seconds(unit, table.names[column], path)
    time: Floats = table.columns[column]
    clock = Clock(name, time if factor == 1.0 else factor * time)
    about: dict[str, object] = {"time": table.names[column], "unit_in_file": unit}
    return (
        clock,
        about,
        [*clock_notes(clock, is_variable=card.variable_rate), *_few_note(rows, name)],
    )


def _seconds(unit: str, name: str, path: object) -> float:
    try:
        return si_factor(unit or "none", "s")
    except ValueError:
        pass
    try:
        return si_factor(unit.casefold() or "none", "s")
    except ValueError as error:
        raise unreadable(
            path,
            f"column '{name}'",
            "a unit of time such as s",
            f"'{unit}'" if unit else "none",
            "Look at the row of units." if unit else _SAY_UNIT,
        ) from error


def _few_note(rows: int, name: str) -> list[QualityNote]:
    if rows >= FEW or not rows:
        return []
    message = f"only {rows} samples: the test was not carried through, or not exported whole"
    return [QualityNote("few_samples", Severity.WARNING, f"clock {name}", message)]


def _channel_notes(channels: Sequence[Channel], card: Card) -> list[QualityNote]:
    blank = [(channel, int(np.isnan(channel.values).sum())) for channel in channels]
    missing = [_missing_note(channel, count, card) for channel, count in blank if count]
    return [*missing, *channel_notes(channels)]


def _missing_note(channel: Channel, count: int, card: Card) -> QualityNote:
    codes = "".join(f" or {code:.0f}" for code in card.missing)
    first = int(np.flatnonzero(np.isnan(channel.values))[0]) + 1
    message = f"{count} of {len(channel.values)} values are missing (blank{codes}),"
    message += f" the first in row {first}"
    return QualityNote("missing_values", Severity.WARNING, channel.path, message)
