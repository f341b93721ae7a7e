"""Decks: the law of a wire as input of simulation programs, each with its range."""

from labpipe.decks.deck_files import deck_paths, deck_texts, write_decks, write_texts

__all__ = ["deck_paths", "deck_texts", "write_decks", "write_texts"]
