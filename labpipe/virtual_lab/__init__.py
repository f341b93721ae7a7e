"""labpipe.virtual_lab."""
