"""Uncertainties and certificates of protocol and test sheet: what they give, what is refused."""

from __future__ import annotations

from collections.abc import Callable
from datetime import date
from pathlib import Path

import pytest

from labpipe.errors import ProtocolError
from labpipe.protocol.load import dump_protocol, load_test_sheet, parse_protocol, resolve
from labpipe.protocol.schema import Protocol
from tests.protocol.conftest import SHEET, Tell, Told

CERTIFICATE = "{number: LC-7 / 2026, date: 2026-01-10, due: 2027-01-10, uncertainty: 0.5 %}"
FORCE = "unit: V\n"
"""Where a key of the channel of the force can be added."""


def with_certificate(wire: str, certificate: str) -> str:
    calibrated = wire.replace(", gain_uncertainty: 0.2 %", "")
    return calibrated.replace(FORCE, f"{FORCE}    certificate: {certificate}\n")


def kept(protocol: Protocol) -> Protocol:
    """The same, written and read again."""
    again = parse_protocol(dump_protocol(protocol), "again.yaml")
    assert again == protocol
    return again


@pytest.mark.parametrize(
    ("said", "standard"),
    [("0.5 %", 0.0025), ("0.5 %, k: 1", 0.005), ("0.6 %, k: 3", 0.002), ("0 %", 0.0)],
)
def test_a_certificate_states_k_times_the_standard_uncertainty(
    wire: str, said: str, standard: float
) -> None:
    text = with_certificate(wire, CERTIFICATE.replace("0.5 %", said))
    force = kept(parse_protocol(text, "p.yaml")).channels["force"]
    assert force.gain_uncertainty == pytest.approx(standard, rel=1e-12)
    assert force.certificate is not None
    assert force.certificate.number == "LC-7 / 2026"
    assert (force.certificate.date, force.certificate.due) == (date(2026, 1, 10), date(2027, 1, 10))


def test_a_certificate_may_leave_the_uncertainty_to_the_calibration(wire: str) -> None:
    text = wire.replace(FORCE, f"{FORCE}    certificate: {{number: 7, date: 2026-01-10}}\n")
    force = kept(parse_protocol(text, "p.yaml")).channels["force"]
    assert force.gain_uncertainty == 0.002
    assert force.certificate is not None
    assert force.certificate.due is None


def test_a_certificate_that_says_the_same_as_the_calibration(wire: str) -> None:
    """0.2 % of the gain and 0.15 % of the scale make 0.25 %, which is 0.5 % with k = 2."""
    more = f"{FORCE}    scale_uncertainty: 0.15 %\n    certificate: {CERTIFICATE}\n"
    force = parse_protocol(wire.replace(FORCE, more), "p.yaml").channels["force"]
    assert force.gain_uncertainty == pytest.approx(0.0025)


@pytest.mark.parametrize(
    ("said", "standard"),
    [
        ("", 0.0),
        ("    scale_uncertainty: 0.05 %\n", 0.0005),
        (f"    certificate: {CERTIFICATE}\n", 0.0025),
        (f"    scale_uncertainty: 0.25 %\n    certificate: {CERTIFICATE}\n", 0.0025),
    ],
)
def test_cameras_have_a_scale(wire: str, said: str, standard: float) -> None:
    text = wire.replace("reader: motive-csv\n", f"reader: motive-csv\n{said}")
    cameras = kept(parse_protocol(text, "p.yaml")).sources["markers"]
    assert cameras.camera_uncertainty == pytest.approx(standard)
    assert cameras.all_channels == {}


def test_the_zero_of_a_force_drifts(wire: str, tube: str) -> None:
    """Of one channel named like its role, and of one of several; 0 is stated, too."""
    said = wire.replace(FORCE, f"{FORCE}    zero_drift: 0.12 %\n")
    assert kept(parse_protocol(said, "p.yaml")).channels["force"].zero_drift == 0.0012
    assert kept(parse_protocol(wire, "p.yaml")).channels["force"].zero_drift is None
    frame = tube.replace("force: {", "force: {zero_drift: 0, ", 1)
    channels = kept(parse_protocol(frame, "p.yaml")).channels
    assert (channels["force"].zero_drift, channels["displacement"].zero_drift) == (0.0, None)


def test_only_the_zero_of_a_force_is_an_input(tube: str) -> None:
    wrong = tube.replace("displacement: {", "displacement: {zero_drift: 1 %, ", 1)
    with pytest.raises(ProtocolError) as told:
        parse_protocol(wrong, "p.yaml")
    where, _, said = str(told.value).partition(": ")
    assert where.endswith("(sources.frame.channels.displacement.zero_drift)")
    assert said == (
        "expected this key for a force alone, found the key 'zero_drift' of a displacement."
        " Remove it."
    )


