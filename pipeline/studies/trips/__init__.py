"""Which model of choice predicts the roads that people take: real trips, and paths drawn by samplers."""
