"""The frozen vocabulary that every layer speaks: recordings, curves, shapes, results."""
