"""Pure geometry on NumPy arrays: cameras, triangulation, structural axes, propagation of covariances."""
