"""Pure numerics of paths: time base, samplers, planning, simulated participants, grid-world paths."""
