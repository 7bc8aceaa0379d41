"""Recordings for the Rerun viewer, and the servers that hand them to viewers on this machine."""
