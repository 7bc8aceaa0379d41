"""One thin module per DVC stage: read, check, one pure call, write whole."""
