"""Cards of smallest forces that come with labpipe: YAML, each with the source of its numbers."""

from __future__ import annotations

from importlib.resources import files

from labpipe.protocol.yaml_text import FaultsError, build_choice_fault, parse_yaml


def read_limit_card(name: object) -> object:
    """Read a shipped card by its name.

    Parameters
    ----------
    name : such as ``crimp-pull``; a card that is written out is returned as it is

    Raises
    ------
    FaultsError
        If labpipe has no card of this name.
    """
    if not isinstance(name, str):
        return name
    folder = files(__name__)
    cards = [path.name.removesuffix(".yaml") for path in folder.iterdir() if ".yaml" in path.name]
    if name not in cards:
        raise FaultsError(build_choice_fault((), name, cards, "a card or one of"))
    text = (folder / f"{name}.yaml").read_text(encoding="utf-8")
    return parse_yaml(text, name).data
