"""labpipe: from the raw exports of a wire-harness test lab to trustworthy numbers and figures."""

__version__ = "0.1.0"
