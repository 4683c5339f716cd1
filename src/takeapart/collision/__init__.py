"""Part against part, near its place: how far apart surfaces are, how deep they overlap, and how far a part moves until
it meets another. No arm. Kernels by numba."""
