"""Frozen records that all layers share: recordings, curves, shapes, results, groups."""
