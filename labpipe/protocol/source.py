"""Sources of a protocol: exports, channels, calibrations; plausible ranges of dimensions."""

from __future__ import annotations

from collections.abc import Mapping
from math import hypot, isclose
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, TypeAlias, get_args

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PlainSerializer,
    PrivateAttr,
    ValidationInfo,
    WithJsonSchema,
    field_validator,
)

from labpipe.errors import Fault
from labpipe.protocol.grammar import Block
from labpipe.protocol.values import SI_UNITS, Day, ShortForm, Text, find_si_unit, wrap_in_list
from labpipe.protocol.yaml_text import FaultsError, refused
from labpipe.records.declarations import Area, Distance, Length, Quantity, Snake, Uncertainty
from labpipe.records.recording import EXPORT_FORMATS
from labpipe.units import parse_quantity

Role = Literal["force", "markers", "frame"]
ROLES: Final[tuple[str, ...]] = get_args(Role)
"""Roles of the exports of a test."""
READERS: Final = tuple(export_format.name for export_format in EXPORT_FORMATS)
"""Readers that a protocol can name."""
MARKER_READERS: Final = frozenset(
    export_format.name for export_format in EXPORT_FORMATS if export_format.has_markers
)
"""Readers of marker tracks; the others read channels."""

PLAUSIBLE_RANGES: Final = MappingProxyType(
    {
        "length": ("m", "1 mm", "10 m"),
        "span": ("m", "1 mm", "10 m"),
        "diameter": ("m", "0.01 mm", "200 mm"),
        "wall": ("m", "1 um", "50 mm"),
        "width": ("m", "0.01 mm", "1 m"),
        "area": ("m^2", "0.0001 mm^2", "0.1 m^2"),
        "offset": ("m", "0 mm", "1 m"),
        "other": ("m", "1 um", "10 m"),
        "travel": ("m", "1 um", "5 m"),
        "speed": ("m/s", "0.1 um/s", "1 m/s"),
        "mass": ("kg", "0 g", "20 kg"),
        "mass_per_length": ("kg/m", "0.01 g/m", "20 kg/m"),
    }
)
"""SI unit, smallest and largest plausible value of each kind of dimension."""
DIMENSION_KINDS: Final = MappingProxyType(
    {
        **{kind: kind for kind in ("length", "span", "diameter", "wall", "width", "area")},
        **{kind: kind for kind in ("offset", "speed", "mass_per_length")},
        "bore": "diameter",
        "thickness": "wall",
        "stroke": "travel",
        "counterweight": "mass",
    }
)
"""Kind of dimension by its key, or by the last word of its key (``outer_diameter``)."""

if TYPE_CHECKING:
    _ReaderName = str
    _Kind = str
else:
    _ReaderName = Literal[READERS]
    _Kind = Literal[tuple(PLAUSIBLE_RANGES)]

ReaderNames = Annotated[
    tuple[_ReaderName, ...],
    ShortForm(wrap_in_list, {"enum": list(READERS)}),
    Field(min_length=1),
]

ChannelNames = Annotated[
    tuple[Text, ...],
    ShortForm(wrap_in_list, {"type": ["string", "number"], "minLength": 1}),
    Field(min_length=1),
    PlainSerializer(lambda names: names[0] if len(names) == 1 else list(names)),
]
"""Names of a channel; the first one that the export has counts."""


AreaUncertainty = Annotated[float, Quantity("m^2", "mm^2", "0.05 mm^2", minimum=0.0)]


class Section(Block):
    """Cross-section of the specimen; give what is known."""

    outer_diameter: Length | None = None
    inner_diameter: Length | None = None
    wall: Length | None = None
    width: Length | None = None
    thickness: Length | None = None
    area: Area | None = None


class SizeUncertainties(Block):
    """Standard uncertainties of the specimen's dimensions; others count as exact."""

    length: Distance | None = None
    gauge_length: Distance | None = None
    span: Distance | None = None
    outer_diameter: Distance | None = None
    inner_diameter: Distance | None = None
    wall: Distance | None = None
    width: Distance | None = None
    thickness: Distance | None = None
    area: AreaUncertainty | None = None

    @property
    def by_key(self) -> dict[str, float]:
        """Return the given uncertainties by key, m (m^2 for the area)."""
        return {name: value for name, value in vars(self).items() if value is not None}


class PlausibleRange(Block):
    """Smallest and largest plausible value."""

    start: Text = Field(alias="from", description="Such as 20 N")
    stop: Text = Field(alias="to", description="Such as 2 kN")


