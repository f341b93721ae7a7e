"""Pure fitters: lines, corners and the numbers of a curve, each with a 95 % interval."""
