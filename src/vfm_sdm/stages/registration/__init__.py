"""Sub-pixel registration of image subsets: kernels, subsets, correlation peaks."""
