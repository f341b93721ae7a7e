"""What a protocol says of how well things are known: certificates, and sizes of the specimen."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import date
from typing import Annotated

from pydantic import Field
from pydantic_core import PydanticCustomError

from labpipe.errors import Fault, KeyPath
from labpipe.protocol.faults import shown
from labpipe.protocol.grammar import Block
from labpipe.protocol.values import Day, Text, parse_day
from labpipe.records.declarations import Distance, Quantity, Uncertainty
from labpipe.units import parse_quantity

AreaUncertainty = Annotated[float, Quantity("m^2", "mm^2", "0.05 mm^2", minimum=0.0)]
CoverageFactor = Annotated[float, Quantity("1", "1", "2", minimum=1.0, maximum=10.0)]


class SizeUncertainties(Block):
    """Standard uncertainties of the specimen's sizes; what is left out is taken as exact."""

    length: Distance | None = None
    span: Distance | None = None
    outer_diameter: Distance | None = None
    inner_diameter: Distance | None = None
    wall: Distance | None = None
    width: Distance | None = None
    thickness: Distance | None = None
    area: AreaUncertainty | None = None

    @property
    def stated(self) -> dict[str, float]:
        """Return those that are given, by key, m (of the area m^2)."""
        return {name: value for name, value in vars(self).items() if value is not None}


class Certificate(Block):
    """What the certificate of a calibration says of an instrument."""

    number: Text
    date: Day = Field(description="Of the calibration")
    due: Day | None = Field(
        None, description="Of the next one; numbers of a later test that rest on it are doubtful"
    )
    uncertainty: Uncertainty | None = Field(
        None, description="Expanded, as certificates state it: k times the standard uncertainty"
    )
    k: CoverageFactor = Field(2.0, description="Coverage factor; 1 for a standard uncertainty")

    @classmethod
    def between(cls, data: object) -> list[Fault]:
        """Refuse a calibration that was due before it was made."""
        values = data if isinstance(data, Mapping) else {}
        calibrated, due = (_day(values.get(key)) for key in ("date", "due"))
        if calibrated is None or due is None or due > calibrated:
            return []
        expected = f"a day after 'date', {calibrated}"
        return [Fault(("due",), expected, str(due), "Correct the one that is wrong.")]


def standard_uncertainty(certificate: Certificate | None) -> float | None:
    """Return the standard uncertainty of the calibrated scale, a ratio; None if not stated."""
    if certificate is None or certificate.uncertainty is None:
        return None
    return certificate.uncertainty / certificate.k


def certificate_faults(values: Mapping[str, object], path: KeyPath) -> Iterator[Fault]:
    """Find an uncertainty of a scale that its certificate contradicts.

    Parameters
    ----------
    values : block of a channel or source as written
    path : way to it
    """
    certificate = values.get("certificate")
    calibration = values.get("calibration")
    if not isinstance(certificate, Mapping) or certificate.get("uncertainty") is None:
        return
    gain = calibration if isinstance(calibration, Mapping) else {}
    stated = {
        (*path, "calibration", "gain_uncertainty"): gain.get("gain_uncertainty"),
        (*path, "scale_uncertainty"): values.get("scale_uncertainty"),
    }
    uncertainties = {place: _ratio(text) for place, text in stated.items() if text is not None}
    expanded, k = _ratio(certificate["uncertainty"]), _ratio(certificate.get("k", 2))
    if expanded is None or not k or None in uncertainties.values():
        return  # each is a fault of its own
    standard = expanded / k
    together = sum(value**2 for value in uncertainties.values() if value is not None) ** 0.5
    if not together or abs(together - standard) <= 1e-9 * standard:
        return
    place = next(place for place, value in uncertainties.items() if value)
    expected = f"{100.0 * standard:.4g} %, as 'certificate' has it"
    actual = f"{100.0 * together:.4g} %"
    remedy = f"Take {place[-1]!r} out, or 'uncertainty' out of the certificate."
    yield Fault(place, expected, actual, remedy)


def size_faults(specimen: Mapping[str, object]) -> Iterator[Fault]:
    """Find a size of the specimen that is known no better than it is large.

    Parameters
    ----------
    specimen : block as written
    """
    uncertainties, section = specimen.get("uncertainty"), specimen.get("section")
    sizes = {**(section if isinstance(section, Mapping) else {}), **specimen}
    for key, text in uncertainties.items() if isinstance(uncertainties, Mapping) else ():
        unit = "m^2" if key == "area" else "m"
        size, uncertainty = (_quantity(value, unit) for value in (sizes.get(key), text))
        if size is not None and uncertainty is not None and uncertainty >= size > 0.0:
            expected = f"less than the {key} itself, {sizes[key]}"
            yield Fault(
                ("specimen", "uncertainty", key), expected, shown(text), "Look at its unit."
            )


def length_faults(
    specimen: Mapping[str, object], entry: Mapping[str, object], path: KeyPath
) -> Iterator[Fault]:
    """Find an uncertainty of a length that a result states otherwise than the specimen.

    Parameters
    ----------
    specimen : block as written
    entry : of a bending stiffness
    path : way to it
    """
    key = "length" if entry.get("support") == "cantilever" else "span"
    block = specimen.get("uncertainty")
    given = block.get(key) if isinstance(block, Mapping) else None
    stated = entry.get("length_uncertainty")
    values = _quantity(stated, "m"), _quantity(given, "m")
    if None in values or values[0] == values[1]:
        return
    expected = f"the uncertainty of the {key} once"
    actual = f"{stated!r} beside {given!r} in 'specimen.uncertainty.{key}'"
    remedy = f"Write it as 'specimen.uncertainty.{key}' alone."
    yield Fault((*path, "length_uncertainty"), expected, actual, remedy)


def _day(value: object) -> date | None:
    """Return the day; None for what is none, which is a fault of its own."""
    try:
        return parse_day(value)
    except PydanticCustomError:
        return None


def _ratio(text: object) -> float | None:
    return _quantity(text, "1")


def _quantity(text: object, unit: str) -> float | None:
    """Return the value in a unit; None for what is none, which is a fault of its own."""
    try:
        return parse_quantity(text, unit)
    except ValueError:
        return None
