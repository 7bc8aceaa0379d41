"""Section 5 of the paper: how much a posterior depends on which alternatives were sampled."""
