"""Trips in a road network, as sparse text matrices."""