def test_sizes_have_uncertainties(tube: str) -> None:
    said = "thickness: 0.3 mm}, uncertainty: {length: 0.5 mm, thickness: 6 um, area: 0.05 mm^2}}"
    specimen = kept(parse_protocol(tube.replace("thickness: 0.3 mm}}", said), "p.yaml")).specimen
    assert specimen.uncertainty is not None
    assert specimen.uncertainty.stated == pytest.approx(
        {"length": 5e-4, "thickness": 6e-6, "area": 5e-8}
    )


@pytest.mark.parametrize(
    ("sheet", "overrides"),
    [
        (", uncertainty: {length: 1 mm}", ""),
        ("", "overrides:\n  specimen.uncertainty.length: {value: 1 mm, because: bent}\n"),
    ],
)
def test_a_test_has_uncertainties_of_its_own(
    sheet: str, overrides: str, lab: Path, wire: str, write: Callable[[str], Path]
) -> None:
    text = wire.replace(
        "{length: 85 mm}", "{length: 85 mm, uncertainty: {length: 2 mm, wall: 1 um}}"
    )
    (lab / "protocols" / "wire.yaml").write_text(text, encoding="utf-8")
    path = write(SHEET.replace("length: 80 mm", f"length: 80 mm{sheet}") + overrides)

    found = resolve(load_test_sheet(path), path, lab / "protocols").specimen.uncertainty

    assert found is not None
    assert found.stated == {"length": 0.001, "wall": 1e-6}


def test_a_test_says_an_uncertainty_once(tell: Tell) -> None:
    sheet = SHEET.replace("length: 80 mm", "length: 80 mm, uncertainty: {length: 1 mm}")
    more = "overrides:\n  specimen.uncertainty.length: {value: 2 mm, because: x}\n"
    assert tell(sheet + more) == [
        f"{Path('test', 'test.yaml')}, line 7, column 40 "
        "(overrides.specimen.uncertainty.length.value): expected 'specimen.uncertainty.length'"
        " once, found '2 mm' beside '1 mm' in 'specimen'. Keep the one in 'specimen'."
    ]


def test_an_uncertainty_of_a_test_is_refused_where_it_stands(tell: Tell) -> None:
    sheet = SHEET.replace("length: 80 mm", "length: 80 mm, uncertainty: {length: 90 mm}")
    assert tell(sheet) == [
        f"{Path('test', 'test.yaml')}, line 3, column 85 (specimen.uncertainty.length):"
        " expected less than the length itself, 80 mm, found '90 mm'. Look at its unit."
    ]


