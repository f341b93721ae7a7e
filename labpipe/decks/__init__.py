"""Decks: a wire's law as the input of simulation programs, each with its range."""

from labpipe.decks.files import write_decks

__all__ = ["write_decks"]
