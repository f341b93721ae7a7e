"""Result files: HDF5 and summary.json, written whole or not at all, read with every check."""
