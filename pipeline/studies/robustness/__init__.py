"""Section 5 of the paper: how far a posterior depends on which alternatives were sampled."""
