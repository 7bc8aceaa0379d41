"""What a scene moves and how: joints and their limits, what follows them, what they carry, where all of it is at rest."""
