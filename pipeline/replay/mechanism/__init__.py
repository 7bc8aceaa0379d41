"""What a scene moves and how: joints and their limits, what follows them, what they carry, and where it is at rest."""