def complete_ranges(stated: object) -> Any:
    """Fill in the shipped ranges and ends of ranges that a file leaves out."""
    if not isinstance(stated, Mapping):
        return stated
    shipped = {kind: {"from": low, "to": high} for kind, (_, low, high) in PLAUSIBLE_RANGES.items()}
    ranges = {
        kind: {**shipped.get(kind, {}), **ends} if isinstance(ends, Mapping) else ends
        for kind, ends in stated.items()
    }
    return shipped | ranges


def _build_range_schema(low: str, high: str) -> dict[str, object]:
    ends = {"from": {"type": "string", "default": low}, "to": {"type": "string", "default": high}}
    return {"type": "object", "properties": ends, "additionalProperties": False}


Plausible: TypeAlias = Annotated[
    dict[_Kind, PlausibleRange],
    BeforeValidator(complete_ranges),
    Field(validate_default=True),
    WithJsonSchema(
        {
            "type": "object",
            "properties": {
                kind: _build_range_schema(*ends) for kind, (_, *ends) in PLAUSIBLE_RANGES.items()
            },
            "additionalProperties": False,
        }
    ),
]


CoverageFactor = Annotated[float, Quantity("1", "1", "2", minimum=1.0, maximum=10.0)]


class Certificate(Block):
    """Certificate of the calibration of an instrument."""

    number: Text
    date: Day = Field(description="Of the calibration")
    due: Day | None = Field(
        None, description="Of the next calibration; results of a later test are doubtful"
    )
    uncertainty: Uncertainty | None = Field(
        None, description="Expanded, as certificates state it: k times the standard uncertainty"
    )
    k: CoverageFactor = Field(2.0, description="Coverage factor; 1 for a standard uncertainty")

    @field_validator("due")
    @classmethod
    def _check_due_date(cls, due: Any, info: ValidationInfo) -> Any:
        calibrated = info.data.get("date")
        if due is not None and calibrated is not None and due <= calibrated:
            raise refused("protocol.due_too_early", found=due, calibrated=calibrated)
        return due


def _find_standard_uncertainty(certificate: Certificate | None) -> float | None:
    """Return the standard uncertainty of the scale as a ratio; None if not certified."""
    if certificate is None or certificate.uncertainty is None:
        return None
    return certificate.uncertainty / certificate.k


def _check_against_scale(certificate: Certificate | None, info: ValidationInfo) -> Any:
    """Refuse a certified uncertainty that contradicts those stated for gain and scale."""
    calibration, scale = info.data.get("calibration"), info.data.get("scale_uncertainty") or 0.0
    together = hypot(calibration.gain_uncertainty if calibration else 0.0, scale)
    certified = _find_standard_uncertainty(certificate)
    if certified is not None and together and not isclose(together, certified, rel_tol=1e-9):
        fault = Fault.of(
            "protocol.not_as_certified", certified=1e2 * certified, found=1e2 * together
        )
        raise FaultsError(fault)
    return certificate


CheckedCertificate = Annotated[Certificate, AfterValidator(_check_against_scale)]


class Calibration(Block):
    """A linear calibration of a channel."""

    gain: Text = Field(description="Such as 0.5 N/V: target unit per unit of the channel")
    offset: Text | None = Field(None, description="Such as 0.01 N: added after the gain")
    gain_uncertainty: Uncertainty = Field(
        0.0, description="Standard uncertainty of the gain, such as 1 %"
    )


