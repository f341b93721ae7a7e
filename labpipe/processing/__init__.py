"""Pure steps between a recording and a curve: arrays in, new arrays out, no files, no protocol."""
