"""Section 4 of the paper: inference from simulated demonstrations in a grid world, under several models of choice."""