class ChannelSource(Block):
    """One channel of an export."""

    channel: ChannelNames = Field(
        description="Name or full path, as `labpipe inspect` shows it; or a list of names"
    )
    unit: Text | None = Field(None, description="Unit in the export, where the export states none")
    wrong_unit_in_file: Text | None = Field(
        None, description="Unit that the export states by mistake; 'unit' is the right one"
    )
    calibration: Calibration | None = None
    quantity: Snake | None = Field(
        None, description="Needed if the name of the channel is not that of a quantity"
    )
    plausible_peak: PlausibleRange | None = Field(
        None, description="Range of the largest absolute value; doubtful outside"
    )
    scale_uncertainty: Uncertainty = Field(
        0.0, description="Standard uncertainty of the scale, such as the class of a load cell"
    )
    zero_drift: Uncertainty | None = Field(
        None,
        description="Of a force: standard uncertainty of the drift of its zero during the test, as "
        "a share of the largest force; measure it without a specimen",
    )
    certificate: CheckedCertificate | None = Field(
        None, description="Of the calibration; its uncertainty includes those of gain and scale"
    )
    _name: str = PrivateAttr("")
    _key: str = PrivateAttr("")

    @property
    def key(self) -> str:
        """Return the dotted key of the channel for overrides: ``sources.frame.channels.force``."""
        return self._key

    @property
    def target_unit(self) -> str:
        """Return the SI unit of the channel once calibrated."""
        return SI_UNITS[self.quantity or self._name]

    @property
    def is_extension(self) -> bool:
        """Check whether an extensometer gives the channel, as a length or as strain."""
        return (self.quantity or self._name) == "extension"

    @property
    def channel_unit(self) -> str | None:
        """Return the SI unit before calibration; None if the protocol states no unit."""
        if self.unit is None:
            return None
        return self.target_unit if self.calibration is None else find_si_unit(self.unit)

    @property
    def gain(self) -> float:
        """Return the gain, `target_unit` per `channel_unit`; 1 without a calibration."""
        if self.calibration is None:
            return 1.0
        return parse_quantity(self.calibration.gain, f"{self.target_unit}/({self.channel_unit})")

    @property
    def offset(self) -> float:
        """Return the calibration offset, in `target_unit`; 0 without one."""
        if self.calibration is None or self.calibration.offset is None:
            return 0.0
        return parse_quantity(self.calibration.offset, self.target_unit)

    @property
    def gain_uncertainty(self) -> float:
        """Return the standard uncertainty of gain and scale as a ratio; 0 if not stated."""
        if (certified := _find_standard_uncertainty(self.certificate)) is not None:
            return certified
        gain = 0.0 if self.calibration is None else self.calibration.gain_uncertainty
        return hypot(gain, self.scale_uncertainty)

    @property
    def peak_range(self) -> tuple[float, float] | None:
        """Return the smallest and largest plausible peak, in `target_unit`; None if not stated."""
        if self.plausible_peak is None:
            return None
        ends = self.plausible_peak.start, self.plausible_peak.stop
        lowest, highest = (parse_quantity(end, self.target_unit) for end in ends)
        return lowest, highest

    def with_name(self, name: str, key: str) -> ChannelSource:
        """Return a copy with the name of the channel in labpipe, and its dotted key."""
        channel = self.model_copy()
        channel._name, channel._key = name, key
        return channel


class Source(Block):
    """One export of a test, or several parts of one."""

    reader: ReaderNames = Field(description="Format of the export, or a list of possible formats")
    dialect: ChannelNames | None = Field(
        None, description="Of a load frame: card, or cards, that the export must fit"
    )
    part: Text | None = Field(
        None, description="Of a load frame: the specimen or sheet, if an export has several"
    )
    optional: bool = Field(
        False,
        description="Whether a test may lack it; steps and results that need it are then left out",
    )
    channel: ChannelNames | None = Field(
        None, description="Short form for one channel with the name of the role"
    )
    unit: Text | None = None
    wrong_unit_in_file: Text | None = None
    calibration: Calibration | None = None
    quantity: Snake | None = None
    plausible_peak: PlausibleRange | None = None
    scale_uncertainty: Uncertainty | None = Field(
        None, description="Of one channel with the name of the role, or of the cameras"
    )
    zero_drift: Uncertainty | None = None
    certificate: CheckedCertificate | None = Field(
        None, description="Of one channel with the name of the role, or of the cameras"
    )
    channels: dict[Snake, ChannelSource] | None = None
    _role: str = PrivateAttr("")

    @property
    def key(self) -> str:
        """Return the dotted key of the source for overrides: ``sources.frame``."""
        return f"sources.{self._role}"

    @property
    def all_channels(self) -> dict[str, ChannelSource]:
        """Return the channels by name, from the short or the long form; empty for marker tracks."""
        key = self.key
        if self.channel is not None:
            stated = {name: getattr(self, name) for name in ChannelSource.model_fields}
            single = ChannelSource.model_construct(
                **{name: value for name, value in stated.items() if value is not None}
            )
            return {self._role: single.with_name(self._role, key)}
        several = (self.channels or {}).items()
        return {
            name: channel.with_name(name, f"{key}.channels.{name}") for name, channel in several
        }

    @property
    def camera_uncertainty(self) -> float:
        """Return the standard uncertainty of the scale of marker tracks; 0 if not stated."""
        certified = _find_standard_uncertainty(self.certificate)
        return (self.scale_uncertainty or 0.0) if certified is None else certified

    def with_role(self, role: str) -> Source:
        """Return a copy with the role of the source."""
        source = self.model_copy()
        source._role = role
        return source
