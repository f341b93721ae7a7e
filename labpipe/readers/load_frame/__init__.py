"""Exports of load frames: one reader, a dialect (a card of data) per vendor's program."""
