"""`lessbench watch`: a folder is followed, and what its recordings say is shown and kept."""
