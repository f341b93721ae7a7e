"""Whether the instruments of a test were calibrated when it was made."""

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
"""What exports call the day, or the time, that they were recorded at: ISO 8601 in all of them."""


def day_of_test(sheet: str, recordings: Mapping[str, Recording]) -> date | None:
    """Find the day on which a test was made.

    Parameters
    ----------
    sheet : text of its test sheet, whose date counts first
    recordings : by role; the first one that says a day

    Returns
    -------
    The day; None where nothing says it.
    """
    said = parse_yaml(sheet, "test.yaml").data
    written = [said.get("date")] if isinstance(said, Mapping) else []
    written += [
        recording.metadata.get(key) for recording in recordings.values() for key in DAY_KEYS
    ]
    return next(filter(None, map(_day, written)), None)


def _day(written: object) -> date | None:
    try:
        return date.fromisoformat(str(written)[:10])
    except ValueError:
        return None


def operator_of_test(sheet: str) -> str:
    """Find who made a test; empty where its sheet does not say.

    Parameters
    ----------
    sheet : text of the test sheet
    """
    said = parse_yaml(sheet, "test.yaml").data
    operator = said.get("operator") if isinstance(said, Mapping) else None
    return operator if isinstance(operator, str) else ""


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
            certificate=each.number,
            calibrated=each.date,
            due=each.due,
            uncertainty=each.uncertainty,
            k=each.k,
        )
        for name, each, quantities in _certificates(protocol)
    )


def check_due(protocol: Protocol, tested: date | None) -> Iterator[Finding]:
    """Doubt what rests on an instrument whose calibration was overdue.

    Parameters
    ----------
    protocol : with certificates
    tested : day of the test; None where it is not known, and nothing is doubted
    """
    for where, certificate, quantities in _certificates(protocol):
        due = certificate.due
        if due is not None and tested is not None and tested > due:
            message = (
                f"calibration {certificate.number} of {certificate.date} was due again on {due}, "
                f"the test was made on {tested}: have the instrument calibrated"
            )
            yield doubtful("calibration_overdue", where, message, *quantities)


def _certificates(protocol: Protocol) -> Iterator[tuple[str, Certificate, tuple[str, ...]]]:
    """Certificates, with the channel or role that they are of, and the quantities it stands for."""
    curve = protocol.curve
    words = {} if curve is None else {curve.force: "force", curve.displacement: "displacement"}
    for name, channel in protocol.channels.items():
        if channel.certificate is not None:
            yield name, channel.certificate, (words.get(name, name),)
    cameras = protocol.sources.get("markers")
    if cameras is not None and cameras.certificate is not None:
        yield "markers", cameras.certificate, tuple(_seen(protocol))


def _seen(protocol: Protocol) -> Iterator[str]:
    """Quantities that cameras measure: the displacement, too, where nothing else does."""
    yield "mid_span"
    curve = protocol.curve
    made = {step.channel for step in protocol.steps if isinstance(step, TravelFromSpeed)}
    if curve is None or curve.displacement not in {*protocol.channels, *made}:
        yield "displacement"
