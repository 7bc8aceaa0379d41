"""Covering the space of trajectories that a person could have chosen, and weighing it."""
