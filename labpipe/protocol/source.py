"""Define the sources of a protocol, and the plausible ranges of dimensions.

A source is an export with its channels, their units and their calibrations.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from math import hypot, inf, isclose
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, TypeAlias, get_args

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PlainSerializer,
    PrivateAttr,
    WithJsonSchema,
)

from labpipe.errors import Fault, KeyPath, format_overrides, sort_by_likeness
from labpipe.protocol.grammar import (
    SI_UNITS,
    Block,
    Day,
    OneOf,
    QuantityName,
    QuantityText,
    Text,
    explain_unit,
    find_si_unit,
    list_blocks,
    list_items,
    try_parse_quantity,
    wrap_in_list,
)
from labpipe.protocol.yaml_text import FaultsError, format_nearest_words, prefix_paths
from labpipe.records.declarations import Area, Distance, Length, Quantity, SnakeName, Uncertainty
from labpipe.records.recording import EXPORT_FORMATS
from labpipe.units import get_conversion_factor, parse_quantity

Role = Literal["force", "markers", "frame"]
ROLES: Final[tuple[str, ...]] = get_args(Role)
"""Roles of the exports of a test."""
READER_NAMES: Final = tuple(export_format.name for export_format in EXPORT_FORMATS)
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
"""SI unit, smallest and largest plausible value of each kind of dimension, as shipped."""
LARGEST_VALUES: Final = MappingProxyType({"m": 30.0, "N": 2e6})
"""Largest plausible value of a recording, keyed by SI unit. Halls with cameras are smaller, and
load frames are weaker; a wrong prefix of a unit multiplies by a thousand or more."""
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
"""Kind of dimension, keyed by its key or by the last word of its key (``outer_diameter``)."""

if TYPE_CHECKING:
    RoleKey = Role
else:
    # A protocol with a misspelt role is checked further, see `assign_roles`.
    RoleKey = Annotated[str, WithJsonSchema({"enum": list(ROLES), "type": "string"})]

_ReaderName = Annotated[str, OneOf(READER_NAMES)]
_Kind = Annotated[str, OneOf(tuple(PLAUSIBLE_RANGES))]

ReaderNames = Annotated[
    tuple[_ReaderName, ...],
    BeforeValidator(wrap_in_list, json_schema_input_type=_ReaderName | tuple[_ReaderName, ...]),
    Field(min_length=1),
]

ChannelNames = Annotated[
    tuple[Text, ...],
    BeforeValidator(wrap_in_list, json_schema_input_type=Text | tuple[Text, ...]),
    Field(min_length=1),
    PlainSerializer(lambda names: names[0] if len(names) == 1 else list(names)),
]
"""Names of a channel; the first one that the export has is used."""

AreaUncertainty = Annotated[float, Quantity("m^2", "mm^2", "0.05 mm^2", minimum=0.0)]


class Section(Block):
    """Sizes of the cross-section of the specimen, as far as they are known."""

    outer_diameter: Length | None = None
    inner_diameter: Length | None = None
    wall: Length | None = None
    width: Length | None = None
    thickness: Length | None = None
    area: Area | None = None

    def find_value_faults(self) -> Iterator[Fault]:
        """Find an inner diameter and a wall that are too large for the outer diameter."""
        outer = self.outer_diameter or inf
        for key, bound in {"inner_diameter": outer, "wall": 0.5 * outer}.items():
            if (size := getattr(self, key) or 0.0) >= bound:
                limit, outer_mm, found = 1e3 * bound, 1e3 * outer, 1e3 * size
                yield Fault.of(
                    "protocol.section_size", (key,), bound=limit, outer=outer_mm, found=found
                )


class SizeUncertainties(Block):
    """Standard uncertainties of the specimen's dimensions; a dimension without one is exact."""

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
        """Return the stated uncertainties, m (m^2 for the area), keyed by dimension."""
        return {name: value for name, value in vars(self).items() if value is not None}


class PlausibleRange(Block):
    """Smallest and largest plausible value."""

    start: Text = Field(alias="from")
    """Smallest value, such as 20 N."""
    stop: Text = Field(alias="to")
    """Largest value, such as 2 kN."""


def _complete_ranges(data: object) -> Any:
    """Fill in the shipped ranges and ends of ranges that a file omits."""
    if not isinstance(data, Mapping):
        return data
    shipped_ranges = PLAUSIBLE_RANGES.items()
    ranges: Any = {kind: {"from": start, "to": stop} for kind, (_, start, stop) in shipped_ranges}
    for kind, ends in data.items():
        shipped_ends = ranges.get(kind, ranges["other"])  # an unknown kind is a fault by itself
        ranges[kind] = {**shipped_ends, **ends} if isinstance(ends, Mapping) else ends
    return ranges


