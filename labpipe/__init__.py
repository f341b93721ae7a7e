"""Results, intervals and figures from the raw exports of a wire-harness test lab.

Functions for Python and notebooks:

- ``labpipe.open(path)`` opens a processed test;
- ``labpipe.process(source)`` processes a test in memory;
- ``labpipe.table(folder)`` and ``labpipe.groups(folder)`` collect many processed tests;
- ``labpipe.inspect(file)`` describes an export.

Importing labpipe imports nothing else, because each of these names is imported at its first use.
"""

import sys as _sys
from importlib import import_module as _import_module
from types import ModuleType as _ModuleType

__version__ = "0.2.0"
_API_NAMES = ("Export", "Test", "groups", "inspect", "open", "process", "table")


def __getattr__(name: str) -> object:
    """Import a name of ``labpipe.api`` when it is first used (PEP 562)."""
    if name == "process":  # the package with this name can be called as a function
        return _import_module("labpipe.process")
    if name in _API_NAMES:
        attribute = getattr(_import_module("labpipe.api"), name)
        globals()[name] = attribute
        return attribute
    message = f"module 'labpipe' has no attribute {name!r}"
    raise AttributeError(message)


def __dir__() -> list[str]:
    return sorted({*globals(), *_API_NAMES})


class _CallablePackage(_ModuleType):
    """A package that can also be called as a function: `labpipe.process`."""

    def __call__(self, *args: object, **keywords: object) -> object:
        return getattr(_import_module("labpipe.api"), self.__name__.rpartition(".")[2])(
            *args, **keywords
        )


def _make_callable(package: str) -> None:
    """Make an imported package callable, like the function of `labpipe.api` with its name."""
    _sys.modules[package].__class__ = _CallablePackage
