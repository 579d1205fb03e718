"""How good the lighting of a file is: poses, errors in degrees, limits, and the cost of options."""