def _find_quantity_faults(
    text: str | None, unit: str, path: KeyPath, example_number: str
) -> Iterator[Fault]:
    """Find a text at a path that is no quantity of the dimension of a unit."""
    plain_unit = unit.replace("(", "").replace(")", "")
    quantity = Quantity(unit, plain_unit, f"{example_number} {plain_unit}".removesuffix(" 1"))
    try:
        if text is not None:
            QuantityText(quantity).parse(text)
    except FaultsError as error:
        yield from prefix_paths(path, error.faults)


def _find_range_faults(ends: PlausibleRange, unit: str) -> list[Fault]:
    """Find ends of a plausible range that are no quantities, are negative, or do not increase."""
    faults = [*_find_quantity_faults(ends.start, unit, ("from",), "20")]
    faults += _find_quantity_faults(ends.stop, unit, ("to",), "20")
    if not faults:
        start, stop = parse_quantity(ends.start, unit), parse_quantity(ends.stop, unit)
        if not 0.0 <= start < stop:
            faults.append(Fault.of("protocol.range_reversed", low=start, high=stop, unit=unit))
    return faults


def _check_ranges(ranges: dict[str, PlausibleRange]) -> dict[str, PlausibleRange]:
    """Return plausible ranges; refuse them if a range that is not shipped is invalid."""
    faults: list[Fault] = []
    for kind, ends in ranges.items():
        if (ends.start, ends.stop) != PLAUSIBLE_RANGES[kind][1:]:
            range_faults = _find_range_faults(ends, PLAUSIBLE_RANGES[kind][0])
            faults += prefix_paths((kind,), range_faults)
    if faults:
        raise FaultsError(*faults)
    return ranges


class StatedRange(Block):
    """Stated ends of a plausible range; an end that is not stated is that of the shipped range."""

    start: Text | None = Field(None, alias="from")
    stop: Text | None = Field(None, alias="to")


Plausible: TypeAlias = Annotated[
    dict[_Kind, PlausibleRange],
    BeforeValidator(_complete_ranges, json_schema_input_type=dict[_Kind, StatedRange]),
    AfterValidator(_check_ranges),
    Field(validate_default=True),
]


def find_implausible_sizes(
    data: object,
    path: KeyPath,
    ranges: Mapping[str, PlausibleRange],
    *,
    other_lengths: Collection[str] = (),
    has_ranges: bool = False,
) -> Iterator[Fault]:
    """Find dimensions with absolute values outside their plausible ranges.

    Parameters
    ----------
    data : validated block, or validated blocks keyed by their key in the file
    path : path of the data in their file
    ranges : plausible range of each kind of dimension
    other_lengths : keys of further lengths, of the kind ``other``
    has_ranges : whether the file itself states ranges; otherwise the remedy is an override in a
        test sheet

    Yields
    ------
    Faults, with their paths in the file.
    """
    sizes = (
        ((*block_path, key), value)
        for block_path, block in list_blocks(data, path)
        if not {"uncertainty", "labels", "positions"} & {*block_path}
        for key, value in list_items(block)
        if isinstance(value, float)
    )
    for size_path, size in sizes:
        key = next(str(part) for part in reversed(size_path) if isinstance(part, str))
        kind = DIMENSION_KINDS.get(key) or DIMENSION_KINDS.get(key.rpartition("_")[2])
        kind = kind or ("other" if key in other_lengths else None)
        if kind is None:
            continue
        si_unit, ends = PLAUSIBLE_RANGES[kind][0], ranges[kind]
        minimum, maximum = (parse_quantity(text, si_unit) for text in (ends.start, ends.stop))
        if minimum <= abs(size) <= maximum:
            continue
        end_key, limit = ("from", ends.start) if abs(size) < minimum else ("to", ends.stop)
        unit = limit.lstrip("+-.0123456789e ")
        size_text = f"{size / get_conversion_factor(unit, si_unit):.12g} {unit}"
        override = format_overrides(f"plausible.{kind}.{end_key}", size_text)
        if has_ranges:
            override = f"'plausible: {{{kind}: {{{end_key}: {size_text}}}}}'"
        yield Fault.of(
            "protocol.implausible",
            size_path,
            kind=kind.replace("_", " ") if kind != "other" else "dimension",
            low=ends.start,
            high=ends.stop,
            found=repr(size_text),
            override=override,
        )


CoverageFactor = Annotated[float, Quantity("1", "1", "2", minimum=1.0, maximum=10.0)]


class Certificate(Block):
    """Certificate of the calibration of an instrument."""

    number: Text
    date: Day
    """Date of the calibration."""
    due: Day | None = None
    """Date of the next calibration; results of a later test are doubtful."""
    uncertainty: Uncertainty | None = None
    """Expanded uncertainty, k times the standard uncertainty, as certificates state it."""
    k: CoverageFactor = 2.0
    """Coverage factor; 1 for a standard uncertainty."""


