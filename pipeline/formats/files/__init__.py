"""Files of no format: written whole or not at all, locked, and given up when the parent process ends."""
