"""Kernel sums over feature space: densities, bandwidths, and the engines that compute them."""