WRONG = {
    "gain of less than nothing": (
        "gain_uncertainty: 0.2 %",
        "gain_uncertainty: -0.2 %",
        "p.yaml, line 8, column 65 (sources.force.calibration.gain_uncertainty): expected a pure"
        " number (also in % or ppm) from 0 % up, at most 100 %, found '-0.2 %'.",
    ),
    "scale beyond itself": (
        FORCE,
        f"{FORCE}    scale_uncertainty: 2.5\n",
        "p.yaml, line 8, column 24 (sources.force.scale_uncertainty): expected a pure number (also"
        " in % or ppm) from 0 % up, at most 100 %, found '2.5'.",
    ),
    "zero beyond the force": (
        FORCE,
        f"{FORCE}    zero_drift: 101 %\n",
        "p.yaml, line 8, column 17 (sources.force.zero_drift): expected a pure number (also in % or"
        " ppm) from 0 % up, at most 100 %, found '101 %'.",
    ),
    "centre of less than nothing": (
        "grip_offset: 6 mm",
        "centre_uncertainty: -1 mm",
        "p.yaml, line 13, column 57 (markers.centre_uncertainty): expected a quantity with a unit"
        " such as mm from 0 mm up, found '-1 mm'.",
    ),
    "length as large as itself": (
        "length: 85 mm",
        "length: 85 mm, uncertainty: {length: 85 mm}",
        "p.yaml, line 11, column 49 (specimen.uncertainty.length): expected less than the length"
        " itself, 85 mm, found '85 mm'. Look at its unit.",
    ),
    "area as large as itself": (
        "length: 85 mm",
        "section: {area: 5 mm^2}, uncertainty: {area: 0.1 cm^2}",
        "p.yaml, line 11, column 57 (specimen.uncertainty.area): expected less than the area"
        " itself, 5 mm^2, found '0.1 cm^2'. Look at its unit.",
    ),
    "no size": (
        "length: 85 mm",
        "uncertainty: {lenght: 1 mm}",
        "p.yaml, line 11, column 26 (specimen.uncertainty.lenght): expected one of the keys"
        " 'length', 'area', 'inner_diameter', 'outer_diameter', 'span', 'wall', ..., found"
        " 'lenght'. Did you mean 'length'?",
    ),
    "certificate that contradicts the gain": (
        FORCE,
        f"{FORCE}    certificate: {CERTIFICATE}\n",
        "p.yaml, line 9, column 65 (sources.force.calibration.gain_uncertainty): expected 0.25 %,"
        " as 'certificate' has it, found 0.2 %. Take 'gain_uncertainty' out, or 'uncertainty' out"
        " of the certificate.",
    ),
    "certificate that contradicts the cameras": (
        "reader: motive-csv\n",
        f"reader: motive-csv\n    scale_uncertainty: 1 %\n    certificate: {CERTIFICATE}\n",
        "p.yaml, line 11, column 24 (sources.markers.scale_uncertainty): expected 0.25 %, as"
        " 'certificate' has it, found 1 %. Take 'scale_uncertainty' out, or 'uncertainty' out of"
        " the certificate.",
    ),
    "due before it was made": (
        FORCE,
        f"{FORCE}    certificate: {{number: 7, date: 2026-01-10, due: 2025-01-10}}\n",
        "p.yaml, line 8, column 53 (sources.force.certificate.due): expected a day after 'date',"
        " 2026-01-10, found 2025-01-10. Correct the one that is wrong.",
    ),
    "due on the day it was made": (
        FORCE,
        f"{FORCE}    certificate: {{number: 7, date: 2026-01-10, due: 2026-01-10}}\n",
        "p.yaml, line 8, column 53 (sources.force.certificate.due): expected a day after 'date',"
        " 2026-01-10, found 2026-01-10. Correct the one that is wrong.",
    ),
    "no day": (
        FORCE,
        f"{FORCE}    certificate: {{number: 7, date: January, due: 2025-01-10}}\n",
        "p.yaml, line 8, column 36 (sources.force.certificate.date): expected a date such as"
        " 2026-03-04, found 'January'.",
    ),
    "coverage factor below one": (
        FORCE,
        f"{FORCE}    certificate: {{number: 7, date: 2026-01-10, k: 0.5}}\n",
        "p.yaml, line 8, column 51 (sources.force.certificate.k): expected a pure number (also in"
        " % or ppm) from 1 up, at most 10, found '0.5'.",
    ),
    "certificate without a number": (
        FORCE,
        f"{FORCE}    certificate: {{date: 2026-01-10}}\n",
        "p.yaml, line 8, column 18 (sources.force.certificate): expected the key 'number', found"
        " no such key. Add the key 'number'.",
    ),
}


@pytest.mark.parametrize(("old", "new", "expected"), WRONG.values(), ids=WRONG)
def test_what_is_wrong_is_told_with_its_place(
    told: Told, old: str, new: str, expected: str
) -> None:
    (message,) = told((old, new))

    assert message.startswith(expected)


BENDING = "  - {result: peak-force}\n"
OF_RESULT = (
    f"{BENDING}  - {{result: bending-stiffness, of: initial_stiffness, support: cantilever,"
    " length_uncertainty: 1 mm}\n"
)
AFTER = "  - {result: initial-stiffness, from: 0.5 mm, to: 4 mm}\n"


def test_a_length_of_a_result_that_the_specimen_has_otherwise(told: Told) -> None:
    size = ("{length: 85 mm}", "{length: 85 mm, uncertainty: {length: 2 mm}}")
    assert told((AFTER, AFTER + OF_RESULT.removeprefix(BENDING)), size) == [
        "p.yaml, line 28, column 97 (results.3.length_uncertainty): expected the uncertainty of the"
        " length once, found '1 mm' beside '2 mm' in 'specimen.uncertainty.length'. Write it as"
        " 'specimen.uncertainty.length' alone."
    ]


@pytest.mark.parametrize(
    "more", ["", ", uncertainty: {length: 1 mm}", ", uncertainty: {span: 3 mm}"]
)
def test_a_length_of_a_result_that_the_specimen_has_not_or_has_too(wire: str, more: str) -> None:
    text = wire.replace(AFTER, AFTER + OF_RESULT.removeprefix(BENDING))
    kept(parse_protocol(text.replace("{length: 85 mm}", f"{{length: 85 mm{more}}}"), "p.yaml"))
