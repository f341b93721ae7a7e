"""The model of a bundle of wires: where they lie, and how stiff they are together."""
