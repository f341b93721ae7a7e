"""What goes wrong in a take: gaps, swapped labels, a marker under another name, a frozen one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.virtual_lab.scenario import Mishaps, Stretch
from labpipe.virtual_lab.schedule import Schedule

UNLABELLED = "Unlabeled 1234"


@dataclass(frozen=True, slots=True)
class Happening:
    """One mishap: to which markers (counted from 0 at the clamp) and in which frames.

    Parameters
    ----------
    kind : gap, switch, unlabelled or frozen
    markers : the markers themselves, whatever their labels
    start, stop : frames, `stop` left out
    """

    kind: str
    markers: tuple[int, ...]
    start: int
    stop: int


Log = tuple[Happening, ...]


def befall(
    names: tuple[str, ...],
    positions: Floats,
    mishaps: Mishaps,
    schedule: Schedule,
    *,
    n_body: int,
    random: np.random.Generator,
) -> tuple[tuple[str, ...], Floats, Log]:
    """Let the mishaps happen to the markers along the wire.

    Parameters
    ----------
    names : of the markers, the body's first, the wire's from the clamp on after them
    positions : shape (frames, markers, 3), m
    mishaps : which
    schedule : gaps fall while the clamp moves
    n_body : number of the body's markers
    random : source of the gaps

    Returns
    -------
    Names and positions with the mishaps, and what happened. Gaps belong to markers, not to labels:
    a gap during a switch shows under the other label.
    """
    frames, n_wire = len(positions), positions.shape[1] - n_body
    log = _happenings(mishaps, schedule, n_wire, random)
    seen = positions.copy()
    extra = np.full((frames, 1, 3), np.nan)
    for event in log:
        during, columns = slice(event.start, event.stop), [m + n_body for m in event.markers]
        match event.kind:
            case "gap":
                seen[during, columns] = np.nan
            case "frozen":
                seen[during, columns] = seen[event.start, columns]
            case "unlabelled":
                extra[during, 0] = seen[during, columns[0]]
                seen[during, columns] = np.nan
            case _:
                seen[during, columns] = seen[during, columns[::-1]]
    if any(event.kind == "unlabelled" for event in log):
        return (*names, UNLABELLED), np.concatenate([seen, extra], axis=1), log
    return names, seen, log


def _happenings(
    mishaps: Mishaps, schedule: Schedule, n_wire: int, random: np.random.Generator
) -> Log:
    """Fix frames and markers: first what a marker does, last what its label does."""
    time = schedule.frame_times
    first, last = np.searchsorted(time, schedule.turning_times[[0, -1]])
    lengths = list(random.integers(2, 16, mishaps.n_gaps))
    if mishaps.long_gap > 0.0:
        lengths.append(round(mishaps.long_gap / (time[1] - time[0])))
    log: list[Happening] = []
    for length in lengths:
        start = int(random.integers(first, max(first + 1, last - length)))
        log.append(Happening("gap", (int(random.integers(n_wire)),), start, start + int(length)))
    log += _stretch("frozen", mishaps.frozen, len(time), n_markers=1, n_wire=n_wire)
    log += _stretch("unlabelled", mishaps.unlabelled, len(time), n_markers=1, n_wire=n_wire)
    log += _stretch("switch", mishaps.switch, len(time), n_markers=2, n_wire=n_wire)
    return tuple(log)


def _stretch(
    kind: str, stretch: Stretch | None, frames: int, *, n_markers: int, n_wire: int
) -> list[Happening]:
    if stretch is None:
        return []
    markers = tuple(range(stretch.marker, stretch.marker + n_markers))
    if not (
        markers[0] >= 0 and markers[-1] < n_wire and 0.0 <= stretch.start < stretch.stop <= 1.0
    ):
        message = (
            f"{kind}={stretch}: allowed are markers 0 to {n_wire - n_markers} and "
            f"0 <= start < stop <= 1"
        )
        raise ValueError(message)
    return [Happening(kind, markers, int(stretch.start * frames), int(stretch.stop * frames))]
