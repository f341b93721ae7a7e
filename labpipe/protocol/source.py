"""Sources of a protocol: exports, channels and their units; sizes, and what is plausible."""

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
from labpipe.protocol.values import SI_UNITS, Day, OrShort, Text, listed, si_unit_like
from labpipe.protocol.yaml_text import FaultsError, refused
from labpipe.records.declarations import Area, Distance, Length, Quantity, Snake, Uncertainty
from labpipe.records.recording import EXPORT_FORMATS
from labpipe.units import parse_quantity

Role = Literal["force", "markers", "frame"]
ROLES: Final[tuple[str, ...]] = get_args(Role)
"""What an export can be for."""
READERS: Final = tuple(export_format.name for export_format in EXPORT_FORMATS)
"""The readers a protocol can name."""
MARKER_READERS: Final = frozenset(
    export_format.name for export_format in EXPORT_FORMATS if export_format.has_markers
)
"""Those whose exports hold marker tracks rather than channels."""

PLAUSIBLE: Final = MappingProxyType(
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
"""SI unit, least and largest plausible value of each kind of dimension."""
KEYS: Final = MappingProxyType(
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
    _Kind = Literal[tuple(PLAUSIBLE)]

Readers = Annotated[
    tuple[_ReaderName, ...],
    OrShort(listed, {"enum": list(READERS)}),
    Field(min_length=1),
]

Names = Annotated[
    tuple[Text, ...],
    OrShort(listed, {"type": ["string", "number"], "minLength": 1}),
    Field(min_length=1),
    PlainSerializer(lambda names: names[0] if len(names) == 1 else list(names)),
]
"""One name, or several of which the first that the export has counts."""


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
    """Standard uncertainties of the specimen's sizes; what is left out is taken as exact."""

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
    def stated(self) -> dict[str, float]:
        """Those that are given, by key, m (of the area m^2)."""
        return {name: value for name, value in vars(self).items() if value is not None}


class PlausibleRange(Block):
    """Least and largest plausible value."""

    start: Text = Field(alias="from", description="Such as 20 N")
    stop: Text = Field(alias="to", description="Such as 2 kN")


def filled_ranges(stated: object) -> Any:
    """Put the shipped ranges, and ends of ranges, where some are left out."""
    if not isinstance(stated, Mapping):
        return stated
    shipped = {kind: {"from": low, "to": high} for kind, (_, low, high) in PLAUSIBLE.items()}
    ranges = {
        kind: {**shipped.get(kind, {}), **ends} if isinstance(ends, Mapping) else ends
        for kind, ends in stated.items()
    }
    return shipped | ranges


def _schema_of(low: str, high: str) -> dict[str, object]:
    ends = {"from": {"type": "string", "default": low}, "to": {"type": "string", "default": high}}
    return {"type": "object", "properties": ends, "additionalProperties": False}


Plausible: TypeAlias = Annotated[
    dict[_Kind, PlausibleRange],
    BeforeValidator(filled_ranges),
    Field(validate_default=True),
    WithJsonSchema(
        {
            "type": "object",
            "properties": {kind: _schema_of(*ends) for kind, (_, *ends) in PLAUSIBLE.items()},
            "additionalProperties": False,
        }
    ),
]


CoverageFactor = Annotated[float, Quantity("1", "1", "2", minimum=1.0, maximum=10.0)]


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

    @field_validator("due")
    @classmethod
    def _is_after_the_date(cls, due: Any, info: ValidationInfo) -> Any:
        calibrated = info.data.get("date")
        if due is not None and calibrated is not None and due <= calibrated:
            raise refused("protocol.due_too_early", found=due, calibrated=calibrated)
        return due


def standard_uncertainty(certificate: Certificate | None) -> float | None:
    """Of the scale that was calibrated, as a ratio; None where no certificate says one."""
    if certificate is None or certificate.uncertainty is None:
        return None
    return certificate.uncertainty / certificate.k


def _agrees_with_scale(certificate: Certificate | None, info: ValidationInfo) -> Any:
    """Refuse an uncertainty that is not that of gain and scale, where these are stated, too."""
    calibration, scale = info.data.get("calibration"), info.data.get("scale_uncertainty") or 0.0
    together = hypot(calibration.gain_uncertainty if calibration else 0.0, scale)
    certified = standard_uncertainty(certificate)
    if certified is not None and together and not isclose(together, certified, rel_tol=1e-9):
        found = Fault.of(
            "protocol.not_as_certified", certified=1e2 * certified, found=1e2 * together
        )
        raise FaultsError(found)
    return certificate


AgreedCertificate = Annotated[Certificate, AfterValidator(_agrees_with_scale)]


class Calibration(Block):
    """A linear calibration of a channel."""

    gain: Text = Field(description="Such as 0.5 N/V: target unit per unit of the channel")
    offset: Text | None = Field(None, description="Such as 0.01 N: added after the gain")
    gain_uncertainty: Uncertainty = Field(
        0.0, description="Standard uncertainty of the gain, such as 1 %"
    )


class ChannelSource(Block):
    """One channel of an export."""

    channel: Names = Field(
        description="Name or full path in the export, as `labpipe inspect` says; or a list of names"
    )
    unit: Text | None = Field(None, description="Unit in the export, where the export is silent")
    wrong_unit_in_file: Text | None = Field(
        None, description="The unit that the export states, where that is wrong and 'unit' is right"
    )
    calibration: Calibration | None = None
    quantity: Snake | None = Field(None, description="Needed where the name does not say it")
    plausible_peak: PlausibleRange | None = Field(
        None, description="Of the largest absolute value; doubtful outside"
    )
    scale_uncertainty: Uncertainty = Field(
        0.0, description="Standard uncertainty of the scale, as the class of a load cell says"
    )
    zero_drift: Uncertainty | None = Field(
        None,
        description="Of a force: standard uncertainty of how far its zero has moved by the end of "
        "the test, as a share of the largest force; read it with the specimen out",
    )
    certificate: AgreedCertificate | None = Field(
        None, description="Of the calibration; its uncertainty is that of gain and scale together"
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
        """Return the SI unit before calibration; None if the export must state it."""
        if self.unit is None:
            return None
        return self.target_unit if self.calibration is None else si_unit_like(self.unit)

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
        if (certified := standard_uncertainty(self.certificate)) is not None:
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

    def named(self, name: str, key: str) -> ChannelSource:
        """Return the channel with its name in labpipe and its key."""
        channel = self.model_copy()
        channel._name, channel._key = name, key
        return channel


class Source(Block):
    """One export of a test, or several parts of one."""

    reader: Readers = Field(description="The format, or the formats, that the export may have")
    dialect: Names | None = Field(
        None, description="Of a load frame: the card, or cards, that the export must fit"
    )
    part: Text | None = Field(
        None, description="Of a load frame: which specimen or sheet of an export that holds several"
    )
    optional: bool = Field(
        False, description="Whether a test may lack it; what only this source makes then falls away"
    )
    channel: Names | None = Field(None, description="Short for one channel named like the role")
    unit: Text | None = None
    wrong_unit_in_file: Text | None = None
    calibration: Calibration | None = None
    quantity: Snake | None = None
    plausible_peak: PlausibleRange | None = None
    scale_uncertainty: Uncertainty | None = Field(
        None, description="Of one channel named like the role, or of the cameras"
    )
    zero_drift: Uncertainty | None = None
    certificate: AgreedCertificate | None = Field(
        None, description="Of one channel named like the role, or of the cameras"
    )
    channels: dict[Snake, ChannelSource] | None = None
    _role: str = PrivateAttr("")

    @property
    def key(self) -> str:
        """Return the dotted key of the source, as an override begins: ``sources.frame``."""
        return f"sources.{self._role}"

    @property
    def all_channels(self) -> dict[str, ChannelSource]:
        """Return the channels by name, however they were written; empty for marker tracks."""
        key = self.key
        if self.channel is not None:
            stated = {name: getattr(self, name) for name in ChannelSource.model_fields}
            single = ChannelSource.model_construct(
                **{name: value for name, value in stated.items() if value is not None}
            )
            return {self._role: single.named(self._role, key)}
        several = (self.channels or {}).items()
        return {name: channel.named(name, f"{key}.channels.{name}") for name, channel in several}

    @property
    def camera_uncertainty(self) -> float:
        """Return the standard uncertainty of the scale of marker tracks; 0 if not stated."""
        certified = standard_uncertainty(self.certificate)
        return (self.scale_uncertainty or 0.0) if certified is None else certified

    def in_role(self, role: str) -> Source:
        """Return the source with its role."""
        source = self.model_copy()
        source._role = role
        return source
