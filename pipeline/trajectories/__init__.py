"""Numerics of paths: time bases, samplers, planning, simulated participants, paths through a grid world."""
