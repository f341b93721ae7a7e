"""Sizes: plausible ranges, outside of which a value is refused, and standard uncertainties."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, TypeAlias

from pydantic import BeforeValidator, Field, WithJsonSchema

from labpipe.errors import Fault, KeyPath, in_test_sheet
from labpipe.protocol.grammar import Block
from labpipe.protocol.values import Text, quantity_remedy
from labpipe.records.declarations import Distance, Quantity
from labpipe.units import parse_quantity

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
_NO_DIMENSIONS = frozenset({"uncertainty", "labels", "positions"})
"""Blocks in which the keys mean something else."""
Ranges: TypeAlias = Mapping[str, Mapping[str, str]]
"""Ends of the range of each kind of dimension, ``from`` and ``to``, as written."""


AreaUncertainty = Annotated[float, Quantity("m^2", "mm^2", "0.05 mm^2", minimum=0.0)]


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
        """Those that are given, by key, m (of the area m^2)."""
        return {name: value for name, value in vars(self).items() if value is not None}


class PlausibleRange(Block):
    """Least and largest plausible value."""

    start: Text = Field(alias="from", description="Such as 20 N")
    stop: Text = Field(alias="to", description="Such as 2 kN")


def range_faults(stated: object, path: KeyPath, unit: str) -> Iterator[Fault]:
    """Find a plausible range without a unit, or with its ends the wrong way round.

    Parameters
    ----------
    stated : the range as written
    path : way to it
    unit : SI unit of its ends
    """
    texts = dict(stated) if isinstance(stated, Mapping) else {}
    ends = [
        quantity_in(texts[key], unit, (*path, key), "20")
        for key in ("from", "to")
        if isinstance(texts.get(key), str)
    ]
    yield from (end for end in ends if isinstance(end, Fault))
    sizes = [end for end in ends if isinstance(end, float)]
    if len(sizes) == 2 and not 0.0 <= sizes[0] < sizes[1]:
        expected = "'from' of at least zero, and 'to' above it"
        yield Fault(path, expected, f"{sizes[0]:g} to {sizes[1]:g} {unit}", "Correct them.")


def quantity_in(text: str, unit: str, path: KeyPath, example: str) -> float | Fault:
    """Read a quantity in a unit, or return what is wrong with it.

    Parameters
    ----------
    text : as written
    unit : in which it is wanted
    path : way to it
    example : number of an example
    """
    try:
        return parse_quantity(text, unit)
    except ValueError:
        such = unit.replace("(", "").replace(")", "")
        remedy = quantity_remedy(text, unit, f"{example} {such}")
        return Fault(path, f"a quantity with a unit such as {such}", repr(text), remedy)


if TYPE_CHECKING:
    _Kind = str
else:
    _Kind = Literal[tuple(PLAUSIBLE)]


def _filled(stated: object) -> object:
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
    BeforeValidator(_filled),
    Field(validate_default=True),
    WithJsonSchema(
        {
            "type": "object",
            "properties": {kind: _schema_of(*ends) for kind, (_, *ends) in PLAUSIBLE.items()},
            "additionalProperties": False,
        }
    ),
]


def ranges_in(data: Mapping[str, object]) -> Ranges:
    """Read the ranges of a protocol or a harness as written.

    Parameters
    ----------
    data : with or without the key ``plausible``

    Returns
    -------
    The range of each kind of dimension that has one; its ends may be wrong, a fault of its own.
    """
    ranges: Any = _filled(data.get("plausible") or {})
    kinds = PLAUSIBLE.items() if isinstance(ranges, Mapping) else ()
    return {kind: ranges[kind] for kind, _ in kinds if isinstance(ranges[kind], Mapping)}


def plausible_faults(
    data: Mapping[str, object], blocks: Collection[str], *, in_file: bool = False
) -> Iterator[Fault]:
    """Find wrong ranges in a file, and dimensions in some of its blocks that are outside theirs.

    Parameters
    ----------
    data : the file as written
    blocks : keys of the blocks
    in_file : whether a range is widened in the file itself, which no test sheet can override
    """
    stated = data.get("plausible")
    for kind, ends in stated.items() if isinstance(stated, Mapping) else ():
        if kind in PLAUSIBLE:
            yield from range_faults(ends, ("plausible", kind), PLAUSIBLE[kind][0])
    for block in blocks:
        yield from implausible(data.get(block), (block,), ranges_in(data), in_file=in_file)


def implausible(
    node: object,
    path: KeyPath,
    ranges: Ranges,
    *,
    others: Collection[str] = (),
    in_file: bool = False,
) -> Iterator[Fault]:
    """Find dimensions that are outside the plausible range of their kind.

    Parameters
    ----------
    node : block, list or value as written; what is no quantity is a fault of its own
    path : way to it
    ranges : by kind of dimension
    others : keys of further lengths, whose names say no kind
    in_file : as for `plausible_faults`
    """
    if isinstance(node, Mapping):
        for key in node.keys() - _NO_DIMENSIONS:
            yield from implausible(node[key], (*path, key), ranges, others=others, in_file=in_file)
    elif isinstance(node, list):
        for number, item in enumerate(node):
            yield from implausible(item, (*path, number), ranges, others=others, in_file=in_file)
    elif isinstance(node, str):
        key = next(str(part) for part in reversed(path) if isinstance(part, str))
        kind = KEYS.get(key) or KEYS.get(key.rpartition("_")[2]) or ("other" * (key in others))
        if kind in ranges:
            yield from _outside(kind, node, path, ranges[kind], in_file=in_file)


def _outside(
    kind: str, text: str, path: KeyPath, ends: Mapping[str, str], *, in_file: bool
) -> Iterator[Fault]:
    unit = PLAUSIBLE[kind][0]
    try:
        size = abs(parse_quantity(text, unit))
        low, high = (parse_quantity(ends[end], unit) for end in ("from", "to"))
    except ValueError:
        return
    if low <= size <= high or low >= high:
        return
    end = "from" if size < low else "to"
    override = in_test_sheet(f"plausible.{kind}.{end}", text)
    if in_file:
        override = f"'plausible: {{{kind}: {{{end}: {text}}}}}'"
    name = kind.replace("_", " ") if kind != "other" else "dimension"
    expected = f"a plausible {name}, {ends['from']} to {ends['to']}"
    remedy = f"Correct number or unit; if both are right, write {override}."
    yield Fault(path, expected, repr(text), remedy)