class Calibration(Block):
    """Linear calibration of a channel."""

    gain: Text
    """Gain, such as 0.5 N/V: unit of the quantity per unit of the channel."""
    offset: Text | None = None
    """Offset, such as 0.01 N, which is added after the gain."""
    gain_uncertainty: Uncertainty = 0.0
    """Relative standard uncertainty of the gain, such as 1 %."""


class ChannelSource(Block):
    """One channel of an export."""

    channel: ChannelNames | None = None
    """Name or full path, as `labpipe inspect` shows it; or a list of names."""
    unit: Text | None = None
    """Unit of the channel, if the export states none."""
    wrong_unit_in_file: Text | None = None
    """Unit that the export states by mistake; 'unit' is the right one."""
    calibration: Calibration | None = None
    quantity: QuantityName | None = None
    """Measured quantity, if it is not the name of the channel."""
    plausible_peak: PlausibleRange | None = None
    """Range of the largest absolute value; results are doubtful outside it."""
    scale_uncertainty: Uncertainty | None = None
    """Relative standard uncertainty of the scale, such as the class of a load cell; with marker
    tracks, that of the cameras."""
    zero_drift: Uncertainty | None = None
    """Standard uncertainty of the drift of the zero of a force during the test, as a fraction of
    the largest force; measure it without a specimen."""
    certificate: Certificate | None = None
    """Certificate of the calibration; its uncertainty includes those of gain and scale."""
    # `assign_roles` sets the name of the channel in labpipe, and the dotted key of the block.
    _name: str = PrivateAttr("")
    _key: str = PrivateAttr("")

    @property
    def key(self) -> str:
        """Return the dotted key of the block for overrides: ``sources.frame.channels.force``."""
        return self._key

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names in the export, of which the first that exists is used."""
        return self.channel or ()

    @property
    def gain_uncertainty(self) -> float:
        """Return the standard uncertainty of gain and scale, certified or stated, as a ratio."""
        certified_error, stated_error = self._get_scale_errors()
        return stated_error if certified_error is None else certified_error

    def _get_scale_errors(self) -> tuple[float | None, float]:
        """Return the certified standard uncertainty or None, and that stated for gain and scale."""
        gain = 0.0 if self.calibration is None else self.calibration.gain_uncertainty
        certificate, certified_error = self.certificate, None
        if certificate is not None and certificate.uncertainty is not None:
            certified_error = certificate.uncertainty / certificate.k
        return certified_error, hypot(gain, self.scale_uncertainty or 0.0)

    @property
    def measured_quantity(self) -> str:
        """Return the measured quantity, by default the name of the channel in labpipe."""
        return self.quantity or self._name

    @property
    def target_unit(self) -> str:
        """Return the SI unit of the calibrated channel."""
        return SI_UNITS[self.measured_quantity]

    @property
    def is_extension(self) -> bool:
        """Return whether an extensometer gives the channel, as a length or as strain."""
        return self.measured_quantity == "extension"

    @property
    def channel_unit(self) -> str | None:
        """Return the SI unit before the calibration; None if the unit is unknown or not stated."""
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
    def peak_range(self) -> tuple[float, float] | None:
        """Return the smallest and largest plausible peak, in `target_unit`; None if not stated."""
        ends, unit = self.plausible_peak, self.target_unit
        if ends is None:
            return None
        return parse_quantity(ends.start, unit), parse_quantity(ends.stop, unit)

    def find_value_faults(self) -> Iterator[Fault]:
        """Find uncertainties that contradict the certificate, and faults of the channel."""
        certified, stated = self._get_scale_errors()
        if certified is not None and stated and not isclose(stated, certified, rel_tol=1e-9):
            path = ("certificate",)
            yield Fault.of(
                "protocol.not_as_certified", path, certified=1e2 * certified, stated=1e2 * stated
            )
        if self.channel is not None:
            yield from self._find_channel_faults()

    def _find_channel_faults(self) -> Iterator[Fault]:
        """Find an unknown quantity, and values that do not fit it."""
        quantity = self.measured_quantity
        if quantity not in SI_UNITS:
            yield Fault.of("protocol.no_measurand", valid=format_nearest_words(quantity, SI_UNITS))
            return
        if self.plausible_peak is not None:
            faults = _find_range_faults(self.plausible_peak, self.target_unit)
            yield from prefix_paths(("plausible_peak",), faults)
        # Only the intervals of forces include the drift of the zero.
        if quantity != "force" and self.zero_drift is not None:
            path = ("zero_drift",)
            yield Fault.of("protocol.drift_of_no_force", path, is_key=True, quantity=quantity)
        if self.unit is not None:
            yield from self._find_unit_faults(quantity, self.unit)
            return
        if self.wrong_unit_in_file is not None:
            yield Fault.of("protocol.no_right_unit", ("wrong_unit_in_file",))
        if self.calibration is not None:
            yield Fault.of("protocol.no_unit_before")

    def _find_unit_faults(self, quantity: str, unit: str) -> Iterator[Fault]:
        """Find a unit or a calibration that does not give the SI unit of the quantity."""
        si_unit, path, text = self.channel_unit, ("unit",), repr(unit)
        if si_unit is None:
            yield Fault.of("protocol.no_unit", path, quantity="V", found=text)
        elif hint := explain_unit(unit, si_unit):
            yield Fault.of(
                "protocol.wrong_unit", path, quantity=quantity, unit=si_unit, found=text, hint=hint
            )
        elif self.calibration is not None:
            offset, gain = self.calibration.offset, self.calibration.gain
            gain_unit, path = f"{self.target_unit}/({si_unit})", ("calibration",)
            yield from _find_quantity_faults(offset, self.target_unit, (*path, "offset"), "0.5")
            yield from _find_quantity_faults(gain, gain_unit, (*path, "gain"), "0.5")
            if try_parse_quantity(gain, gain_unit) == 0.0:
                yield Fault.of("protocol.no_gain", (*path, "gain"), found=repr(gain))


class _ListedChannel(ChannelSource):
    """One of several channels of an export."""

    channel: ChannelNames
    """Name or full path, as `labpipe inspect` shows it; or a list of names."""


class _Export(Block):
    """Keys that describe the export of a source."""

    reader: ReaderNames
    """Format of the export, or a list of possible formats."""
    dialect: ChannelNames | None = None
    """Card of a load frame, or a list of cards, that the export must fit."""
    part: Text | None = None
    """Specimen or sheet in the export of a load frame, if it has several."""
    optional: bool = False
    """Whether a test may lack the export; steps and results that need it are then omitted."""


class Source(ChannelSource, _Export):
    """One export of a test, in one or several parts, with its channel or channels."""

    channels: dict[SnakeName, _ListedChannel] | None = None
    """Channels of the export, if it has several."""

    @property
    def all_channels(self) -> dict[str, ChannelSource]:
        """Return the channels, keyed by name; empty for marker tracks."""
        only_channel = {self._name: self} if self._list_channel_keys() else {}
        return {**only_channel, **(self.channels or {})}

    def _list_channel_keys(self) -> list[str]:
        """List the stated keys of a single channel, without those that cameras have, too."""
        camera_keys = {"scale_uncertainty", "certificate"} if self._name == "markers" else set()
        stated_keys = self.model_fields_set - camera_keys
        return [key for key in ChannelSource.model_fields if key in stated_keys]

    def find_value_faults(self) -> Iterator[Fault]:
        """Find readers and keys that do not fit the role, and missing or faulty channels."""
        yield from super().find_value_faults()
        stated_keys, has_markers = self.model_fields_set, self._name == "markers"
        channel_keys = self._list_channel_keys()
        if "load-frame" not in self.reader:
            for key in {"dialect", "part"} & stated_keys:
                yield Fault.of("protocol.load_frame_key", (key,), is_key=True, key=key)
        readers = MARKER_READERS if has_markers else {*READER_NAMES} - MARKER_READERS
        if not {*self.reader} <= readers:
            content = "marker tracks" if has_markers else "channels"
            found, valid = ", ".join(map(repr, self.reader)), format_nearest_words("", readers)
            yield Fault.of(
                "protocol.wrong_reader", ("reader",), content=content, found=found, valid=valid
            )
        elif has_markers and ("channels" in stated_keys or channel_keys):
            key = "channels" if "channels" in stated_keys else channel_keys[0]
            yield Fault.of("protocol.channel_of_markers", (key,), key=key)
        elif "channels" in stated_keys and channel_keys:
            yield Fault.of("protocol.channels_twice", (channel_keys[0],), key=channel_keys[0])
        elif not (has_markers or self.channels or "channel" in stated_keys):
            yield Fault.of("protocol.no_channels")


def assign_roles(sources: dict[Role, Source]) -> dict[Role, Source]:
    """Assign a role to each source, and a name in labpipe and a dotted key to each channel.

    Parameters
    ----------
    sources : source of each role; a misspelt role is read as the most similar one

    Returns
    -------
    The same sources.
    """
    for role, source in sources.items():
        source._name = role if role in ROLES else sort_by_likeness(role, [*ROLES], limit=1)[0]
        source._key = f"sources.{role}"
        for name, channel in (source.channels or {}).items():
            channel._name, channel._key = name, f"{source.key}.channels.{name}"
    return sources
