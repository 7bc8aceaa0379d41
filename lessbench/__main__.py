"""`python -m lessbench` is `lessbench`."""

from lessbench import main

main()
