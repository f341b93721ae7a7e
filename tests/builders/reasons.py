"""Reasons of the results in a ``summary.json``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def codes(result: Mapping[str, Any]) -> list[str]:
    """Codes of the reasons of a result."""
    return [each["code"] for each in result["reasons"]]


def why(result: Mapping[str, Any]) -> str:
    """Codes and sentences of the reasons of a result, as the commands print them."""
    return "; ".join(f"{each['code']}: {each['message']}" for each in result["reasons"])
