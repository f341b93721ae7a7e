"""What a shipped protocol says its inputs are uncertain by: a machine is off by as much.

Read from the YAML as it stands, without labpipe.
"""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import Any

import yaml

PROTOCOLS = Path(__file__).resolve().parents[3] / "protocols"
UNITS = {"": 1.0, "%": 0.01, "mm": 1e-3, "um": 1e-6, "m": 1.0}


@cache
def _said(protocol: str) -> dict[str, Any]:
    text = (PROTOCOLS / f"{protocol}.yaml").read_text(encoding="utf-8")
    made: dict[str, Any] = yaml.safe_load(text)
    return made


def stated(protocol: str, *path: str) -> float:
    """A standard uncertainty, SI; 0 where the protocol does not state it.

    Parameters
    ----------
    protocol : name of a shipped one
    path : keys, such as ``markers``, ``centre_uncertainty``
    """
    found: Any = _said(protocol)
    for key in path:
        found = found.get(key, {}) if isinstance(found, dict) else {}
    if isinstance(found, dict):
        return 0.0
    matched = re.fullmatch(r"([\d.]+) ?(%|[a-z]*)", str(found))
    assert matched is not None, (protocol, path, found)
    return float(matched[1]) * UNITS[matched[2]]


def force_channel(protocol: str) -> tuple[str, ...]:
    """Keys of the channel that the force comes from."""
    sources = _said(protocol)["sources"]
    if "channel" in sources.get("force", {}):
        return "sources", "force"
    role = "force" if "force" in sources else "frame"
    return "sources", role, "channels", "force"


def zero_drift(protocol: str) -> float:
    """How far the zero of the force moves in a test, a share of the largest force."""
    return stated(protocol, *force_channel(protocol), "zero_drift")


def scale(protocol: str, role: str, channel: str = "") -> float:
    """Of a channel's scale, a ratio.

    Parameters
    ----------
    protocol : name of a shipped one
    role : of the source
    channel : of the source; empty where it has one
    """
    where = ("sources", role, *(("channels", channel) if channel else ()))
    gain = stated(protocol, *where, "calibration", "gain_uncertainty")
    return float((gain**2 + stated(protocol, *where, "scale_uncertainty") ** 2) ** 0.5)
