"""Define the frozen records of all layers: recordings, curves, shapes, results, groups."""
