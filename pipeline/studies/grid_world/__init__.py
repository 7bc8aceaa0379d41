"""Section 4 of the paper: demonstrations on a grid world under two models of people and two of the robot."""
