"""`python -m pipeline` is `lessbench`."""

from pipeline.cli import main

main()
