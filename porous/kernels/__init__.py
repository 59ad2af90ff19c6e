"""The loops: the only folder that imports numba. Arrays in, arrays out."""
