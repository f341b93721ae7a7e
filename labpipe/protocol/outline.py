"""The outline of a protocol: its names and tags, readable even where details are wrong.

The checks of one part of a protocol against another look at this outline and not at the finished
models, so that a misspelt key in one place hides nothing that is wrong in another.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from labpipe.errors import KeyPath, nearest
from labpipe.protocol.quantities import SI_UNITS
from labpipe.protocol.source import MARKER_READERS, READERS, ROLES
from labpipe.protocol.steps import STEPS

Values: TypeAlias = Mapping[str, object]

CHANNEL_KEYS = (
    *("channel", "unit", "wrong_unit_in_file", "calibration"),
    *("quantity", "plausible_peak", "scale_uncertainty"),
)


@dataclass(frozen=True, slots=True)
class ChannelOutline:
    """One channel of a source.

    Parameters
    ----------
    name : as labpipe calls it
    role : of its source
    path : way to its block
    values : what the block says
    """

    name: str
    role: str
    path: KeyPath
    values: Values

    @property
    def quantity(self) -> str | None:
        """What it measures; None if that is missing."""
        said = self.values.get("quantity")
        return said if isinstance(said, str) else self.name if self.name in SI_UNITS else None

    @property
    def unit(self) -> str | None:
        """SI unit of what it measures; None if that is not known."""
        return SI_UNITS.get(self.quantity or "")


@dataclass(frozen=True, slots=True)
class Outline:
    """Names and tags of a protocol as written.

    Parameters
    ----------
    data : the protocol as plain values
    """

    data: Values

    def block(self, *path: str) -> Values:
        """Find the block under a path; empty if there is none."""
        node: object = self.data
        for key in path:
            node = node.get(key) if isinstance(node, Mapping) else None
        return node if isinstance(node, Mapping) else {}

    def entries(self, key: str, tag: str) -> Iterator[tuple[int, str, Values]]:
        """List the blocks of a list that have a tag: number, tag, block."""
        items = self.data.get(key)
        for number, item in enumerate(items if isinstance(items, list) else []):
            if isinstance(item, Mapping) and isinstance(item.get(tag), str):
                yield number, item[tag], item

    @property
    def sources(self) -> dict[str, Values]:
        """The sources by role."""
        return {role: self.block("sources", role) for role in self.block("sources")}

    def readers(self, role: str) -> list[str]:
        """Known readers that a source names."""
        said = self.sources[role].get("reader")
        words = said if isinstance(said, list) else [said]
        return [word for word in words if word in READERS]

    def has_markers(self) -> bool:
        """Say whether any source gives marker tracks."""
        roles = self.sources
        return "markers" in roles or any(MARKER_READERS & set(self.readers(role)) for role in roles)

    @property
    def channels(self) -> list[ChannelOutline]:
        """The channels of all sources."""
        found = []
        for role, source in self.sources.items():
            if any(key in source for key in CHANNEL_KEYS):
                name = role if role in ROLES else nearest(role, list(ROLES), most=1)[0]
                found.append(ChannelOutline(name, role, ("sources", role), source))
            for name in self.block("sources", role, "channels"):
                path = ("sources", role, "channels", name)
                found.append(ChannelOutline(name, role, path, self.block(*path)))
        return found

    @property
    def clamp(self) -> bool:
        """Say whether a rigid body marks the clamp."""
        return self.block("markers").get("clamp") is not None

    def made_by(self, tag: str, step: Values) -> tuple[str, ...]:
        """Channels that a step adds to those of the sources."""
        if tag == "specimen-frame" and not self.clamp:
            return ()
        makes = STEPS[tag].makes if tag in STEPS else ()
        return tuple(name.format_map({"channel": None, **step}) for name in makes)

    @property
    def made(self) -> list[str]:
        """Channels that the steps add, in order."""
        return [
            name
            for _, tag, step in self.entries("steps", "step")
            for name in self.made_by(tag, step)
        ]

    @property
    def from_speed(self) -> dict[str, str]:
        """Channels that are made from crosshead speed, and the force that each is made with."""
        return {
            str(step.get("channel")): str(step.get("force"))
            for _, tag, step in self.entries("steps", "step")
            if tag == "travel-from-speed"
        }

    def is_optional(self, role: str) -> bool:
        """Say whether a test may lack a source."""
        return str(self.block("sources", role).get("optional")).lower() == "true"

    def clock_of(self, channel: str) -> str | None:
        """Role whose clock a channel is on; None for an unknown channel."""
        own = next((each.role for each in self.channels if each.name == channel), None)
        if own is not None:
            return own
        force = self.from_speed.get(channel)
        if force is not None:
            return next((each.role for each in self.channels if each.name == force), None)
        return "markers" if channel in self.made else None

    def unit_of(self, channel: str) -> str | None:
        """SI unit of a channel; None where it is not known."""
        if channel in self.made:
            return "m"
        return next((each.unit for each in self.channels if each.name == channel), None)

    @property
    def turning_points(self) -> bool:
        """Say whether two clocks are joined at the turning points of a clamp."""
        return self.block("align").get("method") == "turning-points"

    @property
    def joins_clocks(self) -> bool:
        """Say whether two clocks are joined."""
        return self.block("align").get("method") in ("turning-points", "common-start", "stated")
