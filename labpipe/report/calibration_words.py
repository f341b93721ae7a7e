"""A calibration in words: its numbers as lines of a table, its verdicts as sentences."""

from __future__ import annotations

from collections.abc import Iterator

from labpipe.records.calibration import (
    CalibratedParameter,
    Calibration,
    Separability,
    SourceCalibration,
)
from labpipe.records.quality import Severity
from labpipe.report.calibration_look import (
    SHOWN,
    SMALL_FORCE,
    percent,
    typeset,
)
from labpipe.report.numbers import write_number
from labpipe.report.wording import count_of

HEADS = ("parameter", "value", "95 % interval", "unit", "verdict")
_DIGITS = 2
"""Of a value whose interval is open."""
_TOLD = frozenset({"at_bound", "not_identified", "prior_contradicts_data"})
"""Codes of notes that repeat what the sentences of the parameters say."""


def parameter_row(parameter: CalibratedParameter) -> tuple[str, ...]:
    """Write a parameter as the line of a table, under `HEADS`.

    Parameters
    ----------
    parameter : an interval that is open on a side is ``below ...`` or ``above ...``
    """
    shown = SHOWN[parameter.name]
    factor, is_open = shown.scale.factor, parameter.is_open_below or parameter.is_open_above
    written = write_number(parameter.value, parameter.interval, factor)
    value = write_number(parameter.value, None, factor, digits=_DIGITS) if is_open else written
    ends = {
        (False, False): written.interval,
        (True, False): f"below {written.upper}",
        (False, True): f"above {written.lower}",
        (True, True): "open on both sides",
    }
    between = ends[parameter.is_open_below, parameter.is_open_above]
    unit = shown.scale.unit or "1"
    return (
        typeset(shown.words).rstrip("."),
        value.value,
        between or "\u2013",
        unit,
        parameter.verdict.value,
    )


def sentences(calibration: Calibration, source: SourceCalibration | None = None) -> list[str]:
    """Say what a calibration found, and what it does not know.

    Parameters
    ----------
    calibration : all of it
    source : said where it was run

    Returns
    -------
    Sentences on: each parameter, its prior, agreement with the tests, what cannot be told apart,
    notes, `method: source`.
    """
    return [
        *_parameters(calibration),
        _agreement(calibration),
        _levels(calibration),
        *_separabilities(calibration),
        *_notes(calibration),
        *([_source(source)] if source is not None else []),
    ]


def _parameters(calibration: Calibration) -> Iterator[str]:
    for parameter in calibration.parameters:
        yield typeset(parameter.words)
        if parameter.conflict is not None:
            yield typeset(parameter.conflict.message)


def _agreement(calibration: Calibration) -> str:
    rmse = SMALL_FORCE.factor * calibration.rmse
    counts = (
        count_of(calibration.n_points, "point"),
        count_of(len(calibration.curves), "curve"),
        count_of(calibration.n_samples, "sample"),
    )
    return (
        f"Model against all curves: RMSE {rmse:.3g} {SMALL_FORCE.unit}, "
        f"{percent(calibration.rmse_share)} of the largest force, over {' of '.join(counts)}."
    )


def _levels(calibration: Calibration) -> str:
    levels = calibration.levels
    scatter = f"Samples scatter by {percent(levels.scatter)} in force"
    if levels.scatter_freedom == 0.0:
        scatter = "How samples scatter is not known"
    return (
        f"{scatter}; the gain of the load cell is uncertain by {percent(levels.gain)}; "
        f"the noise is {levels.noise_factor:.2f} times as much as stated, and neighbouring points "
        f"are correlated by {levels.correlation:.2f}."
    )


def _separabilities(calibration: Calibration) -> Iterator[str]:
    """Of friction always; of the parameters where they are not all told apart."""
    for each in (calibration.friction_separability, calibration.separability):
        if each is not None and _is_worth_saying(each):
            yield typeset(each.words)


def _is_worth_saying(separability: Separability) -> bool:
    return not all(separability.are_identified.values())


def _notes(calibration: Calibration) -> Iterator[str]:
    for note in calibration.notes:
        if note.code not in _TOLD and note.severity is not Severity.INFO:
            yield f"Note: {typeset(note.message)}"


def _source(source: SourceCalibration) -> str:
    milli, unit = SMALL_FORCE
    numbers = (
        f"mu_s {source.strand_friction:.3g}, mu_p {source.insulation_friction:.3g}, F_rad "
        f"{milli * source.radial_force:.4g} {unit}"
    )
    start = ", ".join(f"{value:g}" for value in source.start)
    ending = "" if source.converged else "; its search did not converge"
    return typeset(
        f"Method: source, three friction numbers and one stiffness for the whole wire: phi = "
        f"{milli * source.radial_friction:.4g} {unit} ({numbers}, search begun at {start}); RMSE "
        f"{milli * source.rmse:.3g} {unit}, "
        f"{percent(source.rmse_share)} of the largest force{ending}."
    )
