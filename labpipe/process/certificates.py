"""Check that the instruments of a test were in calibration on the day of the test."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import date

from labpipe.protocol.schema import Protocol
from labpipe.protocol.uncertainties import Certificate
from labpipe.protocol.yaml_text import parse_yaml
from labpipe.records.declarations import TravelFromSpeed
from labpipe.records.quality import Finding, doubtful
from labpipe.records.recording import Recording
from labpipe.records.result import Instrument

DAY_KEYS = ("date", "start_time", "Capture Start Time")
"""Metadata keys of the recording date or time, always in ISO 8601."""


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


def instruments_of(protocol: Protocol) -> tuple[Instrument, ...]:
    """List the instruments whose certificates a protocol states.

    Parameters
    ----------
    protocol : with or without certificates
    """
    return tuple(
        Instrument(
            channel=name,
            measures=quantities,
            certificate=certificate.number,
            calibrated=certificate.date,
            due=certificate.due,
            uncertainty=certificate.uncertainty,
            k=certificate.k,
        )
        for name, certificate, quantities in _certificates(protocol)
    )


def check_due(protocol: Protocol, tested: date | None) -> Iterator[Finding]:
    """Report quantities of instruments whose calibration was overdue.

    Parameters
    ----------
    protocol : with certificates
    tested : day of the test; None if it is not known; then nothing is doubted
    """
    for where, certificate, quantities in _certificates(protocol):
        due = certificate.due
        if due is not None and tested is not None and tested > due:
            message = (
                f"calibration {certificate.number} of {certificate.date} expired on {due}, "
                f"before the test on {tested}: have the instrument calibrated"
            )
            yield doubtful("calibration_overdue", where, message, *quantities)


def _certificates(protocol: Protocol) -> Iterator[tuple[str, Certificate, tuple[str, ...]]]:
    """Yield each certificate with its channel or role and the quantities measured."""
    curve = protocol.curve
    quantity_of = (
        {} if curve is None else {curve.force: "force", curve.displacement: "displacement"}
    )
    for name, channel in protocol.channels.items():
        if channel.certificate is not None:
            yield name, channel.certificate, (quantity_of.get(name, name),)
    cameras = protocol.sources.get("markers")
    if cameras is not None and cameras.certificate is not None:
        yield "markers", cameras.certificate, tuple(_camera_quantities(protocol))


def _camera_quantities(protocol: Protocol) -> Iterator[str]:
    """Yield the quantities that cameras measure; the displacement only if nothing else does."""
    yield "mid_span"
    curve = protocol.curve
    step_channels = {step.channel for step in protocol.steps if isinstance(step, TravelFromSpeed)}
    if curve is None or curve.displacement not in {*protocol.channels, *step_channels}:
        yield "displacement"
