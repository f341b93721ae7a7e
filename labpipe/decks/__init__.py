"""Decks: a wire's law as the input of simulation programs, each with its range."""

from labpipe.decks.files import deck_paths, write_decks

__all__ = ["deck_paths", "write_decks"]
